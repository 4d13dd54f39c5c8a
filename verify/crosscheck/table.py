"""The table of a cross-check: query, our claim, their answer, time; and what the answers mean together."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import dataclass
from enum import StrEnum


class Agreement(StrEnum):
    """What a tool's answer means for our claim."""

    CONFIRMED = "confirmed"
    """`unsat`: the tool proved it too."""
    UNDECIDED = "undecided"
    """`unknown`, `timeout`, a tool that failed, or a `sat` without an input that decides it."""
    MISTAKEN = "mistaken"
    """`sat`, but the network does not do it at the tool's input."""
    CONTRADICTED = "contradicted"
    """`sat`, and the network does it: one of us is wrong about the same numbers."""
    NOT_ASKED = "not asked"
    """The tool cannot read the query."""


@dataclass(frozen=True)
class Entry:
    """One query, one tool.

    Attributes
    ----------
    query : str
    tool : str
    answer : str
        The tool's word, "" where it was not asked.
    agreement : Agreement
    seconds : float
    detail : str
        Why it was not asked, how it failed, what its counterexample is worth.
    """

    query: str
    tool: str
    answer: str
    agreement: Agreement
    seconds: float
    detail: str = ""


def exit_code(entries: Sequence[Entry]) -> int:
    """6 where a claim is contradicted; 0 where every query that was asked is confirmed, and one was; else 5."""
    found = {entry.agreement for entry in entries}
    if Agreement.CONTRADICTED in found:
        return 6
    return 0 if found and found <= {Agreement.CONFIRMED, Agreement.NOT_ASKED} and Agreement.CONFIRMED in found else 5


def summary(entries: Sequence[Entry]) -> list[str]:
    """Per tool one line: how many queries it confirmed, and everything else by name."""
    lines = []
    for tool in dict.fromkeys(entry.tool for entry in entries):
        own = [entry for entry in entries if entry.tool == tool]
        counts = {kind: sum(1 for entry in own if entry.agreement is kind) for kind in Agreement}
        seconds = sum(entry.seconds for entry in own)
        words = ", ".join(f"{count} {kind.value}" for kind, count in counts.items() if count)
        lines.append(f"{tool}: {words} of {len(own)} queries, {seconds:.1f} s")
    return lines


def table_csv(entries: Sequence[Entry], versions: dict[str, str]) -> str:
    """All entries, with the versions of the tools."""
    text = io.StringIO()
    writer = csv.writer(text, lineterminator="\n")
    writer.writerow(["query", "claim", "tool", "version", "answer", "agreement", "seconds", "detail"])
    for entry in entries:
        version = versions.get(entry.tool, "")
        row = [entry.query, "unsat", entry.tool, version, entry.answer, entry.agreement.value]
        writer.writerow([*row, f"{entry.seconds:.3f}", entry.detail])
    return text.getvalue()
