"""Old evidence looked at again: whether it still proves what the journal says about its row, and no less."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

from ...models.perturbation import proportions
from ...specs.errors import InputError
from ..checker.certificate_file import read_certificate
from ..checker.contract import read_contract
from ..checker.recheck import recheck
from ..checker.witness_file import read_witness
from ..deadline import Deadline
from .document import Outcome, Row
from .question import Question

PROVES = {"certificate": Outcome.VERIFIED, "witness": Outcome.FALSIFIED}


def look_again(work: tuple[Question, bytes, Row]) -> str:
    """Check a row's evidence again: "" where it proves everything that the row says, else why not."""
    question, evidence, row = work
    deadline = Deadline.after(question.timeout)
    asked = question.inputs.files[question.inputs.specification]
    with question.files() as (_, specification):
        folder = Path(specification).parent
        try:
            answer = recheck(evidence, question.policy, asked, folder, workers=1, stop=lambda: deadline.expired)
            own = read_contract(asked, folder).radius
        except InputError as error:
            return f"the evidence is damaged: {error.message}"
    if not answer.accepted:
        return answer.sentence
    kind = answer.data["evidence"]
    if PROVES[kind] is not row.outcome:
        return f"a {kind} does not prove {row.outcome.value}"
    about = read_certificate(evidence).header if kind == "certificate" else read_witness(evidence)
    if (own if about.observation_radius is None else about.observation_radius) != _radii(question, row, own):
        return f"the {kind} is about another perturbation radius"
    return _less(row, answer.data) if row.outcome is Outcome.VERIFIED else ""


def _radii(question: Question, row: Row, own: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
    """Radius of every component of the observation that the row's verdict is about.

    A row's epsilon is every component's radius; a search keeps the specification's proportions.
    """
    if row.radius is None:
        return own if question.epsilon is None else (question.epsilon,) * len(own)
    found = row.radius.verified if row.outcome is Outcome.VERIFIED else row.radius.falsified
    return own if found is None else tuple(Fraction(found) * share for share in proportions(own))


def _less(row: Row, proved: dict[str, Any]) -> str:
    """What a certificate proves less than the row says; positive polarity: what is said is there, and is proved."""
    margins = {entry["name"]: entry["margin"] for entry in proved["requirements"]}
    for entry in row.requirements:
        if not (entry.margin is not None and entry.name in margins and margins[entry.name] >= entry.margin):
            return "the certificate proves smaller margins than were reported"
    if row.value is not None:
        value = proved["value"] or {}
        for name, said in (("discounted", row.value.discounted), ("undiscounted", row.value.undiscounted)):
            if not (said is None or (name in value and value[name] >= said)):
                return "the certificate proves a smaller V(s0) than was reported"
    if not set(row.semantics) <= set(proved["semantics"]):
        return "the certificate covers less than was reported"
    return ""
