"""What a result says to people and to programs: nothing that is printed is better than what was found."""

from __future__ import annotations

import hashlib
import json
import math
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from command_line import EXAMPLE, HOPELESS, QUICK
from hypothesis import given
from hypothesis import strategies as st

import setrl
from setrl.specs.errors import InputError
from setrl.specs.exact import decimal_range
from setrl.specs.reader import parse_specification
from setrl.verify import report, tables
from setrl.verify.options import Options
from setrl.verify.result import Reason, Result, Value
from setrl.verify.wording import at_least, at_most, quantity

finite = st.floats(allow_nan=False, allow_infinity=False)


@pytest.fixture(scope="module")
def proved(tmp_path_factory: pytest.TempPathFactory) -> Result:
    path = tmp_path_factory.mktemp("proved") / "quick.yaml"
    path.write_text(QUICK)
    return setrl.verify(EXAMPLE, path)


@pytest.fixture(scope="module")
def claimed() -> Result:
    return setrl.verify(EXAMPLE, parse_specification(QUICK, "quick.yaml"))


@pytest.fixture(scope="module")
def unknown() -> Result:
    return setrl.verify(EXAMPLE, parse_specification(HOPELESS, "hopeless.yaml"), options=Options(splits=1))


@given(finite, st.integers(1, 17))
def test_a_printed_lower_bound_is_not_above_the_bound(value: float, digits: int) -> None:
    assert Fraction(at_least(value, digits)) <= Fraction(value)


@given(finite, st.integers(1, 17))
def test_a_printed_upper_bound_is_not_below_the_bound(value: float, digits: int) -> None:
    assert Fraction(at_most(value, digits)) >= Fraction(value)


@pytest.mark.parametrize(("value", "text"), [(math.inf, "inf"), (-math.inf, "-inf"), (0.0, "0")])
def test_a_bound_that_is_not_finite_is_printed_as_it_is(value: float, text: str) -> None:
    assert at_least(value) == at_most(value) == text


def test_the_verdict_line_is_the_claim_or_the_reason(proved: Result, claimed: Result, unknown: Result) -> None:
    assert report.verdict_line(proved) == f"VERIFIED: {proved.claim}"
    assert report.verdict_line(claimed) == f"CLAIMED: {proved.claim}"
    assert unknown.reason is not None
    assert report.verdict_line(unknown) == f"UNKNOWN: {unknown.reason.sentence}"


@pytest.mark.parametrize("name", ["proved", "claimed", "unknown"])
def test_no_text_says_safe(name: str, request: pytest.FixtureRequest) -> None:
    result = request.getfixturevalue(name)
    assert "safe" not in "\n".join([report.verdict_line(result), *report.describe(result)]).lower()


def test_json_has_the_same_keys_whatever_the_outcome(proved: Result, claimed: Result, unknown: Result) -> None:
    first, second, third = proved.to_json(), unknown.to_json(), claimed.to_json()
    assert first.keys() == second.keys() == third.keys()
    assert first["requirements"][0].keys() == second["requirements"][0].keys()
    for data in (first, second, third):
        assert json.loads(json.dumps(data, allow_nan=False)) == data


def test_json_has_null_for_what_is_not_finite(proved: Result) -> None:
    data = report.result_to_json(replace(proved, value=Value(-math.inf, math.nan, 0.99)))
    assert data["value"] == {"discounted": None, "undiscounted": None, "discount": 0.99}


def test_json_names_the_certificate_where_there_is_one(proved: Result, claimed: Result, unknown: Result) -> None:
    content = proved.certificate
    assert content is not None and claimed.certificate is None and unknown.certificate is None
    facts = {"sha256": hashlib.sha256(content).hexdigest(), "bytes": len(content), "leaves": 1}
    assert proved.to_json()["certificate"] == {"path": None, **facts}
    assert report.result_to_json(proved, None, "a.cert")["certificate"] == {"path": "a.cert", **facts}
    assert claimed.to_json()["certificate"] is None and unknown.to_json()["certificate"] is None


def test_only_a_verified_says_that_the_checker_accepted(proved: Result, claimed: Result) -> None:
    words = "accepted by the checker"
    assert words in "\n".join(report.describe(proved)) and words not in "\n".join(report.describe(claimed))
    pretended = replace(claimed, certificate=proved.certificate)
    assert words not in "\n".join(report.describe(pretended))


