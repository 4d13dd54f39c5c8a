"""junit.xml is what Jenkins reads, and fails exactly where the gate does."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import replace
from pathlib import Path

import pytest
import report_cases as reports
import xmlschema
from hypothesis import given, settings
from hypothesis import strategies as st

from setrl.verify.certification.document import Outcome, Report, RequirementRow, Row
from setrl.verify.certification.reports import junit

SCHEMA = xmlschema.XMLSchema(Path(__file__).parent / "data" / "junit-10.xsd")


def parsed(report: Report) -> ET.Element:
    text = junit.render(report)
    text.encode()
    SCHEMA.validate(text)
    return ET.fromstring(text)


def children(suite: ET.Element) -> list[str]:
    return [case[0].tag for case in suite.iter("testcase")]


def only(row: Row) -> ET.Element:
    return parsed(reports.report_of(row))[0]


def test_a_report_of_every_outcome_is_valid_and_counts_what_it_contains() -> None:
    root = parsed(reports.every_outcome())
    for suite in root:
        assert int(suite.attrib["tests"]) == len(suite.findall("testcase")) >= 1
        for key, tag in (("failures", "failure"), ("errors", "error"), ("skipped", "skipped")):
            assert int(suite.attrib[key]) == len(suite.findall(f"testcase/{tag}"))
    for key in ("tests", "failures", "errors"):
        assert int(root.attrib[key]) == sum(int(suite.attrib[key]) for suite in root)


def test_a_suite_fails_exactly_where_its_row_does_not_pass() -> None:
    report = reports.every_outcome()
    for suite, row in zip(parsed(report), report.rows, strict=True):
        bad = {"failure", "error"} & set(children(suite))
        assert bool(bad) == (not row.passed), row.name


@pytest.mark.parametrize(
    ("outcome", "child"),
    [
        (Outcome.VERIFIED, "system-out"),
        (Outcome.UNKNOWN, "failure"),
        (Outcome.FALSIFIED, "failure"),
        (Outcome.ERROR, "error"),
        (Outcome.INTERNAL, "error"),
    ],
)
def test_an_outcome_has_its_own_element(outcome: Outcome, child: str) -> None:
    assert children(only(reports.made_up("p.onnx", outcome))) == [child]


def test_an_unknown_that_is_allowed_is_skipped_and_says_why() -> None:
    row = reports.made_up("p.onnx", Outcome.UNKNOWN, passed=True, objections=(), allow_unknown=True)
    suite = only(row)
    assert children(suite) == ["skipped"]
    assert "could not be proved" in suite.find("testcase/skipped").attrib["message"]  # type: ignore[union-attr]


def test_no_requirement_of_a_row_that_is_not_verified_counts_as_passed() -> None:
    proved = RequirementRow("other", "avoid", True, 1.0, 0.0, 5)
    for outcome in (Outcome.UNKNOWN, Outcome.FALSIFIED):
        row = reports.made_up("p.onnx", outcome)
        suite = only(replace(row, requirements=(*row.requirements, proved)))
        assert children(suite) == ["failure", "skipped"]


def test_a_row_whose_requirements_are_all_proved_but_which_is_unknown_fails_as_a_whole() -> None:
    row = reports.made_up("p.onnx", Outcome.UNKNOWN, requirements=(RequirementRow("a", "avoid", True, 1.0, 0.0, 5),))
    assert children(only(row)) == ["skipped", "failure"]


def test_a_verified_row_below_its_floor_fails_with_every_objection() -> None:
    row = reports.made_up("p.onnx", Outcome.VERIFIED, passed=False, objections=("one", "two"))
    suite = only(row)
    assert children(suite) == ["system-out", "failure", "failure"]
    assert [entry.attrib["message"] for entry in suite.iter("failure")] == ["one", "two"]


@pytest.mark.parametrize("more", [{"requirements": ()}, {"search": True}])
def test_a_row_with_nothing_but_a_reward_or_a_search_has_one_case(more: dict[str, object]) -> None:
    assert len(children(only(reports.made_up("p.onnx", Outcome.VERIFIED, **more)))) == 1


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_no_text_adds_an_element(text: str) -> None:
    hostile, harmless = parsed(reports.hostile(text)), parsed(reports.hostile("harmless"))
    assert [element.tag for element in hostile.iter()] == [element.tag for element in harmless.iter()]


@settings(max_examples=25, deadline=None)
@given(st.text(min_size=1, max_size=60))
def test_no_text_at_all_adds_an_element_or_makes_it_invalid(text: str) -> None:
    shape = [element.tag for element in ET.fromstring(junit.render(reports.hostile("harmless"))).iter()]
    assert [element.tag for element in ET.fromstring(junit.render(reports.hostile(text)).encode()).iter()] == shape
