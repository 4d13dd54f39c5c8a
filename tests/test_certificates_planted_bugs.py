"""An engine with a bug may claim what is false: then the checker rejects the certificate, whatever the bug is.

For each planted bug the broken engine claims a proof; points, trajectories or rationals show that what it wrote down is
false, without any enclosure.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache

import certificate_points
import numpy as np
import pytest
from certificate_bugs import BUGS, Bug
from certificate_oracle import falsity
from certificate_streams import opened
from certificate_trajectories import Question
from certificates import case_of

from setrl.specs.errors import InputError
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.network import read_network
from setrl.verify.checker.rejection import Rejected
from setrl.verify.result import Verdict

IN_RATIONALS = ("no room for what was dropped", "does not contain the initial box", "outside its claimed range")


@dataclass(frozen=True)
class Outcome:
    """What became of a broken engine's certificate: whether it differs, why it is rejected, why it is false."""

    differs: bool
    accepted: bool
    answer: str
    false: str


@lru_cache(maxsize=len(BUGS))
def outcome(bug: Bug) -> Outcome:
    case = case_of(bug.number, **bug.given)
    honest = case.certificate
    assert isinstance(_checked(honest, case.policy, case.specification), Accepted)
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        bug.mutate(patch)
        result = case.verify(check=False)
    content = result.certificate
    assert result.verdict is Verdict.CLAIMED and content is not None, "the broken engine claims nothing here"
    answer = _checked(content, case.policy, case.specification)
    try:
        given = opened(content, case.policy, case.specification)
        with pytest.MonkeyPatch.context() as patch:  # more points than for a corruption
            patch.setattr(certificate_points, "POINTS", 400)
            assert result.loop is not None
            false = falsity(Question(result.loop, read_network(case.policy), given.setting), given)
    except (InputError, Rejected) as problem:
        false = f"not of the format: {problem}"
    return Outcome(content != honest, isinstance(answer, Accepted), str(answer), false)


def _checked(content: bytes, policy: bytes, specification: bytes) -> Accepted | str:
    try:
        return check(content, policy, specification, workers=1)
    except InputError as error:
        return str(error)


@pytest.mark.parametrize("bug", BUGS, ids=str)
def test_what_a_broken_engine_claims_is_rejected(bug: Bug) -> None:
    found = outcome(bug)
    assert found.differs, "the bug does not show in this certificate"
    assert not found.accepted


def test_most_of_the_bugs_make_false_claims() -> None:
    table = {str(bug): outcome(bug) for bug in BUGS}
    for name, found in table.items():
        print(f"{name:40} rejected: {found.answer[:70]:72} false: {found.false or 'not shown'}")
    shown = [found for found in table.values() if found.false]
    by_points = [found for found in shown if not found.false.endswith(IN_RATIONALS)]
    print(f"{len(table)} bugs, {len(shown)} make claims that are shown false, {len(by_points)} of them at points")
    assert len(table) >= 45 and len(by_points) >= 30 and len(shown) >= 38
    assert not any(found.accepted for found in shown)
