"""Taylor expansions of an ODE's solution in ball arithmetic, with a remainder that is proved.

For x' = f(x, p), x(0) = x0, and a box B that contains the solution on [0, h]:

    x(t) in sum_(k<K) X_k(x0) t^k + X_K(B) t^K,     0 <= t <= h,

where X_k(y) is the k-th Taylor coefficient of the solution that starts at y. B is proved by Picard iteration: the
solution exists and stays in ``x0 + [0, h] f(B)`` where that lies within B. Guesses (of B, of h) may be anything; only
that inclusion and the finiteness of every coefficient count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

from flint import arb, ctx

from .jets import flow_jets, map_jets
from .program import Program, ball, compile_program

__all__ = ["Program", "Segment", "ball", "between", "coefficients", "compile_program", "evaluate", "solve"]

Vector: TypeAlias = list[Any]

PICARD_TRIES = 8
SMALLEST_STEP, MOST_STEPS = 2**14, 1000
"""Where the expansion gives up: parts of a duration that are smaller, or more of them."""


def between(low: Fraction, high: Fraction) -> Any:
    """A ball that contains ``[low, high]``."""
    return ball(low).union(ball(high))


def evaluate(program: Program, inputs: Sequence[Any]) -> Vector:
    """Enclose a program's outputs for all points of a vector of balls."""
    return [value for (value,) in map_jets(program, inputs, 0, ())]


def coefficients(program: Program, state: Sequence[Any], held: Sequence[Any], order: int) -> list[Vector]:
    """Taylor coefficients 0 .. order of the solution that starts at `state`, inputs and disturbances `held`."""
    return [[value for (value,) in row] for row in flow_jets(program, [*state, *held], 0, order + 1, ())]


@dataclass(frozen=True)
class Segment:
    """The solution on ``[start, start + length]``; the last coefficient is the one over `box`, the remainder's."""

    start: Fraction
    length: Fraction
    coefficients: list[Vector]
    box: Vector

    def at(self, time: Fraction) -> Vector:
        """Enclosure at one exact time."""
        return self._evaluated(ball(time - self.start), time, time)

    def over(self, first: Fraction, last: Fraction) -> Vector:
        """Enclosure of all states between two times."""
        return self._evaluated(between(first - self.start, last - self.start), first, last)

    def _evaluated(self, t: Any, first: Fraction, last: Fraction) -> Vector:
        if not self.start <= first <= last <= self.start + self.length:
            raise AssertionError("a time outside the segment")
        total = self.coefficients[-1]
        for row in reversed(self.coefficients[:-1]):
            total = [a + t * b for a, b in zip(row, total, strict=True)]
        return total


def solve(
    program: Program, state: Sequence[Any], held: Sequence[Any], duration: Fraction
) -> tuple[list[Segment], Vector] | None:
    """Enclose the solution on ``[0, duration]`` at the precision in force.

    Parameters
    ----------
    program : Program
        The vector field; inputs are states and what is held constant.
    state : sequence of balls
    held : sequence of balls
    duration : Fraction

    Returns
    -------
    (list of Segment, vector of balls) or None
        The parts and the final state; None where no solution could be proved to exist up to the end.
    """
    segments: list[Segment] = []
    time, current, length = Fraction(0), list(state), duration
    while time < duration:
        if len(segments) == MOST_STEPS:
            return None
        segment = _step(program, current, held, time, min(length, duration - time), duration / SMALLEST_STEP)
        if segment is None:
            return None
        segments.append(segment)
        time += segment.length
        current = segment.at(time)
        length = 2 * segment.length
    return segments, current


def _step(
    program: Program, state: Vector, held: Sequence[Any], start: Fraction, length: Fraction, least: Fraction
) -> Segment | None:
    order = ctx.prec // 5
    found = coefficients(program, state, held, order - 1)
    if not _finite(*found):
        return None
    while length > 2 * least and not _negligible(found[-1], state, length, order - 1):
        length /= 2
    while length >= least:
        box = _a_priori(program, state, held, length)
        if box is not None:
            last = coefficients(program, box, held, order)[order]
            if _finite(last) and (length < 2 * least or _negligible(last, found[0], length, order)):
                return Segment(start, length, [*found, last], box)
        length /= 2
    return None


def _negligible(last: Vector, state: Vector, length: Fraction, order: int) -> bool:
    """Whether the remainder is as small as the rounding; decides how long a step is, nothing else."""
    power = ball(length) ** order
    return all(
        bool(abs(value) * power < (1 + abs(x)) * arb(2) ** -(ctx.prec - 8))
        for value, x in zip(last, state, strict=True)
    )


def _a_priori(program: Program, state: Vector, held: Sequence[Any], length: Fraction) -> Vector | None:
    """A box that provably contains the solution on ``[0, length]``."""
    time = between(Fraction(0), length)

    def picard(box: Vector) -> Vector:
        slope = evaluate(program, [*box, *held])
        return [x + time * v for x, v in zip(state, slope, strict=True)]

    image = picard(state)
    for _ in range(PICARD_TRIES):
        if not _finite(image):
            return None
        # any guess will do
        box = [arb(y.mid(), y.rad() * arb(1.25) + arb(2) ** -(ctx.prec // 2)) for y in image]
        image = picard(box)
        if _finite(image) and all(b.contains(y) for b, y in zip(box, image, strict=True)):
            return image
    return None


def _finite(*rows: Vector) -> bool:
    return all(bool(value.is_finite()) for row in rows for value in row)
