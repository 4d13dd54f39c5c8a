"""Every epsilon of the engine: bounds on what float64 arithmetic, rounding to nearest, leaves out.

The unit roundoff is u = 2^-53. For products of A (m x k) and B (k x q), any summation order, with or without fused
multiply-add [1]_: ``|fl(AB) - AB| <= gamma_k |A||B| + k 2^-1074``, gamma_k = k u / (1 - k u), k <= 2^20, no overflow.

Nothing else in the package adds an epsilon. The engine calls these functions through the module
(``rounding.enlarged``), so that a benchmark can measure what they cost.

References
----------
.. [1] N. J. Higham, "Accuracy and Stability of Numerical Algorithms", 2nd ed., SIAM 2002, section 3.5.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

UNIT = 2.0**-53
TINY = 2.0**-960
"""Above the sum of all underflow errors of any expression here, below anything a specification can mean."""
ELEMENTARY_UNITS = 8.0
"""Error of numpy's elementary functions, in units of u: 4 ulp. Measured worst case is 1.1 ulp (tanh); a test compares
with ball arithmetic."""

Array = NDArray[np.float64]


CHECKER_SLACK = 2.0**-12
"""Room that a certificate leaves to whoever checks it: ball arithmetic may carry radii of 30 bits, and may evaluate the
same formula in another order."""


def checkable(x: Any) -> Any:
    """A bound with the room of `CHECKER_SLACK`, for what a checker has to bound once more."""
    return x * (1.0 + CHECKER_SLACK)


def with_room(margin: float) -> float:
    """A positive margin, diminished by the room of `CHECKER_SLACK`."""
    return margin * (1.0 - CHECKER_SLACK)


def enlarged(x: Any, roundings: int) -> Any:
    """Upper bound of a non-negative quantity that was computed as `x` with so many rounded operations in sequence.

    If ``E <= x / (1 - u)^k`` up to underflow, then ``E <= fl(x (1 + (k + 4) u) + 2^-960)``: (1 - u)^-k <= 1 + (k + 1) u
    for k <= 2^26, and the two roundings of this function itself cost less than the remaining 3 u.
    """
    return x * (1.0 + (roundings + 4 + roundings % 2) * UNIT) + TINY


def relative_error(x: Any, roundings: int) -> Any:
    """Upper bound of the error of a quantity computed as `x` with so many roundings, ``<= (k + 2) u |x| + 2^-960``."""
    return abs(x) * ((roundings + 3) * UNIT) + TINY


def product_factor(terms: int) -> float:
    """Factor g with ``|fl(AB) - AB| <= g fl(|A||B|)`` (plus underflow) for `terms` summands: (terms + 3) u."""
    return (terms + 3) * UNIT


def sum_error(terms: int, magnitude: Any) -> Any:
    """What each factor of a product of sums has to carry: ``|fl(AB) - AB| <= |A| sum_error(k, |B|)`` for k terms.

    The constant keeps the bound when g |b| would underflow while |a| is huge: an underflow error of 2^-1074 per product
    is below |a| 2^-1000 for |a| > 2^-74, and below `TINY`, which every bound gets in the end, for smaller a.
    """
    return magnitude * product_factor(terms) + 2.0**-1000


def product_error(terms: int, absolute: Any, columns: int = 1) -> Any:
    """Bound of ``|fl(AB) - AB|``, given ``absolute = fl(|A||B|)``; with ``absolute = fl(|A| fl(|B| 1))`` of its row
    sums.

    Parameters
    ----------
    terms : int
        Inner dimension k of the product, at most 2^20.
    absolute : array
        fl(|A||B|), or fl(|A| s) with s = fl(|B| 1).
    columns : int
        Number of columns that were summed in s.
    """
    return absolute * product_factor(terms) + float((terms + 1) * columns) * 2.0**-1021


def absolute_sum(x: Array, axis: int) -> Array:
    """Upper bound of the sum of absolute values along an axis."""
    return enlarged(np.abs(x).sum(axis), x.shape[axis])  # type: ignore[no-any-return]


def lower(center: Any, radius: Any) -> Any:
    """Float below ``center - radius``."""
    return np.nextafter(center - radius, -np.inf)


def upper(center: Any, radius: Any) -> Any:
    """Float above ``center + radius``."""
    return np.nextafter(center + radius, np.inf)


def up(x: Any) -> Any:
    """Next float above: bounds one correctly rounded operation from above."""
    return np.nextafter(x, np.inf)


def down(x: Any) -> Any:
    """Next float below."""
    return np.nextafter(x, -np.inf)


def center_radius(low: Any, high: Any) -> tuple[Any, Any]:
    """Center and radius whose ball contains ``[low, high]``."""
    center = 0.5 * low + 0.5 * high
    radius = np.maximum(up(high - center), up(center - low))
    return center, np.where((low == center) & (high == center), 0.0, radius)


def elementary_error(value: Any) -> Any:
    """Error bound of an elementary function whose float result is `value`."""
    return abs(value) * (ELEMENTARY_UNITS * UNIT) + TINY


def ball_of(number: Fraction) -> tuple[float, float]:
    """Float nearest to a rational, and an upper bound of the distance (0 where the rational is a float)."""
    center = float(number)
    distance = abs(number - Fraction(center))
    return center, float_above(distance)


def balls_of(numbers: Iterable[Fraction]) -> tuple[Array, Array]:
    """`ball_of` of a sequence: two arrays."""
    pairs = [ball_of(number) for number in numbers]
    return np.array([p[0] for p in pairs], dtype=np.float64), np.array([p[1] for p in pairs], dtype=np.float64)


def float_above(number: Fraction) -> float:
    """Smallest float that is not below a rational."""
    value = float(number)
    return math.nextafter(value, math.inf) if Fraction(value) < number else value


def float_below(number: Fraction) -> float:
    """Largest float that is not above a rational."""
    value = float(number)
    return math.nextafter(value, -math.inf) if Fraction(value) > number else value


def self_test() -> list[str]:
    """Test the assumptions of this module on the machine it runs on.

    Returns
    -------
    list of str
        One sentence per violated assumption; empty when all hold.
    """
    problems = []
    if np.finfo(np.float64).eps != 2.0**-52 or 1.0 + UNIT != 1.0 or 1.0 + 3 * UNIT != 1.0 + 4 * UNIT:
        problems.append("float64 is not IEEE binary64 with rounding to nearest, ties to even")
    least = np.array([2.0**-1074, 2.0**-1022])
    if not ((least * 0.5)[1] == 2.0**-1023 and (least + least)[0] == 2.0**-1073):
        problems.append("subnormal numbers are flushed to zero")
    generator = np.random.default_rng(0)
    for size in (7, 64, 300):
        left = generator.standard_normal((size, size)) * np.exp2(generator.integers(-30, 30, (size, 1)))
        right = generator.standard_normal((size, size)) * np.exp2(generator.integers(-30, 30, (1, size)))
        left[size // 2] = np.exp2(-52.0)
        left[size // 2, 0] = 1.0
        # A product by Strassen's scheme mixes rows of different magnitude and misses this rowwise bound by far.
        bound = product_error(size, np.abs(left) @ np.abs(right))
        result = left @ right
        for row, column in ((0, 0), (size // 2, 1), (size - 1, size - 1)):
            exact = sum(
                (Fraction(a) * Fraction(b) for a, b in zip(left[row], right[:, column], strict=True)), Fraction(0)
            )
            if not abs(Fraction(result[row, column]) - exact) <= Fraction(bound[row, column]):
                problems.append(f"matrix products of size {size} exceed the summation error bound")
                break
    return problems
