"""Linear arithmetic and its and/or combinations, exact, normalised to a disjunction while they are read."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from itertools import chain, product
from typing import TypeAlias

from .errors import InputError

MOST_CASES = 100_000
MOST_CONSTRAINTS = 4_000_000
"""Of all normal forms together that are made on the way."""
MOST_BITS = 1 << 14
"""Of a number that arithmetic makes."""

Variable: TypeAlias = tuple[str, int]
"""("X", i) or ("Y", j)."""


@dataclass(frozen=True)
class Linear:
    """``sum_v terms[v] v + constant``; a term may be 0."""

    terms: Mapping[Variable, Fraction]
    constant: Fraction


Clause: TypeAlias = tuple[Linear, ...]
"""A conjunction of ``form <= 0``."""


@dataclass(frozen=True)
class Formula:
    """A disjunction of clauses."""

    clauses: tuple[Clause, ...]


def combine(parts: Sequence[tuple[int, Linear]]) -> Linear:
    """Sum of forms, each times a whole number."""
    terms: dict[Variable, Fraction] = {}
    constant = Fraction(0)
    for factor, part in parts:
        constant = _bounded(constant + factor * part.constant)
        for variable, number in part.terms.items():
            terms[variable] = _bounded(terms.get(variable, Fraction(0)) + factor * number)
    return Linear(terms, constant)


def multiply(parts: Sequence[Linear]) -> Linear:
    """Product of forms of which at most one is not a number.

    Raises
    ------
    InputError
        The product is not linear, or its numbers are too long.
    """
    variable = [part for part in parts if part.terms]
    if len(variable) > 1:
        raise InputError("a product of two variables is not linear", remedy="only linear arithmetic is supported")
    factor = Fraction(1)
    for part in parts:
        if not part.terms:
            factor = _bounded(factor * part.constant)
    if not variable:
        return Linear({}, factor)
    only = variable[0]
    terms = {name: _bounded(factor * number) for name, number in only.terms.items()}
    return Linear(terms, _bounded(factor * only.constant))


def _bounded(number: Fraction) -> Fraction:
    if number.numerator.bit_length() > MOST_BITS or number.denominator.bit_length() > MOST_BITS:
        raise InputError(f"arithmetic makes a number of more than {MOST_BITS} bits", remedy="scale or round it")
    return number


@dataclass
class Normalizer:
    """Makes normal forms within one budget.

    Attributes
    ----------
    made : int
        Constraints in all normal forms so far.
    """

    made: int = field(default=0)

    def conjunction(self, parts: Sequence[Formula]) -> Formula:
        """``and``: every choice of one clause per part.

        Raises
        ------
        InputError
            More than `MOST_CASES` cases or `MOST_CONSTRAINTS` constraints.
        """
        cases = 0 if any(not part.clauses for part in parts) else 1
        for part in parts:
            cases = min(cases * len(part.clauses), MOST_CASES + 1)
        # every clause of a part occurs once per choice from the others
        self._spend(cases, sum(cases // len(part.clauses) * _size(part) for part in parts) if cases else 0)
        choices = product(*(part.clauses for part in parts))
        return Formula(tuple(tuple(chain.from_iterable(choice)) for choice in choices))

    def disjunction(self, parts: Sequence[Formula]) -> Formula:
        """``or``: the clauses of all parts.

        Raises
        ------
        InputError
            More than `MOST_CASES` cases.
        """
        self._spend(sum(len(part.clauses) for part in parts), 0)
        return Formula(tuple(chain.from_iterable(part.clauses for part in parts)))

    def _spend(self, cases: int, constraints: int) -> None:
        self.made += cases + constraints
        if cases > MOST_CASES or self.made > MOST_CONSTRAINTS:
            raise InputError(
                f"the query has more than {MOST_CASES} cases, or {MOST_CONSTRAINTS} constraints in them",
                remedy="ask about fewer cases at once",
            )


def _size(part: Formula) -> int:
    return sum(len(clause) for clause in part.clauses)
