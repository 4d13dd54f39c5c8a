"""index.html as a browser shows it: alone, legible in both themes, and as narrow as a telephone."""

from __future__ import annotations

import shutil
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
import report_cases as reports

from setrl.verify.certification.document import Outcome, Report
from setrl.verify.certification.reports import html

sync_api = pytest.importorskip("playwright.sync_api", reason="playwright is part of the extra `dev`")

CHROMIUM = shutil.which("chromium") or shutil.which("chromium-browser") or shutil.which("google-chrome")
pytestmark = pytest.mark.skipif(CHROMIUM is None, reason="no Chromium on this machine: the page was not looked at")
SWITCHES = [
    *("--headless=new", "--no-sandbox", "--disable-gpu", "--disable-quic", "--no-first-run"),
    *("--disable-background-networking", "--disable-component-update", "--disable-sync"),
]

LOOK = """() => {
  const canvas = document.createElement('canvas').getContext('2d', {willReadFrequently: true});
  const rgb = color => {
    canvas.clearRect(0, 0, 1, 1); canvas.fillStyle = color; canvas.fillRect(0, 0, 1, 1);
    return [...canvas.getImageData(0, 0, 1, 1).data];
  };
  const light = ([r, g, b]) => {
    const [x, y, z] = [r, g, b].map(v => v / 255).map(v => v <= 0.04045 ? v / 12.92 : ((v + 0.055) / 1.055) ** 2.4);
    return 0.2126 * x + 0.7152 * y + 0.0722 * z;
  };
  const ground = element => {
    for (let e = element; e; e = e.parentElement) {
      const color = rgb(getComputedStyle(e).backgroundColor);
      if (color[3] === 255) return color;
    }
    return [255, 255, 255, 255];
  };
  const found = [], walker = document.createTreeWalker(document.body, NodeFilter.SHOW_TEXT);
  for (let node = walker.nextNode(); node; node = walker.nextNode()) {
    const element = node.parentElement;
    if (!node.data.trim() || element.closest('title, desc, style') || !element.checkVisibility()) continue;
    const style = getComputedStyle(element), svg = element.closest('svg');
    const color = rgb(svg ? style.fill : style.color);
    const [a, b] = [light(color), light(ground(svg ? svg.parentElement : element))].sort((x, y) => y - x);
    let size = parseFloat(style.fontSize);
    if (svg) size *= element.getScreenCTM().d > 0 ? element.getScreenCTM().d : Math.abs(element.getScreenCTM().b);
    found.push([node.data.trim().slice(0, 60), (a + 0.05) / (b + 0.05), size, color[3]]);
  }
  return found;
}"""
"""Every visible text with its contrast (WCAG 2.1), its size in pixels of the screen, and how opaque it is."""


@pytest.fixture(scope="module")
def browser() -> Iterator[Any]:
    with sync_api.sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=CHROMIUM, args=SWITCHES)
        yield browser
        browser.close()


@pytest.fixture(scope="module")
def report() -> Report:
    rows = (
        replace(reports.made_up("p.onnx", Outcome.VERIFIED), name="p @ 0.2", epsilon="0.2"),
        replace(reports.made_up("p.onnx", Outcome.UNKNOWN), name="p @ 0.4", epsilon="0.4"),
        reports.real_row("navigation-set", "navigation"),
        reports.real_row("quadrotor2d-set", "quadrotor2d"),
    )
    made_up = reports.every_outcome()
    return reports.report_of(*rows, *made_up.rows, baseline=made_up.baseline)


@pytest.fixture(scope="module")
def address(report: Report, tmp_path_factory: pytest.TempPathFactory) -> str:
    path = tmp_path_factory.mktemp("page") / "index.html"
    path.write_text(html.render(report), encoding="utf-8")
    return path.as_uri()


def opened(browser: Any, address: str, scheme: str, width: int) -> tuple[Any, list[str]]:
    """The page with all rows open, and everything that went wrong with it."""
    page = browser.new_context(color_scheme=scheme, viewport={"width": width, "height": 800}).new_page()
    complaints: list[str] = []
    page.on("request", lambda request: complaints.append(request.url) if request.url != address else None)
    page.on("console", lambda message: complaints.append(f"{message.type}: {message.text}"))
    page.on("pageerror", lambda error: complaints.append(str(error)))
    page.goto(address)
    page.evaluate("() => document.querySelectorAll('details').forEach(row => { row.open = true })")
    return page, complaints


@pytest.mark.parametrize("scheme", ["light", "dark"])
def test_every_text_can_be_read(browser: Any, address: str, scheme: str) -> None:
    page, complaints = opened(browser, address, scheme, 1200)
    found = page.evaluate(LOOK)
    assert len(found) > 300
    assert [entry for entry in found if entry[1] < 4.5 or entry[3] < 255] == []
    assert complaints == []


def test_a_telephone_shows_the_page_without_scrolling_sideways_and_in_letters_that_can_be_read(
    browser: Any, address: str
) -> None:
    page, complaints = opened(browser, address, "light", 360)
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 360
    assert [entry for entry in page.evaluate(LOOK) if entry[2] < 11.0] == []
    assert complaints == []


def test_the_themes_differ_and_neither_is_blank(browser: Any, address: str) -> None:
    shots = []
    for scheme in ("light", "dark"):
        page, _ = opened(browser, address, scheme, 900)
        shots.append(page.screenshot())
    assert shots[0] != shots[1]
    assert min(len(shot) for shot in shots) > 20_000


def test_a_link_to_a_row_opens_it(browser: Any, address: str) -> None:
    page, _ = opened(browser, address, "light", 1200)
    page.evaluate("() => document.querySelectorAll('details').forEach(row => { row.open = false })")
    page.click("#rows tbody tr:first-child a")
    page.wait_for_function("() => document.querySelector('details').open")


def test_no_text_runs_loads_or_widens_anything(browser: Any, tmp_path: Path) -> None:
    rows = [row for text in reports.HOSTILE for row in reports.hostile(text).rows]
    path = tmp_path / "index.html"
    path.write_text(html.render(reports.report_of(*rows, baseline=reports.hostile("x").baseline)), encoding="utf-8")
    page, complaints = opened(browser, path.as_uri(), "light", 360)
    assert complaints == []
    assert page.evaluate("() => document.documentElement.scrollWidth") <= 360
    assert page.evaluate("() => document.scripts.length + document.images.length") == 0


def test_a_style_or_script_that_got_in_would_be_refused(browser: Any, tmp_path: Path) -> None:
    broken = html.render(reports.every_outcome()).replace(
        "<body>", "<body style='x:y'><script>document.title=1</script>"
    )
    path = tmp_path / "broken.html"
    path.write_text(broken, encoding="utf-8")
    page, complaints = opened(browser, path.as_uri(), "light", 900)
    assert len([line for line in complaints if "Content Security Policy" in line]) >= 2
    assert page.title() != "1"
