"""What a row says before it is decided and where there is no answer; which rows the journal's word is taken for."""

from __future__ import annotations

import re
from pathlib import Path

from ...specs.exact import decimal_text
from ..checker.certificate_file import read_certificate
from ..checker.witness_file import read_witness
from ..executors.task import Broken, Lost, Refused
from .document import Outcome, Row, Why
from .figures import Figures
from .plan import Planned

_PASSING = ("time limit", "memory limit")
"""Resources that a manifest limits: a row that used them up keeps its verdict, one that was lost otherwise does not."""


def blank(planned: Planned, outcome: Outcome, why: Why | None) -> Row:
    """A row without figures."""
    return Row(
        planned.name,
        planned.key,
        planned.policy,
        planned.specification,
        planned.plant,
        None if planned.epsilon is None else decimal_text(planned.epsilon),
        outcome,
        search=planned.search is not None,
        why=why,
        options={} if planned.question is None else planned.question.chosen,
    )


def without_answer(planned: Planned, outcome: Refused | Broken | Lost) -> Row:
    """A row whose process did not answer: one of three reasons, and no other row is touched."""
    if isinstance(outcome, Refused):
        return blank(planned, Outcome.ERROR, Why("input", outcome.sentence))
    if isinstance(outcome, Broken):
        remedy = "please report this with the policy, the specification and the output of `setrl doctor`"
        return blank(planned, Outcome.INTERNAL, Why("internal", outcome.sentence, remedy=remedy))
    source = {"time": "time limit", "memory": "memory limit"}.get(outcome.kind, "lost")
    remedy = {
        "time limit": "raise the row's timeout, or set fewer splits",
        "memory limit": "raise the row's memory",
    }.get(source, "run setrl certify again: the row is tried again")
    sentence = f"the row's process {outcome.sentence}"
    return blank(planned, Outcome.UNKNOWN, Why("resource", sentence, source=source, remedy=remedy))


def is_about(figures: Figures, planned: Planned) -> bool:
    """Whether evidence is about the very files that the row names."""
    read = (
        read_certificate(figures.evidence).header if figures.kind == "certificate" else read_witness(figures.evidence)
    )
    named = (planned.policy, planned.specification, planned.plant)
    return (read.policy, read.specification, read.plant) == tuple(subject.sha256 for subject in named)


def keeps(row: Row) -> bool:
    """Whether the journal's word on a row is taken: verdicts, and rows that used up what the manifest gave them."""
    if row.outcome in (Outcome.VERIFIED, Outcome.FALSIFIED):
        return row.evidence is not None
    if row.outcome is not Outcome.UNKNOWN or row.why is None:
        return False
    return row.why.kind == "proof" or row.why.source in _PASSING


def slug(planned: Planned) -> str:
    """A file name that says which row it belongs to."""
    at = "" if planned.epsilon is None else f"-{decimal_text(planned.epsilon)}"
    names = (Path(subject.name).stem[:40] for subject in (planned.policy, planned.specification))
    return re.sub(r"[^A-Za-z0-9.]+", "-", "-".join(names) + at).strip("-.")
