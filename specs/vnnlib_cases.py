"""Assertions about a network as cases: a finite box of inputs, and the constraints that are no bounds of an input."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import chain

from .errors import InputError
from .queries import Case, LinearConstraint
from .specification import Bounds
from .vnnlib_logic import Clause, Formula, Linear, Normalizer

MOST_ENTRIES = 20_000_000
"""Bounds of all cases together."""


@dataclass(frozen=True)
class FoundCases:
    """Result of `cases_of`.

    Attributes
    ----------
    cases : tuple of Case
    note : str
        What was left out because its bounds contradict each other; "" where nothing was.
    """

    cases: tuple[Case, ...]
    note: str


def cases_of(asserted: Sequence[Formula], inputs: int, normalizer: Normalizer) -> FoundCases:
    """Normalise the conjunction of assertions.

    Parameters
    ----------
    asserted : sequence of Formula
    inputs : int
        Number of the network's inputs.
    normalizer : Normalizer

    Returns
    -------
    FoundCases

    Raises
    ------
    InputError
        An input has no finite bounds in some case, or the caps are exceeded.
    """
    # what holds in every case is not multiplied by their number
    common = chain.from_iterable(part.clauses[0] for part in asserted if len(part.clauses) == 1)
    shared = _Box([None] * inputs, [None] * inputs)
    kept = shared.restrict(common)
    rest = normalizer.conjunction([part for part in asserted if len(part.clauses) != 1])
    if len(rest.clauses) * (inputs + len(kept or ())) > MOST_ENTRIES:
        raise InputError(f"the cases have more than {MOST_ENTRIES} bounds together", remedy="ask about fewer cases")
    if kept is None:
        return FoundCases((), "no input satisfies the assertions: one of them is false by itself")
    cases: list[Case] = []
    empty: list[str] = []
    frozen = None if any(side is None for side in (*shared.lower, *shared.upper)) else shared.bounds()
    for clause in rest.clauses:
        found = _case(clause, shared, frozen, kept)
        if isinstance(found, Case):
            cases.append(found)
        elif found:
            empty.append(found)
    note = f"{len(empty)} of {len(rest.clauses)} cases are empty, the first because {empty[0]}" if empty else ""
    return FoundCases(tuple(cases), note)


def _case(
    clause: Clause, shared: _Box, frozen: tuple[Bounds, ...] | None, kept: tuple[LinearConstraint, ...]
) -> Case | str:
    """One case, or why it has no input."""
    box = shared if all(not _bounded_input(form) for form in clause) else _Box([*shared.lower], [*shared.upper])
    own = box.restrict(clause)
    if own is None:
        return "an assertion is false by itself"
    conflict = box.conflict()
    if conflict:
        return conflict
    bounds = frozen if box is shared and frozen is not None else box.bounds()
    return Case(bounds, kept + own)


def _bounded_input(form: Linear) -> bool:
    """Whether a form is about one input only."""
    names = [name for name, number in form.terms.items() if number]
    return len(names) == 1 and names[0][0] == "X"


@dataclass
class _Box:
    """Bounds of every input so far; None where there is none."""

    lower: list[Fraction | None]
    upper: list[Fraction | None]

    def restrict(self, forms: Iterable[Linear]) -> tuple[LinearConstraint, ...] | None:
        """Apply what bounds an input and return the rest; None where a form is false for every input."""
        rest = []
        for form in forms:
            terms = sorted((name, number) for name, number in form.terms.items() if number)
            bound = -form.constant
            if not terms:
                if bound < 0:
                    return None
                continue
            if len(terms) == 1 and terms[0][0][0] == "X":
                (_, index), factor = terms[0]
                self._tighten(index, bound / factor, factor > 0)
                continue
            sides = {kind: tuple((i, number) for (k, i), number in terms if k == kind) for kind in "XY"}
            rest.append(LinearConstraint(sides["X"], sides["Y"], bound))
        return tuple(rest)

    def _tighten(self, index: int, value: Fraction, from_above: bool) -> None:
        side = self.upper if from_above else self.lower
        known = side[index]
        if known is None or (value < known if from_above else value > known):
            side[index] = value

    def conflict(self) -> str:
        """Which bounds contradict each other; "" where none do.

        Raises
        ------
        InputError
            An input has no finite bounds.
        """
        found = ""
        for index, (low, high) in enumerate(zip(self.lower, self.upper, strict=True)):
            if low is None or high is None:
                side = "lower" if low is None else "upper"
                raise InputError(f"input {index} has no {side} bound", remedy="give every input finite bounds")
            if low > high and not found:
                found = f"input {index} has a lower bound above its upper bound"
        return found

    def bounds(self) -> tuple[Bounds, ...]:
        """The box, where all bounds are known."""
        return tuple(
            Bounds(low, high)
            for low, high in zip(self.lower, self.upper, strict=True)
            if low is not None and high is not None
        )
