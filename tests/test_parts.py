"""A question decided in parts: their certificates together prove what one certificate would, and nothing else."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest

import setrl
from setrl.models.example import shipped_policies
from setrl.specs.errors import InputError, UsageError
from setrl.specs.reader import find_specification
from setrl.verify.certificate import join_certificates
from setrl.verify.checker.certificate import Accepted
from setrl.verify.checker.certificate import check as check_certificate
from setrl.verify.deadline import Deadline
from setrl.verify.options import Options
from setrl.verify.parts import Cut, cut_like, joined
from setrl.verify.result import Result, Verdict
from setrl.verify.verifier import verify_radii

POLICY = next(str(path) for path in shipped_policies() if path.name == "quadrotor1d-point.onnx")
SHIPPED = find_specification("quadrotor1d").read_text(encoding="utf-8")


@pytest.fixture(scope="module")
def specification(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The shipped specification from a box that needs eight cells."""
    wide = SHIPPED.replace("initial: {z: -4, zdot: 0}", "initial: {z: [-4.5, -3.5], zdot: [-0.5, 0.5]}")
    path = tmp_path_factory.mktemp("parts") / "wide.yaml"
    path.write_text(wide.replace("observation: 0.1", "observation: 0.02"), encoding="utf-8")
    return path


def judged(content: bytes, specification: Path) -> Accepted | str:
    try:
        return check_certificate(
            content, Path(POLICY).read_bytes(), specification.read_bytes(), specification.parent, workers=1
        )
    except InputError as error:
        return error.message


def part_of(specification: Path, box: Any, radius: str | None = None, **options: Any) -> Result:
    epsilon = None if radius is None else Fraction(radius)
    (result,) = verify_radii(POLICY, str(specification), [epsilon], options=Options(**options), part=box)
    return result


@pytest.fixture(scope="module")
def whole(specification: Path) -> Result:
    """A search that its first cells did not decide."""
    result = setrl.verify(POLICY, str(specification), options=Options(splits=4))
    assert result.verdict is Verdict.UNKNOWN
    return result


@pytest.fixture(scope="module")
def cut(whole: Result) -> Cut:
    return cut_like(whole, 3)


@pytest.fixture(scope="module")
def parts(specification: Path, cut: Cut) -> list[Result]:
    return [part_of(specification, box) for box in cut.parts]


def volume(boxes: Any) -> Fraction:
    total = Fraction(0)
    for box in boxes:
        size = Fraction(1)
        for low, high in box:
            size *= high - low if high > low else 1
        total += size
    return total


def test_parts_cover_the_initial_set_exactly(whole: Result, cut: Cut) -> None:
    initial = whole.loop.initial
    assert len(cut.parts) == 3
    assert volume(cut.parts) == volume([initial])
    for box in cut.parts:
        assert all(low <= a <= b <= high for (a, b), (low, high) in zip(box, initial, strict=True))


def test_a_proof_of_a_part_is_only_claimed(parts: list[Result]) -> None:
    assert [result.verdict for result in parts] == [Verdict.CLAIMED] * 3


def test_the_certificate_of_a_part_is_no_certificate_of_the_whole(specification: Path, parts: list[Result]) -> None:
    for result in parts:
        assert result.certificate is not None
        assert not isinstance(judged(result.certificate, specification), Accepted)


def test_the_parts_together_are_verified_by_one_certificate(
    specification: Path, whole: Result, cut: Cut, parts: list[Result]
) -> None:
    result = joined(whole, cut, parts, Deadline.after(None))
    assert result.verdict is Verdict.VERIFIED and result.reason is None
    assert result.leaves == sum(part.leaves for part in parts)
    assert result.certificate is not None
    answer = judged(result.certificate, specification)
    assert isinstance(answer, Accepted) and answer.leaves == result.leaves
    assert [margin for _, margin in answer.margins] == [entry.margin for entry in result.requirements]
    assert result.value is not None and answer.value == (result.value.discounted, result.value.undiscounted)
    assert len(result.flowpipe.points) == len(result.flowpipe.margins) == sum(len(p.flowpipe.points) for p in parts)


