"""What a person sees of a batch: a live table on a terminal, one plain line per row anywhere else."""

from __future__ import annotations

import math
import sys
import time
from collections import Counter
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from typing import Any

from ..report import margin_text
from ..wording import at_least
from .batch import Watch
from .document import Outcome, Row, Source
from .plan import Planned

MOST_SHOWN = 12
"""Rows that a live table shows at once."""
PAUSE = 0.1
"""Seconds between two drawings of a live table at least."""

_COLORS = {
    Outcome.VERIFIED: "green",
    Outcome.UNKNOWN: "yellow",
    Outcome.FALSIFIED: "red",
    Outcome.ERROR: "magenta",
    Outcome.INTERNAL: "magenta",
}


def row_line(row: Row) -> str:
    """``VERIFIED   policy x specification @ 0.1  margin +0.08  V(s0) >= -12.1  1.2 s``."""
    parts = [f"{row.outcome.value:<9}", one_line(row.name)]
    if row.radius is not None:
        parts.append(
            f"certified radius {row.radius.verified or 'none'}, falsified from {row.radius.falsified or 'none'}"
        )
    if row.margin is not None:
        parts.append(f"margin {margin_text(row.margin)}")
    if row.outcome is Outcome.VERIFIED and row.value is not None and row.value.discounted is not None:
        parts.append(f"V(s0) >= {at_least(row.value.discounted, 4)}")
    parts.append(how_known(row))
    if row.why is not None and row.outcome is not Outcome.VERIFIED:
        parts.append(one_line(row.why.sentence))
    return "  ".join(parts)


def how_known(row: Row) -> str:
    """Seconds, or where the verdict comes from."""
    if row.source is Source.JOURNAL:
        return "unchanged"
    if row.source is Source.RECHECKED:
        return "unchanged, checked again"
    return f"{row.timings.get('total', 0.0):.1f} s"


def one_line(text: str) -> str:
    """A text from a file as a terminal may show it."""
    joined = " ".join(text.split())
    return joined if joined.isprintable() else joined.encode("unicode_escape").decode("ascii")


@dataclass
class Lines(Watch):
    """One line per finished row, on stderr."""

    total: int = 0
    done: int = 0

    def begin(self, planned: Sequence[Planned], workers: int) -> None:
        """Say how many rows there are."""
        self.total = len(planned)
        some = f"{workers} worker{'' if workers == 1 else 's'}"
        print(f"{self.total} row{'' if self.total == 1 else 's'}, {some}", file=sys.stderr, flush=True)

    def finished(self, row: Row) -> None:
        """Write the row's line."""
        self.done += 1
        width = len(str(self.total))
        print(f"[{self.done:>{width}}/{self.total}] {row_line(row)}", file=sys.stderr, flush=True)


@dataclass
class Table(Watch):
    """A table that is drawn anew: how many rows are decided, what runs, what was decided last, how long it may take."""

    live: Any
    total: int = 0
    workers: int = 1
    started: float = field(default_factory=time.monotonic)
    rows: list[Row] = field(default_factory=list)
    counts: Counter[Outcome] = field(default_factory=Counter)
    now: Sequence[tuple[str, float]] = ()
    drawn: float = -math.inf

    def begin(self, planned: Sequence[Planned], workers: int) -> None:
        """All rows."""
        self.total, self.workers = len(planned), workers

    def finished(self, row: Row) -> None:
        """A row is decided: it stays above the table."""
        self.rows.append(row)
        self.counts[row.outcome] += 1
        self._draw()

    def running(self, names: Sequence[tuple[str, float]]) -> None:
        """What runs now."""
        self.now = names
        self._draw()

    def _draw(self) -> None:
        if time.monotonic() - self.drawn < PAUSE:  # thousands of unchanged rows come at once
            return
        self.drawn = time.monotonic()
        from rich.table import Table as RichTable
        from rich.text import Text

        title = Text(f"{len(self.rows)}/{self.total} rows")
        for outcome in Outcome:
            if self.counts[outcome]:
                title.append(f"  {self.counts[outcome]} {outcome.value}", style=_COLORS[outcome])
        left = remaining_seconds(self.rows, self.total, self.workers)
        if left is not None and len(self.rows) < self.total:
            title.append(f"  about {duration(left)} left")
        table = RichTable(title=title, title_justify="left", expand=True, box=None, pad_edge=False)
        for name, justify in (
            ("verdict", "left"),
            ("row", "left"),
            ("margin", "right"),
            ("V(s0)", "right"),
            ("", "right"),
        ):
            table.add_column(name, justify=justify, overflow="fold", no_wrap=name != "row")  # type: ignore[arg-type]
        for row in self.rows[-MOST_SHOWN:]:
            value = row.value.discounted if row.value is not None and row.outcome is Outcome.VERIFIED else None
            table.add_row(
                Text(row.outcome.value, style=_COLORS[row.outcome]),
                Text(one_line(row.name)),
                "" if row.margin is None else margin_text(row.margin),
                "" if value is None else at_least(value, 4),
                how_known(row),
            )
        for name, seconds in self.now:
            table.add_row(Text("running", style="dim"), Text(one_line(name), style="dim"), "", "", f"{seconds:.0f} s")
        self.live.update(table)


def remaining_seconds(rows: Sequence[Row], total: int, workers: int) -> float | None:
    """Guess of the time that is left: what the rows that were decided in this run took, for those that are not."""
    taken = [row.timings.get("total", 0.0) for row in rows if row.source is Source.DECIDED]
    if not taken:
        return None
    return sum(taken) / len(taken) * (total - len(rows)) / workers


def duration(seconds: float) -> str:
    """``40 s``, ``3 min``, ``1 h 10 min``."""
    if seconds < 90:
        return f"{seconds:.0f} s"
    minutes = round(seconds / 60)
    return f"{minutes} min" if minutes < 90 else f"{minutes // 60} h {minutes % 60} min"


@contextmanager
def watch_of(quiet: bool) -> Iterator[Watch]:
    """What watches a batch: nothing, a live table where stderr is a terminal, else lines."""
    if quiet:
        yield Watch()
        return
    if not sys.stderr.isatty():
        yield Lines()
        return
    from rich.console import Console
    from rich.live import Live

    with Live(console=Console(stderr=True), refresh_per_second=4, transient=True) as live:
        yield Table(live)
