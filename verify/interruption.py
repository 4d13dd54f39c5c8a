"""While a search or a check runs: a terminal shows how far it is, and Ctrl-C leaves what was found to be reported."""

from __future__ import annotations

import signal
import sys
import threading
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Watcher:
    """What a progress bar is told: the state of a search, then the checker's way through the leaves.

    Attributes
    ----------
    bar, task
        Of rich.
    """

    bar: Any
    task: Any

    def __call__(self, found: Exploration) -> None:
        """Show the decided share of the initial set."""
        from .report import search_progress

        share, text = search_progress(found)
        self.bar.update(self.task, completed=share, description=text)

    def checking(self, checked: int, leaves: int) -> None:
        """Show how many leaves of a certificate are checked."""
        self.bar.update(self.task, completed=checked / leaves, description=f"checking {checked}/{leaves} leaves")


@contextmanager
def progress_bar(wanted: bool) -> Iterator[Watcher | None]:
    """What draws progress on stderr; None where nobody watches."""
    with _bar(wanted, "first cells") as found:
        yield None if found is None else Watcher(*found)


@contextmanager
def share_bar(wanted: bool) -> Iterator[Callable[[int, int, str], None] | None]:
    """What draws progress in parts on stderr, told how many are done, how many there are, and what comes next."""
    with _bar(wanted, "") as found:
        if found is None:
            yield None
            return
        bar, task = found

        def show(done: int, parts: int, words: str) -> None:
            bar.update(task, completed=done / max(parts, 1), description=words)

        yield show


@contextmanager
def _bar(wanted: bool, text: str) -> Iterator[tuple[Any, Any] | None]:
    """A bar of rich and its task, from 0 to 1; None where stderr is no terminal."""
    if not (wanted and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TextColumn("{task.percentage:>5.1f} %"), TextColumn("{task.description}"))
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
        yield bar, bar.add_task(text, total=1.0)
