"""Ranges of elementary functions over balls of any width.

flint's functions of a ball add a bound of the slope times the radius, which is up to twice too wide on a wide ball.
Here wide balls are bounded from their ends. Where a function is not defined on all of a ball, the result is not finite.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from flint import arb

THIN_BITS = 50
"""Balls of at least so many bits of accuracy are left to flint; it decides how tight a range is, nothing else."""
_THIN_RADIUS = arb(2) ** -THIN_BITS
_WIDEST_ANGLE = arb(3) / 2


def square(x: Any) -> Any:
    """``[min |x|^2, max |x|^2]``."""
    if x.rel_accuracy_bits() >= THIN_BITS:
        return x * x
    least, most = x.abs_lower(), x.abs_upper()
    return (least * least).union(most * most)


def exp(x: Any) -> Any:
    """Range of exp."""
    return _increasing(x, _exp)


def log(x: Any) -> Any:
    """Range of log; not finite where x may be 0 or less."""
    return _increasing(x, _log)


def sqrt(x: Any) -> Any:
    """Range of the square root; not finite where x may be less than 0."""
    return _increasing(x, _sqrt)


def tanh(x: Any) -> Any:
    """Range of tanh."""
    return _increasing(x, _tanh)


def reciprocal(x: Any) -> Any:
    """Range of 1/x; not finite where x may be 0."""
    if not x.is_finite():
        return arb.nan()
    if x.rel_accuracy_bits() >= THIN_BITS:
        return 1 / x
    low, high = x.lower(), x.upper()
    return (1 / low).union(1 / high) if low > 0 or high < 0 else arb.nan()


def sincos(x: Any) -> tuple[Any, Any]:
    """Ranges of sine and cosine.

    With x = m + d, |d| <= r <= 3/2, both ends have sin(m +- r) = sin m cos r +- cos m sin r. If |cos m| cos r > |sin m|
    sin r, the derivative has one sign, and the ends bound the range. Else there may be one extremum (two are further
    apart than 2 r), less than a right angle from m: it is 1 if sin m > 0, and -1 if sin m < 0. Likewise for the cosine.
    """
    if not x.is_finite():
        return arb.nan(), arb.nan()
    radius = x.rad()
    if radius < _THIN_RADIUS or not radius <= _WIDEST_ANGLE:
        sine, cosine = x.sin_cos()
        return sine, cosine
    sine, cosine = x.mid().sin_cos()
    part, rest = radius.sin_cos()
    return _turned(sine, cosine, part, rest), _turned(cosine, sine, part, rest)


def _turned(value: Any, slope: Any, part: Any, rest: Any) -> Any:
    """Range of ``value cos d + slope sin d`` for part = sin r and rest = cos r."""
    steepness = abs(slope)
    middle, spread = value * rest, steepness * part
    ends = (middle - spread).union(middle + spread)
    if steepness * rest > abs(value) * part:
        return ends
    # where the sign of value is not decided either, both extremes are
    ends = ends if value < 0 else ends.union(arb(1))
    return ends if value > 0 else ends.union(arb(-1))


def _increasing(x: Any, function: Callable[[Any], Any]) -> Any:
    # flint returns something finite for tanh and 1/x of infinity, which stands for "anything or nothing" here
    if not x.is_finite():
        return arb.nan()
    if x.rel_accuracy_bits() >= THIN_BITS:
        return function(x)
    return function(x.lower()).union(function(x.upper()))


def _exp(x: Any) -> Any:
    return x.exp()


def _log(x: Any) -> Any:
    return x.log()


def _sqrt(x: Any) -> Any:
    return x.sqrt()


def _tanh(x: Any) -> Any:
    return x.tanh()
