"""Polynomials in time: weights of Taylor coefficients at the end of a step and over its parts, rounding included."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from . import balls, rounding
from .balls import Ball

Array = NDArray[np.float64]


def powers(time: Ball, terms: int) -> Ball:
    """1, t, t^2, ..., shape (terms, *time.shape)."""
    values = [balls.exact(np.ones_like(time.mid))]
    for _ in range(terms - 1):
        values.append(balls.multiply(values[-1], time))
    return Ball(np.stack([v.mid for v in values]), np.stack([v.rad for v in values]))


def combine(weights: Ball, coefficients: Ball) -> Ball:
    """``sum_k weights[s, k] coefficients[k]``: weights (S, K), coefficients (K, ...) to (S, ...)."""
    terms = weights.mid.shape[1]
    shape = (weights.mid.shape[0], *coefficients.mid.shape[1:])
    mid, rad = coefficients.mid.reshape(terms, -1), coefficients.rad.reshape(terms, -1)
    size = np.abs(mid)
    spread = weights.magnitude @ (rad + rounding.sum_error(terms, size)) + weights.rad @ size
    return Ball((weights.mid @ mid).reshape(shape), rounding.enlarged(spread, terms + 8).reshape(shape))


def largest(weights: Ball, coefficients: Ball) -> Array:
    """Upper bound of ``sum_k |weights[s, k]| |coefficients[k]|``, shape (S, ...)."""
    terms = weights.mid.shape[1]
    total = weights.magnitude @ coefficients.magnitude.reshape(terms, -1)
    shape = (weights.mid.shape[0], *coefficients.mid.shape[1:])
    return rounding.enlarged(total, terms + 2).reshape(shape)  # type: ignore[no-any-return]


@lru_cache(maxsize=256)
def step_weights(duration: Fraction, terms: int) -> Ball:
    """Powers of a step's duration, shape (1, terms)."""
    values = powers(balls.rational(duration), terms)
    return Ball(values.mid[None], values.rad[None])


@dataclass(frozen=True)
class SlabWeights:
    """Weights of the time coefficients for every part of a step.

    Attributes
    ----------
    half : float
        Upper bound of half the parts' width.
    value, velocity : Ball, shape (S, K)
        Of the state and its time derivative at the parts' middles.
    last, second_derivative : Ball, shape (S, K)
        Of bounds of the state and of its second derivative up to the parts' ends.
    remainder : array, shape (S,)
        Upper bound of the parts' end to the power K.
    """

    half: float
    value: Ball
    velocity: Ball
    last: Ball
    second_derivative: Ball
    remainder: Array


@lru_cache(maxsize=256)
def slab_weights(duration: Fraction, slabs: int, terms: int) -> SlabWeights:
    """Weights for `slabs` equal parts of a step."""
    middle = powers(balls.rationals([duration * (2 * part + 1) / (2 * slabs) for part in range(slabs)]), terms)
    last = powers(balls.rationals([duration * (part + 1) / slabs for part in range(slabs)]), terms + 1)
    middle, last = Ball(middle.mid.T, middle.rad.T), Ball(last.mid.T, last.rad.T)
    count = np.arange(terms, dtype=np.float64)

    def derivative(weights: Ball, by: int) -> Ball:
        """Weights of the by-th time derivative: k (k - 1) ... (k - by + 1) t^(k - by), zero for k < by."""
        factor = count.copy()
        for i in range(1, by):
            factor = factor * (count - i)
        zero = np.zeros((slabs, by))
        mid = np.concatenate([zero, weights.mid[:, : terms - by]], 1)
        rad = np.concatenate([zero, weights.rad[:, : terms - by]], 1)
        return balls.multiply(Ball(mid, rad), balls.exact(factor))

    return SlabWeights(
        float(balls.rational(duration / (2 * slabs)).upper),
        middle,
        derivative(middle, 1),
        last[:, :terms],
        derivative(last, 2),
        last.upper[:, terms],
    )
