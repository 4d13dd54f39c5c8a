"""Proposes trajectories that violate a requirement. It proves nothing: simulation in float64 only.

Candidates come from the corners of the initial set, from the verifier's own extreme factors and from random points; the
perturbations are corners of their boxes, held or random.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundPolytope, BoundRequirement, ClosedLoop
from ..models.sampling import center_state, corner_states, sample_disturbances, sample_noise, uniform_states
from ..models.simulation import simulate

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Candidate:
    """A simulated trajectory that violates a requirement.

    Attributes
    ----------
    requirement : str
    time : float
        Seconds at which the violation is largest.
    violation : float
        How far inside the forbidden region, or outside the required one, in the requirement's unit.
    initial : array, shape (n,)
    noise : array, shape (T, n_obs)
    disturbances : array, shape (T, d)
    times : array, shape (S,)
    states : array, shape (S, n)
    """

    requirement: str
    time: float
    violation: float
    initial: Array
    noise: Array
    disturbances: Array
    times: Array
    states: Array


def propose(
    loop: ClosedLoop,
    extremes: Array | None = None,
    random: int = 64,
    seed: int = 0,
    samples: int = 8,
    stop: Callable[[], bool] | None = None,
) -> Candidate | None:
    """Simulate candidates and return the worst violation found, or None.

    Parameters
    ----------
    loop : ClosedLoop
    extremes : array, shape (k, n), optional
        Initial states that the verifier suspects.
    random : int
        Number of uniformly drawn initial states.
    seed : int
    samples : int
        Simulated times per control period at which requirements are checked (one for a discrete-time plant).
    stop : callable, optional
        Says when time is up; what was simulated until then counts.

    Returns
    -------
    Candidate or None
    """
    generator = np.random.default_rng(seed)
    starts = [corner_states(loop, 64), center_state(loop)[None], uniform_states(loop, random, generator)]
    if extremes is not None and extremes.size:
        starts.insert(0, extremes)
    initial = np.concatenate(starts)
    attacks: list[Literal["none", "uniform", "corner"]] = ["none"]
    if any(radius > 0 for radius in loop.observation_radius) or loop.disturbances:
        attacks += ["corner", "uniform"]
    best: Candidate | None = None
    for attack in attacks:
        noise = sample_noise(loop, attack, len(initial), generator)
        disturbances = sample_disturbances(loop, attack, len(initial), generator)
        count = 1 if loop.plant.discrete else samples
        run = simulate(loop, initial, noise, disturbances, rtol=1e-7, atol=1e-9, samples_per_period=count, stop=stop)
        for requirement in loop.requirements:
            amount, when = violations(requirement, run.times, run.states, count, float(loop.period))
            worst = int(np.argmax(amount))
            if amount[worst] > 0.0 and (best is None or amount[worst] > best.violation):
                best = Candidate(
                    requirement.name,
                    float(run.times[when[worst]]),
                    float(amount[worst]),
                    initial[worst],
                    run.noise[worst],
                    run.disturbances[worst],
                    run.times,
                    run.states[worst],
                )
    return best


def violations(
    requirement: BoundRequirement, times: Array, states: Array, samples: int, period: float
) -> tuple[Array, NDArray[np.intp]]:
    """How much each sampled trajectory violates a requirement, <= 0 where it does not.

    Parameters
    ----------
    requirement : BoundRequirement
    times : array, shape (S,)
    states : array, shape (N, S, n)
    samples : int
        Samples per control period.
    period : float
        Seconds.

    Returns
    -------
    array, shape (N,)
        Largest violation (reach: smallest over the window).
    array of int, shape (N,)
        Its sample.
    """
    slack = 1e-9 * period  # sample times are rounded; this only decides which samples belong to the window
    window = (times >= float(requirement.start) - slack) & (times <= float(requirement.end) + slack)
    if requirement.kind == "reach":
        window &= np.arange(times.size) % samples == 0
    if not window.any():
        return np.full(len(states), -np.inf), np.zeros(len(states), dtype=np.intp)
    depth = np.max([-_outside(member, states) for member in requirement.region], axis=0)  # > 0 inside
    amount = depth if requirement.kind == "avoid" else -depth
    amount = np.where(np.isnan(amount), -np.inf, amount)
    if requirement.kind == "reach":
        amount = np.where(window, amount, np.inf)
        chosen = amount.argmin(1)
    else:
        amount = np.where(window, amount, -np.inf)
        chosen = amount.argmax(1)
    return np.take_along_axis(amount, chosen[:, None], 1)[:, 0], chosen


def _outside(polytope: BoundPolytope, states: Array) -> Array:
    """``max_i C_i x - d_i``: positive outside, negative inside, per state (N, S)."""
    normals = np.array(polytope.normals, dtype=np.float64)
    return (states @ normals.T - np.array(polytope.bounds, dtype=np.float64)).max(-1)  # type: ignore[no-any-return]
