"""The training loop: all seeds move in lock-step through episodes, one gradient step per environment step.

Order of an update: targets, critic, actor with the updated critic, soft updates. A seed whose episode has ended waits
for the others; what it would store or change while it waits is masked, so that it never knows who runs beside it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .algorithms.table import algorithm_of
from .environment import Environment, Lanes
from .losses import Networks, targets
from .networks import Layout, Tensor, initial_parameters
from .optimiser import Adam, Mask, soft_update
from .options import TrainingOptions
from .replay import Replay, Transitions
from .streams import Streams
from .task import Task

Array = NDArray[np.float64]

REVERSION = 0.15
"""Share of an Ornstein-Uhlenbeck noise that decays per step."""


@dataclass(frozen=True)
class EpisodeStatistics:
    """What happened in one episode; arrays of shape (S,).

    Attributes
    ----------
    episode : int
        1 for the first.
    returns : array
        Discounted, of the noisy actions.
    steps : array of int
    critic_loss, actor_loss : array
        Means over the episode's updates; NaN where there was none.
    """

    episode: int
    returns: Array
    steps: NDArray[np.int64]
    critic_loss: Array
    actor_loss: Array


class Trainer:
    """Training of all seeds of one run.

    Parameters
    ----------
    lanes : Lanes
        What is trained on, one lane per seed.
    options : TrainingOptions
    """

    def __init__(self, lanes: Lanes, options: TrainingOptions) -> None:
        self.lanes, self.options = lanes, options
        self.seeds = options.seed_numbers
        self.discount = lanes.discount if options.discount is None else options.discount
        self.epsilon = lanes.epsilon if options.epsilon is None else options.epsilon
        self.dtype = torch.float32 if options.precision == "float32" else torch.float64
        self.device = options.device
        self.streams = Streams(self.seeds)
        n, m = lanes.inputs, lanes.actions
        actor_layout = Layout((n, *options.hidden, m), True)
        critic_layout = Layout((n + m, *options.hidden, 1), False)
        weights = self.streams.of("weights")
        critics = 2 if options.base == "td3" else 1
        actor = initial_parameters(actor_layout, weights, self.dtype).to(self.device)
        critic = torch.cat([initial_parameters(critic_layout, weights, self.dtype) for _ in range(critics)])
        critic = critic.to(self.device)
        self.networks = Networks(actor_layout, critic_layout, actor, critic, actor.clone(), critic.clone())
        self.actor_adam = Adam(actor, options.actor_learning_rate)
        self.critic_adam = Adam(critic, options.critic_learning_rate, options.critic_decay)
        rows = torch.from_numpy(self.epsilon * lanes.perturbation).to(self.dtype).to(self.device)
        self.algorithm = algorithm_of(options, self.epsilon, rows)
        columns = self.algorithm.columns(self.networks)
        capacity = min(options.buffer, max(options.episodes * lanes.horizon, options.warmup))
        self.replay = Replay(len(self.seeds), capacity, n, m, columns, dtype=self.dtype, device=self.device)
        self.episode = 0
        self.updates = np.zeros(len(self.seeds), dtype=np.int64)
        self._actor_gradient = torch.zeros_like(actor)
        self._critic_gradient = torch.zeros_like(critic)
        self._everyone = Mask(np.ones(len(self.seeds), dtype=np.bool_), actor)
        # gradients are most of an update, and the only part whose shapes and branches never change
        self._regress, self._climb = self._critic_loss, self._actor_loss
        if options.compile:
            self._regress, self._climb = (torch.compile(f, dynamic=False) for f in (self._regress, self._climb))

    @property
    def actor(self) -> Tensor:
        """Parameters of all policies, (S, P)."""
        return self.networks.actor

    @property
    def actor_layout(self) -> Layout:
        """Their shape."""
        return self.networks.actor_layout

    @property
    def critic(self) -> Tensor:
        """Parameters of the critics that the policies climb, (S, P)."""
        return self.networks.first_critic

    @property
    def critic_layout(self) -> Layout:
        """Their shape."""
        return self.networks.critic_layout

    def run_episode(self) -> EpisodeStatistics:
        """One episode of every seed, with its updates."""
        with torch.no_grad():
            return self._run_episode()

    def _run_episode(self) -> EpisodeStatistics:
        lanes, options, streams, count = self.lanes, self.options, self.streams, len(self.seeds)
        horizon = lanes.horizon
        forces = lanes.sample_forces(streams)
        noise = self._exploration()
        draws = streams.uniform("batch", (horizon, options.batch))
        smoothing = self._smoothing()
        attack = self._tensor(streams.uniform("attack", (horizon, self.algorithm.draws)))
        x = lanes.reset(lanes.sample_starts(streams))
        active = np.ones(count, dtype=np.bool_)
        returns, steps = np.zeros(count), np.zeros(count, dtype=np.int64)
        losses = torch.zeros((2, count), dtype=self.dtype, device=self.device)
        done = np.zeros((2, count), dtype=np.int64)
        for t in range(horizon):
            decision = self.algorithm.act(self.networks, x[:, None], attack[:, t])
            action = (decision.action + noise[:, t]).clamp_(-1.0, 1.0)
            step = lanes.step(action, forces[:, t])
            last = t == horizon - 1 and options.time_limit == "terminal"
            terminal = torch.ones_like(step.reward) if last else step.ended.to(self.dtype)
            parts = [x, action, step.reward[:, None], step.observation, terminal[:, None]]
            if decision.columns is not None:
                parts.append(decision.columns.flatten(1))
            self.replay.add(parts, active)
            returns += self.discount**t * step.reward.double().cpu().numpy() * active
            steps += active
            ready = active & (self.replay.stored >= options.warmup)
            if ready.any():
                done += self._update(draws[:, t], None if smoothing is None else smoothing[:, t], ready, losses)
            active &= ~step.ended.cpu().numpy()
            if not active.any():
                break
            x = step.observation
        self.episode += 1
        means = np.where(done > 0, losses.double().cpu().numpy() / np.maximum(done, 1), np.nan)
        return EpisodeStatistics(self.episode, returns, steps, means[0], means[1])

    def _tensor(self, values: Array) -> Tensor:
        return torch.from_numpy(values).to(self.dtype).to(self.device)

    def _exploration(self) -> Tensor:
        """Noise on the actions of one episode, (S, T, m)."""
        options = self.options
        noise = options.exploration * self.streams.normal("exploration", (self.lanes.horizon, self.lanes.actions))
        if options.exploration_process == "ornstein-uhlenbeck":
            for t in range(1, noise.shape[1]):
                noise[:, t] += (1.0 - REVERSION) * noise[:, t - 1]
        return self._tensor(noise)

    def _smoothing(self) -> Tensor | None:
        """TD3's noise on the target actions of one episode, (S, T, B, m)."""
        options = self.options
        if options.base != "td3":
            return None
        noise = self.streams.normal("smoothing", (self.lanes.horizon, options.batch, self.lanes.actions))
        return self._tensor(np.clip(options.smoothing * noise, -options.smoothing_clip, options.smoothing_clip))

    def _update(
        self, draws: Array, smoothing: Tensor | None, ready: NDArray[np.bool_], losses: Tensor
    ) -> NDArray[np.bool_]:
        """One update of the seeds that are `ready`: adds to both losses (2, S), and says where they were computed."""
        options, networks = self.options, self.networks
        batch = self.replay.sample(draws)
        self.updates += ready
        regressing = climbing = self._everyone if ready.all() else Mask(ready, self.actor)
        if options.base == "td3":
            climbing = Mask(ready & (self.updates % options.policy_delay == 0), self.actor)
        critics = networks.critics
        critic_loss = self._regress(batch, smoothing)
        self.critic_adam.step(self._critic_gradient, regressing.repeated(critics, self.actor))
        if critics > 1:
            critic_loss = critic_loss.unflatten(0, (critics, -1)).mean(0)
        losses[0].addcmul_(critic_loss, regressing.column[:, 0])
        if climbing.any:
            losses[1].addcmul_(self._climb(batch), climbing.column[:, 0])
            self.actor_adam.step(self._actor_gradient, climbing)
            share = options.target_update
            soft_update(networks.target_critic, networks.critic, share, climbing.repeated(critics, self.actor))
            soft_update(networks.target_actor, networks.actor, share, climbing)
        return np.stack([regressing.rows, climbing.rows])

    def _critic_loss(self, batch: Transitions, smoothing: Tensor | None) -> Tensor:
        networks = self.networks
        y = targets(networks, batch.following, batch.reward, batch.terminal, self.discount, smoothing)
        return self.algorithm.critic(networks, batch, y, self._critic_gradient)

    def _actor_loss(self, batch: Transitions) -> Tensor:
        return self.algorithm.actor(self.networks, batch, self._actor_gradient)

    def _parts(self) -> dict[str, Adam | Replay]:
        return {"actor_adam": self.actor_adam, "critic_adam": self.critic_adam, "replay": self.replay}

    def tensors(self) -> dict[str, Tensor]:
        """Everything that training changes, as tensors; with `numbers` the whole state of a run."""
        networks = self.networks
        found = {
            "actor": networks.actor,
            "critic": networks.critic,
            "target_actor": networks.target_actor,
            "target_critic": networks.target_critic,
        }
        for prefix, part in self._parts().items():
            found |= {f"{prefix}.{name}": value for name, value in part.tensors().items()}
        return found

    def numbers(self) -> dict[str, Any]:
        """The rest of the state: plain data."""
        return {"episode": self.episode, "updates": self.updates.tolist(), "streams": self.streams.state()}

    def restore(self, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> None:
        """Continue where `tensors` and `numbers` were taken, bit for bit on one thread."""
        networks = self.networks
        for name in ("actor", "critic", "target_actor", "target_critic"):
            getattr(networks, name).copy_(tensors[name])
        for prefix, part in self._parts().items():
            mine = {name: value for name, value in tensors.items() if name.startswith(f"{prefix}.")}
            part.restore({name.removeprefix(f"{prefix}."): value for name, value in mine.items()})
        self.episode = int(numbers["episode"])
        self.updates = np.array(numbers["updates"], dtype=np.int64)
        self.streams.restore(numbers["streams"])


def make_lanes(task: Task, options: TrainingOptions) -> Environment:
    """The lock-step environment of a run: one lane per seed."""
    dtype = torch.float32 if options.precision == "float32" else torch.float64
    return Environment(task, options.seeds, dtype=dtype, device=options.device, goal_stop=options.goal_stop)
