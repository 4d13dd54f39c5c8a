"""What training costs: CPU milliseconds per update and seed, against the point algorithm and Stable-Baselines3.

    OMP_NUM_THREADS=1 python benchmarks/training.py [--seeds 5] [--rounds 9] [--compiled] [--baselines]

Everything is measured on one thread in one process, interleaved: every round runs some episodes of every candidate, and
medians over the rounds are compared, so that a machine that slows down slows all of them. --baselines needs
stable-baselines3 (pip install stable-baselines3), which nothing else here does.
"""

from __future__ import annotations

import argparse
import platform
import resource
import statistics
import time
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import torch

from setrl.specs.reader import find_specification, read_specification
from setrl.train.configuration import configure
from setrl.train.options import ALGORITHMS
from setrl.train.task import start_bounds, task_of
from setrl.train.trainer import Trainer, make_lanes

EPISODES = 4
"""Per candidate and round."""
BASELINE_STEPS = 120
"""Environment steps of Stable-Baselines3 per round."""

Measured = Callable[[], float]
"""Runs a while and returns CPU milliseconds per update and seed."""


def candidate(specification: str, algorithm: str, seeds: int, **changes: Any) -> Measured:
    """A trainer behind its warm-up."""
    contract = read_specification(find_specification(specification))
    found = configure(contract, {"algorithm": algorithm})
    options = replace(found.options, seeds=seeds, goal_stop=0.0, episodes=2000, **changes)
    task = task_of(contract, None if found.start is None else start_bounds(found.start))
    trainer = Trainer(make_lanes(task, options), options)
    for _ in range(5):
        trainer.run_episode()

    def measure() -> float:
        before, started = int(trainer.updates.sum()), time.process_time()
        for _ in range(EPISODES):
            trainer.run_episode()
        return 1000.0 * (time.process_time() - started) / (int(trainer.updates.sum()) - before)

    return measure


def stable_baselines(specification: str) -> Measured:
    """Stable-Baselines3's DDPG with the same networks, batch and one update per environment step."""
    from stable_baselines3 import DDPG

    from setrl.train.gymnasium_environments import make_environment

    contract = read_specification(find_specification(specification))
    environment = make_environment(specification, start=configure(contract, {}).start)
    model = DDPG(
        "MlpPolicy",
        environment,
        batch_size=64,
        learning_starts=64,
        train_freq=1,
        gradient_steps=1,
        policy_kwargs={"net_arch": [64, 32]},
        device="cpu",
    )
    model.learn(300)

    def measure() -> float:
        started = time.process_time()
        model.learn(BASELINE_STEPS, reset_num_timesteps=False)
        return 1000.0 * (time.process_time() - started) / BASELINE_STEPS

    return measure


def main() -> None:
    """Measure and print a table."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--specification", default="quadrotor1d")
    parser.add_argument("--seeds", type=int, default=5)
    parser.add_argument("--rounds", type=int, default=9)
    parser.add_argument("--compiled", action="store_true", help="also with torch.compile")
    parser.add_argument("--baselines", action="store_true", help="also Stable-Baselines3")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    candidates = {name: candidate(arguments.specification, name, arguments.seeds) for name in ALGORITHMS}
    for name in ("pa-pc", "sa-pc", "sa-sc"):
        candidates[f"{name} td3"] = candidate(arguments.specification, name, arguments.seeds, base="td3")
    if arguments.compiled:
        for name in ("pa-pc", "sa-pc", "sa-sc"):
            started = time.perf_counter()
            candidates[f"{name} compiled"] = candidate(arguments.specification, name, arguments.seeds, compile=True)
            print(f"# {name}: compiled in {time.perf_counter() - started:.0f} s")
    if arguments.baselines:
        candidates["stable-baselines3 ddpg"] = stable_baselines(arguments.specification)
    taken: dict[str, list[float]] = {name: [] for name in candidates}
    for _ in range(arguments.rounds):
        for name, measure in candidates.items():
            taken[name].append(measure())
    medians = {name: statistics.median(values) for name, values in taken.items()}
    ratios = {
        name: statistics.median(mine / point for mine, point in zip(values, taken["pa-pc"], strict=True))
        for name, values in taken.items()
    }
    print(f"# {platform.machine()}, Python {platform.python_version()}, torch {torch.__version__}, 1 thread")
    print(f"# {arguments.specification}, {arguments.seeds} seeds side by side, medians of {arguments.rounds} rounds")
    print(f"{'':24}{'ms/update/seed':>16}{'ratio to pa-pc':>16}")
    for name, value in medians.items():
        print(f"{name:24}{value:16.3f}{ratios[name]:16.2f}")
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    print(f"# peak memory of this process: {peak:.0f} MiB")


if __name__ == "__main__":
    main()