def test_json_keeps_the_hull_of_the_flowpipe(proved: Result) -> None:
    points = proved.to_json()["flowpipe"]["points"]
    assert np.shape(points["lower"]) == np.shape(points["upper"]) == (6, 2)
    assert np.all(np.array(points["lower"]) <= np.array(points["upper"]))


def test_a_bound_that_is_missing_in_one_cell_is_missing_in_the_hull(proved: Result) -> None:
    points = np.repeat(proved.flowpipe.points, 2, axis=0)
    points[1, 3] = np.nan
    hull = report.flowpipe_to_json(replace(proved.flowpipe, points=points))["points"]
    assert np.isnan(hull["lower"][3]).all() and not np.isnan(hull["lower"][2]).any()


def test_a_reason_says_what_made_the_set_grow_and_what_does_verify(unknown: Result) -> None:
    assert unknown.reason is not None
    reason = Reason(
        "s",
        shares={"network relaxation": 0.75, "flow remainder": 0.25, "disturbances": 0.0},
        remedy="allow more splits",
        verified_until=1.5,
        verified_part=0.999999,
        largest_box={"z": (-1.0, 0.5), "zdot": (0.0, 0.0)},
    )
    text = "\n".join(report.reason_lines(reason, unknown))
    assert "network relaxation 75 %, flow remainder 25 %" in text and "disturbances" not in text
    assert "up to 1.5 s" in text and "99.99 %" in text and "100 %" not in text
    assert "z in [-1, 0.5], zdot = 0" in text and "allow more splits" in text


def test_a_value_that_is_no_bound_is_not_printed_as_a_number() -> None:
    assert "no lower bound" in report.value_text(Value(-math.inf, -math.inf, 0.99))


def test_a_margin_carries_its_sign() -> None:
    assert [report.margin_text(value) for value in (0.5, -0.5, -math.inf, math.nan)] == ["+0.5", "-0.5", "none", "none"]


def test_a_count_is_written_as_people_write_it() -> None:
    assert [quantity(1, "cell"), quantity(2, "cell"), quantity(3, "trajectory")] == [
        "1 cell",
        "2 cells",
        "3 trajectories",
    ]


def test_a_sweep_table_has_every_radius_as_it_was_written(proved: Result) -> None:
    radii = [Fraction(0), Fraction(1, 10)]
    lines = tables.sweep_table(radii, [proved, proved])
    assert [line.split()[0] for line in lines] == ["epsilon", "0", "0.1"]
    assert tables.sweep_csv(radii, [proved, proved]).splitlines()[2].startswith("0.1,VERIFIED,")


@pytest.mark.parametrize(
    ("text", "numbers"),
    [
        ("0:0.5:0.25", ["0", "0.25", "0.5"]),
        ("0:0.3:0.1", ["0", "0.1", "0.2", "0.3"]),
        ("0:1:0.4", ["0", "0.4", "0.8"]),
        ("0.5", ["0.5"]),
        ("0, 1e-3", ["0", "1e-3"]),
    ],
)
def test_a_range_is_exact_and_has_both_ends(text: str, numbers: list[str]) -> None:
    assert decimal_range(text) == tuple(Fraction(number) for number in numbers)


@pytest.mark.parametrize("text", ["", "0:1", "0:1:0", "0:1:-1", "1:0:1", "a", "0,-1", "0:1:1e-300", "nan", "0:1:1:1"])
def test_a_range_that_means_nothing_is_an_error_with_a_remedy(text: str) -> None:
    with pytest.raises(InputError) as error:
        decimal_range(text)
    assert error.value.remedy


def test_progress_counts_what_is_decided() -> None:
    lower, upper = np.array([[-1.0, -1.0], [0.0, 0.5]]), np.array([[0.0, 1.0], [1.0, 1.0]])
    assert report.decided_share(lower, upper) == 0.5 + 0.125
    assert report.decided_share(np.zeros((0, 2)), np.zeros((0, 2))) == 0.0


def test_a_table_is_aligned() -> None:
    rows: list[Any] = [("a", "bbb"), ("cccc", "d")]
    assert report.table(rows) == ["a     bbb", "cccc  d"]
