"""What a report draws of a flowpipe: plain numbers, small enough that a batch can keep one per row.

Everything is rounded outward, to a grid of about a thousandth of what is seen: a drawn box contains the box that it
stands for. matplotlib is not needed; which plane is shown is decided as in `verify.plot`.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ....models.closed_loop import BoundRequirement, ClosedLoop
from ...plot_plane import same_unit, window_text
from ...plot_regions import bounds_only, interval, polygon, shown_plane, view_of
from ...result import Flowpipe, Result
from .picture_boxes import Grid, boxes_in_plane, boxes_over_time, truncated_at

Array = NDArray[np.float64]

MOST_POINTS = 200
"""Of the trajectory of a witness."""
MOST_OUTLINES = 200
"""Time-point sets that are outlined."""


def picture_of(result: Result) -> dict[str, Any]:
    """The drawing of a flowpipe as plain data for JSON.

    Parameters
    ----------
    result : Result

    Returns
    -------
    dict
        ``kind`` is "plane", with ``axes``, ``view``, ``regions``, ``boxes`` (x, y, x, y), ``points``, ``initial``,
        ``clock``; or "times", with one entry of ``panels`` per state. Both have ``witness`` (None unless a violation
        is proved), ``truncated_at`` (seconds from which on no box is finite everywhere, or None) and ``cells``.
    """
    loop, flowpipe = result.loop, result.flowpipe
    candidate = result.candidate if result.witness is not None else None
    count = len(loop.plant.states)
    seen = np.zeros((0, count)) if candidate is None else candidate.states
    bounds = [flowpipe.points.reshape(-1, count), flowpipe.intervals.reshape(-1, count)]
    view = view_of(loop, seen, np.concatenate(bounds))
    grids = [Grid.of(*view[:, state]) for state in range(count)]
    plane = shown_plane(loop)
    shared = {"cells": len(flowpipe.points), "truncated_at": truncated_at(flowpipe, loop.plant.discrete)}
    path = None if candidate is None else _path(candidate.times, candidate.states, candidate.time)
    if plane is not None:
        return {**_plane(loop, plane, view[:, plane], [grids[state] for state in plane], flowpipe, path), **shared}
    return {**_times(loop, view, grids, flowpipe, path), **shared}


_Path = tuple[list[float], Array, int]
"""Times, states, and the position that is marked."""


def _path(times: Array, states: Array, marked: float) -> _Path:
    """Every so manieth sample of a trajectory, the marked one among them."""
    at = int(np.abs(times - marked).argmin())
    step = -(-len(times) // (MOST_POINTS - 1))
    kept = np.unique(np.concatenate([np.arange(0, len(times), step), [at]]))
    finite = kept[np.isfinite(states[kept]).all(1)]
    return times[finite].tolist(), states[finite], int(np.abs(finite - at).argmin()) if finite.size else 0


def _plane(
    loop: ClosedLoop, plane: tuple[int, int], view: Array, grids: Sequence[Grid], flowpipe: Flowpipe, path: _Path | None
) -> dict[str, Any]:
    witness = None
    if path is not None and path[0]:
        places = [[grid.near(x) for grid, x in zip(grids, row, strict=True)] for row in path[1][:, plane].tolist()]
        witness = {"path": places, "mark": path[2], "time": path[0][path[2]]}
    intervals = flowpipe.points if loop.plant.discrete else flowpipe.intervals
    many = flowpipe.points.shape[0] * flowpipe.points.shape[1] > MOST_OUTLINES  # which hide each other
    return {
        "kind": "plane",
        "axes": [_axis(loop, state) for state in plane],
        "equal": same_unit(loop, plane),
        "view": [[grid.low(low), grid.high(high)] for grid, low, high in zip(grids, *view.tolist(), strict=True)],
        "regions": [_region(loop, entry, plane, view, grids) for entry in loop.requirements],
        "boxes": boxes_in_plane(intervals[..., plane], grids),
        "points": [] if loop.plant.discrete or many else boxes_in_plane(flowpipe.points[..., plane], grids),
        "initial": [side(float(loop.initial[s][k])) for k in (0, 1) for s, side in _sides(plane, grids, k)],
        "clock": _clock(flowpipe, plane, grids),
        "witness": witness,
    }


def _sides(plane: tuple[int, int], grids: Sequence[Grid], which: int) -> list[tuple[int, Any]]:
    return [(state, (grid.low, grid.high)[which]) for state, grid in zip(plane, grids, strict=True)]


def _axis(loop: ClosedLoop, state: int) -> dict[str, str]:
    name = loop.plant.states[state]
    unit = loop.plant.description.states.get(name, "")
    return {"name": name, "unit": "" if unit == "1" else unit}


def _region(
    loop: ClosedLoop, requirement: BoundRequirement, plane: tuple[int, int], view: Array, grids: Sequence[Grid]
) -> dict[str, Any]:
    """A requirement's region: polygons, and whether they are its shadow because other states are bounded too."""
    members = [polygon(member, plane, view) for member in requirement.region]
    return {
        "kind": requirement.kind,
        "name": requirement.name,
        "window": window_text(requirement, loop).strip(),
        "shadow": not all(bounds_only(member, plane) for member in requirement.region),
        "polygons": [
            [[grid.near(x) for grid, x in zip(grids, corner, strict=True)] for corner in corners.tolist()]
            for corners in members
            if len(corners) > 2
        ],
    }


