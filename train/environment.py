"""Training episodes of many lanes in lock-step: the closed loop without its policy, one control period per step.

A lane is a seed, or a seed and one of its evaluation runs. Lanes do not influence each other: everything here is
elementwise over them, so that a lane's numbers do not depend on how many run beside it.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Protocol, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.closed_loop import BoundAffine, BoundPolytope
from ..models.tape import Tape
from ..specs.errors import UsageError
from .dynamics import Discretisation
from .streams import Streams
from .tape_programs import Program
from .task import Task, sample_forces, sample_starts

Array = NDArray[np.float64]
Tensor: TypeAlias = torch.Tensor


@dataclass(frozen=True, eq=False)
class Step:
    """What one step returns, on the lanes' device.

    Attributes
    ----------
    observation : Tensor, shape (L, inputs)
        Of the state at the end of the step: what the policy network takes next, without perturbation.
    reward : Tensor, shape (L,)
        Of the state at the end of the step, not discounted.
    ended : Tensor of bool, shape (L,)
        The episode is over for its own reasons (the goal stop, a fall), never for the time limit.
    """

    observation: Tensor
    reward: Tensor
    ended: Tensor


class Lanes(Protocol):
    """What a trainer needs to know of the world: `Environment`, or `gymnasium_environments.GymnasiumLanes`.

    Attributes
    ----------
    lanes : int
        How many run in lock-step.
    inputs, actions : int
        Numbers that a policy network takes and returns; what it returns is in [-1, 1].
    horizon : int
        Steps of an episode.
    discount, epsilon : float
        Discount of the return; largest radius of the perturbation of the network's input.
    perturbation : array, shape (q, inputs)
        Generator rows of the set of perturbed inputs at radius 1.
    """

    @property
    def lanes(self) -> int: ...
    @property
    def inputs(self) -> int: ...
    @property
    def actions(self) -> int: ...
    @property
    def horizon(self) -> int: ...
    @property
    def discount(self) -> float: ...
    @property
    def epsilon(self) -> float: ...
    @property
    def perturbation(self) -> Array: ...

    def sample_starts(self, streams: Streams) -> Array:
        """One row per seed that `reset` takes, from the stream "start"."""

    def sample_forces(self, streams: Streams) -> Array:
        """(S, horizon, d): what `step` takes, from the stream "disturbance"; d may be 0."""

    def reset(self, starts: Array) -> Tensor:
        """Begin an episode in every lane; observations (L, inputs)."""

    def step(self, action: Tensor, force: Array) -> Step:
        """One step of every lane from network outputs (L, actions) and disturbances (L, d)."""


class Environment:
    """The closed loop of a task without its policy.

    A step maps the network's output by `after`, clips it, queues it where the controller has a delay, moves the plant
    by one period, and observes. The reward is that of the state at the end,
    ``-weights' |s - target| - penalty [s in region]``.

    A lane is *lost* once its state, observation or reward is no finite number of `dtype`. Its state then stays the last
    good one until the next `reset`, and so do its observation and its reward; it is never `ended`, because an end
    would save it the costs of the steps that are left. The other lanes do not notice.

    Parameters
    ----------
    task : Task
    lanes : int
    dtype : torch.dtype
        Of what is returned; states are float64.
    device : str
        Of what is returned; states are numpy arrays.
    goal_stop : float
        A lane has ended in every step after which each state with a positive weight is within `goal_stop` of its
        target. 0: never. What follows in an ended lane is simulated all the same.

    Attributes
    ----------
    state : array, shape (L, n)
    lost : array of bool, shape (L,)
    """

    def __init__(
        self, task: Task, lanes: int, *, dtype: torch.dtype, device: str = "cpu", goal_stop: float = 0.0
    ) -> None:
        loop, reward = task.loop, task.loop.reward
        assert reward is not None
        self.task, self.lanes, self.dtype, self.device, self.goal_stop = task, lanes, dtype, device, goal_stop
        self.discretisation = Discretisation(loop.plant, loop.period)
        self._float = np.float32 if dtype == torch.float32 else np.float64
        self._observation = None if loop.observation is None else _Observation(loop.observation, lanes)
        self._before, self._after = (None if m is None else _AffineMap(m, lanes) for m in (loop.before, loop.after))
        self._clip = None if loop.clip is None else np.array(loop.clip, dtype=np.float64).T
        self._delayed = np.tile(np.array(loop.delayed_action, dtype=np.float64), (lanes, 1))
        weighted = [index for index, weight in enumerate(reward.weights) if weight > 0]
        self._weighted = [(index, float(reward.weights[index]), float(reward.target[index])) for index in weighted]
        self._penalty = float(reward.penalty)
        self._region = _float_region(reward.penalty_region) if reward.penalty else []
        self._pending: deque[Array] = deque()
        self.state = np.zeros((lanes, len(loop.plant.states)))
        self.lost = np.zeros(lanes, dtype=bool)
        self._any_lost = False

    @property
    def inputs(self) -> int:
        """Numbers that the policy network takes."""
        return self.task.inputs

    @property
    def actions(self) -> int:
        """Numbers that it returns."""
        return self.task.actions

    @property
    def horizon(self) -> int:
        """Steps of an episode."""
        return self.task.horizon

    @property
    def discount(self) -> float:
        """Of the specification's reward."""
        return self.task.discount

    @property
    def epsilon(self) -> float:
        """Largest observation radius of the specification."""
        return self.task.epsilon

    @property
    def perturbation(self) -> Array:
        """Generator rows of the set of perturbed network inputs at radius 1, (q, inputs)."""
        return self.task.perturbation

    def sample_starts(self, streams: Streams) -> Array:
        """Initial states, uniform in the task's start box, (S, n)."""
        return sample_starts(self.task, streams)

    def sample_forces(self, streams: Streams) -> Array:
        """Disturbances, uniform within their bounds, (S, horizon, d)."""
        return sample_forces(self.task, streams)

    def reset(self, starts: Array) -> Tensor:
        """Begin an episode in every lane.

        Parameters
        ----------
        starts : array, shape (L, n)
            Initial states; not required to lie in the start box.

        Returns
        -------
        Tensor, shape (L, inputs)

        Raises
        ------
        UsageError
            The shape is wrong, or a number or what is observed there is not finite.
        """
        state = np.array(starts, dtype=np.float64)
        if state.shape != self.state.shape:
            raise UsageError(f"initial states of shape {self.state.shape} are required, received {state.shape}")
        with np.errstate(all="ignore"):
            observation = self._observed(state).astype(self._float)
        if not (np.isfinite(state).all() and np.isfinite(observation).all()):
            raise UsageError(
                "an episode begins at finite numbers, the state's and the observation's",
                remedy="draw initial states with sample_starts",
            )
        self.state = state
        self.lost, self._any_lost = np.zeros(self.lanes, dtype=bool), False
        self._pending = deque([self._delayed] * self.task.loop.delay)
        return self._tensor(observation)

    def step(self, action: Tensor, force: Array) -> Step:
        """One control period of every lane.

        Parameters
        ----------
        action : Tensor, shape (L, actions)
            Output of the policy network, in [-1, 1] (not enforced); detached.
        force : array, shape (L, d)
            Disturbances during the period.

        Returns
        -------
        Step
        """
        with np.errstate(all="ignore"):
            given = action.detach().to("cpu", torch.float64).numpy()
            acting = given if self._after is None else self._after(given)
            if self._clip is not None:
                acting = np.clip(acting, *self._clip)
            if self.task.loop.delay:
                self._pending.append(acting.copy())
                acting = self._pending.popleft()
            state = self.discretisation.advance(self.state, acting, force)
            observation, reward = self._judged(state)
            # a sum is finite only if all its terms are: one number decides the usual case
            if self._any_lost or not math.isfinite(state.sum() + observation.sum() + reward.sum()):
                state = self._without_lost(state, observation, reward)
                observation, reward = self._judged(state)
            self.state = state
            return Step(self._tensor(observation), self._tensor(reward), self._ended())

    def _judged(self, state: Array) -> tuple[NDArray[np.floating], NDArray[np.floating]]:
        """Observation and reward in the type that is returned."""
        observation, reward = self._observed(state), np.zeros(self.lanes)
        for index, weight, target in self._weighted:
            reward -= weight * np.abs(state[:, index] - target)
        if self._region:
            reward -= self._penalty * _inside(self._region, state)
        return observation.astype(self._float), reward.astype(self._float)

    def _without_lost(self, state: Array, observation: NDArray[np.floating], reward: NDArray[np.floating]) -> Array:
        good = np.isfinite(state).all(axis=1) & np.isfinite(observation).all(axis=1) & np.isfinite(reward)
        self.lost = self.lost | ~good
        self._any_lost = bool(self.lost.any())
        return np.where(self.lost[:, None], self.state, state)

    def _observed(self, state: Array) -> Array:
        seen = state if self._observation is None else self._observation(state)
        return seen if self._before is None else self._before(seen)

    def _ended(self) -> Tensor:
        if self.goal_stop <= 0.0 or not self._weighted:
            return torch.zeros(self.lanes, dtype=torch.bool, device=self.device)
        ended = ~self.lost
        for index, _, target in self._weighted:
            ended &= np.abs(self.state[:, index] - target) <= self.goal_stop
        return self._tensor(ended)

    def _tensor(self, values: NDArray[np.generic]) -> Tensor:
        tensor = torch.from_numpy(values)
        return tensor if self.device == "cpu" else tensor.to(self.device)


