"""Pictures: a flowpipe with the specification's regions, worst rewards over radii, simulated trajectories."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import ClosedLoop
from ..models.rollouts import roll_out
from ..models.simulation import Trajectories
from ..specs.errors import UsageError
from .plot_plane import draw_plane, plane_height
from .plot_regions import shown_plane, view_of
from .plot_style import FORBIDDEN, GOAL, PIPE, add_key, add_title, check_path, new_figure, written
from .plot_times import draw_times
from .result import Flowpipe, Result, Verdict
from .wording import at_least, number, quantity

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

ROLLOUTS = 24
MOST_CELLS = 512
"""Above so many cells their boxes are joined before they are drawn."""


def plot_result(result: Result, path: str | None = None, states: tuple[str, str] | None = None) -> Figure:
    """Draw a flowpipe with the specification's regions and some simulated trajectories.

    Parameters
    ----------
    result : Result
    path : str, optional
        File to write: .png, .pdf or .svg.
    states : pair of str, optional
        Plane to draw. By default the plane of the two states that the requirements name; where they name another
        number of states, every state over time.

    Returns
    -------
    matplotlib.figure.Figure
    """
    check_path(path)
    loop = result.loop
    figure = _drawing(
        loop,
        states,
        roll_out(loop, ROLLOUTS, "corner", np.random.default_rng(0)),
        _joined(result.flowpipe),
        result.candidate,
    )
    add_title(figure, *_headline(result))
    return written(figure, path)


def plot_trajectories(
    loop: ClosedLoop, trajectories: Trajectories, path: str | None = None, states: tuple[str, str] | None = None
) -> Figure:
    """Draw simulated trajectories with the specification's regions.

    Parameters
    ----------
    loop : ClosedLoop
    trajectories : Trajectories
    path : str, optional
        File to write: .png, .pdf or .svg.
    states : pair of str, optional
        As in `plot_result`.

    Returns
    -------
    matplotlib.figure.Figure
    """
    check_path(path)
    figure = _drawing(loop, states, trajectories, None, None)
    add_title(figure, f"Simulation: {quantity(len(trajectories.states), 'trajectory')}", _subject(loop))
    return written(figure, path)


def plot_sweep(radii: Sequence[float], results: Sequence[Result], path: str | None = None) -> Figure:
    """Draw the verified performance and the margins over the radius of the observation perturbation.

    Parameters
    ----------
    radii : sequence of float
    results : sequence of Result
        One per radius.
    path : str, optional
        File to write: .png, .pdf or .svg.

    Returns
    -------
    matplotlib.figure.Figure
    """
    check_path(path)
    names = [entry.name for entry in results[0].requirements]
    values = [result.value for result in results if result.value is not None]
    panels = (1 if values else 0) + (1 if names else 0)
    figure = new_figure(6.4, 0.9 + 2.3 * panels)
    axes = list(figure.subplots(panels, 1, sharex=True, squeeze=False)[:, 0])
    proved = np.array([result.verdict is Verdict.VERIFIED for result in results])
    if values:
        first = axes.pop(0)
        discount = f"discount {number(values[0].discount)}"
        _curve(first, radii, [value.discounted for value in values], proved, PIPE, "-", discount)
        _curve(first, radii, [value.undiscounted for value in values], proved, GOAL, "--", "undiscounted")
        first.set_ylabel("V(s0), lower bound")
        first.legend(frameon=False, fontsize=8)
    for last in axes:
        for position, name in enumerate(names):
            margins = [result.requirements[position].margin for result in results]
            _curve(last, radii, margins, proved, _cycle(position), ("-", "--", ":", "-.")[position % 4], name)
        last.axhline(0.0, color="black", linewidth=0.8)
        last.set_ylabel("margin")
        last.legend(frameon=False, fontsize=8)
    figure.axes[-1].set_xlabel("radius of the observation perturbation (filled: VERIFIED, hollow: UNKNOWN)")
    add_title(figure, f"VERIFIED for {int(proved.sum())} of {len(results)} radii", _subject(results[0].loop))
    return written(figure, path)


def _cycle(position: int) -> str:
    return (PIPE, FORBIDDEN, GOAL, "#CC79A7", "#E69F00", "#56B4E9")[position % 6]


def _curve(
    axes: Axes, radii: Sequence[float], values: Sequence[float], proved: Any, color: str, style: str, label: str
) -> None:
    """A line with a marker per radius; what is not finite leaves a gap."""
    x, y = np.array(radii, dtype=float), np.array(values, dtype=float)
    y = np.where(np.isfinite(y), y, np.nan)
    axes.plot(x, y, style, color=color, linewidth=1.2, label=label)
    axes.plot(x[proved], y[proved], "o", color=color, markersize=4)
    axes.plot(x[~proved], y[~proved], "o", color=color, markersize=4, markerfacecolor="white")
    axes.grid(True, linewidth=0.3, color="0.85")


def _headline(result: Result) -> tuple[str, str]:
    largest = max(result.observation_radius, default=0.0)
    parts = [_subject(result.loop)]
    if largest > 0.0:
        parts.append(f"observations off by up to {number(largest)}")
    if result.value is not None and math.isfinite(result.value.discounted):
        parts.append(f"V(s0)\u00a0≥\u00a0{at_least(result.value.discounted, 4)}")
    proved = ", ".join(entry.name for entry in result.requirements) or "worst reward"
    missing = "" if result.reason is None else result.reason.requirement or "see the reason"
    return f"{result.verdict.value}: {missing or proved}", ", ".join(parts)


def _subject(loop: ClosedLoop) -> str:
    return f"plant {loop.plant.description.name}, policy {loop.policy.name or 'without a name'}"


def _joined(flowpipe: Flowpipe) -> Flowpipe:
    """The same flowpipe, joined to one cell where there are too many to draw."""
    if len(flowpipe.points) <= MOST_CELLS:
        return flowpipe

    def hull(bounds: Array) -> Array:
        return np.stack([bounds[:, :, 0].min(axis=0), bounds[:, :, 1].max(axis=0)], axis=1)[None]

    margins = np.fmin.reduce(flowpipe.margins, axis=0)[None]
    return Flowpipe(flowpipe.period, flowpipe.states, hull(flowpipe.points), hull(flowpipe.intervals), margins)


def _drawing(
    loop: ClosedLoop,
    states: tuple[str, str] | None,
    trajectories: Trajectories,
    flowpipe: Flowpipe | None,
    candidate: Any,
) -> Figure:
    plane = _plane(loop, states)
    boxes = [] if flowpipe is None else [flowpipe.points.reshape(-1, len(flowpipe.states))]
    if flowpipe is not None:
        boxes.append(flowpipe.intervals.reshape(-1, len(flowpipe.states)))
    seen = [trajectories.states.reshape(-1, len(loop.plant.states))]
    if candidate is not None:
        seen.append(candidate.states)
    nothing = np.zeros((0, len(loop.plant.states)))
    view = view_of(loop, np.concatenate(seen), np.concatenate([nothing, *boxes]))
    if plane is not None:
        figure = new_figure(6.4, plane_height(loop, plane, view[:, plane]))
        draw_plane(figure.subplots(), loop, plane, view[:, plane], trajectories, flowpipe, candidate)
        add_key(figure, flowpipe is not None, candidate is not None)
        return figure
    count = len(loop.plant.states)
    columns = 1 if count <= 4 else 2
    rows = -(-count // columns)
    figure = new_figure(6.4 if columns == 1 else 9.0, 0.9 + 1.9 * rows)
    panels = figure.subplots(rows, columns, sharex=True, squeeze=False)
    for state, axes in enumerate(panels.T.flat):
        if state < count:
            draw_times(axes, loop, state, view[:, state], trajectories, flowpipe, candidate)
        else:
            axes.set_visible(False)
    for axes in panels[-1]:
        axes.set_xlabel("time (s)")
    add_key(figure, flowpipe is not None, candidate is not None)
    return figure


def _plane(loop: ClosedLoop, states: tuple[str, str] | None) -> tuple[int, int] | None:
    names = loop.plant.states
    if states is None:
        return shown_plane(loop)
    if len(states) != 2 or len(set(states)) != 2 or not set(states) <= set(names):
        raise UsageError(
            f"two different states are required, received {', '.join(map(str, states))}",
            remedy=f"the plant's states: {', '.join(names)}",
        )
    return names.index(states[0]), names.index(states[1])
