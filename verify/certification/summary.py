"""A report in a few lines of text."""

from __future__ import annotations

from .document import Report
from .progress import one_line, row_line


def summary_lines(report: Report) -> list[str]:
    """Every row that does not pass with its objections, then one line about all."""
    lines = []
    for row in report.failed:
        lines.append(f"FAILED: {row_line(row)}")
        lines += [f"  {one_line(objection)}" for objection in row.objections]
    if report.baseline is not None and report.baseline.missing:
        lines.append(f"no longer there: {', '.join(one_line(name) for name in report.baseline.missing)}")
    counts = ", ".join(f"{count} {name}" for name, count in report.counts.items())
    passed = len(report.rows) - len(report.failed)
    lines.append(f"{passed} of {len(report.rows)} rows pass: {counts}")
    return lines
