"""results.csv: the table of the ARCH-COMP repeatability package, ``benchmark,instance,result,time`` and what follows.

The first four columns are the competition's; the others separate the time. Simulation is part of falsification here
and has a time of its own only where a run measured one.
"""

from __future__ import annotations

import csv
import io

from ..document import Report, Row
from . import phrases
from .text import visible

COLUMNS = (
    *("benchmark", "instance", "result", "time"),
    *("load", "simulation", "falsification", "reachability", "checking", "total"),
)
_PHASES = {
    "load": "load",
    "simulation": "simulation",
    "falsification": "falsification",
    "reachability": "reachability",
    "checking": "check",
    "total": "total",
}
_FORMULA = ("=", "+", "-", "@")


def render(report: Report) -> str:
    """The report as comma-separated values, a row each; times in seconds, empty where there is none.

    Parameters
    ----------
    report : Report
    """
    buffer = io.StringIO()
    writer = csv.writer(buffer, lineterminator="\n")
    writer.writerow(COLUMNS)
    for row in report.rows:
        phases = [_time(row.timings.get(phase)) for phase in _PHASES.values()]
        writer.writerow([*_names(row), row.outcome.value, phases[-1], *phases])
    return buffer.getvalue()


def _names(row: Row) -> tuple[str, str]:
    radius = "" if row.epsilon is None and not row.search else f" @ {phrases.radius_text(row)}"
    return _cell(row.specification.name), _cell(f"{row.policy.name}{radius}")


def _cell(text: str) -> str:
    """Text that no spreadsheet takes for a formula: an apostrophe in front of what would begin one."""
    shown = visible(text)
    return f"'{shown}" if shown.lstrip().startswith(_FORMULA) else shown


def _time(seconds: float | None) -> str:
    return "" if seconds is None else f"{seconds:.3f}"
