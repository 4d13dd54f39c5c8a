"""A text is refused with its line, or gets its right answer; `unsat` never comes of a text that was not understood."""

from __future__ import annotations

import time

import numpy as np
import pytest
from vnnlib_malformed import ANSWERS, EITHER, ERRORS, GOOD, TWO, UNSAT

from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine, Policy
from setrl.specs import vnnlib_logic
from setrl.specs.errors import InputError
from setrl.specs.vnnlib_reader import parse_vnnlib
from setrl.specs.vnnlib_syntax import MOST_BYTES
from setrl.verify.open_loop.decide import decide


@pytest.fixture(scope="module")
def policy() -> Policy:
    generator = np.random.default_rng(5)
    layers = (
        Affine(generator.normal(size=(6, 2)), generator.normal(size=6)),
        Activation("relu"),
        Affine(generator.normal(size=(1, 6)), generator.normal(size=1)),
    )
    return read_policy(policy_bytes(layers))


def test_the_corpus_is_large() -> None:
    assert len(ERRORS) >= 60 and len(ANSWERS) >= 25


@pytest.mark.parametrize("name", ERRORS)
def test_what_is_no_query_is_an_error_that_names_the_file(name: str) -> None:
    content, message = ERRORS[name]
    start = time.process_time()
    with pytest.raises(InputError) as refused:
        parse_vnnlib(content, "q.vnnlib")
    assert message in str(refused.value)
    assert str(refused.value).startswith("q.vnnlib") and len(str(refused.value)) < 500
    assert refused.value.remedy
    assert time.process_time() - start < 2.0


@pytest.mark.parametrize("name", ANSWERS)
def test_an_odd_query_gets_its_right_answer(name: str, policy: Policy) -> None:
    text, word = ANSWERS[name]
    answer = decide(policy, parse_vnnlib(text))
    assert answer.word == word if word != EITHER else answer.word in ("sat", "unsat")
    assert "real" in answer.semantics


@pytest.mark.parametrize("text", [GOOD, TWO])
def test_no_beginning_of_a_query_is_unsat(text: str, policy: Policy) -> None:
    whole = decide(policy, parse_vnnlib(text)).word
    for end in range(0, len(text), 3):
        try:
            query = parse_vnnlib(text[:end])
        except InputError:
            continue
        # an assertion at the end may be missing, and then more inputs violate
        assert whole == UNSAT or decide(policy, query).word == "sat"


def test_a_case_that_no_input_satisfies_is_told() -> None:
    query = parse_vnnlib(ANSWERS["contradictory bounds in one case"][0])
    assert len(query.cases) == 1
    assert "1 of 2 cases are empty" in query.comment and "input 0" in query.comment
    query = parse_vnnlib(ANSWERS["a false constant"][0])
    assert query.cases == () and "false by itself" in query.comment


def test_a_line_is_named() -> None:
    with pytest.raises(InputError, match=r"q\.vnnlib:5: 'Y_9' is not declared"):
        parse_vnnlib(GOOD.replace("(<= Y_0", "(<= Y_9"), "q.vnnlib")


def test_a_text_that_is_too_large_is_not_read() -> None:
    with pytest.raises(InputError, match="no query has more than"):
        parse_vnnlib(b" " * (MOST_BYTES + 1))


def test_work_before_the_cap_is_bounded_however_it_is_nested(monkeypatch: pytest.MonkeyPatch) -> None:
    """Many products, each below the cap of cases, share one budget."""
    monkeypatch.setattr(vnnlib_logic, "MOST_CONSTRAINTS", 60_000)
    one = "(and " + " ".join("(or (<= Y_0 1.0) (<= Y_0 2.0))" for _ in range(8)) + ")"
    text = GOOD + f"(assert (or {one * 20}))"
    with pytest.raises(InputError, match="cases, or 60000 constraints"):
        parse_vnnlib(text)
