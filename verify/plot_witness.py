"""The picture of a witness: its trajectory, the requirement's region, the initial set, and where it is violated."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement, ClosedLoop
from ..models.simulation import Trajectories
from .plot_plane import draw_plane, plane_height
from .plot_regions import view_of
from .plot_style import FORBIDDEN, START, add_title, check_path, new_figure, written
from .plot_times import draw_times
from .result import ProvedWitness
from .witness_trajectory import margins, trajectory_of, violated_requirement
from .wording import at_least, number

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

    from .falsifier import Candidate

Array = NDArray[np.float64]

VERBS = {"avoid": "entered", "stay": "left", "reach": "missed"}


def plot_witness(loop: ClosedLoop, candidate: Candidate, witness: ProvedWitness, path: str | None = None) -> Figure:
    """Draw the trajectory of a proved violation: in the plane of the two states that the requirement bounds, and
    where it bounds another number of states, every state over time.

    The trajectory is simulated; what is proved about it is in the witness.

    Parameters
    ----------
    loop : ClosedLoop
    candidate : Candidate
        What the trajectory is simulated from.
    witness : ProvedWitness
    path : str, optional
        File to write: .png, .pdf or .svg.

    Returns
    -------
    matplotlib.figure.Figure
    """
    check_path(path)
    requirement, run = violated_requirement(loop, candidate), trajectory_of(loop, candidate)
    marks = _marks(requirement, run, witness)
    bounded = _bounded(requirement)
    view = view_of(loop, run.states[0], np.zeros((0, run.states.shape[2])))
    if len(bounded) == 2:
        figure = _in_plane(loop, (bounded[0], bounded[1]), view, run, marks)
    else:
        figure = _over_time(loop, view, run, marks)
    _add_key(figure, run, marks, requirement.kind == "reach")
    add_title(figure, *_headline(loop, candidate, witness))
    return written(figure, path)


@dataclass(frozen=True)
class _Marks:
    """Samples at which the requirement is violated, and the one that is marked."""

    violated: NDArray[np.bool_]
    worst: int


def _marks(requirement: BoundRequirement, run: Trajectories, witness: ProvedWitness) -> _Marks:
    """The proved time is marked; for `reach` the sampling instant of its window that comes closest to the region."""
    half = 0.5 * (run.times[1] - run.times[0])  # sample times are rounded
    seen = (run.times > float(requirement.start) - half) & (run.times < float(requirement.end) + half)
    distance = margins(requirement, run.states[0])
    if witness.time is not None:
        return _Marks(seen & (distance < 0.0), int(np.abs(run.times - float(witness.time)).argmin()))
    instants = seen & (np.arange(run.times.size) % run.samples_per_period == 0)
    return _Marks(instants & (distance < 0.0), int(np.where(instants, distance, -np.inf).argmax()))


def _bounded(requirement: BoundRequirement) -> list[int]:
    normals = np.array([normal for member in requirement.region for normal in member.normals], dtype=np.float64)
    return [int(state) for state in np.flatnonzero(normals.any(axis=0))]


def _in_plane(loop: ClosedLoop, plane: tuple[int, int], view: Array, run: Trajectories, marks: _Marks) -> Figure:
    figure = new_figure(6.4, plane_height(loop, plane, view[:, plane]))
    axes = figure.subplots()
    draw_plane(axes, loop, plane, view[:, plane], run, None, None)
    x, y = run.states[0][:, plane].T
    _draw_path(axes, x, y, marks)
    axes.plot(x[:: run.samples_per_period], y[:: run.samples_per_period], "o", color="black", markersize=2.0, zorder=5)
    return figure


def _over_time(loop: ClosedLoop, view: Array, run: Trajectories, marks: _Marks) -> Figure:
    count = len(loop.plant.states)
    columns = 1 if count <= 4 else 2
    rows = -(-count // columns)
    figure = new_figure(6.4 if columns == 1 else 9.0, 1.1 + 1.9 * rows)
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for state, axes in enumerate(panels.T.flat):
        if state >= count:
            axes.set_visible(False)
            continue
        draw_times(axes, loop, state, view[:, state], run, None, None)
        _draw_path(axes, run.times, run.states[0, :, state], marks)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    return figure


def _draw_path(axes: Axes, x: Array, y: Array, marks: _Marks) -> None:
    """The trajectory, its violating part, and the mark above everything."""
    axes.plot(x, y, color="black", linewidth=1.2, zorder=4.5)
    axes.plot(x, np.where(marks.violated, y, np.nan), color=FORBIDDEN, linewidth=2.6, zorder=5.5)
    axes.plot(x[marks.worst], y[marks.worst], "X", color=FORBIDDEN, markeredgecolor="white", markersize=10, zorder=8)


def _add_key(figure: Any, run: Trajectories, marks: _Marks, reach: bool) -> None:
    from matplotlib.lines import Line2D

    when = f"{'nearest' if reach else 'violation'} at {number(float(run.times[marks.worst]))} s"
    entries = [
        Line2D([], [], color=START, linewidth=2.0, label="initial set"),
        Line2D([], [], color="black", linewidth=1.2, label="simulated trajectory"),
        Line2D([], [], color=FORBIDDEN, marker="X", linewidth=2.6, markeredgecolor="white", markersize=10, label=when),
    ]
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), frameon=False, fontsize=8)


def _headline(loop: ClosedLoop, candidate: Candidate, witness: ProvedWitness) -> tuple[str, str]:
    requirement = violated_requirement(loop, candidate)
    when = f"at {number(requirement.end if witness.time is None else witness.time)} s"
    if witness.time is None and requirement.start < requirement.end:
        when = f"at every sampling instant from {number(requirement.start)} s to {number(requirement.end)} s"
    depth = at_least(witness.depth, 3)
    first = f"FALSIFIED: {witness.requirement} is {VERBS[witness.kind]} {when}, by at least {depth}"
    subject = f"plant {loop.plant.description.name}, policy {loop.policy.name or 'without a name'}"
    return first, f"{subject}, {witness.grade}"
