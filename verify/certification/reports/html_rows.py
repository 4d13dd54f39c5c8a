"""One row of the batch in index.html: its summary, and all that is known about it."""

from __future__ import annotations

import hashlib
from typing import Any
from urllib.parse import quote

from ...wording import number, quantity
from ..document import Evidence, Outcome, RadiusFound, RequirementRow, Row, Subject, Why
from . import phrases
from .markup import Markup, join, tag
from .svg_curves import draw_margins, draw_search
from .svg_flowpipe import draw
from .text import visible

_SIGNS = {
    Outcome.VERIFIED: "✓",
    Outcome.UNKNOWN: "?",
    Outcome.FALSIFIED: "✗",
    Outcome.ERROR: "!",
    Outcome.INTERNAL: "!!",
}


def anchor(row: Row) -> str:
    """Where a row is in the page; the same in every run, for its name is."""
    return f"row-{hashlib.sha256(row.name.encode('utf-8', 'surrogatepass')).hexdigest()[:16]}"


def badge(outcome: Outcome) -> Markup:
    """The outcome as a word with a sign."""
    sign = tag("span", _SIGNS[outcome], aria_hidden="true")
    return tag("span", sign, outcome.value, class_=f"badge {outcome.value.lower()}")


def prose(text: str) -> Markup:
    """A sentence in which what stands in backticks is set as code."""
    parts = visible(text).split("`")
    if len(parts) % 2 == 0:  # one backtick has no partner
        return join([text])
    return join(tag("code", part) if position % 2 else part for position, part in enumerate(parts))


def row_details(row: Row, pictured: bool, opened: bool) -> Markup:
    """A row that opens and closes.

    Parameters
    ----------
    row : Row
    pictured : bool
        Whether its drawings are part of it.
    opened : bool
    """
    title = [tag("bdi", row.policy.name or "?"), " × ", tag("bdi", row.specification.name)]
    radius = "radius searched" if row.search else f"radius {phrases.radius_text(row)}"
    facts = [radius]
    if row.requirements:
        facts.append(f"margin {phrases.margin_text(row.margin)}")
    if row.value is not None:
        facts.append(f"V(s0) {phrases.value_of(row)}")
    summary = tag(
        "summary",
        badge(row.outcome),
        tag("span", title, class_="title"),
        tag("span", ", ".join(facts), class_="soft"),
        None if row.passed else tag("span", "does not pass", class_="gate-no"),
    )
    inside = [
        _found(row),
        _objections(row),
        _why(row.why),
        _figures(row) if pictured else None,
        _requirements(row),
        _list("What this rests on", row.assumptions),
        _list("Notes", row.notes),
        _facts(row),
    ]
    return tag("details", summary, tag("div", inside, class_="inside", id=anchor(row)), class_="row", open=opened)


def _found(row: Row) -> Markup:
    verified = row.outcome is Outcome.VERIFIED
    class_ = "claim" if verified else f"reason {row.outcome.value.lower()}"
    return tag("p", tag("strong", row.outcome.value), ": ", prose(phrases.finding(row)), class_=class_)


def _objections(row: Row) -> Markup | None:
    if row.passed:
        expected = " or ".join(row.expected)
        as_expected = row.outcome is not Outcome.VERIFIED
        said = f"It passes: the manifest expects {expected}." if expected else "It passes: UNKNOWN is allowed here."
        return tag("p", said) if as_expected else None
    return join([tag("h3", "Why it does not pass"), tag("ul", [tag("li", prose(text)) for text in row.objections])])


def _why(why: Why | None) -> Markup | None:
    if why is None:
        return None
    facts = [
        ("requirement", why.requirement),
        ("at", phrases.when(why.time)),
        ("growth", why.source if why.kind == "proof" else ""),
        ("proved until", phrases.when(why.verified_until) if why.verified_until > 0.0 else ""),
        ("proved part", f"{min(100.0 * why.verified_part, 99.99):.4g} %" if why.verified_part > 0.0 else ""),
        ("try", why.remedy),
    ]
    entries = [join([tag("dt", name), tag("dd", prose(text))]) for name, text in facts if text]
    return tag("dl", entries) if entries else None


def _figures(row: Row) -> Markup | None:
    """Everything that is drawn of a row."""
    name = row.name
    figures = []
    if row.picture is not None:
        title = f"Reachable states of {name}"
        figures.append(_figure(draw(row.picture, title), _picture_caption(row.picture)))
    if row.radius is not None and (drawn := draw_search(row.radius, f"Radii that were tried for {name}")) is not None:
        figures.append(_figure(drawn, _search_caption(row.radius)))
    for entry in row.requirements:
        curve = draw_margins(entry, row.period, f"Margin of {entry.name} over time, {name}")
        if curve is not None:
            engine = "Margin of every control period, by the engine; above zero is proof."
            figures.append(_figure(curve, [tag("strong", tag("bdi", entry.name)), f". {engine}"]))
    if len(figures) > 2:  # the large one beside the others
        figures = [figures[0], tag("div", figures[1:], class_="stack")]
    return tag("div", figures, class_="charts") if figures else None


def _figure(drawn: Markup, caption: object) -> Markup:
    return tag("figure", tag("div", drawn, class_="view"), tag("figcaption", caption))


