"""Interval arithmetic on arrays in midpoint-radius form: every operation encloses, rounding included.

A `Ball` is the set of all arrays X with ``|X - mid| <= rad`` elementwise. Non-finite radii mean "no bound"; comparisons
that prove something must be true comparisons, so they never hold for them.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import rounding

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Ball:
    """Array of intervals ``[mid - rad, mid + rad]``; `mid` and `rad` broadcast to the same shape, rad >= 0."""

    mid: Array
    rad: Array

    @property
    def lower(self) -> Array:
        """Float array below every member."""
        return rounding.lower(self.mid, self.rad)  # type: ignore[no-any-return]

    @property
    def upper(self) -> Array:
        """Float array above every member."""
        return rounding.upper(self.mid, self.rad)  # type: ignore[no-any-return]

    @property
    def magnitude(self) -> Array:
        """Upper bound of the absolute value."""
        return rounding.enlarged(np.abs(self.mid) + self.rad, 1)  # type: ignore[no-any-return]

    def __getitem__(self, index: Any) -> Ball:
        return Ball(self.mid[index], self.rad[index])


def exact(values: Any) -> Ball:
    """Floats that are meant exactly."""
    mid = np.asarray(values, dtype=np.float64)
    return Ball(mid, np.zeros_like(mid))


def rational(number: Fraction) -> Ball:
    """Enclosure of one rational, shape ()."""
    mid, rad = rounding.ball_of(number)
    return Ball(np.float64(mid), np.float64(rad))  # type: ignore[arg-type]


def rationals(numbers: Iterable[Fraction]) -> Ball:
    """Enclosure of a sequence of rationals, shape (n,)."""
    return Ball(*rounding.balls_of(numbers))


def rational_matrix(rows: Iterable[Iterable[Fraction]]) -> Ball:
    """Enclosure of a matrix of rationals."""
    balls = [rationals(row) for row in rows]
    return Ball(np.array([b.mid for b in balls]), np.array([b.rad for b in balls]))


def hull(low: Array, high: Array) -> Ball:
    """Smallest ball known to contain ``[low, high]``."""
    return Ball(*rounding.center_radius(low, high))


def concatenate(parts: Sequence[Ball], axis: int) -> Ball:
    """Join arrays along an axis."""
    return Ball(np.concatenate([p.mid for p in parts], axis), np.concatenate([p.rad for p in parts], axis))


def add(a: Ball, b: Ball) -> Ball:
    """a + b."""
    mid = a.mid + b.mid
    return Ball(mid, rounding.enlarged(a.rad + b.rad + rounding.relative_error(mid, 1), 3))


def subtract(a: Ball, b: Ball) -> Ball:
    """a - b."""
    mid = a.mid - b.mid
    return Ball(mid, rounding.enlarged(a.rad + b.rad + rounding.relative_error(mid, 1), 3))


def negate(a: Ball) -> Ball:
    """-a, exactly."""
    return Ball(-a.mid, a.rad)


def multiply(a: Ball, b: Ball) -> Ball:
    """a b: ``|ab - a0 b0| <= |a0| rb + ra (|b0| + rb)``."""
    mid = a.mid * b.mid
    rad = np.abs(a.mid) * b.rad + a.rad * (np.abs(b.mid) + b.rad) + rounding.relative_error(mid, 1)
    return Ball(mid, rounding.enlarged(rad, 5))


def scale(a: Ball, factor: float) -> Ball:
    """a times a float that is meant exactly."""
    mid = a.mid * factor
    return Ball(mid, rounding.enlarged(a.rad * abs(factor) + rounding.relative_error(mid, 1), 3))


def divide_exact(a: Ball, divisor: float) -> Ball:
    """a divided by a non-zero float that is meant exactly."""
    mid = a.mid / divisor
    return Ball(mid, rounding.enlarged(a.rad / abs(divisor) + rounding.relative_error(mid, 1), 3))


def square(a: Ball) -> Ball:
    """a^2, tighter than a a: with m = |a0| and r the radius, a^2 lies in [max(m - r, 0)^2, (m + r)^2]."""
    magnitude = np.abs(a.mid)
    least = np.maximum(rounding.down(magnitude - a.rad), 0.0)
    most = rounding.up(magnitude + a.rad)
    # nextafter may leave 0 downwards; a square is never below 0
    return hull(np.maximum(rounding.down(least * least), 0.0), rounding.up(most * most))


def divide(a: Ball, b: Ball) -> Ball:
    """a / b; the radius is inf where b contains 0.

    With q = a0 / b0: ``|a/b - q| <= (ra + |q| rb) / (|b0| - rb)``.
    """
    with np.errstate(divide="ignore", invalid="ignore", over="ignore"):
        distance = rounding.down(rounding.down(np.abs(b.mid) - b.rad))
        mid = a.mid / b.mid
        spread = rounding.enlarged(a.rad + rounding.enlarged(np.abs(mid), 1) * b.rad, 3)
        rad = rounding.enlarged(spread / distance + rounding.relative_error(mid, 1), 3)
        sound = (distance > 0.0) & np.isfinite(rad)
        return Ball(np.where(sound, mid, 0.0), np.where(sound, rad, np.inf))


def _monotone(a: Ball, function: Any) -> Ball:
    """Enclosure of an increasing elementary function from its values at both ends."""
    with np.errstate(all="ignore"):
        low, high = function(a.lower), function(a.upper)
        low = low - rounding.elementary_error(low)
        high = high + rounding.elementary_error(high)
        result = hull(rounding.down(low), rounding.up(high))
        # NaN (outside the domain) and overflow become "no bound"
        sound = np.isfinite(result.mid) & np.isfinite(result.rad) & np.isfinite(a.mid) & np.isfinite(a.rad)
        return Ball(np.where(sound, result.mid, 0.0), np.where(sound, result.rad, np.inf))


def exp(a: Ball) -> Ball:
    """exp(a)."""
    return _monotone(a, np.exp)


def log(a: Ball) -> Ball:
    """log(a); no bound where a touches 0 or below."""
    return _monotone(a, np.log)


def sqrt(a: Ball) -> Ball:
    """sqrt(a); no bound where a goes below 0."""
    return _monotone(a, np.sqrt)


def tanh(a: Ball) -> Ball:
    """tanh(a)."""
    return _monotone(a, np.tanh)


def sincos(a: Ball) -> tuple[Ball, Ball]:
    """sin(a) and cos(a); no bound where a has none.

    With a = m + d, |d| <= r <= 3/2: sin(m +- r) = sin m cos r +- cos m sin r. Where the derivative keeps its sign, that
    is |cos m| cos r > |sin m| sin r, these ends bound the range. Else it may contain one extremum (two are further
    apart than 2 r), less than a right angle from m: the sign of sin m; and the range lies between it and the end that
    is farther from it, ``sin m cos r - sign(sin m) |cos m| sin r``.
    """
    with np.errstate(all="ignore"):
        usable = a.rad <= 1.5
        rad = np.where(usable, a.rad, 1.5)
        mid = np.where(usable, a.mid, 0.0)
        value = np.array([np.sin(mid), np.cos(mid)])  # both functions at once: each is the other's slope
        size = np.abs(value)
        slope = size[::-1]
        # sin r <= r, and 1 - cos r = 2 sin^2(r/2) without cancellation
        sin_r = np.minimum(rounding.enlarged(np.sin(rad), 8), rad)
        half = np.sin(0.5 * rad)
        drop = 2.0 * half * half
        most_drop = rounding.enlarged(drop, 20)
        # a float comparison with a margin of 64 units on the side that must be smaller
        steady = slope * (1.0 - most_drop) > rounding.enlarged(size * sin_r, 64)
        # sin m cos r = sin m - sin m (1 - cos r)
        center, radius = value - value * drop, slope * sin_r
        farther = size - size * drop - radius
        sign = np.where(value < 0.0, -1.0, 1.0)
        center = np.where(steady, center, sign * (0.5 + 0.5 * farther))
        radius = np.where(steady, radius, 0.5 - 0.5 * farther)
        # elementary errors of value, slope and drop, relative to sizes of at most 1; absolute ones where 1 is an end
        radius = rounding.enlarged(radius + rounding.relative_error(np.where(steady, size, 1.0), 60), 40)
        good = usable & np.isfinite(radius)
        # wide angles have every value; an argument without a bound may not exist at all
        known = np.isfinite(a.mid) & np.isfinite(a.rad)
        center = np.where(good & known, center, 0.0)
        radius = np.where(known, np.where(good, radius, 1.0), np.inf)
        return Ball(center[0], radius[0]), Ball(center[1], radius[1])


class BallAlgebra:
    """The algebra of balls for `models.tape.run`: interval evaluation of a tape."""

    def constant(self, value: Fraction) -> Ball:
        """Enclosure of a rational constant."""
        return rational(value)

    add = staticmethod(add)
    subtract = staticmethod(subtract)
    multiply = staticmethod(multiply)
    divide = staticmethod(divide)
    negate = staticmethod(negate)
    square = staticmethod(square)
    sincos = staticmethod(sincos)
    exp = staticmethod(exp)
    log = staticmethod(log)
    sqrt = staticmethod(sqrt)
    tanh = staticmethod(tanh)
