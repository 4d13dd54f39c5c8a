"""Balls and rationals to numbers that fit into a file, always to the side on which a statement stays true."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np

from ..checker.obligations import below

DIGITS = 17
"""Significant decimal digits of a bound: as many as tell two float64 numbers apart."""


def rounded(number: float | Fraction, precision: str) -> float:
    """A nearest number of a precision, "float32" or "float64"; infinite where there is none."""
    with np.errstate(over="ignore"):
        return float(np.dtype(precision).type(float(number)))


def at_most(value: Any) -> Fraction:
    """A rational that no point of a ball exceeds."""
    return -at_least(-value)


def at_least(value: Any) -> Fraction:
    """A rational that no point of a ball is below."""
    return Fraction(below(value))


def decimal_above(number: Fraction, strictly: bool = False) -> Fraction:
    """The next decimal of `DIGITS` significant digits that is not below a number, or (`strictly`) that is above it.

    Files contain decimals; a bound that is one is read back as it was meant.
    """
    scale = _scale(number)
    scaled = number * scale
    if strictly:
        return Fraction(scaled.numerator // scaled.denominator + 1) / scale
    return Fraction(-(-scaled.numerator // scaled.denominator)) / scale


def decimal_below(number: Fraction, strictly: bool = False) -> Fraction:
    """`decimal_above` downward."""
    return -decimal_above(-number, strictly)


def _scale(number: Fraction) -> Fraction:
    """Power of ten that leaves `DIGITS` digits, or one more, in front of the point."""
    if not number:
        return Fraction(10) ** (2 * DIGITS)
    size = len(str(abs(number.numerator))) - len(str(number.denominator))
    return Fraction(10) ** (DIGITS - size)
