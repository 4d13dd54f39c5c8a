"""certification.sarif is valid SARIF 2.1.0, alerts exactly where the gate fails, and keeps its fingerprints."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import unquote, urlsplit

import jsonschema
import pytest
import report_cases as reports
from hypothesis import given, settings
from hypothesis import strategies as st

from setrl.verify.certification.document import Outcome, Report, Row, Subject
from setrl.verify.certification.reports import sarif

SCHEMA = json.loads((Path(__file__).parent / "data" / "sarif-2.1.0-rtm.5.json").read_text())
VALIDATOR = jsonschema.Draft4Validator(SCHEMA, format_checker=jsonschema.FormatChecker())


def run_of(report: Report) -> dict[str, Any]:
    text = sarif.render(report)
    text.encode()
    log = json.loads(text)
    VALIDATOR.validate(log)
    (run,) = log["runs"]
    return dict(run)


def results(*rows: Row) -> list[dict[str, Any]]:
    return list(run_of(reports.report_of(*rows))["results"])


def test_a_report_of_every_outcome_is_valid() -> None:
    assert run_of(reports.every_outcome())["tool"]["driver"]["version"] == "0.1.0"


@pytest.mark.parametrize(
    ("outcome", "kinds"),
    [
        (Outcome.VERIFIED, ["pass"]),
        (Outcome.UNKNOWN, ["open", "fail"]),
        (Outcome.FALSIFIED, ["fail"]),
        (Outcome.ERROR, ["fail"]),
        (Outcome.INTERNAL, ["fail"]),
    ],
)
def test_an_outcome_has_its_kind_and_only_a_failure_has_a_level(outcome: Outcome, kinds: list[str]) -> None:
    found = results(reports.made_up("p.onnx", outcome))
    assert [entry["kind"] for entry in found] == kinds
    assert all((entry["level"] == "none") == (entry["kind"] != "fail") for entry in found)


def test_an_alert_is_raised_exactly_where_a_row_does_not_pass() -> None:
    report = reports.every_outcome()
    found = run_of(report)["results"]
    for row in report.rows:
        alerts = [entry for entry in found if entry["properties"]["row"] == row.name and entry["level"] == "error"]
        assert bool(alerts) == (not row.passed), row.name


def test_the_alerts_are_what_fails_and_nothing_else() -> None:
    report = reports.every_outcome()
    log = json.loads(sarif.render_alerts(report))
    VALIDATOR.validate(log)
    errors = [entry for entry in run_of(report)["results"] if entry["level"] == "error"]
    assert [entry["message"] for entry in log["runs"][0]["results"]] == [entry["message"] for entry in errors]
    passing = json.loads(sarif.render_alerts(reports.report_of(report.rows[0])))
    assert passing["runs"][0]["results"] == []


def test_a_violation_that_is_expected_is_suppressed() -> None:
    (entry,) = results(reports.made_up("p.onnx", Outcome.FALSIFIED, passed=True, expected=("FALSIFIED",)))
    assert (entry["kind"], entry["level"], entry["suppressions"][0]["status"]) == ("fail", "note", "accepted")


def test_a_finding_is_at_the_line_of_its_requirement() -> None:
    (entry,) = results(reports.made_up("p.onnx", Outcome.VERIFIED))
    place = entry["locations"][0]["physicalLocation"]
    assert place["artifactLocation"]["uri"] == "specs/hover.yaml"
    assert place["region"]["startLine"] == 23


@pytest.mark.parametrize(
    "name", ["//host/x.yaml", "/etc/passwd", "javascript:alert(1)", "c:\\x.yaml", "a b#c?d.yaml", "../x.yaml", "é.yaml"]
)
def test_a_location_is_a_relative_reference_whatever_the_name(name: str) -> None:
    (entry,) = results(reports.made_up("p.onnx", Outcome.VERIFIED, specification=Subject(name, "")))
    uri = entry["locations"][0]["physicalLocation"]["artifactLocation"]["uri"]
    parts = urlsplit(uri)
    assert (parts.scheme, parts.netloc, parts.query, parts.fragment) == ("", "", "", "")
    assert not uri.startswith("/")
    assert unquote(uri) == name.lstrip("/")


def test_fingerprints_tell_findings_apart_and_depend_on_no_number() -> None:
    rows = [reports.made_up(name, outcome) for name in ("a.onnx", "b.onnx") for outcome in Outcome]
    rows = [replace(row, name=f"{number} {row.name}") for number, row in enumerate(rows)]

    def prints(*some: Row) -> list[str]:
        return [str(sorted(entry["partialFingerprints"].items())) for entry in results(*some)]

    assert len(set(prints(*rows))) == len(prints(*rows))
    changed = [
        replace(
            row,
            requirements=tuple(replace(entry, margin=-7.0, time=0.1, line=40) for entry in row.requirements),
            timings={},
            key="other",
        )
        for row in rows
    ]
    assert prints(*changed) == prints(*rows)


def test_every_file_is_an_artifact_with_its_digest_once() -> None:
    run = run_of(reports.every_outcome())
    names = [entry["location"]["uri"] for entry in run["artifacts"]]
    assert len(names) == len(set(names))
    assert {"specs/hover.yaml", "good.onnx", "quadrotor1d"} <= set(names)
    digests = {entry["location"]["uri"]: entry["hashes"]["sha-256"] for entry in run["artifacts"]}
    assert digests["good.onnx"] == reports.sha("good.onnx")
    for entry in run["results"]:
        place = entry["locations"][0]["physicalLocation"]["artifactLocation"]
        assert names[place["index"]] == place["uri"]


def test_rules_are_referred_to_by_their_position() -> None:
    run = run_of(reports.every_outcome())
    for entry in run["results"]:
        assert run["tool"]["driver"]["rules"][entry["ruleIndex"]]["id"] == entry["ruleId"]


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_no_text_makes_it_invalid_or_adds_a_finding(text: str) -> None:
    assert len(run_of(reports.hostile(text))["results"]) == len(run_of(reports.hostile("harmless"))["results"])


@settings(max_examples=15, deadline=None)
@given(st.text(min_size=1, max_size=60))
def test_no_text_at_all_becomes_a_link_in_a_message(text: str) -> None:
    assert_no_link(text)


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_no_text_becomes_a_link_in_a_message(text: str) -> None:
    assert_no_link(text)


def assert_no_link(text: str) -> None:
    for entry in json.loads(sarif.render(reports.hostile(text)))["runs"][0]["results"]:
        message = entry["message"]["text"].replace("\\[", "").replace("\\]", "")
        assert "[" not in message and "]" not in message
