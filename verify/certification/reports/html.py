"""index.html: one page that needs nothing but itself, for people who review a batch.

No script, no request, no font from elsewhere; rows open and close by themselves (``details``). What a colour says is
also said by a word, a shape or a hatching.
"""

from __future__ import annotations

from collections.abc import Sequence

from ...wording import quantity
from ..document import Baseline, Outcome, Report, Row
from . import phrases
from .html_rows import anchor, badge, row_details
from .html_style import POLICY, STYLE
from .markup import Markup, join, tag
from .svg_curves import draw_values, exact

PICTURED = 100
"""Rows with a picture; beyond that only those that do not pass have one."""
OPENED = 12
"""Rows that do not pass and are open when the page is."""


def render(report: Report) -> str:
    """The report as an HTML page.

    Parameters
    ----------
    report : Report
    """
    curves = _curves(report)
    sections = [
        _changes(report),
        _table(report),
        _value_section(curves),
        _details(report),
        _reading(),
    ]
    page = tag(
        "html",
        tag(
            "head",
            tag("meta", charset="utf-8"),
            tag("meta", http_equiv="Content-Security-Policy", content=POLICY),
            tag("meta", name="viewport", content="width=device-width,initial-scale=1"),
            tag("meta", name="referrer", content="no-referrer"),
            tag("title", f"Certification: {phrases.headline(report)}"),
            tag("style", Markup(STYLE)),
        ),
        tag("body", _patterns(), _header(report, bool(curves)), tag("main", sections), _footer(report)),
        lang="en",
    )
    return f"<!doctype html>\n{page}\n"


def _header(report: Report, curves: bool) -> Markup:
    failed = len(report.failed)
    title = (
        "Every row passes" if not failed else f"{quantity(failed, 'row')} {'does' if failed == 1 else 'do'} not pass"
    )
    links = [("changes", "What changed")] if report.baseline is not None else []
    links += [("rows", "All rows")]
    links += [("values", "V(s0) over the radius")] if curves else []
    links += [("details", "Row by row"), ("reading", "How to read this")]
    counts = [tag("li", badge(Outcome(outcome)), f" {count}") for outcome, count in report.counts.items()]
    return tag(
        "header",
        tag("p", "Certification of neural network policies", class_="eyebrow"),
        tag("h1", title if report.rows else "No rows"),
        tag("p", f"{phrases.headline(report)}.", class_="lead"),
        _shares(report),
        tag("ul", counts, class_="legend"),
        tag("nav", [tag("a", text, href=f"#{name}") for name, text in links], aria_label="Sections"),
    )


def _shares(report: Report) -> Markup:
    """A bar of the outcomes, which the words below it repeat."""
    total, at, parts = max(len(report.rows), 1), 0.0, []
    for outcome, count in report.counts.items():
        width = 100.0 * count / total
        class_ = f"share-{outcome.lower()}"
        parts.append(
            tag("rect", x=f"{at:.3f}", y="0", width=f"{max(width - 0.25, 0.1):.3f}", height="4", class_=class_)
        )
        at += width
    said = ", ".join(f"{count} {outcome}" for outcome, count in report.counts.items())
    bar = tag(
        "svg",
        tag("title", "Rows by verdict"),
        tag("desc", said),
        parts,
        role="img",
        aria_label=f"Rows by verdict: {said}",
        viewBox="0 0 100 4",
        preserveAspectRatio="none",
    )
    return tag("div", bar, class_="counts")


def _changes(report: Report) -> Markup | None:
    base = report.baseline
    if base is None:
        return None
    changed = [(row, change) for row in report.rows if (change := row.change) and phrases.differences(change)]
    lines = []
    for row, change in sorted(changed, key=lambda pair: not pair[1].regressions):
        for position, (name, before, after) in enumerate(phrases.differences(change)):
            first = [tag("a", tag("bdi", row.name), href=f"#{anchor(row)}")] if position == 0 else []
            note = "; ".join(change.regressions) if position == 0 else ""
            worse = tag("td", f"▼ {note}", class_="worse") if note else tag("td")
            lines.append(
                tag("tr", tag("td", first, class_="name"), [tag("td", t) for t in (name, before, after)], worse)
            )
    table = _scrolled(["row", "what", "before", "now", "worse by more than the tolerance"], lines, "Changes")
    return tag(
        "section",
        tag("h2", "What changed"),
        tag("p", "Compared with ", tag("code", base.name), f", tolerance {base.tolerance}. ", _digest(base)),
        table if lines else tag("p", "No row that both have differs."),
        _names("Only in the baseline", base.missing),
        _names("Only here", base.added),
        id="changes",
    )


def _digest(base: Baseline) -> Markup | None:
    return tag("span", f"sha256 {base.sha256}", class_="digest") if base.sha256 else None


def _names(title: str, names: Sequence[str]) -> Markup | None:
    if not names:
        return None
    return join([tag("h3", title), tag("ul", [tag("li", tag("bdi", name)) for name in names])])


def _scrolled(head: Sequence[str], lines: Sequence[Markup], title: str, numbers: Sequence[int] = ()) -> Markup:
    """A table that scrolls inside itself where the window is narrow."""
    cells = [tag("th", name, scope="col", class_="num" if k in numbers else None) for k, name in enumerate(head)]
    table = tag("table", tag("thead", tag("tr", cells)), tag("tbody", lines))
    return tag("div", table, class_="scroll", tabindex="0", role="region", aria_label=title)


def _table(report: Report) -> Markup:
    head = ["verdict", "policy × specification", "radius", "gate", "margin", "V(s0)", "known", "time"]
    lines = [_line(row) for row in report.rows]
    return tag(
        "section",
        tag("h2", "All rows"),
        _scrolled(head, lines, "All rows", (4, 5, 7)),
        id="rows",
    )


