"""What is looked at while cells move through the horizon: requirements, costs, hulls.

Checks are array programs too. A small batch is buffered over several periods, so that one check sees enough sets to be
worth its overhead; a large batch is checked period by period, so that cells that fail leave it early.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import ClosedLoop
from . import rounding
from .balls import Ball
from .closed_loop import Period
from .options import Options
from .performance import Performance
from .requirements import Monitor
from .steps import Step
from .zonotope import Zonotope, stack_cells

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]

ENOUGH_SETS = 32
"""Sets that make a check worth its overhead."""


PARTS = 4
"""Hulls that are kept per control period: a box around a whole period of motion is too coarse a picture."""


def _part_of(whole: Zonotope, low: Fraction, high: Fraction) -> Ball:
    """Enclosing interval of a part of a time-interval set, whose last generator is time.

    `low` and `high` are the part's ends as shares of the step.
    """
    time = whole.generators[:, -1]
    middle, half = float(low + high) - 1.0, float(high - low)  # exact: quotients of powers of two
    center = whole.center + middle * time
    others = rounding.enlarged(np.abs(whole.generators[:, :-1]).sum(1) + whole.radius, whole.generators.shape[1])
    spread = others + half * np.abs(time) + rounding.relative_error(middle * time, 1)
    return Ball(center, rounding.enlarged(spread + rounding.relative_error(center, 1), 4))


@dataclass
class Watch:
    """Observes one batch of cells.

    Attributes
    ----------
    loop : ClosedLoop
    monitors : list of Monitor
    performance : Performance or None
    points : array, shape (cells, T + 1, 2, n)
        Hulls of the time-point sets, NaN where there is none.
    intervals : array, shape (cells, T * PARTS, 2, n)
        Hulls of the time-interval sets, PARTS per period.
    """

    loop: ClosedLoop
    monitors: list[Monitor]
    performance: Performance | None
    points: Array
    intervals: Array
    _ends: list[tuple[Indices, int, Zonotope, Bools]] = field(default_factory=list)
    _steps: dict[tuple[int, Fraction], list[tuple[Indices, Fraction, Step]]] = field(default_factory=dict)
    _waiting: int = 0

    @classmethod
    def over(cls, loop: ClosedLoop, options: Options, start: Zonotope) -> Watch:
        """Begin with the initial sets, shape (cells, n)."""
        cells, states = start.batch, start.dimension
        points = np.full((cells, loop.periods + 1, 2, states), np.nan)
        hull = start.interval
        points[:, 0] = np.stack([hull.lower, hull.upper], 1)
        monitors = [Monitor.create(requirement, cells, options, loop) for requirement in loop.requirements]
        for monitor in monitors:
            monitor.observe_start(start)
        return cls(
            loop,
            monitors,
            None if loop.reward is None else Performance.create(loop.reward, cells, loop.periods),
            points,
            np.full((cells, loop.periods * PARTS, 2, states), np.nan),
        )

    def see(self, period: Period) -> None:
        """Take note of one period; check once enough has come together."""
        begin = self.loop.period * period.number
        self._ends.append((period.index, period.number, period.end, period.sound))
        for group in period.flow.groups:
            now = begin
            for position, step in enumerate(group.steps):
                key = (position, step.duration)
                self._steps.setdefault(key, []).append((period.index[group.cells], now, step))
                now += step.duration
        self._waiting += period.index.size
        if self._waiting >= ENOUGH_SETS:
            self.flush()

    def flush(self) -> None:
        """Check everything that was put off."""
        if not self._ends:
            return
        index = np.concatenate([entry[0] for entry in self._ends])
        numbers = np.concatenate([np.full(entry[0].size, entry[1]) for entry in self._ends])
        end = stack_cells([entry[2] for entry in self._ends])
        sound = np.concatenate([entry[3] for entry in self._ends])
        hull = end.interval
        self.points[index, numbers + 1] = np.stack([hull.lower, hull.upper], 1)
        if self.performance is not None:
            self.performance.observe(index[sound], numbers[sound], end[sound])
        for monitor in self.monitors:
            times = [self.loop.period * int(number + 1) for number in numbers]
            monitor.observe_points(index, times, end, numbers + 1)
        for entries in self._steps.values():
            self._check(entries)
        self._ends, self._steps, self._waiting = [], {}, 0

    def _check(self, entries: Sequence[tuple[Indices, Fraction, Step]]) -> None:
        """Check steps of the same kind and duration, possibly of several periods, as one batch."""
        first = entries[0][2]
        step = first if len(entries) == 1 else type(first).join([entry[2] for entry in entries])
        index = np.concatenate([entry[0] for entry in entries])
        begins = [entry[1] for entry in entries for _ in range(entry[0].size)]
        numbers = np.array([int(begin // self.loop.period) for begin in begins], dtype=np.intp)
        for monitor in self.monitors:
            monitor.observe_steps(index, begins, step, numbers + 1)
        width = self.loop.period / PARTS
        offset = begins[0] % self.loop.period  # the same for all: steps of the same position and duration
        whole = step.time_intervals(1)[0]
        for part in range(PARTS):
            low, high = max(offset, width * part), min(offset + step.duration, width * (part + 1))
            if low < high:
                hull = _part_of(whole, (low - offset) / step.duration, (high - offset) / step.duration)
                place = numbers * PARTS + part
                known = self.intervals[index, place]
                self.intervals[index, place, 0] = np.fmin(known[:, 0], hull.lower)
                self.intervals[index, place, 1] = np.fmax(known[:, 1], hull.upper)

    @property
    def failed(self) -> Bools:
        """Cells for which some requirement is known to be out of reach, shape (cells,)."""
        failed = np.zeros(self.points.shape[0], dtype=bool)
        for monitor in self.monitors:
            failed |= monitor.failed
        return failed

    def periods_before_failure(self) -> Indices:
        """Whole periods before the first failure of a requirement; T where none failed, shape (cells,)."""
        first = np.full(self.points.shape[0], float(self.loop.periods))
        for monitor in self.monitors:
            first = np.fmin(first, np.floor(monitor.failed_at / float(self.loop.period)))
        return first.astype(np.intp)
