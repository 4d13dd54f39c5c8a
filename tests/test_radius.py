"""The radius that verifies and the one that fails: on both sides of the true one, proved, exact, and never crossed."""

from __future__ import annotations

import json
import math
from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import EXAMPLE, HOPELESS, QUICK, contents, run
from hypothesis import given
from hypothesis import strategies as st

from setrl.models.closed_loop import ClosedLoop
from setrl.models.onnx_writer import policy_bytes
from setrl.models.perturbation import proportions
from setrl.models.policy import Activation, Affine
from setrl.specs.errors import InputError, UsageError
from setrl.specs.exact import exact_decimal
from setrl.verify import radius as searching
from setrl.verify.checker.recheck import Answer, recheck
from setrl.verify.deadline import Deadline
from setrl.verify.options import Options
from setrl.verify.radius import RadiusSearch, largest_verified, search_radius
from setrl.verify.radius_bisection import between, largest, smallest
from setrl.verify.radius_report import radius_to_json
from setrl.verify.result import Result, Verdict
from setrl.verify.verifier import load, verify

LINEAR = """\
setrl: 1
plant:
  states: {x: m, y: m}
  inputs: {u: m/s, w: m/s}
  dynamics: {x: u, y: w}
controller: {period: 0.1}
horizon: 1
initial: {x: 0, y: 0}
requirements:
  - stay: {x: [-0.5, 0.5]}
    name: near
"""
"""With the policy -o, perturbed by at most r, x at the end of period k is at most r (1 - 0.9^k) away from 0."""

TRUE = F(1, 2) / (1 - F(9, 10) ** 10)
"""The radius of LINEAR at which x can just reach 0.5 in ten periods: 0.7676..."""

CUT = """\
setrl: 1
plant:
  states: {x: m, y: m}
  inputs: {u: m/s, w: m/s}
  dynamics: {x: u, y: w}
controller: {period: 0.25}
horizon: 1
initial: {x: [-1, 1], y: 0}
requirements:
  - reach: {x: [-0.7, 0.7]}
    name: near
"""
"""With the policy tanh(-3 o) one zonotope proves little of it, because the initial set spans the bend of tanh."""

COARSE: dict[str, Any] = {"most": F(2), "resolution": F(1, 100)}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("radius")
    (path / "linear.onnx").write_bytes(policy_bytes([Affine(-np.eye(2), np.zeros(2))]))
    (path / "tanh.onnx").write_bytes(policy_bytes([Affine(-3 * np.eye(2), np.zeros(2)), Activation("tanh")]))
    for name, text in {"linear": LINEAR, "cut": CUT, "quick": QUICK, "hopeless": HOPELESS}.items():
        (path / f"{name}.yaml").write_text(text)
    return path


