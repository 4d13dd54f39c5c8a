"""A row as the separate questions that test reports and code scanning count: one per requirement, and the gate.

A question is answered with yes only where the whole row is VERIFIED: the engine's word about one requirement of an
UNKNOWN row has no certificate.
"""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum

from ..document import Outcome, RequirementRow, Row
from . import phrases


class Answer(StrEnum):
    """PROVED; DISPROVED; OPEN, what makes the row UNKNOWN; ASIDE, not decided because of another; BROKEN, no answer."""

    PROVED = "proved"
    DISPROVED = "disproved"
    OPEN = "open"
    ASIDE = "aside"
    BROKEN = "broken"
    OBJECTION = "objection"


@dataclass(frozen=True)
class Case:
    """One question about a row.

    Attributes
    ----------
    rule : str
        "avoid", "stay", "reach", "value", "radius", "input", "internal" or "gate".
    name : str
        Of the requirement, or what is asked.
    answer : Answer
    message : str
    line : int
        In the specification; 0 where there is none.
    """

    rule: str
    name: str
    answer: Answer
    message: str
    line: int = 0


def cases(row: Row) -> tuple[Case, ...]:
    """The questions of a row and their answers, at least one; one of them blames the row unless it passes.

    Parameters
    ----------
    row : Row
    """
    if row.outcome in (Outcome.ERROR, Outcome.INTERNAL):
        rule = "input" if row.outcome is Outcome.ERROR else "internal"
        return (Case(rule, rule, Answer.BROKEN, _why(row)),)
    asked = [_requirement(row, entry) for entry in row.requirements] if not row.search else []
    if not asked:
        asked = [_whole(row)]
    blamed = {Answer.DISPROVED, Answer.OPEN}
    if row.outcome is not Outcome.VERIFIED and not any(case.answer in blamed for case in asked):
        answer = Answer.OPEN if row.outcome is Outcome.UNKNOWN else Answer.DISPROVED
        asked.append(Case("gate", "verdict", answer, _why(row)))
    if not row.passed and row.outcome is Outcome.VERIFIED:
        objections = row.objections or ("the row does not pass",)
        asked += [Case("gate", f"gate {n}", Answer.OBJECTION, text) for n, text in enumerate(objections, 1)]
    return tuple(asked)


def _whole(row: Row) -> Case:
    """The only question of a row that has no requirement, or that searches a radius."""
    rule, name = ("radius", "certified radius") if row.search else ("value", "V(s0)")
    found = phrases.found_text(row) if row.search else f"V(s0) {phrases.value_text(row.value)}"
    answers = {
        Outcome.VERIFIED: (Answer.PROVED, found),
        Outcome.UNKNOWN: (Answer.OPEN, _why(row)),
        Outcome.FALSIFIED: (Answer.DISPROVED, _why(row)),
    }
    return Case(rule, name, *answers[row.outcome])


def _requirement(row: Row, entry: RequirementRow) -> Case:
    margin = f"margin {phrases.margin_text(entry.margin)}"
    if entry.time is not None and entry.margin is not None:
        margin += f" at {phrases.when(entry.time)}"
    blamed = row.why.requirement if row.why is not None else ""
    if row.outcome is Outcome.VERIFIED:
        return _case(entry, Answer.PROVED, f"proved, {margin}")
    if row.outcome is Outcome.FALSIFIED:
        if entry.name == blamed:
            return _case(entry, Answer.DISPROVED, _why(row))
        return _case(entry, Answer.ASIDE, f"not decided: {blamed or 'another requirement'} is violated")
    if entry.proved:
        return _case(entry, Answer.ASIDE, f"no certificate: the row is UNKNOWN, {margin} by the engine alone")
    return _case(entry, Answer.OPEN, _why(row) if entry.name == blamed else f"not proved, {margin}")


def _case(entry: RequirementRow, answer: Answer, message: str) -> Case:
    return Case(entry.kind, entry.name, answer, message, entry.line)


def _why(row: Row) -> str:
    """The reason with its remedy."""
    if row.why is None or not row.why.remedy:
        return phrases.finding(row)
    return f"{phrases.finding(row)}; {row.why.remedy}"
