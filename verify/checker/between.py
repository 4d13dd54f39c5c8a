"""Supports of the sets between the ends of a step: every state at every time of a part of it.

Around the middle t_m of a part, with |tau| <= delta, and t_e its end:

    P(t_m + tau) in P(t_m) + P'(t_m) tau +- delta^2/2 |P''|,
    DP(t_m + tau) d in DP(t_m) d +- (|DP'(t_m)| delta + |DP''| delta^2/2) a,     a >= |d|,

and for the second-order and the remainder term their bounds at t_e. |P''| is ``sum_k k (k - 1) |phi_k| t_e^(k-2)``.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .image import Start
from .polynomials import combine, powers_of
from .program import ball

Vector: TypeAlias = list[Any]


@dataclass(frozen=True)
class Between:
    """The set of one part of a step: what its supports are computed from.

    Attributes
    ----------
    center : list of balls, (n,)
    jacobian : list of lists of balls, (n, d)
    drift : list of balls, (n,)
        Half of the way of the center during the part, with its sign: one factor, shared by all states.
    extra : list of balls, (n,)
        Half-widths of what is left.
    """

    start: Start
    center: Vector
    jacobian: list[Vector]
    drift: Vector
    extra: Vector

    def least(self, direction: Sequence[Any]) -> Any:
        """A ball whose lower end is not above ``min direction . z`` over the set."""
        used = [i for i, entry in enumerate(direction) if not entry.is_zero()]
        if not used:  # weights that cancel the facets
            return arb(0)
        start = self.start
        along = combine([direction[i] for i in used], [self.jacobian[i] for i in used])
        middle = sum((direction[i] * self.center[i] for i in used), arb(0))
        reach = abs(sum((direction[i] * self.drift[i] for i in used), arb(0)))
        reach += sum((abs(direction[i]) * self.extra[i] for i in used), arb(0))
        reach += sum((abs(a) * r for a, r in zip(along, start.radius, strict=True) if r), arb(0))
        if start.rows:
            rows = arb_mat(len(start.rows), len(start.center), [x for row in start.rows for x in row])
            reach += sum(map(abs, (rows * arb_mat(len(along), 1, along)).entries()), arb(0))
        return middle - reach


@dataclass(frozen=True)
class Motion:
    """A step that was followed: what the sets between its ends need.

    Attributes
    ----------
    start : Start
    duration : Fraction
    used : tuple of int
        Coordinates that the vector field reads.
    value : list of lists of balls, (K, n)
        Time coefficients at the center.
    jacobian : list of arb_mat, K times (n, d)
    hessian : list of lists of lists of balls, (K, n, v (v + 1)/2)
        Over the start's box.
    remainder : list of balls, (n,)
        Time coefficient K over the a-priori box.
    """

    start: Start
    duration: Fraction
    used: tuple[int, ...]
    value: list[Vector]
    jacobian: list[list[Vector]]
    hessian: list[list[Vector]]
    remainder: Vector

    def between(self, part: int, count: int) -> Between:
        """The set of one of `count` equal parts of the step."""
        order, states = len(self.value), len(self.remainder)
        middle = powers_of(ball(self.duration * Fraction(2 * part + 1, 2 * count)), order)
        end = powers_of(ball(self.duration * Fraction(part + 1, count)), order + 1)
        delta = ball(self.duration / (2 * count))
        velocity = [arb(0), *(k * middle[k - 1] for k in range(1, order))]
        bend = [arb(0), arb(0), *(k * (k - 1) * end[k - 2] for k in range(2, order))]
        bend = [delta * delta / 2 * b for b in bend[:order]]
        spread = [arb(a) for a in self.start.spread]
        variables = [spread[i] for i in self.used]
        center = combine(middle, self.value)
        speed = combine(velocity, self.value)
        bent = combine(bend, [[abs(x) for x in row] for row in self.value])
        jacobian, extra = [], []
        for i in range(states):
            rows = [row[i] for row in self.jacobian]
            jacobian.append(combine(middle, rows))
            moving = combine(velocity, rows)
            bending = combine(bend, [[abs(x) for x in row] for row in rows])
            total = bent[i] + abs(self.remainder[i]) * end[order]
            total += sum(
                (
                    (delta * abs(m) + b) * a
                    for m, b, a in zip(moving, bending, spread, strict=True)
                    if not b.is_zero() or not m.is_zero()
                ),
                arb(0),
            )
            curvature = combine(end[:order], [[abs(x) for x in row[i]] for row in self.hessian])
            entries = iter(curvature)
            for first in range(len(variables)):
                for second in range(first, len(variables)):
                    entry = next(entries)
                    if not entry.is_zero():
                        total += entry * variables[first] * variables[second] / (2 if first == second else 1)
            extra.append(total)
        return Between(self.start, center, jacobian, [delta * v for v in speed], extra)
