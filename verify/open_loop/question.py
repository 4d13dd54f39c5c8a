"""The cases of a query that share a box, as arrays: which linear forms have to be positive so that nothing violates."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...specs.errors import InputError
from ...specs.queries import Case, LinearConstraint, Query
from ...specs.specification import Bounds
from ...specs.vnnlib_numbers import LARGEST
from .. import rounding
from ..balls import Ball

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MOST_NUMBERS = 20_000_000
"""Coefficients of all different constraints, zeros included."""


@dataclass(frozen=True)
class Question:
    """Cases with one box. Case i is refuted where some form of it, ``v = C x + D y - d``, is positive.

    Attributes
    ----------
    box : tuple of Bounds
        Exact.
    low, high : array, shape (n,)
        Floats outside of the box or on its faces.
    cases : tuple of Case
        As asked, every one with a constraint.
    inputs, outputs : Ball, shape (K, n) and (K, m)
        C and D, one row per different constraint.
    bound : Ball, shape (K,)
        d.
    rows : array of int
        Rows of all cases, one case after the other.
    starts : array of int, shape (cases,)
        Where each case begins in `rows`.
    """

    box: tuple[Bounds, ...]
    low: Array
    high: Array
    cases: tuple[Case, ...]
    inputs: Ball
    outputs: Ball
    bound: Ball
    rows: NDArray[np.intp]
    starts: NDArray[np.intp]

    def any_of_case(self, flags: Flags) -> Flags:
        """Per case, whether a flag of its rows is set: (B, K) to (B, cases)."""
        return np.logical_or.reduceat(flags[:, self.rows], self.starts, axis=1)

    def worst_of_case(self, values: Array) -> Array:
        """Per case, the largest value of its rows: (B, K) to (B, cases)."""
        return np.maximum.reduceat(values[:, self.rows], self.starts, axis=1)

    def values(self, x: Array, y: Array) -> Array:
        """v in plain floats, for points (B, n) and outputs (B, m): it steers a search and proves nothing."""
        return np.asarray(x @ self.inputs.mid.T + y @ self.outputs.mid.T - self.bound.mid)

    def row_of(self, case: int, values: Array) -> int:
        """The row of a case with the largest of K values."""
        rows = self.rows[self.starts[case] :][: len(self.cases[case].constraints)]
        return int(rows[np.argmax(values[rows])])


def questions_of(query: Query) -> tuple[Question, ...]:
    """A query's cases by their boxes.

    Cases without a constraint are their own question: it has no rows, and any point of the box answers it.

    Parameters
    ----------
    query : Query

    Returns
    -------
    tuple of Question

    Raises
    ------
    InputError
        The constraints are too many to be held as matrices, or a number is larger than any float64.
    """
    for case in query.cases:
        _require_floats(case)
    groups: dict[tuple[tuple[Bounds, ...], bool], list[Case]] = {}
    for case in query.cases:
        groups.setdefault((case.box, not case.constraints), []).append(case)
    sizes = int(np.prod(query.inputs)), int(np.prod(query.outputs))
    return tuple(_question(box, cases, sizes) for (box, _), cases in groups.items())


def _require_floats(case: Case) -> None:
    numbers = [end for bounds in case.box for end in (bounds.lower, bounds.upper)]
    for constraint in case.constraints:
        numbers += [constraint.bound, *(number for _, number in constraint.inputs + constraint.outputs)]
    if not all(abs(number) <= LARGEST for number in numbers):
        raise InputError("a number of the query is larger than any float64", remedy="scale the query")


def _question(box: tuple[Bounds, ...], cases: Sequence[Case], sizes: tuple[int, int]) -> Question:
    index: dict[LinearConstraint, int] = {}
    rows = [index.setdefault(constraint, len(index)) for case in cases for constraint in case.constraints]
    lengths = [len(case.constraints) for case in cases]
    if len(index) * sum(sizes) > MOST_NUMBERS:
        raise InputError(f"the constraints have more than {MOST_NUMBERS} coefficients", remedy="ask about fewer cases")
    inputs, outputs = (Ball(np.zeros((len(index), n)), np.zeros((len(index), n))) for n in sizes)
    for constraint, row in index.items():
        for ball, terms in ((inputs, constraint.inputs), (outputs, constraint.outputs)):
            for place, number in terms:
                ball.mid[row, place], ball.rad[row, place] = rounding.ball_of(number)
    return Question(
        box=box,
        low=np.array([rounding.float_below(bounds.lower) for bounds in box]),
        high=np.array([rounding.float_above(bounds.upper) for bounds in box]),
        cases=tuple(cases),
        inputs=inputs,
        outputs=outputs,
        bound=Ball(*rounding.balls_of(constraint.bound for constraint in index)),
        rows=np.array(rows, dtype=np.intp),
        starts=np.cumsum([0, *lengths[:-1]], dtype=np.intp),
    )
