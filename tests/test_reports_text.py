"""summary.md, results.csv, certification.json: what is parsed back is what was found, whatever a file is called."""

from __future__ import annotations

import csv
import io
import json
from dataclasses import replace
from pathlib import Path

import pytest
import report_cases as reports
from hypothesis import given, settings
from hypothesis import strategies as st
from markdown_it import MarkdownIt

from setrl.verify.certification.document import Outcome, Report, ValueRow, report_from_json
from setrl.verify.certification.reports import archcomp, json_report, markdown
from setrl.verify.certification.reports.files import FILES, write_reports
from setrl.verify.certification.reports.text import visible

texts = st.text(st.characters(exclude_categories=()), min_size=1, max_size=60)
"""Lone surrogates too."""


def shape(report: Report) -> list[tuple[str, str]]:
    """Everything that a Markdown reader sees but the text: blocks, spans, and raw HTML as it stands."""
    found = []
    parser = MarkdownIt("commonmark").enable(["table", "strikethrough"])
    for token in parser.parse(markdown.render(report)):
        html = token.content if token.type == "html_block" else ""
        found.append((token.type, html.replace("\n", "")[:9]))
        for child in token.children or []:
            if child.type not in ("text", "text_special"):
                found.append((child.type, child.content if child.type == "html_inline" else ""))
    return found


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_no_text_adds_markup_to_the_summary(text: str) -> None:
    shown = text.replace("`", "'")  # in backticks a sentence sets code
    assert shape(reports.hostile(shown)) == shape(reports.hostile("harmless"))


@settings(max_examples=30, deadline=None)
@given(texts)
def test_no_text_at_all_adds_markup_to_the_summary(text: str) -> None:
    shown = text.replace("`", "'")  # in backticks a sentence sets code
    assert shape(reports.hostile(shown)) == shape(reports.hostile("harmless"))


@pytest.mark.parametrize("text", ["`<b>`", "`a|b` `c`", "`", "a ` b ` ` c"])
def test_backticks_set_code_in_the_summary_and_nothing_else(text: str) -> None:
    def others(report: Report) -> list[tuple[str, str]]:
        return [entry for entry in shape(report) if entry[1] not in ("<code>", "</code>")]

    assert others(reports.hostile(text)) == others(reports.hostile("harmless"))


def test_the_summary_of_a_thousand_rows_is_far_below_the_limit_and_has_them_all() -> None:
    report = reports.many(1000)
    text = markdown.render(report)
    assert len(text.encode()) < markdown.LIMIT // 2
    assert all(f"policy-{number:04}" in text for number in range(1000))


@pytest.mark.parametrize("limit", [3_000, 20_000, 100_000])
def test_a_summary_that_is_too_long_is_cut_honestly_and_keeps_what_does_not_pass(limit: int) -> None:
    report = reports.many(1000)
    text = markdown.render(report, limit)
    assert len(text.encode()) <= limit
    shown = [line for line in text.splitlines() if line.startswith("| <code>")]
    assert f"{1000 - len(shown)} more rows: see certification.json" in text
    failing = ["does not pass" in line for line in shown]
    assert failing == sorted(failing, reverse=True) and any(failing)


def test_a_summary_of_the_longest_names_stays_below_the_limit() -> None:
    rows = [replace(row, name="é" * 5000, claim="é" * 5000) for row in reports.many(300).rows]
    assert len(markdown.render(reports.report_of(*rows)).encode()) < markdown.LIMIT


def test_the_summary_says_what_does_not_pass_why_and_what_to_do() -> None:
    text = markdown.render(reports.every_outcome())
    assert text.startswith("## ")
    assert "Certification does not pass" in text
    assert "7 of 12 rows pass: 6 VERIFIED, 2 UNKNOWN, 2 FALSIFIED, 1 ERROR, 1 INTERNAL" in text
    assert "try: try more splits" in text
    assert "V(s0) -9.5 → -12.5" in text


def test_a_batch_that_passes_says_so() -> None:
    text = markdown.render(reports.report_of(reports.made_up("p.onnx", Outcome.VERIFIED)))
    assert "Certification passes" in text and "does not pass" not in text


def table(report: Report) -> list[dict[str, str]]:
    return list(csv.DictReader(io.StringIO(archcomp.render(report), newline="")))


def test_the_competition_s_columns_come_first() -> None:
    report = reports.every_outcome()
    assert archcomp.render(report).startswith("benchmark,instance,result,time,")
    found = table(report)
    assert [entry["result"] for entry in found] == [row.outcome.value for row in report.rows]
    assert (found[0]["benchmark"], found[0]["instance"]) == ("specs/hover.yaml", "good.onnx @ 0.1")
    assert (found[0]["time"], found[0]["reachability"], found[0]["checking"]) == ("1.510", "1.500", "")


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_no_cell_is_a_formula_and_no_text_adds_one(text: str) -> None:
    found = table(reports.hostile(text))
    assert [list(entry) for entry in found] == [list(archcomp.COLUMNS)] * len(Outcome)
    for entry in found:
        for value in (entry["benchmark"], entry["instance"]):
            assert not value.lstrip().startswith(("=", "+", "-", "@"))


@settings(max_examples=50, deadline=None)
@given(texts)
def test_no_text_at_all_adds_a_line_to_the_table(text: str) -> None:
    assert archcomp.render(reports.hostile(text)).count("\n") == 1 + len(Outcome)
    assert [entry["result"] for entry in table(reports.hostile(text))] == [outcome.value for outcome in Outcome]


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_a_report_survives_json(text: str) -> None:
    report = reports.hostile(text)
    written = json_report.render(report).encode()
    assert report_from_json(json.loads(written)) == report


def test_a_number_that_is_not_finite_is_null() -> None:
    row = reports.made_up("p.onnx", Outcome.UNKNOWN, value=ValueRow(float("-inf"), float("nan"), 0.99))
    assert json.loads(json_report.render(reports.report_of(row)))["rows"][0]["value"]["discounted"] is None


@settings(max_examples=200, deadline=None)
@given(texts)
def test_what_is_shown_is_one_line_that_can_be_written(text: str) -> None:
    shown = visible(text)
    shown.encode()
    assert len(shown.splitlines()) <= 1
    assert all(character.isprintable() or character == " " or character.isspace() for character in shown)
    assert visible(shown) == shown


def test_line_breaks_are_blanks_and_what_cannot_be_seen_is_its_code() -> None:
    assert visible("a\nb\tc\u2028d\r\x0be") == "a b c d  e"
    assert visible("\x00\u202e\ud800\U000e0001") == "\\x00\\u202e\\ud800\\U000e0001"
    assert visible("ε × 策略 🤖") == "ε × 策略 🤖"
    assert visible("x" * 30, 10) == "x" * 7 + "..."


def test_every_format_is_written_and_the_same_report_gives_the_same_bytes(tmp_path: Path) -> None:
    report = reports.every_outcome()
    written = write_reports(report, tmp_path)
    first = {name: path.read_bytes() for name, path in written.items()}
    assert sorted(first) == sorted(FILES) == sorted(path.name for path in tmp_path.iterdir())
    write_reports(report_from_json(json.loads(first["certification.json"])), tmp_path)
    assert {name: path.read_bytes() for name, path in written.items()} == first


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_report_without_rows_can_be_rendered(name: str) -> None:
    FILES[name](reports.report_of())