def _clock(flowpipe: Flowpipe, plane: tuple[int, int], grids: Sequence[Grid]) -> list[list[float]]:
    """Where the middle of the sets is at the quarters of the run: seconds, x, y."""
    found: list[list[float]] = []
    if not len(flowpipe.points):
        return found
    hull = flowpipe.points[..., plane]
    last = hull.shape[1] - 1
    for share in (0.25, 0.5, 0.75, 1.0):
        at = round(share * last)
        low, high = hull[:, at, 0].min(0), hull[:, at, 1].max(0)
        middle = 0.5 * low + 0.5 * high
        if np.isfinite(middle).all():
            time = round(at * flowpipe.period, 9)
            found.append([time, *(grid.near(x) for grid, x in zip(grids, middle.tolist(), strict=True))])
    return found


def _times(
    loop: ClosedLoop, view: Array, grids: Sequence[Grid], flowpipe: Flowpipe, path: _Path | None
) -> dict[str, Any]:
    horizon = float(loop.period * loop.periods)
    panels = []
    for state, grid in enumerate(grids):
        low, high = loop.initial[state]
        panels.append(
            {
                **_axis(loop, state),
                "view": [grid.low(view[0, state]), grid.high(view[1, state])],
                "bands": _bands(loop, state, view[:, state], grid),
                "boxes": boxes_over_time(flowpipe, state, grid, loop.plant.discrete, 600 // len(grids)),
                "initial": [grid.low(float(low)), grid.high(float(high))],
                "path": None if path is None else [grid.near(x) for x in path[1][:, state].tolist()],
            }
        )
    witness = None if path is None or not path[0] else {"times": path[0], "mark": path[2], "time": path[0][path[2]]}
    return {"kind": "times", "horizon": horizon, "panels": panels, "witness": witness}


def _bands(loop: ClosedLoop, state: int, view: Array, grid: Grid) -> list[dict[str, Any]]:
    """What requirements say about one state alone, over time; None for a side that is not bounded."""
    found = []
    for requirement in loop.requirements:
        for member in requirement.region:
            low, high = interval(member, state)
            if (low, high) == (-math.inf, math.inf):
                continue
            # a region that bounds other states too says nothing about this one alone, unless it is a goal, or the only
            # region to stay in, each of whose bounds must hold
            alone = requirement.kind == "reach" or (requirement.kind == "stay" and len(requirement.region) == 1)
            if not alone and not bounds_only(member, (state,)):
                continue
            found.append(
                {
                    "kind": requirement.kind,
                    "name": requirement.name,
                    "window": [float(requirement.start), float(requirement.end)],
                    "lower": grid.near(low) if math.isfinite(low) else None,
                    "upper": grid.near(high) if math.isfinite(high) else None,
                    "outside": requirement.kind == "stay" and len(requirement.region) == 1,
                }
            )
    return found