def _line(row: Row) -> Markup:
    name = tag(
        "a", tag("bdi", row.policy.name or "?"), " × ", tag("bdi", row.specification.name), href=f"#{anchor(row)}"
    )
    gate = "passes" if row.passed else tag("span", "does not pass", class_="gate-no")
    margin = phrases.margin_text(row.margin) if row.requirements else ""
    total = row.timings.get("total")
    return tag(
        "tr",
        tag("td", badge(row.outcome)),
        tag("td", name, class_="name"),
        tag("td", phrases.found_text(row) or phrases.radius_text(row)),
        tag("td", gate),
        tag("td", margin, class_="num"),
        tag("td", phrases.value_of(row), class_="num"),
        tag("td", row.source.value),
        tag("td", phrases.seconds_text(total), class_="num"),
    )


Curves = list[tuple[str, list[tuple[float, Row]]]]


def _curves(report: Report) -> Curves:
    """Rows of one policy and one specification at two radii or more that have V(s0), by radius."""
    groups: dict[tuple[str, str], dict[float, Row]] = {}
    for row in report.rows:
        radius = None if row.epsilon is None or row.search else exact(row.epsilon)
        if radius is not None and row.value is not None:
            groups.setdefault((row.policy.name, row.specification.name), {})[float(radius)] = row
    return [
        (f"{policy} × {specification}", sorted(rows.items()))
        for (policy, specification), rows in groups.items()
        if len(rows) > 1 and any(row.value and row.value.discounted is not None for row in rows.values())
    ]


def _value_section(curves: Curves) -> Markup | None:
    if not curves:
        return None
    figures = []
    for name, rows in curves[:PICTURED]:
        proved = sum(row.outcome is Outcome.VERIFIED for _, row in rows)
        caption = f"{proved} of {len(rows)} radii VERIFIED."
        if proved < len(rows):
            caption += " Hollow marks and dashes: a bound of the engine without a certificate; a cross: FALSIFIED."
        drawn = tag("div", draw_values(rows, f"V(s0) of {name}"), class_="view")
        figures.append(tag("figure", drawn, tag("figcaption", tag("strong", tag("bdi", name)), f": {caption}")))
    more = len(curves) - len(figures)
    return tag(
        "section",
        tag("h2", "V(s0) over the radius"),
        tag(
            "p",
            "Verified performance V(s0) is a lower bound of the discounted return, whatever the initial state and the "
            "perturbations within the radius.",
        ),
        tag("div", figures, class_="charts"),
        tag("p", f"{more} more are not drawn; their numbers are in certification.json.") if more else None,
        id="values",
    )


def _details(report: Report) -> Markup:
    many = len(report.rows) > PICTURED
    blocks, opened = [], 0
    for number, row in enumerate(report.rows):
        open_ = not row.passed and opened < OPENED
        opened += open_
        blocks.append(row_details(row, pictured=number < PICTURED or not row.passed, opened=open_))
    said = f"Pictures of the first {PICTURED} rows and of those that do not pass; the others are in certification.json."
    return tag(
        "section",
        tag("h2", "Row by row"),
        tag("p", said) if many else None,
        blocks,
        id="details",
    )


_TERMS = (
    (
        "VERIFIED",
        "A certificate says what was proved, and a checker that shares no code with the engine proved it again.",
    ),
    ("FALSIFIED", "A witness is proved to violate a requirement, in exact arithmetic."),
    ("UNKNOWN", "Neither; the reason says what could not be proved and what to try. It is not a violation."),
    ("ERROR, INTERNAL", "The row's files cannot be used; setrl itself failed. Nothing is said about the policy."),
    ("gate", "Whether the row is what the manifest asks for: expected verdict, least V(s0), no loss to the baseline."),
    ("margin", "Smallest signed distance of all reachable sets to a violation, rounded down; above zero is proof."),
    (
        "V(s0)",
        "Verified performance: a lower bound of the discounted return of every trajectory, rounded down; in "
        "parentheses the engine's bound, where no certificate backs it.",
    ),
    (
        "known",
        "proved: decided in this run. journal: decided before, and nothing that it depends on has changed. rechecked: "
        "the same, and its certificate or witness was proved again in this run.",
    ),
)


def _reading() -> Markup:
    entries = [join([tag("dt", term), tag("dd", sentence)]) for term, sentence in _TERMS]
    return tag("section", tag("h2", "How to read this"), tag("dl", entries), id="reading")


def _footer(report: Report) -> Markup:
    versions = ", ".join(f"{name} {version}" for name, version in report.versions.items())
    name = report.manifest.name
    return tag(
        "footer",
        tag("p", "Manifest ", tag("code", name), ". ", f"This run took {phrases.seconds_text(report.seconds)}."),
        tag("p", f"sha256 {report.manifest.sha256}", class_="digest") if report.manifest.sha256 else None,
        tag("p", versions) if versions else None,
    )


def _patterns() -> Markup:
    """Hatchings, once for all drawings of the page."""

    def hatching(name: str, size: str, *content: Markup) -> Markup:
        return tag("pattern", *content, id=name, width=size, height=size, patternUnits="userSpaceOnUse")

    rising = tag("path", d="M-2 2l4 -4M0 8l8 -8M6 10l4 -4", class_="hatch")
    falling = tag("path", d="M-2 6l4 4M0 0l8 8M6 -2l4 4", class_="hatch")
    dot = tag("circle", cx="3", cy="3", r="0.9", class_="dots")
    content = [
        hatching("hatch-avoid", "8", rising),
        hatching("hatch-outside", "8", falling),
        hatching("dots-goal", "6", dot),
    ]
    return tag("svg", tag("defs", content), class_="defs", aria_hidden="true")