@pytest.fixture
def here(folder: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder to write into, with the same files."""
    for file in folder.iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def linear(folder: Path) -> RadiusSearch:
    return search_radius(folder / "linear.onnx", folder / "linear.yaml", **COARSE)


@pytest.fixture(scope="module")
def hover() -> RadiusSearch:
    return search_radius(EXAMPLE, "quadrotor1d.yaml", most=F(2, 5), resolution=F(1, 50))


def proved_again(evidence: bytes, policy: Path, specification: Path) -> Answer:
    return recheck(evidence, policy.read_bytes(), specification.read_bytes(), workers=1)


# What the two radii say --------------------------------------------------------------------------


def test_the_true_radius_lies_between_the_two_and_both_are_close_to_it(linear: RadiusSearch) -> None:
    assert linear.verified is not None and linear.falsified is not None
    assert linear.verified < TRUE < linear.falsified
    assert linear.falsified - linear.verified <= 2 * linear.resolution
    assert linear.exit_code == 0 and not linear.stopped


def test_the_checker_proves_both_answers_again(linear: RadiusSearch, folder: Path) -> None:
    proved, refuted = linear.verified_result, linear.falsified_result
    assert proved is not None and proved.verdict is Verdict.VERIFIED and proved.certificate is not None
    assert refuted is not None and refuted.verdict is Verdict.FALSIFIED and refuted.witness is not None
    for evidence, radius in (
        (proved.certificate, linear.verified),
        (refuted.witness.content.encode(), linear.falsified),
    ):
        answer = proved_again(evidence, folder / "linear.onnx", folder / "linear.yaml")
        assert answer.accepted, answer.sentence
        assert radius is not None and str(float(radius)) in answer.sentence


def test_both_answers_are_those_of_the_verifier(linear: RadiusSearch, folder: Path) -> None:
    options = Options(splits=searching.SPLITS)
    for radius, verdict in ((linear.verified, Verdict.VERIFIED), (linear.falsified, Verdict.FALSIFIED)):
        result = verify(folder / "linear.onnx", folder / "linear.yaml", options=options, epsilon=radius)
        assert result.verdict is verdict


def test_a_certified_radius_of_the_quadrotor_is_accepted_and_the_next_one_is_not_verified(hover: RadiusSearch) -> None:
    assert hover.verified is not None and hover.falsified is None and hover.verified_result is not None
    _, specification = load(EXAMPLE, "quadrotor1d.yaml")
    assert hover.verified_result.certificate is not None
    assert proved_again(hover.verified_result.certificate, Path(EXAMPLE), Path(specification.source)).accepted
    assert not verify(EXAMPLE, specification, epsilon=hover.verified + hover.resolution, check=False).verdict.positive


def test_the_search_and_the_verified_side_alone_find_the_same(hover: RadiusSearch) -> None:
    network, specification = load(EXAMPLE, "quadrotor1d.yaml")
    grid = [F(0), F(1, 10), F(1, 5), F(2, 5)]
    assert largest_verified(network, specification, grid, F(1, 50), options=Options(splits=1)) == hover.verified


def test_radii_are_exact_and_verdicts_ascend(linear: RadiusSearch, hover: RadiusSearch) -> None:
    for found in (linear, hover):
        assert found.verified is not None and (found.verified / found.resolution).denominator == 1
        radii = [radius for radius, _ in found.tried]
        assert radii == sorted(set(radii)) and radii[0] == 0 and radii[-1] == found.most
        assert all(exact_decimal(text) in radii for text, _ in radius_to_json(found)["tried"])
        assert all(verdict.positive for radius, verdict in found.tried if radius <= found.verified)
        assert not any(verdict.positive for radius, verdict in found.tried if radius > found.verified)
    (lowest, *_) = (radius for radius, verdict in linear.tried if verdict is Verdict.FALSIFIED)
    assert lowest == linear.falsified


def test_cutting_the_initial_set_proves_larger_radii(folder: Path) -> None:
    def search(splits: int) -> RadiusSearch:
        range_of: dict[str, Any] = {"most": F(1, 2), "resolution": F(1, 20)}
        return search_radius(folder / "tanh.onnx", folder / "cut.yaml", options=Options(splits=splits), **range_of)

    whole, cut = search(1), search(32)
    assert whole.verified is not None and cut.verified is not None and cut.verified_result is not None
    assert cut.verified >= 2 * whole.verified and cut.verified_result.leaves > 1
    assert cut.verified_result.verdict is Verdict.VERIFIED


# Proportions -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("own", "expected"),
    [("{x: 0.02, y: 0.005}", (F(1), F(1, 4))), ("{y: 0.3}", (F(0), F(1))), ("0", (F(1), F(1))), ("0.7", (F(1), F(1)))],
)
def test_the_specifications_proportions_are_kept(own: str, expected: tuple[F, F], here: Path) -> None:
    (here / "linear.yaml").write_text(f"{LINEAR}perturbation: {{observation: {own}}}\n")
    found = search_radius(here / "linear.onnx", here / "linear.yaml", most=F(1, 10), resolution=F(1, 10))
    assert found.verified == F(1, 10) and found.verified_result is not None
    assert found.verified_result.loop.observation_radius == tuple(share / 10 for share in expected)


def test_the_doubling_begins_at_the_specifications_own_radius(here: Path) -> None:
    (here / "linear.yaml").write_text(f"{LINEAR}perturbation: {{observation: {{x: 0.07, y: 0.03}}}}\n")
    found = search_radius(here / "linear.onnx", here / "linear.yaml", most=F(1, 5), resolution=F(1, 20))
    assert [radius for radius, _ in found.tried] == [F(0), F(7, 100), F(14, 100), F(1, 5)]


@given(st.lists(st.fractions(0, 10), min_size=1, max_size=4))
def test_proportions_have_one_as_their_largest_and_give_the_radii_back(radii: list[F]) -> None:
    shares, largest_one = proportions(tuple(radii)), max(radii)
    assert max(shares) == 1
    assert [largest_one * share for share in shares] == radii


# How the search ends -----------------------------------------------------------------------------


def test_where_the_least_radius_fails_the_smallest_falsified_is_that_one(here: Path) -> None:
    (here / "linear.yaml").write_text(LINEAR.replace("[-0.5, 0.5]", "[0.5, 1]"))
    found = search_radius(here / "linear.onnx", here / "linear.yaml", **COARSE)
    assert (found.verified, found.falsified, found.exit_code) == (None, F(0), 10)
    assert found.falsified_result is not None and found.falsified_result.witness is not None
    assert found.tried == ((F(0), Verdict.FALSIFIED),)


def test_where_nothing_is_known_of_the_least_radius_its_reason_is_given(folder: Path) -> None:
    span: dict[str, Any] = {"least": F(9, 10), "most": F(9, 10), "options": Options(splits=1)}
    found = search_radius(EXAMPLE, folder / "hopeless.yaml", **span)
    assert (found.verified, found.falsified, found.exit_code) == (None, None, 5)
    assert found.unproved_result is not None and found.unproved_result.reason is not None
    assert "could not be proved" in found.unproved_result.reason.sentence


def test_a_violation_above_an_unknown_least_radius_does_not_decide_that_one(folder: Path) -> None:
    span: dict[str, Any] = {"least": F(9, 10), "most": F(9), "resolution": F(9), "options": Options(splits=1)}
    found = search_radius(EXAMPLE, folder / "hopeless.yaml", **span)
    assert (found.verified, found.falsified, found.exit_code) == (None, F(9), 5)


def test_what_holds_at_the_largest_radius_ends_the_search(folder: Path) -> None:
    found = search_radius(folder / "linear.onnx", folder / "linear.yaml", most=F(1, 2))
    assert (found.verified, found.falsified, found.exit_code) == (F(1, 2), None, 0)


def test_no_time_leaves_no_answer_but_its_reason(folder: Path) -> None:
    found = search_radius(folder / "linear.onnx", folder / "linear.yaml", deadline=Deadline.after(-1.0), **COARSE)
    assert (found.verified, found.falsified, found.exit_code) == (None, None, 5)
    assert found.stopped == "time limit"
    assert found.unproved_result is not None and found.unproved_result.reason is not None


@pytest.mark.parametrize("answers", [1, 2, 4])
def test_an_interrupted_search_keeps_what_was_found(
    answers: int, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    deadline, given = Deadline.after(None), []

    def verified(*arguments: Any, **options: Any) -> Result:
        result = verify(*arguments, **options)
        given.append(result)
        deadline.interrupted = len(given) == answers
        return result

    monkeypatch.setattr(searching, "verify", verified)
    found = search_radius(folder / "linear.onnx", folder / "linear.yaml", deadline=deadline, **COARSE)
    assert found.stopped == "interrupted" and len(given) == answers
    assert found.verified_result is not None and found.verified_result.verdict is Verdict.VERIFIED
    assert (found.falsified is None) == (answers <= 2)
    if found.falsified is not None:
        assert found.verified is not None and found.verified < TRUE < found.falsified


def test_without_the_checker_a_radius_is_only_claimed(folder: Path) -> None:
    found = search_radius(folder / "linear.onnx", folder / "linear.yaml", most=F(1, 10), check=False)
    assert found.verified == F(1, 10) and found.exit_code == 5
    assert found.verified_result is not None and found.verified_result.verdict is Verdict.CLAIMED


def test_a_radius_that_the_checker_refuses_is_not_an_answer(
    linear: RadiusSearch, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What the engine claims above 0.5 is refused here: the answer is the largest claim that is not."""

    def refusing(*arguments: Any, **options: Any) -> Result:
        result = verify(*arguments, **options)
        refused = result.verdict is Verdict.VERIFIED and max(result.loop.observation_radius) > F(1, 2)
        return replace(result, verdict=Verdict.UNKNOWN) if refused else result

    monkeypatch.setattr(searching, "verify", refusing)
    found = search_radius(folder / "linear.onnx", folder / "linear.yaml", most=F(1), resolution=F(1, 10))
    assert found.verified == F(1, 2) < (linear.verified or 0)
    assert dict(found.tried)[F(7, 10)] is Verdict.UNKNOWN


def test_a_violation_below_a_verified_radius_is_an_error_of_the_program(
    here: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def wrong(*arguments: Any, **options: Any) -> Result:
        result = verify(*arguments, **options)
        if result.verdict is not Verdict.FALSIFIED:
            return result
        smaller: ClosedLoop = replace(result.loop, observation_radius=(F(1, 100), F(1, 100)))
        return replace(result, loop=smaller)

    monkeypatch.setattr(searching, "verify", wrong)
    with pytest.raises(AssertionError, match="both verified and falsified"):
        search_radius(here / "linear.onnx", here / "linear.yaml", **COARSE)
    assert any(name.startswith("setrl-bug-") for name in contents(here))


# Wrong input -------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    "span", [{"resolution": F(0)}, {"resolution": F(-1)}, {"least": F(-1)}, {"least": F(2), "most": F(1)}]
)
def test_a_range_that_is_none_is_refused(span: dict[str, F], folder: Path) -> None:
    with pytest.raises(UsageError):
        search_radius(folder / "linear.onnx", folder / "linear.yaml", **span)


def test_without_a_requirement_there_is_no_radius(here: Path) -> None:
    (here / "linear.yaml").write_text(LINEAR[: LINEAR.index("requirements")] + "reward: {weights: {x: 1}}\n")
    with pytest.raises(InputError, match="requirement"):
        search_radius(here / "linear.onnx", here / "linear.yaml")


# Bisection ---------------------------------------------------------------------------------------


def never() -> bool:
    return False


def asking(rule: Callable[[F], bool]) -> tuple[dict[F, bool], Callable[[F], bool]]:
    asked: dict[F, bool] = {}

    def holds(radius: F) -> bool:
        assert radius not in asked, "asked twice"
        asked[radius] = rule(radius)
        return asked[radius]

    return asked, holds


radii = st.integers(1, 400).map(lambda count: F(count, 100))


@given(st.lists(radii, min_size=1, max_size=8, unique=True), radii, radii)
def test_bisection_finds_where_an_answer_changes(grid: list[F], resolution: F, edge: F) -> None:
    grid = sorted(grid)
    asked, holds = asking(lambda radius: radius >= edge)
    smallest(holds, grid, F(0), resolution, never)
    if grid[-1] >= edge:
        found = min(radius for radius, yes in asked.items() if yes)
        below = max((radius for radius, yes in asked.items() if not yes), default=F(0))
        assert edge <= found and below < edge and found - below <= resolution
    asked, holds = asking(lambda radius: radius < edge)
    largest(holds, grid, F(0), None, resolution, never)
    fails = [radius for radius, yes in asked.items() if not yes]
    fine = max((radius for radius, yes in asked.items() if yes), default=F(0))
    assert fine < edge
    assert (min(fails) - fine <= resolution) if fails else fine == grid[-1]


@given(radii, radii, radii, st.integers(1, 7))
def test_radii_between_two_are_multiples_of_the_resolution_and_strictly_between(
    low: F, width: F, resolution: F, most: int
) -> None:
    found = between(low, low + width, resolution, most)
    assert found == sorted(set(found)) and len(found) <= most
    assert all(low < radius < low + width and ((radius - low) / resolution).denominator == 1 for radius in found)
    assert bool(found) == (width > resolution)


def test_bisection_asks_few_questions_and_stops_when_time_is_up() -> None:
    asked, holds = asking(lambda radius: radius >= F(123, 100))
    smallest(holds, [F(2**power) for power in range(4)], F(0), F(1, 1000), never)
    assert len(asked) <= 4 + math.ceil(math.log2(1000)) + 1

    def three() -> Iterator[bool]:
        yield from [False] * 3
        while True:
            yield True

    watch = three()
    asked, holds = asking(lambda radius: radius >= F(123, 100))
    smallest(holds, [F(1), F(2), F(4)], F(0), F(1, 1000), lambda: next(watch))
    assert len(asked) <= 3


# Command line ------------------------------------------------------------------------------------

RANGE = ("--most", "2", "--resolution", "0.1")


def test_the_command_answers_in_two_lines_and_writes_what_proves_them(here: Path, capsys: Any) -> None:
    outcome = run(capsys, "radius", "linear.onnx", "--spec", "linear.yaml", *RANGE, "--witness", "w.json")
    first, second = outcome.out.splitlines()
    assert outcome.code == 0, outcome.err
    assert first.startswith("VERIFIED up to 0.7: no trajectory of plant") and "perturbed by up to 0.7" in first
    assert second.startswith("FALSIFIED from 0.8: `near` is left at 1 s")
    assert "0.7     VERIFIED" in outcome.err and "not known: the radii above 0.7 and below 0.8, 0.1" in outcome.err
    assert run(capsys, "check", "linear.cert", "linear.onnx", "linear.yaml").code == 0
    assert run(capsys, "check", "w.json", "linear.onnx", "linear.yaml").code == 0
    assert {"linear.cert", "w.json", "w.csv", "w.png"} <= set(contents(here))


def test_json_has_the_same_keys_whatever_was_found(here: Path, capsys: Any) -> None:
    (here / "fails.yaml").write_text(LINEAR.replace("[-0.5, 0.5]", "[0.5, 1]"))
    arguments = ("radius", "linear.onnx", "--json", "--quiet", *RANGE)
    found, fails = (run(capsys, *arguments, "--spec", name) for name in ("linear.yaml", "fails.yaml"))
    data, bad = json.loads(found.out), json.loads(fails.out)
    assert data.keys() == bad.keys() and (found.code, fails.code) == (0, 10) == (data["exit_code"], bad["exit_code"])
    assert data["format"] == "setrl-radius/1" and found.err == fails.err == ""
    assert (data["verdict"], data["verified"]["radius"], data["falsified"]["radius"]) == ("VERIFIED", "0.7", "0.8")
    assert data["verified"]["result"]["certificate"]["path"] == "linear.cert"
    assert data["falsified"]["result"]["witness"]["depth"] > 0
    assert ["0.7", "VERIFIED"] in data["tried"] and data["unproved"] is None
    assert (bad["verdict"], bad["verified"], bad["falsified"]["radius"]) == ("FALSIFIED", None, "0")


@pytest.mark.parametrize(
    ("options", "code", "start"),
    [
        (("linear.onnx", "--spec", "linear.yaml", "--timeout", "1e-9"), 5, "UNKNOWN at 0: "),
        (("linear.onnx", "--spec", "linear.yaml", "--most", "0.1", "--no-check"), 5, "CLAIMED up to 0.1: "),
        (("linear.onnx", "--spec", "linear.yaml", "--least", "1.5", "--most", "2"), 10, "FALSIFIED from 1.5: "),
    ],
)
def test_the_exit_code_says_what_was_found(
    options: tuple[str, ...], code: int, start: str, here: Path, capsys: Any
) -> None:
    before = contents(here)
    outcome = run(capsys, "radius", *options)
    assert outcome.code == code and outcome.out.startswith(start) and outcome.out.count("\n") == 1
    assert contents(here) == before


@pytest.mark.parametrize(
    ("options", "words"),
    [
        (("--resolution", "0"), ("resolution", "positive")),
        (("--resolution", "fine"), ("--resolution", "number")),
        (("--most", "1,2"), ("--most", "one radius")),
        (("--most", "-1"), ("--most", "negative")),
        (("--least", "2", "--most", "1"), ("from 2 to 1",)),
        (("--splits", "0"), ("--splits",)),
        (("--workers", "0"), ("--workers",)),
        (("--witness", "w.txt"), (".json",)),
        (("--certificate", "linear.yaml"), ("linear.yaml", "no certificate")),
        (("--epsilon", "0.1"), ("--epsilon",)),
    ],
)
def test_wrong_options_are_one_line(options: tuple[str, ...], words: tuple[str, ...], here: Path, capsys: Any) -> None:
    before = contents(here)
    outcome = run(capsys, "radius", "linear.onnx", "--spec", "linear.yaml", *options)
    assert outcome.code == 2 and outcome.out == "" and outcome.err.count("\n") == 1, outcome.err
    assert all(word in outcome.err for word in words), outcome.err
    assert contents(here) == before
