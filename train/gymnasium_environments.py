"""Gymnasium on both sides: the specifications as its environments, and its environments as lanes for the trainer.

Importing this module registers ``setrl/NAME-v0`` for every shipped specification with a reward.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Mapping
from typing import Any, TypeAlias

import gymnasium
import numpy as np
import torch
from gymnasium import spaces
from numpy.typing import NDArray

from ..specs.errors import UsageError
from ..specs.reader import SHIPPED, find_specification, read_specification, shipped_specifications
from ..specs.specification import Specification
from .environment import Environment, Step
from .streams import Streams
from .task import forces_at, start_bounds, starts_at, task_of

Array = NDArray[np.float64]
Tensor: TypeAlias = torch.Tensor


class SpecificationEnvironment(gymnasium.Env):  # type: ignore[misc]
    """One lane of a `train.environment.Environment` as a Gymnasium environment.

    Actions are the network's outputs, in [-1, 1]; observations what the network takes, without perturbation. An episode
    is truncated at the horizon, and terminated by the goal stop only. A state that left the finite numbers truncates
    the episode too, with ``info["lost"]``.

    Parameters
    ----------
    specification : Specification, str or path
        A shipped name, or the path of a YAML file.
    start : mapping of state name to a number or [lower, upper], optional
        Box of initial states; the specification's initial set by default.
    goal_stop : float
        An episode ends once every state with a positive weight is so close to its target; 0: never.

    Raises
    ------
    SetrlError
        The specification cannot be read or trained for, or the start box does not fit.
    """

    metadata: dict[str, Any] = {"render_modes": []}

    def __init__(
        self,
        specification: Specification | str | os.PathLike[str],
        start: Mapping[str, Any] | None = None,
        goal_stop: float = 0.0,
    ) -> None:
        if not isinstance(specification, Specification):
            specification = read_specification(find_specification(specification))
        self.task = task_of(specification, None if start is None else start_bounds(start))
        self.lane = Environment(self.task, 1, dtype=torch.float64, goal_stop=goal_stop)
        self.observation_space = spaces.Box(-np.inf, np.inf, (self.task.inputs,), np.float32)
        self.action_space = spaces.Box(-1.0, 1.0, (self.task.actions,), np.float32)
        self._forces: Array = np.zeros((0, 0))
        self._steps = 0

    def reset(
        self, *, seed: int | None = None, options: dict[str, Any] | None = None
    ) -> tuple[NDArray[np.float32], dict[str, Any]]:
        """Begin an episode.

        Parameters
        ----------
        seed : int, optional
        options : dict, optional
            ``{"state": [...]}``: begin there, instead of at a point drawn from the start box.

        Returns
        -------
        observation : array of float32
        info : dict
            ``"state"``: the plant's.
        """
        super().reset(seed=seed)
        state = starts_at(self.task, self.np_random.random(len(self.task.start)))
        shares = self.np_random.random((self.task.horizon, len(self.task.loop.disturbances)))
        self._forces = forces_at(self.task, shares)
        self._steps = 0
        if options is not None and "state" in options:
            state = np.asarray(options["state"], dtype=np.float64)
        observation = self.lane.reset(state[None])
        return observation[0].numpy().astype(np.float32), {"state": self.lane.state[0].copy()}

    def step(self, action: Any) -> tuple[NDArray[np.float32], float, bool, bool, dict[str, Any]]:
        """One control period.

        Parameters
        ----------
        action : array_like, shape (actions,)

        Returns
        -------
        observation : array of float32
        reward : float
        terminated, truncated : bool
        info : dict
            ``"state"``: the plant's; ``"lost"``: whether it left the finite numbers.
        """
        given = torch.from_numpy(np.asarray(action, dtype=np.float64).reshape(1, -1))
        step = self.lane.step(given, self._forces[None, min(self._steps, self.task.horizon - 1)])
        self._steps += 1
        lost = bool(self.lane.lost[0])
        info = {"state": self.lane.state[0].copy(), "lost": lost}
        truncated = lost or self._steps >= self.task.horizon
        observation = step.observation[0].numpy().astype(np.float32)
        return observation, float(step.reward[0]), bool(step.ended[0]), truncated, info


def make_environment(
    specification: Specification | str | os.PathLike[str],
    start: Mapping[str, Any] | None = None,
    goal_stop: float = 0.0,
) -> SpecificationEnvironment:
    """A Gymnasium environment of any specification with a reward.

    Parameters
    ----------
    specification : Specification, str or path
    start : mapping of state name to a number or [lower, upper], optional
    goal_stop : float

    Returns
    -------
    SpecificationEnvironment
    """
    return SpecificationEnvironment(specification, start, goal_stop)


class GymnasiumLanes:
    """Gymnasium environments in lock-step, under the interface of `train.environment.Lanes`.

    Each lane is an environment of its own, reset with a seed of its own. The network's output in [-1, 1] is scaled to
    the box of actions, every number that the policy takes is perturbed alike, and there are no disturbances. A lane
    that has terminated stays where it is, with reward 0. There is no plant in it that a verifier could know.

    Parameters
    ----------
    environment : str or callable
        Id such as ``Hopper-v5``, or a function that makes an environment.
    lanes : int
    dtype : torch.dtype
    device : str
    horizon : int, optional
        Steps of an episode; the environment's own time limit by default.
    discount, epsilon : float
        Of the return; largest perturbation radius of the observation.
    **options
        Passed on to `gymnasium.make` with an id.

    Attributes
    ----------
    lanes, inputs, actions, horizon : int
    discount, epsilon : float
    perturbation : array, shape (inputs, inputs)
        The identity.

    Raises
    ------
    UsageError
        There is no such environment, it cannot be made here, its spaces are no bounded box of actions and no vector of
        observations, or it has no time limit and no horizon is given.
    """

    def __init__(
        self,
        environment: str | Callable[[], Any],
        lanes: int,
        *,
        dtype: torch.dtype,
        device: str = "cpu",
        horizon: int | None = None,
        discount: float = 0.99,
        epsilon: float = 0.1,
        **options: Any,
    ) -> None:
        self.lanes, self.dtype, self.device, self.discount, self.epsilon = lanes, dtype, device, discount, epsilon
        self.environments = [
            _made(environment, options) if isinstance(environment, str) else environment() for _ in range(lanes)
        ]
        self.name = environment if isinstance(environment, str) else str(self.environments[0])
        self.inputs, self._low, self._high = _dimensions(self.name, self.environments[0])
        self.actions = len(self._low)
        own = self.environments[0].spec.max_episode_steps if self.environments[0].spec is not None else None
        limit = own if horizon is None else horizon
        if limit is None or limit < 1:
            raise UsageError(
                f"{self.name} has no time limit, and no horizon of at least one step is given", remedy="give a horizon"
            )
        self.horizon: int = limit
        self.perturbation: Array = np.eye(self.inputs)
        self._observation = np.zeros((lanes, self.inputs))
        self._ended = np.zeros(lanes, dtype=bool)

    def sample_starts(self, streams: Streams) -> Array:
        """Seeds of `gymnasium.Env.reset` as whole numbers below 2^32, (S, 1), from the stream "start"."""
        return np.floor(streams.uniform("start", (1,)) * 2.0**32)

    def sample_forces(self, streams: Streams) -> Array:
        """No disturbances: (S, horizon, 0)."""
        return np.zeros((len(streams.seeds), self.horizon, 0))

    def reset(self, starts: Array) -> Tensor:
        """Begin an episode in every lane.

        Parameters
        ----------
        starts : array, shape (L, 1)
            Seeds; equal seeds give equal episodes.

        Returns
        -------
        Tensor, shape (L, inputs)

        Raises
        ------
        UsageError
            The shape is wrong.
        """
        if np.shape(starts) != (self.lanes, 1):
            raise UsageError(f"seeds of shape {(self.lanes, 1)} are required, received {np.shape(starts)}")
        self._ended[:] = False
        for row, environment in enumerate(self.environments):
            self._observation[row] = environment.reset(seed=int(starts[row, 0]))[0]
        return self._tensor(self._observation)

    def step(self, action: Tensor, force: Array) -> Step:
        """One step of every lane.

        Parameters
        ----------
        action : Tensor, shape (L, actions)
            In [-1, 1]; scaled to the box of actions and clipped to it.
        force : array, shape (L, 0)
            Not used.

        Returns
        -------
        Step
        """
        given = action.detach().to("cpu", torch.float64).numpy()
        scaled = np.clip(self._low + 0.5 * (given + 1.0) * (self._high - self._low), self._low, self._high)
        reward = np.zeros(self.lanes)
        for row, environment in enumerate(self.environments):
            if not self._ended[row]:
                acting = scaled[row].astype(environment.action_space.dtype)
                self._observation[row], reward[row], self._ended[row], _, _ = environment.step(acting)
        ended = torch.from_numpy(self._ended.copy()).to(self.device)
        return Step(self._tensor(self._observation), self._tensor(reward), ended)

    def close(self) -> None:
        """Free what the environments hold."""
        for environment in self.environments:
            environment.close()

    def _tensor(self, values: Array) -> Tensor:
        return torch.tensor(values, dtype=self.dtype, device=self.device)


def _made(name: str, options: dict[str, Any]) -> Any:
    try:
        return gymnasium.make(name, **options)
    except (gymnasium.error.Error, ImportError) as error:
        remedy = "MuJoCo's environments need the extra: pip install 'setrl[hopper]'"
        raise UsageError(f"the environment {name} cannot be made: {error}", remedy=remedy) from error


def _dimensions(name: str, environment: Any) -> tuple[int, Array, Array]:
    """Observed numbers, and bounds of the actions."""
    seen, acting = environment.observation_space, environment.action_space
    if not (isinstance(seen, spaces.Box) and len(seen.shape) == 1):
        raise UsageError(
            f"a vector is required as the observation of {name}, received {seen}",
            remedy="wrap it in gymnasium.wrappers.FlattenObservation",
        )
    if not (isinstance(acting, spaces.Box) and len(acting.shape) == 1 and acting.is_bounded("both")):
        raise UsageError(
            f"a bounded vector is required as the action of {name}, received {acting}",
            remedy="only continuous actions are trained",
        )
    return seen.shape[0], acting.low.astype(np.float64), acting.high.astype(np.float64)


def _register() -> None:
    """One id per shipped specification with a reward."""
    entry = f"{__name__}:{SpecificationEnvironment.__name__}"
    for name in shipped_specifications():
        file = SHIPPED / f"{name}.yaml"  # never a file of that name in the current folder
        if read_specification(file).reward is not None:
            gymnasium.register(f"setrl/{name}-v0", entry_point=entry, kwargs={"specification": str(file)})


_register()
