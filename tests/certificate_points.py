"""Claimed sets as affine images of factors, and points that show that a claim about one is false.

A claim: for all factors b, what a function makes of the point c + G b differs from c' + G'b by a member of the rows of
its own and the box. Points are chosen in float64; one exact point, and balls of it, show that a claim is false.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from setrl.verify.checker.program import ball

Array = Any
F = Fraction
POINTS, TRIED = 24, 2
"""Corners per set; points that are proved."""


@dataclass(frozen=True)
class Affine:
    """``center + factors rows`` plus what belongs to nothing else: own rows and a box."""

    center: Array
    rows: Array
    own: Array
    box: Array

    @classmethod
    def of(cls, center: Any, rows: Any, own: Any, box: Any) -> Affine:
        size = len(center)
        return cls(
            np.array(center, float),
            np.array(rows, float).reshape(-1, size),
            np.array(own, float).reshape(-1, size),
            np.array(box, float),
        )

    def excess(self, residual: Array, lines: Array) -> Array:
        """``max_l (l . residual - support(l))`` per point, in float64; and which line it is."""
        support = np.abs(lines @ self.own.T).sum(1) + np.abs(lines) @ self.box
        table = residual @ lines.T - support
        return table.max(1), lines[table.argmax(1)]

    def is_left(self, factors: Sequence[F], reached: Sequence[Any], line: Array) -> bool:
        """Whether balls around a point are provably outside, in the direction of a line; factors are exact."""
        total = arb(0)
        for i, entry in enumerate(line.tolist()):
            middle = F(float(self.center[i])) + sum(
                (f * F(float(row[i])) for f, row in zip(factors, self.rows, strict=True)), F(0)
            )
            total += arb(entry) * (reached[i] - ball(middle))
        support = F(0)
        for row in self.own:
            support += abs(sum((F(x) * F(y) for x, y in zip(line.tolist(), row.tolist(), strict=True)), F(0)))
        support += sum((abs(F(x)) * F(r) for x, r in zip(line.tolist(), self.box.tolist(), strict=True)), F(0))
        return bool(total > ball(support))


def lines_for(claim: Affine, generator: Any) -> Array:
    """Axes, normals of the own rows of planar sets, and random directions, both ways."""
    size = claim.center.size
    lines = [np.eye(size), generator.normal(size=(12 if size > 1 else 0, size))]
    if size == 2 and len(claim.own):
        lines.append(claim.own[:, ::-1] * np.array([1.0, -1.0]))
    found = np.concatenate(lines)
    found = found[np.abs(found).max(1) > 0.0]
    found /= np.abs(found).max(1, keepdims=True)
    return np.concatenate([found, -found])


def factors_of(count: int, generator: Any) -> Array:
    """Corners, single extremes, the middle, some points inside."""
    corners = np.sign(generator.normal(size=(POINTS, count)))
    inside = generator.uniform(-1, 1, size=(POINTS // 3, count))
    single = np.concatenate([np.eye(count), -np.eye(count)])[: 2 * POINTS]
    return np.concatenate([np.zeros((1, count)), corners, inside, single])


def judge(
    claim: Affine,
    start: Affine,
    image: Callable[[Array], Array],
    prove: Callable[[list[F]], Sequence[Any] | None],
    generator: Any,
    used: int,
) -> bool:
    """Whether the image of some point of `start` provably leaves a claim whose first rows share the start's factors.

    `image` takes points of the start, in float64; `prove` takes the exact factors of one, and gives balls.
    `used` factors are those of the claim's rows; the start may have more behind them.
    """
    lines = lines_for(claim, generator)
    count = len(start.rows)
    factors = factors_of(count, generator)
    points = start.center + factors @ start.rows
    residual = image(points) - claim.center - factors[:, :used] @ claim.rows
    worst, line = claim.excess(residual, lines)
    for chosen in np.argsort(-np.where(np.isnan(worst), -np.inf, worst))[:TRIED]:
        exact = [F(float(x)) for x in factors[chosen]]
        reached = prove(exact)
        if reached is not None and claim.is_left(exact[:used], reached, line[chosen]):
            return True
    return False


def exact_point(claim: Affine, factors: Sequence[F]) -> list[F]:
    """``c + G b`` in rationals."""
    return [
        F(float(c)) + sum((f * F(float(row[i])) for f, row in zip(factors, claim.rows, strict=True)), F(0))
        for i, c in enumerate(claim.center)
    ]


def unboxed(center: Any, rows: Any, radius: Any) -> Affine:
    """A tracked set with its box as rows, in the certificate's order."""
    box = np.diag(np.array(radius, float))[np.array(radius) != 0.0]
    found = Affine.of(center, rows, (), np.zeros(len(center)))
    return Affine(found.center, np.concatenate([found.rows, box]), found.own, found.box)
