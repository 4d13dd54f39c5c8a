"""index.html is one page that needs nothing else, and no text in it is markup."""

from __future__ import annotations

import base64
import hashlib
import re
from dataclasses import replace
from html.parser import HTMLParser
from urllib.parse import urlsplit

import pytest
import report_cases as reports
from hypothesis import given, settings
from hypothesis import strategies as st

from setrl.specs.exact import decimal_text
from setrl.verify.certification.document import Evidence, Outcome, RadiusFound, Report, RequirementRow
from setrl.verify.certification.reports import html
from setrl.verify.certification.reports.markup import Markup, join, tag
from setrl.verify.certification.reports.svg_curves import exact

VOID = {"meta", "br", "hr", "col"}


class Page(HTMLParser):
    """Elements with their attributes, and the text, of a page; every element is closed."""

    def __init__(self, text: str) -> None:
        super().__init__(convert_charrefs=True)
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.open: list[str] = []
        self.others: list[str] = []
        self.feed(text)
        self.close()
        assert self.open == [] and self.others == ["doctype html"]

    def handle_starttag(self, name: str, attributes: list[tuple[str, str | None]]) -> None:
        self.elements.append((name, dict(attributes)))
        assert len(dict(attributes)) == len(attributes)
        if name not in VOID:
            self.open.append(name)

    def handle_endtag(self, name: str) -> None:
        assert self.open.pop() == name

    def handle_data(self, data: str) -> None:
        self.texts.append(data)

    def handle_decl(self, declaration: str) -> None:
        self.others.append(declaration)

    def handle_comment(self, data: str) -> None:
        self.others.append(data)

    def handle_pi(self, data: str) -> None:
        self.others.append(data)

    @property
    def shape(self) -> list[tuple[str, tuple[str, ...]]]:
        return [(name, tuple(attributes)) for name, attributes in self.elements]

    @property
    def text(self) -> str:
        return " ".join(self.texts)


def page(report: Report) -> Page:
    return Page(html.render(report))


def harmless(text: str) -> str:
    """A text of the same sort: a radius is drawn, whatever else stands in its place is not."""
    radius = exact(text)
    return "harmless" if radius is None else decimal_text(radius)


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_no_text_adds_an_element_or_an_attribute(text: str) -> None:
    # without backticks, in which a sentence sets code
    shown = text.replace("`", "'")
    assert page(reports.hostile(shown)).shape == page(reports.hostile(harmless(text))).shape


@settings(max_examples=20, deadline=None)
@given(st.text(st.characters(exclude_categories=(), exclude_characters="`"), min_size=1, max_size=40))
def test_no_text_at_all_adds_an_element_or_an_attribute(text: str) -> None:
    assert page(reports.hostile(text)).shape == page(reports.hostile(harmless(text))).shape


def test_backticks_set_code_and_nothing_else() -> None:
    found = page(reports.hostile("`<b>` and `x`"))
    assert {name for name, _ in found.elements} == {name for name, _ in page(reports.hostile("harmless")).elements}


@pytest.mark.parametrize("text", reports.HOSTILE)
def test_every_reference_stays_within_the_folder(text: str) -> None:
    for _, attributes in page(reports.hostile(text)).elements:
        assert not {"src", "srcset", "style", "action", "data"} & set(attributes)
        assert not any(name.startswith("on") for name in attributes)
        target = attributes.get("href")
        if target is not None:
            parts = urlsplit(target)
            assert (parts.scheme, parts.netloc) == ("", "")
            assert target.startswith(("#", "./"))


def test_every_anchor_is_there_once() -> None:
    found = page(reports.every_outcome())
    names = [attributes["id"] for _, attributes in found.elements if "id" in attributes]
    assert len(names) == len(set(names))
    links = [a["href"] for name, a in found.elements if name == "a" and (a["href"] or "").startswith("#")]
    assert {str(link)[1:] for link in links} <= set(names)
    assert len(links) > 12


def test_the_policy_of_the_page_allows_its_own_style_sheet_and_nothing_else() -> None:
    text = html.render(reports.every_outcome())
    (policy,) = [
        attributes["content"]
        for name, attributes in Page(text).elements
        if name == "meta" and attributes.get("http-equiv") == "Content-Security-Policy"
    ]
    style = re.search("<style>(.*?)</style>", text, re.DOTALL)
    assert style is not None
    digest = base64.b64encode(hashlib.sha256(style[1].encode()).digest()).decode()
    assert policy == f"default-src 'none'; base-uri 'none'; form-action 'none'; style-src 'sha256-{digest}'"
    assert "url(" not in style[1].replace("url(#", "")
    assert "@import" not in style[1]


def test_the_page_says_everything_that_is_known_about_a_row() -> None:
    row = reports.made_up(
        "p.onnx",
        Outcome.UNKNOWN,
        assumptions=("an assumption",),
        notes=("a note",),
        evidence=Evidence("witness", "evidence/a b.json", reports.sha("w"), 2100, "proved (real)"),
        options={"splits": 64},
    )
    report = reports.report_of(row)
    found = page(report)
    for said in (
        *("altitude", "stay", "-0.25", "1.25 s", "an assumption", "a note", "try more splits: --splits 64"),
        *("proved until", "0.5 s", "25 %", "network", row.key, row.policy.sha256, row.specification.sha256),
        *("evidence/a b.json", reports.sha("w"), "proved (real)", "splits = 64", "reachability 1.50 s", "(≥ -12.5)"),
        *("UNKNOWN is not allowed", report.manifest.sha256, "onnxruntime 1.26.0", "12.50 s"),
    ):
        assert said in found.text, said
    assert "./evidence/a%20b.json" in [attributes.get("href") for _, attributes in found.elements]


