"""A flowpipe and what the requirements say about one state, over time."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement, ClosedLoop
from ..models.simulation import Trajectories
from .plot_regions import bounds_only, interval
from .plot_style import FORBIDDEN, GOAL, LABEL_BOX, PIPE, PIPE_FILL, START, axis_label, dark, draw_boxes
from .result import Flowpipe

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]


def draw_times(
    axes: Axes,
    loop: ClosedLoop,
    state: int,
    view: Array,
    trajectories: Trajectories,
    flowpipe: Flowpipe | None,
    candidate: Any,
) -> None:
    """Draw bands, flowpipe and trajectories of one state; `view` is its lower and upper end."""
    for requirement in loop.requirements:
        _draw_band(axes, loop, requirement, state, view)
    if flowpipe is not None:
        draw_boxes(axes, _over_time(flowpipe, state), PIPE_FILL, PIPE_FILL, 0.5)
        times = flowpipe.period * np.arange(flowpipe.points.shape[1])
        for points in flowpipe.points[..., state]:
            axes.vlines(times, points[:, 0], points[:, 1], color=PIPE, linewidth=0.8, zorder=3)
    axes.plot(trajectories.times, trajectories.states[..., state].T, color="black", linewidth=0.5, alpha=0.7, zorder=4)
    if candidate is not None:
        at = int(np.abs(candidate.times - candidate.time).argmin())
        path = candidate.states[:, state]
        axes.plot(candidate.times, path, color=FORBIDDEN, linewidth=1.4, zorder=5)
        axes.plot(candidate.times[at], path[at], "X", color=FORBIDDEN, markeredgecolor="white", markersize=9, zorder=6)
    low, high = (float(side) for side in loop.initial[state])
    axes.plot([0.0, 0.0], [low, high], color=START, linewidth=3.0, zorder=6, solid_capstyle="butt")
    axes.plot([0.0], [(low + high) / 2.0], "s", color=START, markersize=3, zorder=6)
    horizon = float(loop.period * loop.periods)
    axes.set(xlim=(-0.015 * horizon, 1.015 * horizon), ylim=view, ylabel=axis_label(loop, state))


def _over_time(flowpipe: Flowpipe, state: int) -> Array:
    """Time-interval boxes (cells, P, 2, 2) of one state, time first."""
    bounds = flowpipe.intervals[..., state]
    width = flowpipe.period * (flowpipe.points.shape[1] - 1) / bounds.shape[1]
    start = width * np.arange(bounds.shape[1])
    times = np.broadcast_to(np.stack([start, start + width], axis=-1), bounds.shape)
    return np.stack([times, bounds], axis=-1)


def _draw_band(axes: Axes, loop: ClosedLoop, requirement: BoundRequirement, state: int, view: Array) -> None:
    """What a requirement says about one state over time, as far as it says it about this state alone."""
    start, end = float(requirement.start), float(requirement.end)
    wide = 0.012 * float(loop.period * loop.periods)
    window = (start, end) if start < end else (start - wide, end + wide)
    named = False
    for member in requirement.region:
        low, high = interval(member, state)
        if (low, high) == (-np.inf, np.inf) or (requirement.kind != "reach" and not bounds_only(member, (state,))):
            continue
        seen = max(low, view[0]), min(high, view[1])
        if requirement.kind == "stay" and len(requirement.region) == 1:
            for bottom, top in ((view[0], low), (high, view[1])):
                if np.isfinite([bottom, top]).all() and bottom < top:
                    _fill_band(axes, window, (bottom, top), FORBIDDEN, "\\\\")
            place = seen[1] if np.isfinite(high) else seen[0]
        elif requirement.kind == "avoid":
            _fill_band(axes, window, seen, FORBIDDEN, "////")
            place = seen[1]
        else:
            _fill_band(axes, window, seen, GOAL, "..")
            place = seen[1]
        if not named:
            late = start > 0.5 * float(loop.period * loop.periods)
            axes.annotate(
                requirement.name,
                (window[0] if late else window[1], place),
                xytext=(-4, -3),
                textcoords="offset points",
                ha="right",
                va="top",
                fontsize=8,
                fontweight="bold",
                color=dark(GOAL if requirement.kind == "reach" else FORBIDDEN),
                zorder=7,
                bbox=LABEL_BOX,
            )
            named = True


def _fill_band(axes: Axes, window: tuple[float, float], band: tuple[float, float], color: str, hatch: str) -> None:
    from matplotlib.patches import Rectangle

    corner, width, height = (window[0], band[0]), window[1] - window[0], band[1] - band[0]
    axes.add_patch(Rectangle(corner, width, height, facecolor=color, alpha=0.12, linewidth=0.0, zorder=1))
    axes.add_patch(
        Rectangle(corner, width, height, facecolor="none", edgecolor=color, hatch=hatch, linewidth=0.8, zorder=2.5)
    )
