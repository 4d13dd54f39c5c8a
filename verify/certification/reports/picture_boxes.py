"""The boxes of a flowpipe, few and short enough for a report, and never smaller than they are."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from ...result import Flowpipe

Array = NDArray[np.float64]

MOST_BOXES = 600
STRIPS = 200
"""At first; fewer where the union still has too many parts."""


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


def boxes_in_plane(bounds: Array, grids: Sequence[Grid], most: int = MOST_BOXES) -> list[list[float]]:
    """Boxes (cells, P, 2, 2) as (x, y, x, y); what is not finite is left out.

    Where there are more than `most`, their union is cut into horizontal strips, each as wide as the boxes that it
    touches: however many cells there are, it grows by no more than the height of a strip.

    Parameters
    ----------
    bounds : array, shape (cells, P, 2, 2)
    grids : pair of Grid
    most : int
    """
    flat = bounds.transpose(1, 0, 2, 3).reshape(-1, 2, 2)
    flat = flat[np.isfinite(flat).all(axis=(1, 2))]
    x, y = grids
    boxes = [(*low, *high) for low, high in flat.tolist()] if len(flat) <= most else _strips(flat, y, STRIPS)
    strips = STRIPS
    while len(boxes) > most:
        strips = strips * 3 // 4
        boxes = _strips(flat, y, strips)
    return [[x.low(left), y.low(low), x.high(right), y.high(high)] for left, low, right, high in boxes]


def _strips(boxes: Array, grid: Grid, count: int) -> list[tuple[float, float, float, float]]:
    """The union of boxes (N, 2, 2) as (x, y, x, y), by `count` strips of what is seen, and one on either side."""
    third = (grid.most - grid.least) / 3.0  # the view is the middle one
    seen = np.linspace(grid.least + third, grid.most - third, count + 1)
    edges = np.concatenate([[grid.least], seen, [grid.most]]).tolist()
    found = []
    for low, high in pairwise(edges):
        touched = boxes[(boxes[:, 0, 1] < high) & (boxes[:, 1, 1] >= low)]
        found += [(left, low, right, high) for left, right in _union(touched[:, :, 0])]
    return found


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
    bounds = _joined(bounds, run)
    found = []
    for number in range(bounds.shape[1]):
        begin = number * run * spacing
        end = begin if discrete else min((number + 1) * run * width, horizon)
        for low, high in _union(bounds[:, number]):
            found.append([round(begin, 6), grid.low(low), round(end, 6), grid.high(high)])
    return found


def _joined(bounds: Array, run: int) -> Array:
    """Hulls of `run` consecutive intervals (cells, P, 2); one that is not finite leaves its hull without an end."""
    if run <= 1:
        return bounds
    starts = np.arange(0, bounds.shape[1], run)
    low = np.minimum.reduceat(bounds[:, :, 0], starts, axis=1)
    return np.stack([low, np.maximum.reduceat(bounds[:, :, 1], starts, axis=1)], axis=2)


def _union(intervals: Array) -> list[tuple[float, float]]:
    """Intervals (cells, 2) as disjoint ones, in ascending order; what is not finite is left out."""
    finite = intervals[np.isfinite(intervals).all(axis=1)]
    if not len(finite):
        return []
    low, high = finite[finite[:, 0].argsort(kind="stable")].T
    reach = np.maximum.accumulate(high)
    first = np.concatenate([[True], low[1:] > reach[:-1]])
    last = np.concatenate([first[1:], [True]])
    return list(zip(low[first].tolist(), reach[last].tolist(), strict=True))


def truncated_at(flowpipe: Flowpipe, discrete: bool) -> float | None:
    """Seconds from which on some cell has no finite box; None where every box is finite."""
    bounds = flowpipe.points if discrete else flowpipe.intervals
    cells, parts = bounds.shape[:2]
    missing = np.flatnonzero(~np.isfinite(bounds).all(axis=(0, 2, 3))) if cells else np.zeros(0)
    if not missing.size:
        return None
    horizon = flowpipe.period * (flowpipe.points.shape[1] - 1)
    return round(float(missing[0]) * (flowpipe.period if discrete else horizon / parts), 6)