class _Observation:
    """The observation's tape on points (L, n); the result is overwritten by the next call."""

    def __init__(self, tape: Tape, lanes: int) -> None:
        self.arguments = tape, lanes
        self.states = np.zeros((len(tape.inputs), lanes))
        self.values = np.zeros((len(tape.outputs), lanes))
        program = Program(tape, self.states, np.zeros((0, lanes)), self.values)
        self.calls = [*program.held, *program.varying]

    def __reduce__(self) -> tuple[type, tuple[Tape, int]]:
        # the calls' rows are views of the buffers, which a copy would part: a copy is made anew
        return _Observation, self.arguments

    def __call__(self, state: Array) -> Array:
        np.copyto(self.states, state.T)
        for call in self.calls:
            call()
        return self.values.T


class _AffineMap:
    """``matrix @ x + offset`` on points (L, inputs), term by term; zero coefficients are left out."""

    def __init__(self, affine: BoundAffine, lanes: int) -> None:
        self.offset = np.tile(np.array(affine.offset, dtype=np.float64)[:, None], lanes)
        matrix = np.array(affine.matrix, dtype=np.float64)
        self.calls = [
            (column, partial(np.multiply, np.broadcast_to(matrix[:, column, None], self.offset.shape).copy()))
            for column in np.flatnonzero(matrix.any(axis=0))
        ]

    def __call__(self, points: Array) -> Array:
        total = self.offset.copy()
        for column, multiply in self.calls:
            total += multiply(points[:, column])
        return total.T


_Facets: TypeAlias = "list[tuple[list[tuple[int, float]], float]]"
"""Of one polytope: coefficients by state, and the bound."""


def _float_region(region: Sequence[BoundPolytope]) -> list[_Facets]:
    return [
        [
            ([(index, float(entry)) for index, entry in enumerate(normal) if entry], float(bound))
            for normal, bound in zip(member.normals, member.bounds, strict=True)
        ]
        for member in region
    ]


def _inside(region: list[_Facets], state: Array) -> NDArray[np.bool_]:
    """`models.simulation.inside` term by term, whose matrix product depends on the number of lanes."""
    found = np.zeros(len(state), dtype=bool)
    for facets in region:
        member = np.ones(len(state), dtype=bool)
        for terms, bound in facets:
            value = np.zeros(len(state))
            for index, entry in terms:
                value += entry * state[:, index]
            member &= value <= bound
        found |= member
    return found