def _picture_caption(picture: dict[str, Any]) -> str:
    said = [f"Blue: boxes around all reachable states, {quantity(picture['cells'], 'cell')}."]
    regions = picture["regions"] if picture["kind"] == "plane" else [b for p in picture["panels"] for b in p["bands"]]
    kinds = {region["kind"] for region in regions}
    said += ["Hatched: forbidden."] if kinds & {"avoid", "stay"} else []
    said += ["Dotted: goal."] if "reach" in kinds else []
    said.append("Framed: initial set.")
    if picture["witness"] is not None:
        said.append("Red: the trajectory of the witness, its violation marked.")
    if picture["truncated_at"] is not None:
        at = number(picture["truncated_at"])
        said.append(f"From {at} s on some boxes have no finite bounds and are not drawn.")
    return " ".join(said)


def _search_caption(found: RadiusFound) -> str:
    """What the marks of a search are; the bar is certified, for a smaller radius perturbs less."""
    shapes = {
        "VERIFIED": "Filled: VERIFIED.",
        "CLAIMED": "Small: proved by the engine, and certified where a larger radius is.",
        "UNKNOWN": "Hollow: UNKNOWN.",
        "FALSIFIED": "Cross: FALSIFIED.",
    }
    verdicts = {verdict for _, verdict in found.tried}
    return " ".join(["Radii that were tried.", *(said for verdict, said in shapes.items() if verdict in verdicts)])


def _requirements(row: Row) -> Markup | None:
    if not row.requirements:
        return None
    names = ("requirement", "kind", "margin", "smallest at", "outcome", "line")
    head = [tag("th", name, scope="col", class_="num" if name == "margin" else None) for name in names]
    lines = [_requirement(entry, row) for entry in row.requirements]
    table = tag("table", tag("thead", tag("tr", head)), tag("tbody", lines))
    scroll = tag("div", table, class_="scroll", tabindex="0", role="region", aria_label=f"Requirements of {row.name}")
    return join([tag("h3", "Requirements"), scroll])


def _requirement(entry: RequirementRow, row: Row) -> Markup:
    proved = "proved" if row.outcome is Outcome.VERIFIED else "proved by the engine, without a certificate"
    violated = row.outcome is Outcome.FALSIFIED and row.why is not None and row.why.requirement == entry.name
    outcome = proved if entry.proved else "violated" if violated else "not proved"
    return tag(
        "tr",
        tag("td", tag("bdi", entry.name), class_="name"),
        tag("td", entry.kind),
        tag("td", phrases.margin_text(entry.margin), class_="num"),
        tag("td", phrases.when(entry.time) if entry.margin is not None else ""),
        tag("td", outcome),
        tag("td", str(entry.line) if entry.line else ""),
    )


def _list(title: str, sentences: tuple[str, ...]) -> Markup | None:
    if not sentences:
        return None
    return join([tag("h3", title), tag("ul", [tag("li", prose(sentence)) for sentence in sentences])])


def _facts(row: Row) -> Markup:
    timings = ", ".join(f"{phase} {phrases.seconds_text(seconds)}" for phase, seconds in row.timings.items())
    options = ", ".join(f"{name} = {value}" for name, value in row.options.items())
    cover = f"{quantity(row.leaves, 'cell')} ({quantity(row.cells, 'cell')} enclosed)" if row.cells else ""
    run = f"{number(row.horizon)} s in periods of {number(row.period)} s" if row.period else ""
    value = row.value
    undiscounted = ""
    if value is not None:
        undiscounted = f"{phrases.value_of(row)} with discount {number(value.discount)}"
        if value.undiscounted is not None:
            undiscounted += f", ≥ {phrases.bound_text(value.undiscounted)} undiscounted"
        if row.outcome is not Outcome.VERIFIED:
            undiscounted += "; the engine's bounds, without a certificate"
    facts: list[tuple[str, object]] = [
        ("V(s0)", undiscounted),
        ("certified radius", phrases.found_text(row)),
        ("arithmetic", ", ".join(row.semantics)),
        ("known", row.source.value),
        ("cover", cover),
        ("run", run),
        ("options", options),
        (row.evidence.kind if row.evidence else "", _evidence(row.evidence)),
        ("policy", _subject(row.policy)),
        ("specification", _subject(row.specification)),
        ("plant", _subject(row.plant)),
        ("key", tag("span", row.key, class_="digest") if row.key else ""),
        ("time", timings),
    ]
    entries = [join([tag("dt", name), tag("dd", text)]) for name, text in facts if text]
    return join([tag("h3", "Facts"), tag("dl", entries)])


def _subject(subject: Subject) -> Markup | None:
    if not subject.name and not subject.sha256:
        return None
    digest = tag("span", f"sha256 {subject.sha256}", class_="digest") if subject.sha256 else None
    return join([tag("code", subject.name), " " if subject.name else None, digest])


def _evidence(evidence: Evidence | None) -> Markup | None:
    if evidence is None:
        return None
    target = "./" + quote(visible(evidence.path).lstrip("/"), safe="/")
    size = f"{-(-evidence.bytes // 1000)} kB"
    said = f", {size}" + (f", {evidence.detail}" if evidence.detail else "") + " "
    digest = tag("span", f"sha256 {evidence.sha256}", class_="digest")
    return join([tag("a", tag("code", evidence.path), href=target), said, digest])
