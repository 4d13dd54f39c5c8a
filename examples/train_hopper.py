"""Train MuJoCo's Hopper with set-based reinforcement learning, and measure how it walks on disturbed observations.

    pip install 'setrl[train,hopper]'
    python examples/train_hopper.py [episodes] [algorithm]

Hopper is a simulator, not a plant written as expressions: nothing about it can be verified. What is printed is the
worst return of rollouts with uniform noise and under the MAD attack. It bounds the worst return from above, not from
below.
"""

from __future__ import annotations

import sys
from dataclasses import replace

import numpy as np
import torch

from setrl.train.attacks import mad
from setrl.train.gymnasium_environments import GymnasiumLanes
from setrl.train.networks import forward
from setrl.train.options import TrainingOptions, options_from
from setrl.train.streams import Streams
from setrl.train.trainer import Trainer

EPSILON = 0.05
ROLLOUTS = 10


def worst_return(trainer: Trainer, name: str, attack: str, options: TrainingOptions) -> float:
    """Worst undiscounted return of `ROLLOUTS` rollouts of the first seed's policy."""
    lanes = GymnasiumLanes(name, ROLLOUTS, dtype=torch.float32)
    streams = Streams(range(1000, 1000 + ROLLOUTS))
    rows = torch.from_numpy(EPSILON * lanes.perturbation).float()
    layout, actor = trainer.actor_layout, trainer.actor[:1]
    forces = lanes.sample_forces(streams)
    x, alive, total = lanes.reset(lanes.sample_starts(streams)), np.ones(ROLLOUTS, dtype=bool), np.zeros(ROLLOUTS)
    with torch.no_grad():
        for t in range(lanes.horizon):
            draws = torch.from_numpy(streams.uniform("attack", (len(rows),))).float()
            seen = x + (2.0 * draws - 1.0) @ rows
            if attack == "mad":
                seen = mad(layout, actor, x[None], rows, draws[None], options.attack_steps)[0]
            step = lanes.step(forward(layout, actor, seen[None])[0], forces[:, t])
            total += step.reward.double().numpy() * alive
            alive &= ~step.ended.numpy()
            if not alive.any():
                break
            x = step.observation
    lanes.close()
    return float(total.min())


def main(episodes: int = 50, algorithm: str = "sa-pc", name: str = "Hopper-v5") -> None:
    """Train one seed and print what it is worth."""
    torch.set_num_threads(1)
    options = replace(
        options_from({"algorithm": algorithm, "episodes": episodes, "epsilon": EPSILON, "goal_stop": 0.0}),
        time_limit="bootstrap",  # walking has no end that a policy should know of
        buffer=200_000,
    )
    lanes = GymnasiumLanes(name, 1, dtype=torch.float32)
    trainer = Trainer(lanes, options)
    for _ in range(episodes):
        found = trainer.run_episode()
        print(f"episode {found.episode}: {int(found.steps[0])} steps, discounted return {found.returns[0]:.1f}")
    lanes.close()
    for attack in ("noise", "mad"):
        worst = worst_return(trainer, name, attack, options)
        print(f"{attack}: worst of {ROLLOUTS} returns {worst:.1f} at radius {EPSILON}")
        assert np.isfinite(worst)


if __name__ == "__main__":
    main(*(int(argument) if argument.isdigit() else argument for argument in sys.argv[1:]))
