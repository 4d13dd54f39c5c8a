"""Polynomials in time whose coefficients are vectors of balls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeAlias

from flint import arb

Vector: TypeAlias = list[Any]


def powers_of(time: Any, count: int) -> Vector:
    """1, t, t^2, ..."""
    powers = [arb(1)]
    for _ in range(count - 1):
        powers.append(powers[-1] * time)
    return powers


def combine(weights: Sequence[Any], coefficients: Sequence[Vector]) -> Vector:
    """``sum_k weights_k coefficients_k``; exact zeros cost nothing."""
    total = [arb(0)] * len(coefficients[0])
    for weight, row in zip(weights, coefficients, strict=False):
        total = [t if x.is_zero() else t + weight * x for t, x in zip(total, row, strict=True)]
    return total
