"""Answers to queries: never wrong, however small the margin, and replayed where they say sat."""

from __future__ import annotations

from collections import Counter
from fractions import Fraction

import numpy as np
import onnxruntime
import pytest
from vnnlib_queries import Known, known_queries

from setrl.models.onnx_reader import read_policy
from setrl.specs.queries import Query
from setrl.specs.vnnlib_reader import parse_vnnlib
from setrl.specs.vnnlib_writer import vnnlib_1_text, vnnlib_2_text
from setrl.verify.deadline import Deadline
from setrl.verify.open_loop.decide import Answer, decide

F = Fraction
KNOWN = known_queries()
FAMILIES = sorted({known.family for known in KNOWN})
CLEAR = F(1, 10**5)
"""A margin that has to be decided."""


def answer_of(known: Known, query: Query | None = None) -> Answer:
    # a hair's margin may stay undecided, and is not looked at for long
    splits = 3000 if known.margin >= CLEAR else 200
    return decide(read_policy(known.content), query or known.query, splits=splits, deadline=Deadline.after(60))


def replayed(answer: Answer, content: bytes) -> bool:
    """Whether a counterexample is one, by onnxruntime alone and in rationals."""
    found = answer.counterexample
    assert found is not None
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    x = np.array([[float(v) for v in found.inputs]], dtype=np.float32)
    y = session.run(None, {session.get_inputs()[0].name: x})[0][0]
    assert [float(v) for v in y] == list(found.outputs)
    assert all(b.lower <= v <= b.upper for v, b in zip(found.inputs, found.case.box, strict=True))
    return all(
        sum((c * found.inputs[i] for i, c in k.inputs), F(0)) + sum((c * F(float(y[j])) for j, c in k.outputs), F(0))
        <= k.bound
        for k in found.case.constraints
    )


def test_there_are_at_least_two_hundred_known_queries_of_both_answers() -> None:
    assert len(KNOWN) >= 200
    assert min(Counter(known.satisfiable for known in KNOWN).values()) >= 70


@pytest.mark.parametrize("family", FAMILIES)
def test_no_answer_is_wrong_and_clear_ones_are_given(family: str) -> None:
    for known in (known for known in KNOWN if known.family == family):
        answer = answer_of(known)
        if "real" in answer.semantics:
            assert answer.word == ("sat" if known.satisfiable else "unsat"), (known, answer)
        if answer.word == "sat":
            assert replayed(answer, known.content) == ("float32" in answer.semantics)
        if known.margin >= CLEAR:
            assert answer.semantics == ("real", "float32"), (known.query, answer)


def test_a_text_of_a_query_gets_the_answer_of_the_query() -> None:
    for known in KNOWN[::25]:
        words = {
            answer_of(known, parse_vnnlib(text)).word
            for text in (vnnlib_1_text(known.query), vnnlib_2_text(known.query))
        }
        assert words == {answer_of(known).word}
