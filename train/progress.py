"""How far a training run is: a bar on a terminal, a line every half minute elsewhere, nothing where nobody wants it."""

from __future__ import annotations

import math
import sys
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np

RECENT = 20
"""Episodes whose returns are shown as one number."""

BETWEEN_LINES = 30.0
"""Seconds between two lines where there is no terminal."""

_BETWEEN_UPDATES = 0.1
"""Seconds between two texts on a terminal."""


class TrainingProgress:
    """Follows a run and says where it is.

    Parameters
    ----------
    show : callable
        Takes the share that is done, in [0, 1], and a text.
    every : float
        Seconds between two calls of it.
    total : int
        Episodes, or steps of the second phase.
    completed : int
        How many of them are done already.
    noun : str
        "episode" or "step".
    clock : callable
        Seconds.
    """

    def __init__(
        self,
        show: Callable[[float, str], None],
        every: float,
        total: int,
        completed: int = 0,
        noun: str = "episode",
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self._show, self._every, self._clock = show, every, clock
        self._recent: deque[Any] = deque(maxlen=RECENT)
        self._values = ""
        self._total, self._noun = total, noun
        self._first = self._done = completed
        self._started = self._shown = clock()

    def begin(self, total: int, noun: str, completed: int = 0) -> None:
        """Begin another phase: so many steps, of which `completed` are done."""
        self._recent.clear()
        self._total, self._noun = total, noun
        self._first = self._done = completed
        self._started = self._clock()

    def advance(self, done: int, returns: Any = None) -> None:
        """`done` episodes (or steps) are over.

        Parameters
        ----------
        done : int
        returns : array (S,), optional
            Of the last one.
        """
        self._done = done
        if returns is not None:
            self._recent.append(returns)
        now = self._clock()
        if now - self._shown >= self._every:
            self._shown = now
            self._show(done / max(1, self._total), self.text())

    def validated(self, values: Any) -> None:
        """V(s0) of every seed at the last validation, shape (S,)."""
        from ..verify.wording import at_least

        middle = float(np.median(values))
        self._values = f"V {at_least(middle, 4)}" if math.isfinite(middle) else "V without a bound"

    def text(self) -> str:
        """``episode 1240/2000, return -31.2, V -45.1, 12.3 episodes/s, 1:02 left``."""
        parts = [f"{self._noun} {self._done}/{self._total}"]
        if self._recent:
            parts.append(f"return {float(np.median(np.stack(list(self._recent)))):.4g}")
        if self._values:
            parts.append(self._values)
        done, seconds = self._done - self._first, self._clock() - self._started
        if done > 0 and seconds > 0.0:
            parts.append(f"{done / seconds:.3g} {self._noun}s/s")
            parts.append(f"{_duration((self._total - self._done) * seconds / done)} left")
        return ", ".join(parts)


@contextmanager
def training_progress(wanted: bool, total: int, completed: int = 0) -> Iterator[TrainingProgress]:
    """Progress of a run on stderr.

    Parameters
    ----------
    wanted : bool
        False: nothing is shown.
    total : int
        Episodes.
    completed : int
        How many of them are done, in a run that is resumed.
    """
    if not wanted:
        yield TrainingProgress(_nothing, math.inf, total, completed)
        return
    if not sys.stderr.isatty():
        yield TrainingProgress(_line, BETWEEN_LINES, total, completed)
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeElapsedColumn

    columns = (BarColumn(), TextColumn("{task.percentage:>5.1f} %"), TextColumn("{task.description}"))
    with Progress(*columns, TimeElapsedColumn(), console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("first episodes", total=1.0)

        def show(share: float, text: str) -> None:
            bar.update(task, completed=share, description=text)

        yield TrainingProgress(show, _BETWEEN_UPDATES, total, completed)


def _line(_: float, text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _nothing(_: float, __: str) -> None:
    """Show nothing."""


def _duration(seconds: float) -> str:
    """``1:02`` or ``1:02:03``."""
    whole = math.ceil(seconds)
    minutes, rest = divmod(whole, 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02}:{rest:02}" if hours else f"{minutes}:{rest:02}"
