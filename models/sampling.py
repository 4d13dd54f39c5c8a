"""Starting points and perturbations for simulations; every random number comes from the caller's generator."""

from __future__ import annotations

import itertools
from fractions import Fraction
from typing import Literal, TypeAlias

import numpy as np

from ..specs.errors import UsageError
from .closed_loop import ClosedLoop
from .policy import FloatArray

Attack: TypeAlias = Literal["none", "uniform", "corner"]
"""No perturbation; uniform over its bounds; a random vertex of its bounds in every period."""


def inner_bounds(lower: Fraction, upper: Fraction) -> tuple[float, float]:
    """Closest floats inside an exact interval; the nearest float twice where there is none inside."""
    low, high = float(lower), float(upper)
    if Fraction(low) < lower:
        low = float(np.nextafter(low, np.inf))
    if Fraction(high) > upper:
        high = float(np.nextafter(high, -np.inf))
    if low > high:
        low = high = float((lower + upper) / 2)
    return low, high


def corner_states(loop: ClosedLoop, limit: int = 1024) -> FloatArray:
    """Vertices of the initial box, (at most `limit`, n)."""
    sides = [sorted(set(inner_bounds(*bounds))) for bounds in loop.initial]
    return np.array(list(itertools.islice(itertools.product(*sides), limit)), dtype=np.float64)


def center_state(loop: ClosedLoop) -> FloatArray:
    """Middle of the initial box, (n,)."""
    return np.array([float((lower + upper) / 2) for lower, upper in loop.initial])


def uniform_states(loop: ClosedLoop, count: int, generator: np.random.Generator) -> FloatArray:
    """Uniform samples of the initial box, (count, n)."""
    lower, upper = np.array([inner_bounds(*bounds) for bounds in loop.initial]).T
    return np.asarray(np.clip(generator.uniform(lower, upper, size=(count, len(lower))), lower, upper))


def sample_noise(loop: ClosedLoop, attack: Attack, count: int, generator: np.random.Generator) -> FloatArray:
    """Observation noise within the specification's radius, (count, periods, k)."""
    bounds = np.array([inner_bounds(-radius, radius) for radius in loop.observation_radius])
    return _draw(bounds, attack, (count, loop.periods), generator)


def sample_disturbances(loop: ClosedLoop, attack: Attack, count: int, generator: np.random.Generator) -> FloatArray:
    """Disturbances within their bounds, (count, periods, d); a constant one does not change over the run."""
    bounds = np.array([inner_bounds(entry.lower, entry.upper) for entry in loop.disturbances]).reshape(-1, 2)
    values = _draw(bounds, attack, (count, loop.periods), generator)
    constant = [entry.constant for entry in loop.disturbances]
    values[:, :, constant] = values[:, :1, constant]
    return values


def _draw(bounds: FloatArray, attack: Attack, shape: tuple[int, int], generator: np.random.Generator) -> FloatArray:
    lower, upper = bounds.T
    size = (*shape, len(bounds))
    if attack == "none":
        return np.broadcast_to((lower + upper) / 2, size).copy()
    if attack == "uniform":
        return np.asarray(np.clip(generator.uniform(lower, upper, size=size), lower, upper))
    if attack != "corner":
        raise UsageError(f"unknown attack {attack}", remedy="attacks: none, uniform, corner")
    return np.asarray(np.where(generator.random(size) < 0.5, lower, upper))
