"""Where along the radii an answer changes: bisection on exact decimals, of a question that takes long to answer."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import TypeAlias

Question: TypeAlias = Callable[[Fraction], bool]


def between(low: Fraction, high: Fraction, resolution: Fraction, most: int = 1) -> list[Fraction]:
    """At most `most` radii strictly between two, on multiples of the resolution above `low`, ascending.

    None where the two are not farther apart than the resolution.
    """
    count = -(-(high - low) // resolution)  # gaps, the last one may be smaller
    steps = sorted({count * part // (most + 1) for part in range(1, most + 1)} - {0})
    return [low + resolution * step for step in steps]


def smallest(
    holds: Question, grid: Sequence[Fraction], low: Fraction, resolution: Fraction, over: Callable[[], bool]
) -> None:
    """Ask for the smallest radius above `low` of which something holds that is easier for larger radii.

    Parameters
    ----------
    holds : callable
        Remembers its answers: they are what the caller wants.
    grid : sequence of Fraction
        Ascending. Its radii above `low` are asked first, from the largest one down until one holds.
    low : Fraction
        Of which it does not hold.
    resolution : Fraction
        Positive.
    over : callable
        Whether to stop now.
    """
    above = [low, *(radius for radius in grid if radius > low)]
    last = next((i for i in range(len(above) - 1, 0, -1) if not over() and holds(above[i])), 0)
    first = 0
    while last - first > 1 and not over():
        middle = (first + last) // 2
        first, last = (first, middle) if holds(above[middle]) else (middle, last)
    low, high = above[first], above[last]
    while high - low > resolution and not over():
        (radius,) = between(low, high, resolution)
        low, high = (low, radius) if holds(radius) else (radius, high)


def largest(
    holds: Question,
    grid: Sequence[Fraction],
    low: Fraction,
    high: Fraction | None,
    resolution: Fraction,
    over: Callable[[], bool],
) -> None:
    """Ask for the largest radius above `low` of which something holds that is harder for larger radii.

    Parameters
    ----------
    holds : callable
        Remembers its answers.
    grid : sequence of Fraction
        Ascending. Its radii between `low` and `high` are asked first, from the smallest one up until one fails.
    low : Fraction
        Of which it holds.
    high : Fraction or None
        Of which it is known not to hold.
    resolution : Fraction
        Positive.
    over : callable
        Whether to stop now.
    """
    for radius in grid:
        if over() or (high is not None and radius >= high):
            break
        if radius > low:
            if not holds(radius):
                high = radius
                break
            low = radius
    while high is not None and high - low > resolution and not over():
        (radius,) = between(low, high, resolution)
        low, high = (radius, high) if holds(radius) else (low, radius)
