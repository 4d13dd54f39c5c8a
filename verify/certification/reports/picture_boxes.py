"""The boxes of a flowpipe, few and short enough for a report, and never smaller than they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ...result import Flowpipe

Array = NDArray[np.float64]

MOST_BOXES = 600


@dataclass(frozen=True)
class Grid:
    """Decimals with a fixed last digit, a thousandth to a ten-thousandth of what is seen of one axis.

    Attributes
    ----------
    digits : int
        Digits after the point; negative where whole tens, hundreds ... are far enough.
    least, most : float
        What is farther away than the whole view is wide is cut there: it is not seen.
    """

    digits: int
    least: float
    most: float

    @classmethod
    def of(cls, low: float, high: float) -> Grid:
        """The grid for a view from `low` to `high`."""
        span = float(high) - float(low)
        return cls(3 - math.floor(math.log10(span)), float(low) - span, float(high) + span)

    def low(self, value: float) -> float:
        """The next decimal that is not above a number."""
        units = math.floor(self._scaled(value))
        # scaling and going back both round, each by less than a unit
        while self._number(units) > max(min(value, self.most), self.least):
            units -= 1
        return self._number(units)

    def high(self, value: float) -> float:
        """The next decimal that is not below a number."""
        return -Grid(self.digits, -self.most, -self.least).low(-value)

    def near(self, value: float) -> float:
        """The nearest decimal."""
        return self._number(round(self._scaled(value)))

    def _scaled(self, value: float) -> float:
        cut = min(max(value, self.least), self.most)
        return cut * 10.0**self.digits if self.digits >= 0 else cut / 10.0**-self.digits

    def _number(self, units: int) -> float:
        number = units / 10**self.digits if self.digits >= 0 else float(units * 10**-self.digits)
        return number or 0.0  # no minus sign before a zero


def boxes_in_plane(bounds: Array, grids: Sequence[Grid], periods: int, most: int = MOST_BOXES) -> list[list[float]]:
    """Boxes (cells, P, 2, 2) as at most about `most` of (x, y, x, y), in the order of time; what is not finite is left out.

    Consecutive boxes of a cell are joined, as far as one box per control period; beyond that neighbouring cells.

    Parameters
    ----------
    bounds : array, shape (cells, P, 2, 2)
    grids : pair of Grid
    periods : int
        Time points of the run: P is about a multiple of it.
    most : int
    """
    cells, parts = bounds.shape[:2]
    if not cells or not parts:
        return []
    per_period = max(parts // max(periods - 1, 1), 1) if periods > 1 else 1
    run = min(-(-cells * parts // most), per_period)
    joined = _joined(bounds, run, axis=1)
    group = -(-joined.shape[0] * joined.shape[1] // most)
    joined = _joined(joined, min(group, cells), axis=0)
    joined = _joined(joined, -(-joined.shape[0] * joined.shape[1] // most), axis=1)
    flat = joined.transpose(1, 0, 2, 3).reshape(-1, 2, 2)
    flat = flat[np.isfinite(flat).all(axis=(1, 2))]
    x, y = grids
    return [[x.low(low[0]), y.low(low[1]), x.high(high[0]), y.high(high[1])] for low, high in flat.tolist()]


def _joined(bounds: Array, run: int, axis: int) -> Array:
    """Hulls of `run` consecutive boxes along an axis; one that is not finite leaves its hull without an end."""
    if run <= 1:
        return bounds
    starts = np.arange(0, bounds.shape[axis], run)
    low = np.minimum.reduceat(bounds[:, :, 0], starts, axis=axis)
    high = np.maximum.reduceat(bounds[:, :, 1], starts, axis=axis)
    return np.stack([low, high], axis=2)


def boxes_over_time(flowpipe: Flowpipe, state: int, grid: Grid, discrete: bool, most: int) -> list[list[float]]:
    """What one state can be over time, as (t, x, t, x): at every time the union of the cells' intervals.

    Parameters
    ----------
    flowpipe : Flowpipe
    state : int
    grid : Grid
        Of the state.
    discrete : bool
        The time-point sets are shown: there is nothing in between.
    most : int
        About so many boxes; consecutive ones are joined.
    """
    bounds = (flowpipe.points if discrete else flowpipe.intervals)[..., state]
    cells, parts = bounds.shape[:2]
    if not cells or not parts:
        return []
    horizon = flowpipe.period * (flowpipe.points.shape[1] - 1)
    width = 0.0 if discrete else horizon / parts
    spacing = flowpipe.period if discrete else width
    run = 1 if discrete else -(-parts // most)
    bounds = _joined(bounds[..., None], run, axis=1)[..., 0]
    found = []
    for number in range(bounds.shape[1]):
        begin = number * run * spacing
        end = begin if discrete else min((number + 1) * run * width, horizon)
        for low, high in _union(bounds[:, number]):
            found.append([round(begin, 6), grid.low(low), round(end, 6), grid.high(high)])
    return found


def _union(intervals: Array) -> list[tuple[float, float]]:
    """Intervals (cells, 2) as disjoint ones, in ascending order; what is not finite is left out."""
    found: list[tuple[float, float]] = []
    for low, high in sorted(intervals[np.isfinite(intervals).all(axis=1)].tolist()):
        if found and low <= found[-1][1]:
            found[-1] = found[-1][0], max(found[-1][1], high)
        else:
            found.append((low, high))
    return found


def truncated_at(flowpipe: Flowpipe, discrete: bool) -> float | None:
    """Seconds from which on some cell has no finite box; None where every box is finite."""
    bounds = flowpipe.points if discrete else flowpipe.intervals
    cells, parts = bounds.shape[:2]
    missing = np.flatnonzero(~np.isfinite(bounds).all(axis=(0, 2, 3))) if cells else np.zeros(0)
    if not missing.size:
        return None
    horizon = flowpipe.period * (flowpipe.points.shape[1] - 1)
    return round(float(missing[0]) * (flowpipe.period if discrete else horizon / parts), 6)
