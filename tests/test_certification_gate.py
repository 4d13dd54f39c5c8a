"""The gate: what passes is proved and was asked for; what an earlier report had is not lost unseen."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction as F
from itertools import product
from pathlib import Path
from typing import Any

import pytest
from certification_cases import ahead, row

from setrl.specs.errors import InputError
from setrl.specs.manifest import Search
from setrl.verify.certification.baseline import TOLERANCE, baseline_of, change_of, read_baseline
from setrl.verify.certification.document import (
    Baseline,
    Change,
    Evidence,
    Outcome,
    Report,
    Row,
    Source,
    Subject,
    Why,
    report_from_json,
    row_from_json,
)
from setrl.verify.certification.gate import judged, worst
from setrl.verify.certification.summary import summary_lines

VERIFIED, UNKNOWN, FALSIFIED, ERROR, INTERNAL = Outcome
VERDICTS = ("VERIFIED", "FALSIFIED", "UNKNOWN")
EXPECTED = [(), *((one,) for one in VERDICTS), ("FALSIFIED", "UNKNOWN"), VERDICTS]
CODES = {VERIFIED: 0, UNKNOWN: 5, FALSIFIED: 10, ERROR: 2, INTERNAL: 6}


# ---- verdicts


@pytest.mark.parametrize(("outcome", "expected", "allowed"), product(Outcome, EXPECTED, (False, True)))
def test_a_row_passes_where_its_verdict_is_expected_or_is_an_unknown_that_is_allowed(
    outcome: Outcome, expected: tuple[str, ...], allowed: bool
) -> None:
    found = judged(row(outcome, margins=(1.0,)), ahead(expected=expected, allow_unknown=allowed))
    passes = outcome.value in (expected or ("VERIFIED",)) or (outcome is UNKNOWN and allowed)
    assert found.passed is passes
    assert bool(found.objections) is not passes
    assert found.exit_code == (0 if passes else CODES[outcome] or 5)
    assert (found.expected, found.allow_unknown, found.outcome) == (expected, allowed, outcome)


@pytest.mark.parametrize("outcome", [ERROR, INTERNAL])
def test_what_has_no_verdict_passes_nothing_and_says_why(outcome: Outcome) -> None:
    found = judged(row(outcome, why=None), ahead(expected=VERDICTS, allow_unknown=True))
    assert (found.passed, found.exit_code) == (False, CODES[outcome])
    assert found.objections == ("there is no answer",)
    assert judged(row(outcome), ahead()).objections == (f"it is {outcome.value}",)


def test_an_earlier_judgement_is_forgotten() -> None:
    old = row(objections=("old",), passed=False, exit_code=10, expected=("FALSIFIED",), allow_unknown=True)
    found = judged(old, ahead())
    assert (found.passed, found.exit_code, found.objections, found.expected) == (True, 0, (), ())
    assert found.allow_unknown is False


def test_the_worst_exit_code_is_the_batch_s() -> None:
    order = [0, 5, 10, 2, 6]
    for first, second in product(range(5), range(5)):
        assert worst([order[first], order[second], 0]) == order[max(first, second)]
    assert worst([]) == 0
    with pytest.raises(ValueError):
        worst([1])


# ---- floors


@pytest.mark.parametrize(
    ("floors", "proved", "passes"),
    [
        ({"value": F(-40)}, {"value": -40.0}, True),
        ({"value": F(-40)}, {"value": -40.000000000000014}, False),
        ({"value": F(-40)}, {"value": 3.0}, True),
        ({"value": F(1, 10)}, {"value": 0.1}, True),  # the float is above the tenth
        ({"value": F(3, 10)}, {"value": 0.3}, False),  # the float is below
        ({"value": F(0)}, {"value": None}, False),
        ({"value": F(-(10**400))}, {"value": -1e308}, True),
        ({"margin": F(0)}, {"margins": (0.0, 2.0)}, True),
        ({"margin": F(1)}, {"margins": (0.5, 2.0)}, False),
        ({"margin": F(0)}, {"margins": (None, 2.0)}, False),
        ({"margin": F(-5)}, {"margins": ()}, False),
        ({"value": F(1), "margin": F(1)}, {"value": 1.0, "margins": (1.0,)}, True),
        ({"value": F(1), "margin": F(1)}, {"value": 1.0, "margins": (0.5,)}, False),
        ({"value": F(1), "margin": F(1)}, {"value": 0.5, "margins": (1.0,)}, False),
    ],
)
def test_a_floor_is_met_by_a_number_that_is_proved_and_not_below(
    floors: dict[str, Any], proved: dict[str, Any], passes: bool
) -> None:
    found = judged(row(**proved), ahead(**floors))
    assert (found.passed, found.exit_code) == ((True, 0) if passes else (False, 5))
    for outcome in (UNKNOWN, FALSIFIED):  # figures of what is not VERIFIED are no proof
        other = judged(row(outcome, **proved), ahead(**floors, expected=VERDICTS, allow_unknown=True))
        assert (other.passed, other.exit_code) == (False, 5)
        assert len(other.objections) == len(floors)
        assert all("nothing is proved" in objection for objection in other.objections)


def test_a_falsified_row_that_misses_a_floor_too_keeps_the_worse_code() -> None:
    found = judged(row(FALSIFIED, value=1.0), ahead(value=F(0)))
    assert (found.exit_code, len(found.objections)) == (10, 2)
    found = judged(row(ERROR), ahead(value=F(0)))
    assert (found.exit_code, len(found.objections)) == (2, 2)


def test_a_floor_s_objection_never_shows_more_than_is_proved() -> None:
    (objection,) = judged(row(value=-40.00000049), ahead(value=F(-40))).objections
    assert objection == "V(s0) of at least -40 is required, -40.0001 is proved"


SEARCH = Search(F(10), F(1, 1000))


@pytest.mark.parametrize(
    ("outcome", "floor", "radius", "passes"),
    [
        (VERIFIED, None, "0.1", True),
        (VERIFIED, F(1, 10), "0.1", True),
        (VERIFIED, F(1, 10), "0.0999999999", False),
        (VERIFIED, F(0), "0", True),
        (VERIFIED, F(0), None, False),
        (UNKNOWN, F(0), None, False),
        (UNKNOWN, F(0), "0.1", False),
        (FALSIFIED, None, None, False),
    ],
)
def test_a_certified_radius_is_verified_and_not_below_its_floor(
    outcome: Outcome, floor: F | None, radius: str | None, passes: bool
) -> None:
    found = judged(row(outcome, radius=radius, search=True), ahead(search=replace(SEARCH, floor=floor)))
    assert found.passed is passes
    allowed = judged(row(outcome, radius=radius, search=True), ahead(search=SEARCH, allow_unknown=True))
    assert allowed.passed is (outcome is not FALSIFIED)
    demanding = ahead(search=replace(SEARCH, floor=F(0)), allow_unknown=True)
    unproved = judged(row(UNKNOWN, radius="0.1", search=True), demanding)
    assert (unproved.passed, unproved.exit_code) == (False, 5)


def test_what_is_expected_and_required_at_a_radius_says_nothing_about_a_search() -> None:
    """An entry may say that the policy fails at one radius, and search the radius up to which it does not."""
    demands = ahead(search=replace(SEARCH, floor=F(1, 10)), expected=("FALSIFIED",), value=F(10**6), margin=F(10**6))
    assert judged(row(radius="0.2", value=1.0, margins=(1.0,)), demands).passed
    assert not judged(row(FALSIFIED, radius=None), ahead(search=SEARCH, expected=("FALSIFIED",))).passed
    assert judged(row(FALSIFIED), ahead(expected=("FALSIFIED",))).expected == ("FALSIFIED",)


# ---- the baseline

EXACT = F(1, 4)
"""A tolerance that floats hold exactly."""


def regressions(before: Row, after: Row, tolerance: F = EXACT) -> tuple[str, ...]:
    return change_of(before, after, tolerance).regressions


@pytest.mark.parametrize("figure", ["value", "margin", "radius"])
@pytest.mark.parametrize(
    ("now", "worse"),
    [(1.0, False), (0.75, False), (0.7499999999, True), (0.5, True), (None, True), (2.0, False)],
)
def test_a_figure_may_fall_by_the_tolerance_and_not_by_more(figure: str, now: float | None, worse: bool) -> None:
    def having(number: float | None) -> Row:
        if figure == "radius":
            return row(radius=None if number is None else str(number))
        return row(value=number) if figure == "value" else row(margins=(3.0, number))

    before, after = having(1.0), having(now)
    change = change_of(before, after, EXACT)
    assert bool(change.regressions) is worse
    assert (getattr(change, figure) is None) is (now == 1.0)
    found = judged(after, ahead(), change)
    assert (found.passed, found.exit_code) == ((False, 5) if worse else (True, 0))
    assert found.change == change and found.objections == change.regressions
    assert not regressions(having(None), after)  # what was not proved before cannot be lost


@pytest.mark.parametrize(("before", "after"), product(Outcome, Outcome))
def test_a_worse_verdict_is_a_regression_and_a_better_one_is_none(before: Outcome, after: Outcome) -> None:
    order = [VERIFIED, UNKNOWN, FALSIFIED, ERROR, INTERNAL]
    change = change_of(row(before), row(after), TOLERANCE)
    assert bool(change.regressions) is (order.index(after) > order.index(before))
    assert change.verdict == (None if before is after else (before.value, after.value))


def test_a_regression_fails_a_row_that_is_allowed_to_be_unknown() -> None:
    demands = ahead(allow_unknown=True)
    before, after = row(value=1.0), row(UNKNOWN, value=5.0)
    assert judged(after, demands).passed
    found = judged(after, demands, change_of(before, after, TOLERANCE))
    assert (found.passed, found.exit_code) == (False, 5)
    assert len(found.objections) == 2  # the verdict, and a V(s0) that is no longer proved


def test_figures_of_what_is_not_verified_are_no_baseline() -> None:
    before = row(UNKNOWN, value=5.0, margins=(5.0,), radius="5")
    assert regressions(before, row(value=1.0, margins=(1.0,), radius="1")) == ()


def test_a_fall_is_written_with_all_digits() -> None:
    (text,) = regressions(row(value=1234.5678), row(value=1234.5677), F(0))
    assert text == "V(s0) was 1234.5678, is 1234.5677"


def test_rows_that_came_and_went_are_named() -> None:
    earlier = report(row(name="a"), row(name="b"))
    found = baseline_of(earlier, "old.json", "ff", [row(name="b"), row(name="c")], F(1, 10))
    assert found == Baseline("old.json", "ff", "0.1", ("a",), ("c",))
    lines = summary_lines(replace(report(row(name="b", passed=True)), baseline=found))
    assert lines == ["no longer there: a", "1 of 1 rows pass: 1 VERIFIED"]


def test_a_summary_is_one_line_per_finding_whatever_is_in_a_name() -> None:
    name = "a\nFAILED: \x1b[31m\u2028b x c"
    lines = summary_lines(report(judged(row(FALSIFIED, name=name, margins=(-1.0,)), ahead())))
    assert len(lines) == 3 and all(line.isprintable() for line in lines)


# ---- reports as files


def report(*rows: Row, **more: Any) -> Report:
    return Report(Subject("fleet.yaml", "ab"), {"setrl": "1"}, rows, worst(each.exit_code for each in rows), **more)


FULL = row(
    UNKNOWN,
    value=-0.1,
    margins=(0.5, None),
    radius="0.25",
    search=True,
    epsilon="0.1",
    source=Source.RECHECKED,
    objections=("one", "two"),
    expected=("FALSIFIED",),
    allow_unknown=True,
    claim="no trajectory",
    why=Why("resource", "ended", "altitude", 0.5, "time limit", "raise it", 0.25, 0.125),
    semantics=("real", "float32"),
    assumptions=("the plant is what it is",),
    notes=("a", "b"),
    cells=3,
    leaves=2,
    evidence=Evidence("witness", "witnesses/w.json", "ff", 10, "proved"),
    picture={"boxes": [[0.0, 1.0]], "none": None},
    change=Change(("VERIFIED", "UNKNOWN"), (1.0, None), (None, 0.5), ("0.1", None), ("worse",)),
    period=0.1,
    horizon=0.5,
    options={"splits": 3, "method": "jets"},
    timings={"total": 1.25},
)


@pytest.mark.parametrize("each", [row(), FULL], ids=["nothing optional", "everything"])
def test_a_report_and_its_rows_come_back_from_json(each: Row) -> None:
    whole = report(each, baseline=Baseline("b", "ff", "0.1", ("x",), ("y", "z")), seconds=2.5)
    assert report_from_json(json.loads(json.dumps(whole.to_json(), allow_nan=False))) == whole
    assert row_from_json(whole.to_json()["rows"][0]) == each
    assert report_from_json(report(each).to_json()) == report(each)


def test_numbers_that_are_not_finite_are_none_in_json() -> None:
    wild = row(value=float("-inf"), margins=(float("nan"), float("inf")))
    assert json.loads(json.dumps(report(wild).to_json(), allow_nan=False))["rows"][0]["value"]["discounted"] is None


def damaged(**changes: Any) -> bytes:
    """A report with other entries in its only row."""
    data = report(row(value=1.0, margins=(1.0,), radius="0.5")).to_json()
    data["rows"][0] |= changes
    return json.dumps(data).encode()


def found_radius(text: Any) -> dict[str, Any]:
    return {"verified": text, "falsified": None, "resolution": "0.1", "tried": []}


def margin(number: Any) -> list[dict[str, Any]]:
    keys = {"name": "r", "kind": "avoid", "proved": True, "time": 0.0, "line": 1, "curve": []}
    return [{**keys, "margin": number}]


def value(number: Any) -> dict[str, Any]:
    return {"discounted": number, "undiscounted": 0.0, "discount": 1.0}


NO_BASELINES = {
    "empty": b"",
    "text": b"no JSON",
    "not text": b"\xff\xfe\x00",
    "deep": b"[" * 100_000,
    "a number of a million digits": b'{"format": ' + b"9" * 1_000_000 + b"}",
    "a list": b"[]",
    "another format": b'{"format": "setrl-certification/2", "rows": []}',
    "no rows": json.dumps({**report().to_json(), "rows": None}).encode(),
    "a key is missing": json.dumps({"format": "setrl-certification/1"}).encode(),
    "half of it": damaged()[:-30],
    "another key": damaged(colour="red"),
    "another verdict": damaged(outcome="SAFER"),
    "a name that is none": damaged(name=3),
    "a value that is text": damaged(value=value("1")),
    "a value that no float holds": damaged(value=value(10**400)),
    "a value that is true": damaged(value=value(True)),
    "a value that is NaN": damaged(value=value(float("nan"))),
    "a value that is infinite": damaged(value=value(float("-inf"))),
    "a margin that is text": damaged(requirements=margin("much")),
    "a margin that is NaN": damaged(requirements=margin(float("nan"))),
    "a margin that is a list": damaged(requirements=margin([])),
    "a radius that is text": damaged(radius=found_radius("much")),
    "a radius that is NaN": damaged(radius=found_radius("nan")),
    "a radius that is a fraction": damaged(radius=found_radius("1/0")),
    "a radius that is negative": damaged(radius=found_radius("-1")),
    "a radius that is a number": damaged(radius=found_radius(0.5)),
    "a radius of many digits": damaged(radius=found_radius("1e999999999")),
    "the same row twice": json.dumps(report(row(), row()).to_json()).encode(),
}


@pytest.mark.parametrize("name", NO_BASELINES)
def test_a_baseline_that_is_none_is_refused_before_anything_is_compared(name: str, tmp_path: Path) -> None:
    path = tmp_path / "old.json"
    path.write_bytes(NO_BASELINES[name])
    with pytest.raises(InputError) as caught:
        read_baseline(path)
    assert caught.value.where == str(path) and caught.value.remedy
    assert "\n" not in str(caught.value)


def test_a_baseline_is_a_file_that_is_there(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "gone.json", tmp_path / ("a" * 5000)):
        with pytest.raises(InputError) as caught:
            read_baseline(path)
        assert caught.value.where == str(path)
    good = tmp_path / "good.json"
    good.write_bytes(damaged())
    assert read_baseline(good)[0] == report(row(value=1.0, margins=(1.0,), radius="0.5"))
    good.write_bytes(damaged(value={**value(1), "undiscounted": 1, "discount": 0.99}))  # a tool may drop the ".0"
    assert read_baseline(good)[0] == report(row(value=1.0, margins=(1.0,), radius="0.5"))
