"""What has changed since an earlier report, and what of it is a regression."""

from __future__ import annotations

import json
import math
from collections.abc import Sequence
from fractions import Fraction
from pathlib import Path

from ...specs.errors import InputError
from ...specs.exact import decimal_text, exact_decimal
from ...specs.reader import digest
from .document import Baseline, Change, Outcome, Report, Row, report_from_json

MOST_BYTES = 1 << 30
TOLERANCE = Fraction(1, 10**6)
"""Two machines round differently; what is less than this is no change."""


def read_baseline(path: Path) -> tuple[Report, str]:
    """An earlier ``certification.json`` and its sha256.

    Raises
    ------
    InputError
        It is not there, or not such a report.
    """
    remedy = "give the certification.json of an earlier run"
    try:
        if not path.is_file():
            raise InputError("there is no such report", where=str(path), remedy=remedy)
        if path.stat().st_size > MOST_BYTES:
            raise InputError(f"no report has more than {MOST_BYTES} bytes", where=str(path), remedy=remedy)
        content = path.read_bytes()
        report = report_from_json(json.loads(content))
        _require_figures(report)
        return report, digest(content)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"cannot read the report: {reason}", where=str(path), remedy=remedy) from None
    except (ValueError, OverflowError, RecursionError):
        raise InputError("this is no JSON", where=str(path), remedy=remedy) from None
    except InputError as error:
        raise error if error.where else error.at(str(path)) from None


def _require_figures(report: Report) -> None:
    """What is compared has to be what it seems to be: no comparison passes, and none fails, by a NaN or a text."""
    names = [row.name for row in report.rows]
    numbers = [row.value.discounted for row in report.rows if row.value is not None]
    numbers += [entry.margin for row in report.rows for entry in row.requirements]
    radii = [row.radius.verified for row in report.rows if row.radius is not None]
    problem = ""
    if not all(isinstance(name, str) for name in names) or len(set(names)) < len(names):
        problem = "a row's name is no text, or appears twice"
    elif not all(number is None or _is_finite(number) for number in numbers):
        problem = "a margin or a V(s0) is no number"
    elif not all(radius is None or (isinstance(radius, str) and _is_decimal(radius)) for radius in radii):
        problem = "a certified radius is no decimal"
    if problem:
        raise InputError(f"the report is damaged: {problem}", remedy="write it again: setrl certify")


def _is_finite(number: object) -> bool:
    return isinstance(number, int | float) and not isinstance(number, bool) and math.isfinite(number)


def _is_decimal(text: str) -> bool:
    try:
        return exact_decimal(text) >= 0
    except InputError:
        return False


def baseline_of(earlier: Report, name: str, sha256: str, rows: Sequence[Row], tolerance: Fraction) -> Baseline:
    """What the report says about its baseline; rows are told apart by their names."""
    before, now = {row.name for row in earlier.rows}, {row.name for row in rows}
    return Baseline(
        name,
        sha256,
        decimal_text(tolerance),
        tuple(row.name for row in earlier.rows if row.name not in now),
        tuple(row.name for row in rows if row.name not in before),
    )


def change_of(before: Row, after: Row, tolerance: Fraction) -> Change:
    """Compare a row with the baseline's.

    A verdict that is worse is a regression, and so is a V(s0), margin or certified radius that was proved and is now
    smaller by more than the tolerance, or no longer proved.

    Parameters
    ----------
    before, after : Row
    tolerance : Fraction

    Returns
    -------
    Change
    """
    regressions = []
    verdict = None
    if before.outcome is not after.outcome:
        verdict = (before.outcome.value, after.outcome.value)
        if after.outcome.rank > before.outcome.rank:
            regressions.append(f"{before.outcome.value} before, {after.outcome.value} now")
    figures = {"V(s0)": (_value(before), _value(after)), "the margin": (_margin(before), _margin(after))}
    changed: dict[str, tuple[float | None, float | None] | None] = {}
    for name, (old, new) in figures.items():
        changed[name] = None if old == new else (old, new)
        if old is not None and not (new is not None and Fraction(new) >= Fraction(old) - tolerance):
            regressions.append(f"{name} was {old!r}, is {'not proved' if new is None else repr(new)}")
    old_radius, new_radius = _radius(before), _radius(after)
    if old_radius is not None and not (
        new_radius is not None and Fraction(new_radius) >= Fraction(old_radius) - tolerance
    ):
        regressions.append(f"the certified radius was {old_radius}, is {new_radius or 'not proved'}")
    radius = None if old_radius == new_radius else (old_radius, new_radius)
    return Change(verdict, changed["V(s0)"], changed["the margin"], radius, tuple(regressions))


def _value(row: Row) -> float | None:
    """V(s0) where it is proved."""
    return row.value.discounted if row.value is not None and row.outcome is Outcome.VERIFIED else None


def _margin(row: Row) -> float | None:
    return row.margin if row.outcome is Outcome.VERIFIED else None


def _radius(row: Row) -> str | None:
    return row.radius.verified if row.radius is not None and row.outcome is Outcome.VERIFIED else None
