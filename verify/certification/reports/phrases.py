"""What several formats say in the same words: the headline, a radius, a margin, V(s0), why a row does not pass."""

from __future__ import annotations

from ...wording import at_least, number, quantity
from ..document import Change, Outcome, Report, Row, ValueRow


def headline(report: Report) -> str:
    """The one sentence about the batch: ``11 of 12 rows pass: 9 VERIFIED, 2 UNKNOWN, 1 FALSIFIED``."""
    counts = ", ".join(f"{count} {outcome}" for outcome, count in report.counts.items())
    total = len(report.rows)
    if not report.failed:
        return f"{'the row passes' if total == 1 else f'all {total} rows pass'}: {counts}" if total else "no rows"
    passed = total - len(report.failed)
    return f"{passed if passed else 'none'} of {quantity(total, 'row')} {'passes' if passed == 1 else 'pass'}: {counts}"


def radius_text(row: Row) -> str:
    """The perturbation radius of a row."""
    if row.search:
        return "searched"
    return "as specified" if row.epsilon is None else row.epsilon


def found_text(row: Row) -> str:
    """What a search for the certified radius found; "" where there was none."""
    if row.radius is None:
        return ""
    found = row.radius
    parts = ["no radius is VERIFIED" if found.verified is None else f"VERIFIED up to {found.verified}"]
    if found.falsified is not None:
        parts.append(f"FALSIFIED at {found.falsified}")
    return f"{', '.join(parts)} (resolution {found.resolution})"


def margin_text(margin: float | None) -> str:
    """A margin with its sign, rounded down; "none" where no set could be compared."""
    if margin is None:
        return "none"
    return f"+{at_least(margin, 4)}" if margin > 0.0 else at_least(margin, 4)


def value_text(value: ValueRow | None) -> str:
    """V(s0) as a lower bound; "" where the specification has no reward."""
    if value is None:
        return ""
    return "no lower bound" if value.discounted is None else f"≥ {at_least(value.discounted, 5)}"


def value_of(row: Row) -> str:
    """V(s0) of a row; in parentheses where it is the engine's word alone, without a certificate."""
    text = value_text(row.value)
    return f"({text})" if text and row.outcome is not Outcome.VERIFIED else text


def seconds_text(seconds: float | None) -> str:
    """A duration."""
    if seconds is None:
        return ""
    return f"{seconds:.2f} s" if seconds < 100.0 else f"{seconds:.0f} s"


def finding(row: Row) -> str:
    """What was found, in one sentence: the claim where it is VERIFIED, else the reason."""
    if row.outcome is Outcome.VERIFIED:
        return row.claim or "every requirement is proved"
    return row.why.sentence if row.why is not None else "no reason was recorded"


def when(seconds: float | None) -> str:
    """A time of the run."""
    return "" if seconds is None else f"{number(seconds)} s"


def bound_text(bound: float | None) -> str:
    """A lower bound, rounded down; "none" where there is none."""
    return "none" if bound is None else at_least(bound, 5)


def differences(change: Change) -> list[tuple[str, str, str]]:
    """What differs from the baseline: name, before, after."""
    found: list[tuple[str, str, str]] = []
    if change.verdict is not None:
        found.append(("verdict", *change.verdict))
    for name, numbers in (("V(s0)", change.value), ("margin", change.margin)):
        if numbers is not None:
            found.append((name, bound_text(numbers[0]), bound_text(numbers[1])))
    if change.radius is not None:
        before, after = (radius or "none" for radius in change.radius)
        found.append(("certified radius", before, after))
    return found