@pytest.mark.parametrize("change", ["exchanged", "left out", "twice", "cut elsewhere"])
def test_parts_that_do_not_belong_together_are_not_accepted(
    specification: Path, cut: Cut, parts: list[Result], change: str
) -> None:
    contents = [part.certificate or b"" for part in parts]
    tree = list(cut.tree)
    if change == "exchanged":
        contents = [contents[1], contents[0], contents[2]]
    elif change == "left out":  # the cover claims less than the initial set
        contents, tree = contents[:1], [None]
    elif change == "twice":
        contents = [contents[0], contents[0], contents[2]]
    else:
        state, at = tree[0]
        low, high = (part.loop.initial[state] for part in (parts[0], parts[2]))
        tree[0] = [state, str((Fraction(at) + max(low[1], high[1])) / 2)]
    answer = judged(join_certificates(tree, contents), specification)
    assert not isinstance(answer, Accepted), answer


def test_parts_of_two_questions_are_not_joined(specification: Path, cut: Cut, parts: list[Result]) -> None:
    other = part_of(specification, cut.parts[0], "0.01")
    contents = [other.certificate or b"", *(part.certificate or b"" for part in parts[1:])]
    with pytest.raises(ValueError, match="differ"):
        join_certificates(cut.tree, contents)


def test_one_part_without_a_proof_leaves_the_whole_unknown(
    specification: Path, whole: Result, cut: Cut, parts: list[Result]
) -> None:
    failed = part_of(specification, cut.parts[1], timeout=1e-9)
    assert failed.verdict is Verdict.UNKNOWN
    result = joined(whole, cut, [parts[0], failed, parts[2]], Deadline.after(None))
    assert result.verdict is Verdict.UNKNOWN and result.reason is not None and result.certificate is None
    assert 0.0 < result.reason.verified_part < 1.0
    values = [entry.value.discounted for entry in (parts[0], failed, parts[2]) if entry.value is not None]
    assert result.value is not None and result.value.discounted == min(values) < max(values)


def test_an_answer_about_another_part_is_a_broken_invariant(whole: Result, cut: Cut, parts: list[Result]) -> None:
    with pytest.raises(AssertionError, match="another part"):
        joined(whole, cut, [parts[1], parts[0], parts[2]], Deadline.after(None))
    with pytest.raises(AssertionError, match="every part"):
        joined(whole, cut, parts[:2], Deadline.after(None))


def test_a_violation_in_one_part_refutes_the_whole(tmp_path: Path) -> None:
    narrow = "requirements:\n  - stay: {z: [-0.5, 0.5]}\n    name: narrow\n\n"
    strict = tmp_path / "strict.yaml"
    start, end = SHIPPED.index("requirements:"), SHIPPED.index("reward:")
    strict.write_text(SHIPPED[:start] + narrow + SHIPPED[end:], encoding="utf-8")
    asked = setrl.verify(POLICY, str(strict), options=Options(splits=4))
    box = tuple(asked.loop.initial)
    result = part_of(strict, box)
    assert result.verdict is Verdict.FALSIFIED
    answer = joined(asked, Cut((None,), (box,)), [result], Deadline.after(None))
    assert answer.verdict is Verdict.FALSIFIED and answer.witness is not None and answer.witness == result.witness


def test_a_part_outside_of_the_initial_set_is_refused(specification: Path, whole: Result) -> None:
    box = [*whole.loop.initial]
    box[0] = (box[0][0] - 1, box[0][1])
    with pytest.raises(UsageError, match="not within"):
        part_of(specification, tuple(box))


def test_a_search_that_cut_nothing_is_one_part(whole: Result) -> None:
    single = replace(whole, cover=(None,))
    assert cut_like(single, 8) == Cut((None,), (tuple(whole.loop.initial),))
