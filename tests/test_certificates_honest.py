"""What the engine proves, the checker accepts: every plant, activation, requirement, wiring, method and semantics."""

from __future__ import annotations

import os
import subprocess
import sys
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import certificates
import pytest
from certificates import Case, case_of, digest_of

import setrl
from setrl.models.example import shipped_policies
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.contract import read_contract
from setrl.verify.checker.network import read_network
from setrl.verify.result import Verdict

ALL = range(230)
FAST = [number for number in range(50) if number not in (16, 19, 23, 30, 37)]
"""The quickest ones; the others are in the slow suite."""
SPLIT = (0, 1, 2, 3, 4, 7, 8, 12, 14, 15, 18, 19, 20, 22)
"""Numbers of cases that a bound near the worst trajectory makes the engine split."""

REJECTED: dict[int, str] = {}
"""Honest certificates that the checker does not accept, and why."""


def parameters(numbers: Any, *marks: Any) -> list[Any]:
    return [
        pytest.param(
            number,
            marks=[*marks, *([pytest.mark.xfail(reason=REJECTED[number], strict=True)] if number in REJECTED else [])],
        )
        for number in numbers
    ]


def prepared(number: int, **given: Any) -> Case:
    case = case_of(number, **given)
    if case.options.method == "linearization" and not find_spec("setrl.verify.checker.linear_step"):
        pytest.skip("the checker has no obligation for the method linearization yet")
    return case


@pytest.mark.parametrize("number", [*parameters(FAST), *parameters(sorted(set(ALL) - set(FAST)), pytest.mark.slow)])
def test_what_the_engine_proves_is_verified(number: int) -> None:
    case = prepared(number)
    result = case.verify()
    assert result.verdict is Verdict.VERIFIED, result.reason
    assert result.certificate is not None
    assert case.options.deployed or result.semantics == ("real",)


@pytest.mark.parametrize("number", [*SPLIT[:4], *(pytest.param(n, marks=pytest.mark.slow) for n in SPLIT[4:])])
def test_covers_of_several_leaves_are_verified(number: int) -> None:
    case = prepared(number, tight=0.7, splits=64, method="jets")
    result = case.verify()
    assert result.verdict is Verdict.VERIFIED and result.leaves > 1, result.reason


@pytest.mark.parametrize("number", [2, 7, 13, 20])
def test_proved_margins_are_not_below_the_claimed_ones(number: int) -> None:
    case = prepared(number)
    answer = check(case.certificate, case.policy, case.specification, workers=1)
    assert isinstance(answer, Accepted)
    claimed = dict(answer.header.requirements)
    assert all(margin >= claimed[name] > 0.0 for name, margin in answer.margins)


@pytest.mark.parametrize("number", [0, 4, 10, 20])
def test_the_same_question_gives_the_same_bytes(number: int) -> None:
    case = prepared(number)
    assert case.verify(check=False).certificate == case.verify(check=False).certificate


def test_another_process_gives_the_same_bytes() -> None:
    numbers = (3, 4, 11)
    code = f"import certificates as c; print(*(c.digest_of(c.case_of(n)) for n in {numbers}))"
    folder = Path(__file__).parent
    paths = os.pathsep.join([str(folder), str(folder.parent / ".src")])
    done = subprocess.run(
        [sys.executable, "-c", code],
        env=os.environ | {"PYTHONPATH": paths, "PYTHONHASHSEED": "77"},
        capture_output=True,
        text=True,
        check=True,
        timeout=120,
    )
    assert done.stdout.split() == [digest_of(case_of(number)) for number in numbers]


# What the corpus contains -----------------------------------------------------------------------------------------


def features(number: int) -> set[str]:
    """What is special about a case, read off the files by the checker's own readers."""
    case = case_of(number)
    contract, network = read_contract(case.specification), read_network(case.policy)
    found = {case.name.split("-")[1], network.precision, case.options.method}
    found |= {getattr(layer, "kind", "affine") for layer in network.layers}
    found |= {requirement.kind for requirement in contract.requirements}
    found |= {"union" for requirement in contract.requirements if len(requirement.region) > 1}
    found |= {"instant" for requirement in contract.requirements if requirement.start == requirement.end}
    found |= {"start" for requirement in contract.requirements if requirement.start == 0}
    found |= {"between" for r in contract.requirements if (r.start / contract.period).denominator > 1}
    found |= {"constant" if entry.constant else "varying" for entry in contract.disturbances}
    given = {
        "before": contract.before is not None,
        "after": contract.after is not None,
        "clipped": any(contract.clip),
        "delay": contract.delay > 0,
        "noise": any(contract.radius),
        "noise per component": len(set(contract.radius)) > 1,
        "fixed": any(low == high for low, high in contract.initial),
        "discrete": contract.plant.discrete,
        "real only": not case.options.deployed,
        "deployed": case.options.deployed,
        "reward": contract.reward is not None,
        "penalty": contract.reward is not None and bool(contract.reward.region),
        "observes functions": any(type(entry).__name__ != "Name" for entry in contract.observe),
    }
    return found | {name for name, there in given.items() if there}


@pytest.mark.slow
def test_the_corpus_has_two_hundred_certificates_with_everything_in_them() -> None:
    accepted = [number for number in ALL if number not in REJECTED]
    assert len(accepted) >= 200
    counts: dict[str, int] = {}
    for number in accepted:
        for name in features(number):
            counts[name] = counts.get(name, 0) + 1
    expected = {*certificates.SUBJECTS, "relu", "tanh", "leaky_relu", "sigmoid", "clip", "float32", "float64", "jets"}
    expected |= {"avoid", "stay", "reach", "union", "instant", "start", "between", "constant", "varying", "before"}
    expected |= {"after", "clipped", "delay", "noise", "noise per component", "fixed", "discrete", "real only"}
    expected |= {"reward", "penalty", "observes functions", "linearization", "deployed"}
    assert expected <= set(counts), expected - set(counts)
    assert min(counts[name] for name in expected) >= 5, counts


def test_a_claim_on_ranges_whose_ends_are_wide_balls_is_verified() -> None:
    """Ranges of neurons that hardly vary: their ends are known to fewer digits than the lines on them need."""
    policy = next(path for path in shipped_policies() if path.name == "navigation-set.onnx")
    result = setrl.verify(str(policy), "navigation", epsilon=0)
    assert result.verdict is Verdict.VERIFIED, result.reason