def test_rows_that_do_not_pass_are_open_and_the_others_closed() -> None:
    report = reports.every_outcome()
    states = ["open" in attributes for name, attributes in page(report).elements if name == "details"]
    assert states == [not row.passed for row in report.rows]


def test_changes_against_the_baseline_are_listed_and_what_got_worse_comes_first() -> None:
    text = page(reports.every_outcome()).text
    rows = text[text.index("worse by more") : text.index("Only in the baseline")]
    assert 0 < rows.index("worse.onnx") < rows.index("better.onnx")
    for said in ("What changed", "gone.onnx x hover.yaml", "Only in the baseline", "▼ V(s0) fell by 3"):
        assert said in text


def test_a_curve_tells_what_is_not_verified_by_its_shape() -> None:
    outcomes = [Outcome.VERIFIED, Outcome.VERIFIED, Outcome.UNKNOWN, Outcome.FALSIFIED]
    rows = [
        replace(reports.made_up("p.onnx", outcome), epsilon=radius, name=f"p @ {radius}", requirements=())
        for outcome, radius in zip(outcomes, ("0", "0.1", "0.2", "0.3"), strict=True)
    ]
    found = page(reports.report_of(*rows))
    classes = [attributes.get("class") for _, attributes in found.elements]
    assert [classes.count(name) for name in ("curve", "curve unproved")] == [1, 2]
    assert [classes.count(f"mark-{name}") for name in ("verified", "unknown", "falsified")] == [2, 1, 1]
    assert "2 of 4 radii VERIFIED" in found.text


def test_a_search_shows_every_radius_that_was_tried() -> None:
    tried = (("0", "CLAIMED"), ("0.1", "VERIFIED"), ("0.2", "UNKNOWN"), ("0.4", "FALSIFIED"))
    row = reports.made_up("p.onnx", Outcome.VERIFIED, search=True, radius=RadiusFound("0.1", "0.4", "0.05", tried))
    found = page(reports.report_of(replace(row, requirements=())))
    classes = [attributes.get("class") for _, attributes in found.elements]
    assert [classes.count(f"mark-{name}") for name in ("verified", "claimed", "unknown", "falsified")] == [1, 1, 1, 1]
    assert "VERIFIED up to 0.1, FALSIFIED at 0.4 (resolution 0.05)" in found.text


def test_every_picture_has_a_name_and_a_description() -> None:
    text = html.render(reports.every_outcome())
    for drawing in re.findall(r"<svg[^>]*role=\"img\"[^>]*>.{0,200}", text):
        assert re.search(r"aria-label=\"[^\"]+\"", drawing) and "<title>" in drawing and "<desc>" in text


def test_a_margin_that_falls_out_of_sight_is_cut_and_said() -> None:
    entry = RequirementRow("a", "avoid", False, -1e6, 0.2, 3, (1.0, 0.5, -1e6))
    found = page(reports.report_of(reports.made_up("p.onnx", Outcome.UNKNOWN, requirements=(entry,))))
    assert "↓ -1e+06" in found.text


@pytest.mark.parametrize("curve", [(), (None, None), (None, 0.5), (0.0, 0.0), (-1.0, -1.0), (1e-300, 1e300)])
def test_every_curve_can_be_drawn(curve: tuple[float | None, ...]) -> None:
    entry = RequirementRow("a", "avoid", True, 0.0, 0.2, 3, curve)
    page(reports.report_of(reports.made_up("p.onnx", Outcome.VERIFIED, requirements=(entry,))))


def test_a_large_batch_has_pictures_of_the_first_rows_and_of_those_that_do_not_pass() -> None:
    drawn = reports.hostile_picture("p")
    report = replace(reports.many(200), rows=tuple(replace(row, picture=drawn) for row in reports.many(200).rows))
    found = page(report)
    pictures = sum("Reachable states" in (a.get("aria-label") or "") for name, a in found.elements if name == "svg")
    assert pictures == 100 + sum(not row.passed for row in report.rows[100:])
    assert "Pictures of the first 100 rows" in found.text


def test_a_thousand_rows_stay_a_page_that_opens() -> None:
    assert len(html.render(reports.many(1000)).encode()) < 12_000_000


@pytest.mark.parametrize("child", ["<b>", ["<b>"], ("<b>", None)])
def test_a_string_is_quoted_wherever_it_stands_in_an_element(child: object) -> None:
    assert tag("p", child) == "<p>&lt;b&gt;</p>"
    assert tag("p", title="\"<b>'") == '<p title="&quot;&lt;b&gt;&#x27;"></p>'
    assert join([Markup("<b>"), "<b>"]) == "<b>&lt;b&gt;"
