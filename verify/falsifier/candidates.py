"""What the falsifier proposes: a simulated trajectory, and how much it violates a requirement."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import BoundPolytope, BoundRequirement

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
    counted = window(requirement, times, samples, period)
    if not counted.any():
        return np.full(len(states), -np.inf), np.zeros(len(states), dtype=np.intp)
    depth = np.max([-_outside(member, states) for member in requirement.region], axis=0)  # > 0 inside
    amount = depth if requirement.kind == "avoid" else -depth
    amount = np.where(np.isnan(amount), -np.inf, amount)
    if requirement.kind == "reach":
        amount = np.where(counted, amount, np.inf)
        chosen = amount.argmin(1)
    else:
        amount = np.where(counted, amount, -np.inf)
        chosen = amount.argmax(1)
    return np.take_along_axis(amount, chosen[:, None], 1)[:, 0], chosen


def window(requirement: BoundRequirement, times: Array, samples: int, period: float) -> NDArray[np.bool_]:
    """Which samples count for a requirement: those in its window, for reach the ends of periods only.

    Parameters
    ----------
    requirement : BoundRequirement
    times : array, shape (S,)
    samples : int
        Samples per control period.
    period : float
        Seconds.

    Returns
    -------
    array of bool, shape (S,)
    """
    slack = 1e-9 * period  # sample times are rounded; this only decides which samples belong to the window
    counted = (times >= float(requirement.start) - slack) & (times <= float(requirement.end) + slack)
    if requirement.kind == "reach":
        counted &= np.arange(times.size) % samples == 0
    return np.asarray(counted)


def magnitude(requirement: BoundRequirement, state: Array) -> float:
    """``max_i |C_i| |x| + |d_i|``: the size of the numbers whose difference a violation at `state` (n,) is."""
    sizes = [
        np.abs(np.array(member.normals, dtype=np.float64)) @ np.abs(state)
        + np.abs(np.array(member.bounds, dtype=np.float64))
        for member in requirement.region
    ]
    return float(np.concatenate(sizes).max())


def _outside(polytope: BoundPolytope, states: Array) -> Array:
    """``max_i C_i x - d_i``: positive outside, negative inside, per state (N, S)."""
    normals = np.array(polytope.normals, dtype=np.float64)
    return (states @ normals.T - np.array(polytope.bounds, dtype=np.float64)).max(-1)  # type: ignore[no-any-return]
