"""A flowpipe and a specification's regions in the plane of two states."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement, ClosedLoop
from ..models.simulation import Trajectories
from .plot_regions import bounds_only, polygon
from .plot_style import FORBIDDEN, GOAL, LABEL_BOX, PIPE, PIPE_FILL, START, axis_label, dark, draw_boxes, note
from .result import Flowpipe
from .wording import number

if TYPE_CHECKING:
    from matplotlib.axes import Axes

Array = NDArray[np.float64]


def draw_plane(
    axes: Axes,
    loop: ClosedLoop,
    plane: tuple[int, int],
    view: Array,
    trajectories: Trajectories,
    flowpipe: Flowpipe | None,
    candidate: Any,
) -> None:
    """Draw regions, flowpipe, trajectories and the initial set; `view` is the plane's lower and upper corner."""
    for requirement in loop.requirements:
        for number_, member in enumerate(requirement.region):
            corners = polygon(member, plane, view)
            if len(corners) > 2:
                label = requirement.name + window_text(requirement, loop)
                label += "" if bounds_only(member, plane) else " (other states too)"
                _draw_region(
                    axes, requirement.kind, corners, view, label if number_ == 0 else "", len(requirement.region)
                )
    if flowpipe is not None:
        draw_boxes(axes, flowpipe.intervals[..., plane], PIPE_FILL, PIPE_FILL, 1.0)
        draw_boxes(
            axes, flowpipe.points[..., plane], "none" if np.isfinite(flowpipe.intervals).any() else PIPE_FILL, PIPE, 0.5
        )
    paths = trajectories.states[..., plane]
    axes.plot(paths[..., 0].T, paths[..., 1].T, color="black", linewidth=0.5, alpha=0.7, zorder=4)
    if candidate is not None:
        x, y = candidate.states[:, plane[0]], candidate.states[:, plane[1]]
        at = int(np.abs(candidate.times - candidate.time).argmin())
        axes.plot(x, y, color=FORBIDDEN, linewidth=1.4, zorder=5)
        axes.plot(x[at], y[at], "X", color=FORBIDDEN, markeredgecolor="white", markersize=9, zorder=6)
    start = np.array([[float(side) for side in loop.initial[state]] for state in plane])
    _draw_start(axes, start)
    _draw_clock(axes, trajectories, plane, view)
    axes.set(xlim=view[:, 0], ylim=view[:, 1], xlabel=axis_label(loop, plane[0]), ylabel=axis_label(loop, plane[1]))
    if same_unit(loop, plane):
        axes.set_aspect("equal", adjustable="box")


def same_unit(loop: ClosedLoop, plane: tuple[int, int]) -> bool:
    """Whether both states of a plane have the same unit."""
    first, second = (loop.plant.description.states.get(loop.plant.states[state], "") for state in plane)
    return first == second


def plane_height(loop: ClosedLoop, plane: tuple[int, int], view: Array) -> float:
    """Inches: as the region needs it where both axes have one scale."""
    if not same_unit(loop, plane):
        return 5.4
    width, height = view[1] - view[0]
    return float(np.clip(1.5 + 5.6 * height / width, 3.0, 8.0))


def window_text(requirement: BoundRequirement, loop: ClosedLoop) -> str:
    """When a requirement holds, where that is not during the whole run."""
    horizon = loop.period * loop.periods
    if requirement.start == requirement.end:
        return f" at {number(requirement.end)} s"
    if requirement.start == 0 and requirement.end == horizon:
        return ""
    return f" {number(requirement.start)}-{number(requirement.end)} s"


def _draw_region(axes: Axes, kind: str, corners: Array, view: Array, label: str, members: int) -> None:
    from matplotlib.patches import PathPatch, Polygon
    from matplotlib.path import Path as Outline

    middle = corners.mean(axis=0)
    if kind == "stay" and members == 1:
        (left, bottom), (right, top) = view
        frame = np.array([[left, bottom], [left, top], [right, top], [right, bottom], [left, bottom]])
        codes = [Outline.MOVETO] + [Outline.LINETO] * 4 + [Outline.MOVETO] + [Outline.LINETO] * len(corners)
        ring = Outline(np.concatenate([frame, corners, corners[:1]]), codes)
        axes.add_patch(PathPatch(ring, facecolor="none", edgecolor=FORBIDDEN, hatch="\\\\", linewidth=1.0, zorder=2.5))
        middle = np.array([middle[0], corners[:, 1].max()])
    elif kind == "avoid":
        axes.add_patch(Polygon(corners, facecolor=FORBIDDEN, alpha=0.18, linewidth=0.0, zorder=1))
        axes.add_patch(Polygon(corners, facecolor="none", edgecolor=FORBIDDEN, hatch="////", linewidth=1.2, zorder=3))
    else:
        axes.add_patch(Polygon(corners, facecolor=GOAL, alpha=0.12, linewidth=0.0, zorder=1))
        edge: dict[str, Any] = {"edgecolor": GOAL, "linestyle": "--", "linewidth": 1.6}
        axes.add_patch(Polygon(corners, facecolor="none", hatch="..", zorder=3, **edge))
        middle = np.array([middle[0], corners[:, 1].min()])
    if label:
        color = GOAL if kind == "reach" else FORBIDDEN
        below = kind in ("reach", "stay")
        axes.annotate(
            label,
            middle,
            xytext=(0, -3 if below else 0),
            textcoords="offset points",
            ha="center",
            va="top" if below else "center",
            fontsize=8,
            color=dark(color),
            fontweight="bold",
            zorder=7,
            bbox=LABEL_BOX,
        )


def _draw_start(axes: Axes, bounds: Array) -> None:
    """The initial set's shadow: a box, a line or a point."""
    (left, right), (bottom, top) = bounds
    axes.plot(
        [left, right, right, left, left],
        [bottom, bottom, top, top, bottom],
        color=START,
        linewidth=1.8,
        solid_joinstyle="miter",
        zorder=6,
    )
    if left == right and bottom == top:
        axes.plot(left, bottom, "s", color=START, markersize=5, zorder=6)
    note(axes, "start", ((left + right) / 2.0, top), (0, 4), "center")


def _draw_clock(axes: Axes, trajectories: Trajectories, plane: tuple[int, int], view: Array) -> None:
    """Times along the first trajectory, so that a plane tells when; the last one first, and none on top of another."""
    path, times = trajectories.states[0][:, plane], trajectories.times
    taken: list[Array] = []
    for share in (1.0, 0.75, 0.5, 0.25):
        at = round(share * (len(times) - 1))
        place = (path[at] - view[0]) / (view[1] - view[0])
        if not np.isfinite(place).all() or any(np.abs(place - other).max() < 0.07 for other in taken):
            continue
        taken.append(place)
        axes.plot(*path[at], "o", color="black", markersize=3, zorder=5)
        note(axes, f"{number(round(float(times[at]), 9))} s", (path[at][0], path[at][1]), (12, 0))
