"""summary.md: what ``$GITHUB_STEP_SUMMARY`` and merge requests show. GitHub drops a summary above 1024 KiB: this one
is cut before, says by how much, and keeps the rows that do not pass.

Text from files is written as character references: they show the character and are never markup, in a table neither.
"""

from __future__ import annotations

import re

from ..document import Outcome, Report, Row
from . import phrases
from .text import visible

LIMIT = 1_048_576
"""Bytes of UTF-8 that GitHub accepts."""
DETAILED = 50
"""Rows that are explained; the others are in the table."""
_NAME, _SENTENCE = 160, 600
_MARKUP = re.compile(r"[\\`*_{}\[\]<>&|~@#!$^]|:(?=/)|(?<=www)\.", re.IGNORECASE)
_SIGNS = {
    Outcome.VERIFIED: "✅",
    Outcome.UNKNOWN: "❔",
    Outcome.FALSIFIED: "❌",
    Outcome.ERROR: "⚠️",
    Outcome.INTERNAL: "💥",
}


def render(report: Report, limit: int = LIMIT) -> str:
    """The report as GitHub-flavoured Markdown.

    Parameters
    ----------
    report : Report
    limit : int
        Bytes that the text may take as UTF-8; it is cut between two rows, and says so.
    """
    rows = sorted(report.rows, key=lambda row: row.passed) if _long(report) else list(report.rows)
    room = limit - 400  # for the sentences that say what was cut
    head = _head(report)
    table = ["| row | radius | verdict | gate | margin | V(s0) |", "|---|---|---|---|---:|---:|"]
    text = "\n".join([*head, *table]) + "\n"
    size, kept = _size(text), 0
    lines: list[str] = []
    for row in rows:
        line = _line(row) + "\n"
        if size + _size(line) > room * 0.7:  # the rest is for the explanations
            break
        size, kept = size + _size(line), kept + 1
        lines.append(line)
    text += "".join(lines) + _rest(len(rows) - kept, "row")
    if any(row.value is not None and row.outcome is not Outcome.VERIFIED for row in rows[:kept]):
        text += "\nV(s0) in parentheses: the engine's bound, without a certificate.\n"
    size = _size(text)
    blocks = [_details(row) for row in rows if not row.passed or row.outcome is not Outcome.VERIFIED]
    shown: list[str] = []
    for block in blocks[:DETAILED]:
        if size + _size(block) > room:
            break
        size += _size(block)
        shown.append(block)
    if shown:
        text += "\n### What is not VERIFIED, or does not pass\n" + "".join(shown)
    text += _rest(len(blocks) - len(shown), "explanation")
    change = _baseline(report)
    return text + (change if size + _size(change) <= room else "\nThe baseline's differences are in index.html.\n")


def _size(text: str) -> int:
    return len(text.encode())


def _long(report: Report) -> bool:
    return len(report.rows) > DETAILED


def _rest(count: int, noun: str) -> str:
    if not count:
        return ""
    return f"\n{count} more {noun if count == 1 else noun + 's'}: see certification.json or index.html.\n"


def _head(report: Report) -> list[str]:
    state = "passes" if not report.failed and report.rows else "does not pass"
    verdict = max((row.outcome for row in report.rows), key=lambda outcome: outcome.rank, default=Outcome.INTERNAL)
    sign = "✅" if state == "passes" else _SIGNS[verdict] if verdict is not Outcome.VERIFIED else "❌"
    lines = [f"## {sign} Certification {state}", "", f"{literal(phrases.headline(report))}.", ""]
    name = report.manifest.name
    facts = [f"manifest {name_of(name)}"] if name else []
    facts += [f"{key} {literal(value, 60)}" for key, value in report.versions.items() if key == "setrl"]
    facts += [f"{phrases.seconds_text(report.seconds)}"]
    return [*lines, ", ".join(facts), ""]


def _line(row: Row) -> str:
    name = f"{name_of(row.policy.name)} × {name_of(row.specification.name)}"
    verdict = f"{_SIGNS[row.outcome]} {row.outcome.value}"
    gate = "passes" if row.passed else "**does not pass**"
    margin = phrases.margin_text(row.margin) if row.requirements else ""
    radius = phrases.found_text(row) or phrases.radius_text(row)
    cells = [name, literal(radius, _NAME), verdict, gate, margin, phrases.value_of(row)]
    return f"| {' | '.join(cells)} |"


def _details(row: Row) -> str:
    """What a row is about that is not VERIFIED or does not pass: why, and what to do."""
    summary = f"{_SIGNS[row.outcome]} {row.outcome.value}: {name_of(row.name)}"
    lines = [
        f"\n<details><summary>{summary}</summary>\n",
        # the verdict comes first because a line that begins with "-" or "1." would be a list
        f"**{row.outcome.value}**: {sentence(phrases.finding(row))}\n",
    ]
    facts: list[tuple[str, str]] = []
    if row.objections:
        facts.append(("gate", "; ".join(row.objections)))
    if row.why is not None:
        growth = row.why.source if row.why.kind == "proof" else ""
        facts += [("requirement", row.why.requirement), ("growth", growth), ("try", row.why.remedy)]
    if row.evidence is not None:
        facts.append((row.evidence.kind, f"{row.evidence.path}, {row.evidence.detail}"))
    lines += [f"- {label}: {sentence(fact)}" for label, fact in facts if fact]
    return "\n".join(lines) + "\n\n</details>\n"


def _baseline(report: Report) -> str:
    if report.baseline is None:
        return ""
    base = report.baseline
    lines = [f"\n### Compared with {name_of(base.name)}\n"]
    changed = [(row, row.change) for row in report.rows if row.change is not None and phrases.differences(row.change)]
    for row, change in changed[: 4 * DETAILED]:
        worse = "**worse**, " if change.regressions else ""
        said = "; ".join(f"{name} {before} → {after}" for name, before, after in phrases.differences(change))
        lines.append(f"- {name_of(row.name)}: {worse}{literal(said)}")
    for label, names in (("only in the baseline", base.missing), ("only here", base.added)):
        lines += [f"- {label}: {name_of(name)}" for name in names[: 2 * DETAILED]]
        if len(names) > 2 * DETAILED:
            lines.append(f"- {label}: {len(names) - 2 * DETAILED} more in certification.json")
    if len(changed) > 4 * DETAILED:
        lines.append(f"- {len(changed) - 4 * DETAILED} more rows differ: see index.html")
    if len(lines) == 1:
        lines.append("Nothing differs.")
    return "\n".join(lines) + "\n"


def literal(value: str, longest: int = _SENTENCE) -> str:
    """Text from a file within a line: every sign that Markdown could read is a character reference."""
    return _MARKUP.sub(lambda match: f"&#{ord(match[0])};", visible(value, longest))


def sentence(value: str) -> str:
    """The same, with what stands in backticks in the type of code."""
    parts = visible(value, _SENTENCE).split("`")
    if len(parts) % 2 == 0:  # one backtick has no partner
        return literal(value)
    return "".join(name_of(part) if position % 2 else literal(part) for position, part in enumerate(parts))


def name_of(value: str) -> str:
    """A name from a file, in the type of code."""
    return f"<code>{literal(value, _NAME)}</code>"
