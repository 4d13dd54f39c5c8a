"""The layers of a network as data, and what they do to vectors of balls.

The meaning is the one of exact real arithmetic on the numbers below: a float stands for the dyadic number that it is.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import Any, TypeAlias

from flint import arb, arb_mat, ctx, fmpq

Number: TypeAlias = float | Fraction
Vector: TypeAlias = list[Any]

FRACTION_BITS = 1400
"""Precision of the stored ball around a number that is not dyadic, more than any computation in here uses."""


@dataclass(frozen=True, eq=False)
class Dense:
    """``y = matrix x + offset``.

    Attributes
    ----------
    matrix : tuple of rows
        One row of numbers per output.
    offset : tuple of numbers
        One per output; zeros where the file has none.
    """

    matrix: tuple[tuple[Number, ...], ...]
    offset: tuple[Number, ...]

    @cached_property
    def arb_matrix(self) -> Any:
        """The matrix as an `arb_mat`, exact where the numbers are floats."""
        entries = [entry for row in self.matrix for entry in row]
        return arb_mat(len(self.matrix), len(self.matrix[0]), enclosures(entries))

    @cached_property
    def arb_offset(self) -> Vector:
        """The offset as a list of `arb`, exact where the numbers are floats."""
        return enclosures(self.offset)


@dataclass(frozen=True, eq=False)
class Diagonal:
    """``y_i = scale_i x_i + offset_i``."""

    scale: tuple[Number, ...]
    offset: tuple[Number, ...]

    @cached_property
    def arb_scale(self) -> Vector:
        """The factors as a list of `arb`, exact where the numbers are floats."""
        return enclosures(self.scale)

    @cached_property
    def arb_offset(self) -> Vector:
        """The offset as a list of `arb`, exact where the numbers are floats."""
        return enclosures(self.offset)


@dataclass(frozen=True, eq=False)
class Selection:
    """``y_i = x_(index_i)``."""

    index: tuple[int, ...]


@dataclass(frozen=True)
class Activation:
    """A function of one number, applied to each.

    Attributes
    ----------
    kind : {"relu", "leaky_relu", "tanh", "sigmoid", "clip"}
    slope : float
        leaky_relu: factor of negative arguments, >= 0.
    low, high : float
        clip: ``min(max(x, low), high)`` with ``low <= high``; -inf or inf where there is no bound.
    """

    kind: str
    slope: float = 0.0
    low: float = -math.inf
    high: float = math.inf


Layer: TypeAlias = Dense | Diagonal | Selection | Activation


def enclosures(numbers: Sequence[Number]) -> Vector:
    """One ball around each number: exact for a float, of relative radius below 2^-1398 for a Fraction."""
    with ctx.workprec(FRACTION_BITS):
        return [
            arb(number) if isinstance(number, float) else arb(fmpq(number.numerator, number.denominator))
            for number in numbers
        ]


def apply(layer: Layer, x: Vector) -> Vector:
    """Enclose a layer's output for every point of a vector of balls, at the precision in force."""
    match layer:
        case Dense():
            product = (layer.arb_matrix * arb_mat(len(x), 1, x)).entries()
            return [y + b for y, b in zip(product, layer.arb_offset, strict=True)]
        case Diagonal():
            return [s * a + b for s, a, b in zip(layer.arb_scale, x, layer.arb_offset, strict=True)]
        case Selection():
            return [x[position] for position in layer.index]
        case Activation():
            return [_activated(layer, a) for a in x]


def _activated(activation: Activation, a: Any) -> Any:
    match activation.kind:
        case "relu":
            return a.max(arb(0))
        case "leaky_relu":
            return a.max(arb(0)) + arb(activation.slope) * a.min(arb(0))
        case "tanh":
            return a.tanh()
        case "sigmoid":
            return ((a / 2).tanh() + 1) / 2
        case "clip":
            return clip(a, arb(activation.low), arb(activation.high))
    raise AssertionError(f"unknown activation {activation.kind}")


def clip(value: Any, low: Any, high: Any) -> Any:
    """``min(max(value, low), high)`` of balls; bounds may be infinite."""
    value = value if low == arb("-inf") else value.max(low)
    return value if high == arb("inf") else value.min(high)
