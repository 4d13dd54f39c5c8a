"""No corrupted certificate that is false is accepted; what is accepted stayed true.

The digests and lengths of a corrupted file are computed anew, so that the proofs have to notice. What is accepted is
judged by an oracle that knows the policy and the plant only at single points.
"""

from __future__ import annotations

import time
from collections import Counter
from dataclasses import dataclass, field
from functools import lru_cache
from typing import Any

import pytest
from certificate_corruptions import Corruption, corruptions
from certificate_oracle import falsity
from certificate_streams import Certificate, opened, reading_once, sealed
from certificate_trajectories import Question
from certificates import Case, case_of

from setrl.models.binding import bind
from setrl.models.onnx_reader import read_policy
from setrl.specs.errors import InputError
from setrl.specs.reader import parse_specification
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.network import read_network
from setrl.verify.checker.rejection import Rejected

LIMIT = 1.0
"""CPU seconds for one file."""

SMALL: list[tuple[int, dict[str, Any]]] = [
    (2, {"periods": 2}),
    (4, {"periods": 2}),
    (5, {"periods": 3}),
    (6, {"periods": 2}),
    (8, {"periods": 2}),
    (11, {"periods": 3}),
    (13, {"periods": 1}),
    (20, {"tight": 0.7, "splits": 64, "method": "jets"}),
    (33, {"periods": 2}),
    (36, {"periods": 1}),
]
"""Numbers of cases, and what is changed about them."""
LARGE: list[tuple[int, dict[str, Any]]] = [
    *((number, {"periods": 3}) for number in (0, 1, 3, 7, 9, 10, 14, 15, 17, 18, 22, 24, 25, 27, 29, 31, 38, 42, 90)),
    *((number, {"tight": 0.7, "splits": 64, "method": "jets"}) for number in (0, 2, 8, 12)),
]


@pytest.fixture(autouse=True)
def _files_are_read_once(monkeypatch: pytest.MonkeyPatch) -> None:
    reading_once(monkeypatch)


@dataclass
class Tally:
    """What became of the corruptions."""

    made: int = 0
    kinds: Counter[str] = field(default_factory=Counter)
    accepted: Counter[str] = field(default_factory=Counter)
    judged: int = 0
    shown: int = 0
    slowest: float = 0.0
    problems: list[str] = field(default_factory=list)

    def __str__(self) -> str:
        stayed = ", ".join(f"{kind} {count}" for kind, count in self.accepted.most_common())
        return (
            f"{self.made} corrupted certificates of {len(self.kinds)} kinds; {self.accepted.total()} accepted, none of "
            f"them shown false: {stayed}\nof {self.judged} rejected ones that were judged, {self.shown} are false; the "
            f"slowest took {self.slowest:.2f} s"
        )


def question_of(case: Case, content: bytes) -> Question:
    """What the oracle asks about a file: its own setting, since its header may name another radius."""
    setting = opened(content, case.policy, case.specification).setting
    return Question(_loop(case), _network(case.policy), setting)


@lru_cache(maxsize=64)
def _loop(case: Case) -> Any:
    return bind(parse_specification(case.specification), read_policy(case.policy))


@lru_cache(maxsize=64)
def _network(policy: bytes) -> Any:
    return read_network(policy)


def false(case: Case, corruption: Corruption, base: Certificate) -> str:
    """Why a corruption is false, as far as can be shown."""
    if corruption.false:
        return corruption.false
    try:
        given = opened(corruption.content, case.policy, case.specification)
        return falsity(question_of(case, corruption.content), given, base)
    except (InputError, Rejected) as problem:
        return f"not of the format, or not about these files: {problem}"


def tried(number: int, given: dict[str, Any], count: int, judged: int) -> Tally:
    """Corrupt the certificate of one case; every `judged`-th rejected one is judged too."""
    case, tally = case_of(number, **given), Tally()
    base = opened(case.certificate, case.policy, case.specification)
    assert sealed(base.header, base.streams) == case.certificate
    assert isinstance(check(case.certificate, case.policy, case.specification, workers=1), Accepted)
    for position, corruption in enumerate(corruptions(base, count, number)):
        started = time.process_time()
        try:
            answer = check(corruption.content, case.policy, case.specification, workers=1)
        except InputError as error:
            answer = str(error)
        spent = time.process_time() - started
        tally.made += 1
        tally.kinds[corruption.kind] += 1
        tally.slowest = max(tally.slowest, spent)
        accepted = isinstance(answer, Accepted)
        if accepted or position % judged == 0:
            reason = false(case, corruption, base)
            if accepted:
                tally.accepted[corruption.kind] += 1
            else:
                tally.judged, tally.shown = tally.judged + 1, tally.shown + bool(reason)
            if accepted and reason:
                tally.problems.append(f"{case}, {position}: {corruption.kind}: {reason}")
        if spent > LIMIT:
            tally.problems.append(f"{case}, {position}: {corruption.kind} took {spent:.2f} s")
    return tally


def concluded(tally: Tally, count: int) -> None:
    print(tally)
    assert tally.problems == [] and tally.made == count
    assert tally.accepted.total() < 0.5 * count
    assert tally.shown >= 0.5 * tally.judged, "the oracle hardly notices anything: it judges nothing"


@pytest.mark.parametrize(("number", "given"), SMALL)
def test_corrupted_certificates_that_are_accepted_are_true(number: int, given: dict[str, Any]) -> None:
    concluded(tried(number, given, 200, 12), 200)


@pytest.mark.slow
@pytest.mark.parametrize(("number", "given"), [*SMALL, *LARGE])
def test_twenty_thousand_corrupted_certificates(number: int, given: dict[str, Any]) -> None:
    concluded(tried(number, given, 640, 6), 640)


def test_weights_that_cancel_the_facets_prove_nothing() -> None:
    case = case_of(21)
    base = opened(case.certificate, case.policy, case.specification)
    writer = base.writer(base.leaves[0])
    weights = [
        1.0 if label == "separating weights" else x for x, (label, _) in zip(writer.floats, writer.labels, strict=True)
    ]
    assert weights != writer.floats
    answer = check(sealed(base.header, [(weights, writer.integers)]), case.policy, case.specification, workers=1)
    assert "avoid" in str(answer) and "positive" in str(answer)
