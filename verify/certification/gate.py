"""Whether a row passes: expected verdicts, floors, the baseline. One function turns figures into pass or fail."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import replace
from fractions import Fraction

from ...specs.exact import decimal_text, signed_text
from ..wording import at_least
from .document import Change, Outcome, Row
from .plan import Planned

UNMET = Outcome.UNKNOWN.exit_code
"""Exit code of a row whose verdict is fine, but which does not prove what the manifest or the baseline demands."""


def judged(row: Row, planned: Planned, change: Change | None = None) -> Row:
    """A row with the gate's judgement.

    Parameters
    ----------
    row : Row
        With its figures.
    planned : Planned
        What the manifest demands.
    change : Change, optional
        Difference to the baseline; its regressions fail the row.

    Returns
    -------
    Row
    """
    entry = planned.entry
    # a search's verdict is that of the radius that it found: what is expected at a radius says nothing about it
    demanded = () if planned.search is not None else entry.expected
    expected = demanded or (Outcome.VERIFIED.value,)
    objections: list[str] = []
    codes: list[int] = []
    if row.outcome in (Outcome.ERROR, Outcome.INTERNAL):
        objections.append(row.why.sentence if row.why is not None else "there is no answer")
        codes.append(row.outcome.exit_code)
    elif row.outcome.value not in expected and not (row.outcome is Outcome.UNKNOWN and planned.allow_unknown):
        objections.append(f"{' or '.join(expected)} is expected, it is {row.outcome.value}")
        codes.append(row.outcome.exit_code or UNMET)
    unmet = [*_floors(row, planned), *(change.regressions if change is not None else ())]
    objections += unmet
    codes += [UNMET] * len(unmet)
    return replace(
        row,
        expected=demanded,
        allow_unknown=planned.allow_unknown,
        objections=tuple(objections),
        passed=not objections,
        exit_code=worst(codes),
        change=change,
    )


def worst(codes: Iterable[int]) -> int:
    """Exit code of a batch: internal error, bad input, falsified, unknown, verified."""
    return max(codes, key=(0, 5, 10, 2, 6).index, default=0)


def _floors(row: Row, planned: Planned) -> list[str]:
    """What the manifest requires beyond the verdict and is not proved; only what is VERIFIED is proved."""
    entry, verified = planned.entry, row.outcome is Outcome.VERIFIED
    objections = []
    if planned.search is not None:
        floor = planned.search.floor
        found = None if row.radius is None or row.radius.verified is None else Fraction(row.radius.verified)
        if floor is not None and not (verified and found is not None and found >= floor):
            shown = "none" if found is None else decimal_text(found)
            objections.append(f"a certified radius of {decimal_text(floor)} is required, {shown} is proved")
        return objections
    value = None if row.value is None else row.value.discounted
    for what, floor, reached in (("V(s0)", entry.value, value), ("a margin", entry.margin, row.margin)):
        if floor is None or (verified and reached is not None and Fraction(reached) >= floor):
            continue
        shown = "nothing" if reached is None or not verified else at_least(reached, 6)
        objections.append(f"{what} of at least {signed_text(floor)} is required, {shown} is proved")
    return objections
