"""While a search runs: Ctrl-C ends it so that what was found is still reported, and a terminal shows how far it is."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Any

from .deadline import Deadline

if TYPE_CHECKING:
    from .splitting import Exploration


@contextmanager
def interruptible(timeout: float | None) -> Iterator[Deadline]:
    """A deadline that the first SIGINT or SIGTERM ends; the second raises KeyboardInterrupt.

    Parameters
    ----------
    timeout : float or None
        Seconds.
    """
    deadline = Deadline.after(timeout)

    def interrupt(*_: Any) -> None:
        if deadline.interrupted:
            raise KeyboardInterrupt
        deadline.interrupted = True
        print("stopping with what was found so far; once more aborts", file=sys.stderr, flush=True)

    before: dict[int, Any] = {}
    if threading.current_thread() is threading.main_thread():  # Python delivers signals nowhere else
        before = {number: signal.signal(number, interrupt) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield deadline
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def progress_bar(wanted: bool) -> Iterator[Callable[[Exploration], None] | None]:
    """A callback that draws the decided share of the initial set on stderr; None where nobody watches."""
    if not (wanted and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    from .report import search_progress

    columns = (BarColumn(), TextColumn("{task.percentage:>5.1f} %"), TextColumn("{task.description}"))
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("first cells", total=1.0)

        def update(found: Exploration) -> None:
            share, text = search_progress(found)
            bar.update(task, completed=share, description=text)

        yield update
