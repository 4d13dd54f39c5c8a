"""Fixed-point numbers: an integer n at `bits` stands for n 2^-bits. Every rounding is directed, and its name says how.

An `Interval` is a pair of integers at the same bits, lower end first.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from operator import mul
from typing import TypeAlias

Interval: TypeAlias = tuple[int, int]
Vector: TypeAlias = list[int]

SIGNIFICANT = 192
"""Bits that are kept of a number which is not dyadic."""
FLOAT_BITS = 1074
"""Every finite float is an integer times 2^-1074."""


def floor_at(number: float | Fraction, bits: int) -> int:
    """Largest integer n with ``n 2^-bits <= number``."""
    top, bottom = number.as_integer_ratio()
    return (top << bits) // bottom


def ceil_at(number: float | Fraction, bits: int) -> int:
    """Smallest integer n with ``number <= n 2^-bits``."""
    top, bottom = number.as_integer_ratio()
    return -((-top << bits) // bottom)


def shifted_up(number: int, places: int) -> int:
    """``number 2^-places``, rounded up."""
    return -(-number >> places)


def product_up(first: int, second: int, places: int) -> int:
    """``first second 2^-places``, rounded up."""
    return -(-first * second >> places)


def enclosure(number: float | Fraction, bits: int) -> Interval:
    """Both roundings of a number."""
    return floor_at(number, bits), ceil_at(number, bits)


def whole(number: float) -> int:
    """The integer ``number 2^1074``: exact."""
    top, bottom = number.as_integer_ratio()
    return top << (FLOAT_BITS + 1 - bottom.bit_length())


@dataclass(frozen=True)
class Factor:
    """A number within [n, n + loose] 2^-scale; `loose` is 0 where the number is dyadic, else 1."""

    n: int
    scale: int
    loose: int = 0

    @classmethod
    def of(cls, number: float | Fraction) -> Factor:
        """Exact for every float and every other dyadic number."""
        top, bottom = number.as_integer_ratio()
        scale = bottom.bit_length() - 1
        if bottom == 1 << scale:
            return cls(top, scale)
        scale = places_of(number)
        return cls((top << scale) // bottom, scale, 1)

    @property
    def absolute(self) -> int:
        """Upper bound of the absolute value, at `scale`."""
        return max(abs(self.n), abs(self.n + self.loose))

    def times(self, x: Interval) -> Interval:
        """Enclose the product with an interval, at the interval's bits."""
        ends = [n * end for n in {self.n, self.n + self.loose} for end in x]
        return min(ends) >> self.scale, shifted_up(max(ends), self.scale)


def places_of(number: float | Fraction) -> int:
    """A scale at which rounding a nonzero number down keeps at least `SIGNIFICANT` bits of it."""
    top, bottom = number.as_integer_ratio()
    return max(SIGNIFICANT + bottom.bit_length() - abs(top).bit_length() + 1, 0)


@dataclass(frozen=True, eq=False)
class Matrix:
    """A matrix within [rows, rows + loose] 2^-scale.

    Attributes
    ----------
    rows : list of list of int
    scale : int
        Common to all entries.
    loose : list of list of int, or None
        1 where an entry was rounded down; None where all are exact.
    absolute : list of list of int
        Upper bounds of the absolute values.
    """

    rows: list[Vector]
    scale: int
    loose: list[Vector] | None
    absolute: list[Vector]

    @classmethod
    def of(cls, table: Sequence[Sequence[float | Fraction]]) -> Matrix:
        """From floats, which are exact, and rationals."""
        factors = [[Factor.of(number) for number in row] for row in table]
        scale = max((factor.scale for row in factors for factor in row), default=0)
        rows = [[floor_at(number, scale) for number in row] for row in table]
        loose = [[factor.loose for factor in row] for row in factors]
        absolute = [
            [max(abs(n), abs(n + more)) for n, more in zip(row, extra, strict=True)]
            for row, extra in zip(rows, loose, strict=True)
        ]
        return cls(rows, scale, loose if any(map(any, loose)) else None, absolute)

    def absolute_times(self, x: Vector) -> Vector:
        """``|W| x`` for x >= 0, rounded up."""
        return [shifted_up(sum(map(mul, row, x)), self.scale) for row in self.absolute]
