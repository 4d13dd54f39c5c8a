"""Point simulation of a closed loop: many trajectories at once, in float64. It proposes; it never proves."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..specs.errors import UsageError
from .closed_loop import BoundAffine, BoundPolytope, ClosedLoop
from .float_algebra import FloatAlgebra
from .policy import FloatArray
from .tape import run

Noise: TypeAlias = "FloatArray | Callable[[int, FloatArray], FloatArray]"
"""Per trajectory and period, (N, periods, k); or a function of the period and the clean values (N, k)."""


@dataclass(frozen=True)
class Trajectories:
    """N runs of one closed loop over T control periods.

    Attributes
    ----------
    times : array, shape (T * samples + 1,)
        In seconds.
    states : array, shape (N, T * samples + 1, n)
        NaN from the period on in which the integrator failed (the trajectory left every bound).
    actions : array, shape (N, T, m)
        What acts on the plant: after clipping and delay.
    observations : array, shape (N, T, k)
        What the policy was given, noise included, before `before`.
    noise : array, shape (N, T, k)
    disturbances : array, shape (N, T, d)
    samples_per_period : int
    """

    times: FloatArray
    states: FloatArray
    actions: FloatArray
    observations: FloatArray
    noise: FloatArray
    disturbances: FloatArray
    samples_per_period: int

    @property
    def period_ends(self) -> FloatArray:
        """States at the end of every period, shape (N, T, n)."""
        return self.states[:, self.samples_per_period :: self.samples_per_period]


def simulate(
    loop: ClosedLoop,
    initial: Any,
    observation_noise: Noise | None = None,
    disturbances: FloatArray | None = None,
    *,
    method: str = "DOP853",
    rtol: float = 1e-9,
    atol: float = 1e-11,
    samples_per_period: int | Sequence[float] = 1,
    policy: Callable[[FloatArray], FloatArray] | None = None,
    stop: Callable[[], bool] | None = None,
) -> Trajectories:
    """Simulate N trajectories.

    Parameters
    ----------
    loop : ClosedLoop
    initial : array_like, shape (N, n) or (n,)
        Initial states in the plant's order; not required to lie in the initial set.
    observation_noise : array, shape (N, periods, k), or callable, optional
        Added to the observation. A callable gets the period and the clean observations (N, k).
    disturbances : array, shape (N, periods, d), optional
        The middle of their bounds by default.
    method, rtol, atol
        Of `scipy.integrate.solve_ivp`; all trajectories are one stacked system. Discrete-time plants are iterated.
    samples_per_period : int or sequence of float
        States that are stored per period, evenly spaced; or where, as increasing shares of a period, the last one 1.
    policy : callable, optional
        Runs instead of the own forward pass, for example `onnx_runtime.deployed_runner(loop.policy)`.
    stop : callable, optional
        Asked at every evaluation of the vector field; once it says True, the rest is NaN.

    Returns
    -------
    Trajectories
    """
    start = np.atleast_2d(np.asarray(initial, dtype=np.float64))
    count, periods = len(start), loop.periods
    size, inputs, observed = len(loop.plant.states), len(loop.plant.inputs), len(loop.observation_names)
    if start.shape != (count, size):
        raise UsageError(f"initial states of shape (N, {size}) are required, received {start.shape}")
    shares = _shares(samples_per_period)
    samples = len(shares)
    if loop.plant.discrete and samples != 1:
        raise UsageError("a discrete-time plant has one sample per period")
    forces = _disturbances(loop, disturbances, count)
    network = loop.policy if policy is None else policy
    stored = np.full((count, periods * samples + 1, size), np.nan)
    actions = np.full((count, periods, inputs), np.nan)
    observations = np.full((count, periods, observed), np.nan)
    noise = np.zeros((count, periods, observed))
    stored[:, 0] = state = start
    pending = [np.tile(_floats(loop.delayed_action), (count, 1)) for _ in range(loop.delay)]
    advance = _map_step if loop.plant.discrete else _Integrator(method, rtol, atol, shares, stop)
    with np.errstate(all="ignore"):
        for k in range(periods):
            clean = observe(loop, state)
            noise[:, k] = _noise(observation_noise, k, clean, periods)
            observations[:, k] = clean + noise[:, k]
            pending.append(act(loop, observations[:, k], network))
            actions[:, k] = pending.pop(0)
            path = advance(loop, state, actions[:, k], forces[:, k])
            stored[:, k * samples + 1 : (k + 1) * samples + 1] = path
            state = path[:, -1]
    times = float(loop.period) * np.concatenate([[0.0], (np.arange(periods)[:, None] + shares).ravel()])
    return Trajectories(times, stored, actions, observations, noise, forces, samples)


def _shares(samples: int | Sequence[float]) -> FloatArray:
    if isinstance(samples, int) and samples < 1:
        raise UsageError(f"at least one sample per period is required, received {samples}")
    return np.arange(1, samples + 1) / samples if isinstance(samples, int) else np.asarray(samples, dtype=np.float64)


def observe(loop: ClosedLoop, states: FloatArray) -> FloatArray:
    """What the policy would see without perturbation: (N, n) to (N, k)."""
    if loop.observation is None:
        return states
    values = run(loop.observation, FloatAlgebra(), list(states.T))
    return _columns(values, len(states))


def act(
    loop: ClosedLoop, observations: FloatArray, policy: Callable[[FloatArray], FloatArray] | None = None
) -> FloatArray:
    """Action of the controller, clipping included, delay not: (N, k) to (N, m)."""
    network = loop.policy if policy is None else policy
    action = _mapped(loop.after, np.asarray(network(_mapped(loop.before, observations))))
    if loop.clip is None:
        return action
    lower, upper = (_floats([pair[side] for pair in loop.clip]) for side in (0, 1))
    return np.clip(action, lower, upper)


def derivative(loop: ClosedLoop, states: FloatArray, actions: FloatArray, disturbances: FloatArray) -> FloatArray:
    """Right-hand side of the plant (or its next state, where it is discrete): (N, n)."""
    values = [*states.T, *actions.T, *disturbances.T]
    return _columns(run(loop.plant.tape, FloatAlgebra(), values), len(states))


def returns(loop: ClosedLoop, trajectories: Trajectories) -> FloatArray:
    """Discounted return of every trajectory, (N,); minus infinity where a trajectory diverged.

    ``sum_k discount^(k-1) (-weights' |s_k - target| - penalty [s_k in region])``, s_k the state at the end of period k.
    """
    reward = loop.reward
    if reward is None:
        raise UsageError("the specification has no reward", remedy="add reward: {weights: ...}")
    states = trajectories.period_ends
    cost = np.abs(states - _floats(reward.target)) @ _floats(reward.weights)
    if reward.penalty_region:
        cost = cost + float(reward.penalty) * inside(reward.penalty_region, states)
    discounts = float(reward.discount) ** np.arange(loop.periods)
    total = -(cost @ discounts)
    return np.where(np.isnan(total), -np.inf, total)


def inside(region: Sequence[BoundPolytope], states: FloatArray) -> NDArray[np.bool_]:
    """Whether points (..., n) lie in a union of polytopes, in float64."""
    found = np.zeros(states.shape[:-1], dtype=bool)
    for member in region:
        found |= (states @ np.array(member.normals, dtype=np.float64).T <= _floats(member.bounds)).all(axis=-1)
    return found


MOST_EVALUATIONS = 4000
"""Evaluations of the vector field per control period after which a trajectory counts as one that left every bound."""


class _GivenUp(Exception):
    """The integrator needs too many steps, or time is up."""


class _Integrator:
    """One control period of a continuous-time plant, all trajectories stacked into one system."""

    def __init__(
        self, method: str, rtol: float, atol: float, shares: FloatArray, stop: Callable[[], bool] | None = None
    ) -> None:
        self.method, self.rtol, self.atol, self.stop = method, rtol, atol, stop
        self.shares, self.samples = shares, len(shares)

    def __call__(self, loop: ClosedLoop, state: FloatArray, action: FloatArray, force: FloatArray) -> FloatArray:
        """States (N, samples, n); trajectories that cannot be continued are NaN."""
        path = np.full((len(state), self.samples, state.shape[1]), np.nan)
        alive = np.isfinite(state).all(axis=1) & np.isfinite(action).all(axis=1)
        if not alive.any():
            return path
        together = self.solve(loop, state[alive], action[alive], force[alive])
        if together is not None:
            path[alive] = together
            return path
        for row in np.flatnonzero(alive):  # one that diverges must not take the others with it
            alone = self.solve(loop, state[row, None], action[row, None], force[row, None])
            if alone is not None:
                path[row] = alone[0]
        return path

    def solve(self, loop: ClosedLoop, state: FloatArray, action: FloatArray, force: FloatArray) -> FloatArray | None:
        from scipy.integrate import solve_ivp

        shape, period = state.shape, float(loop.period)
        evaluations = 0

        def slope(_: float, flat: FloatArray) -> FloatArray:
            nonlocal evaluations
            evaluations += 1
            if evaluations > MOST_EVALUATIONS or (self.stop is not None and self.stop()):
                raise _GivenUp
            return derivative(loop, flat.reshape(shape), action, force).ravel()

        times = period * self.shares
        span, start = (0.0, period), state.ravel()
        try:
            result = solve_ivp(slope, span, start, method=self.method, t_eval=times, rtol=self.rtol, atol=self.atol)
        except _GivenUp:
            return None
        if not result.success or not np.isfinite(result.y).all():
            return None
        return np.asarray(result.y.reshape(*shape, self.samples).transpose(0, 2, 1))


def _map_step(loop: ClosedLoop, state: FloatArray, action: FloatArray, force: FloatArray) -> FloatArray:
    return derivative(loop, state, action, force)[:, None]


def _disturbances(loop: ClosedLoop, given: FloatArray | None, count: int) -> FloatArray:
    shape = (count, loop.periods, len(loop.disturbances))
    if given is None:
        return np.broadcast_to(_floats([(bound.lower + bound.upper) / 2 for bound in loop.disturbances]), shape)
    values = np.asarray(given, dtype=np.float64)
    if values.shape != shape:
        raise UsageError(f"disturbances of shape {shape} are required, received {values.shape}")
    return values


def _noise(given: Noise | None, period: int, clean: FloatArray, periods: int) -> FloatArray:
    if given is None:
        return np.zeros_like(clean)
    if callable(given):
        return np.asarray(given(period, clean), dtype=np.float64)
    values = np.asarray(given, dtype=np.float64)
    required = (len(clean), periods, clean.shape[1])
    if values.shape != required:
        raise UsageError(f"observation noise of shape {required} is required, received {values.shape}")
    return values[:, period]


def _mapped(affine: BoundAffine | None, values: FloatArray) -> FloatArray:
    if affine is None:
        return values
    return np.asarray(values @ np.array(affine.matrix, dtype=np.float64).T + _floats(affine.offset))


def _floats(values: Sequence[Any]) -> FloatArray:
    return np.array([float(value) for value in values], dtype=np.float64)


def _columns(values: Sequence[Any], count: int) -> FloatArray:
    return np.stack([np.broadcast_to(value, (count,)) for value in values], axis=1).astype(np.float64)
