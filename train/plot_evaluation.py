"""The picture of an evaluation: V(s0) over the radius, every seed, and what adversaries leave beside it."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..verify.plot_style import FORBIDDEN, GOAL, PIPE, PIPE_FILL, add_title, check_path, new_figure, written
from ..verify.wording import at_least, number, quantity
from .evaluation import ATTACKS, Evaluation
from .statistics import summary

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

STYLES = {"naive": ("#E69F00", ":"), "grad": ("#CC79A7", "-."), "mad": (GOAL, "--"), "adaptive": (FORBIDDEN, "-")}
"""Colours of Okabe and Ito, and a dash each for a grey print."""


def plot_evaluation(evaluation: Evaluation, path: str | None = None) -> Figure:
    """Draw V(s0) over the radius of the perturbation: seeds thin, median thick, 95 % band of the mean, attacks beside.

    Parameters
    ----------
    evaluation : Evaluation
    path : str, optional
        File to write: .png, .pdf or .svg.

    Returns
    -------
    matplotlib.figure.Figure
    """
    check_path(path)
    figure = new_figure(6.4, 4.2)
    axes = figure.subplots()
    order = np.argsort([float(radius) for radius in evaluation.radii])
    radii = np.array([float(evaluation.radii[position]) for position in order])
    values = evaluation.verified.discounted[:, order]
    _band(axes, radii, values)
    for position, (curve, found) in enumerate(zip(values, evaluation.collapses, strict=True)):
        style, label = ("--", "V(s0), a collapsed seed") if found.collapsed else ("-", "V(s0), every seed")
        earlier = [entry.collapsed for entry in evaluation.collapses[:position]]
        shown = "_nolegend_" if found.collapsed in earlier else label
        axes.plot(radii, _finite(curve), style, color=PIPE, linewidth=0.6, alpha=0.7, label=shown)
    axes.plot(radii, _finite(np.median(values, axis=0)), "-o", color=PIPE, linewidth=2.2, markersize=4, label="median")
    for name in ATTACKS:
        if name in evaluation.attacked:
            color, style = STYLES[name]
            curve = np.median(evaluation.attacked[name].discounted[:, order], axis=0)
            axes.plot(radii, _finite(curve), style, color=color, linewidth=1.1, label=f"attack {name}, median")
    axes.set_xlabel("radius of the observation perturbation")
    axes.set_ylabel(f"return, discount {number(evaluation.discount)}")
    axes.set_ylim(*_view(evaluation, values))
    axes.grid(True, linewidth=0.3, color="0.85")
    axes.legend(frameon=False, fontsize=8)
    count = len(evaluation.seeds)
    collapsed = sum(found.collapsed for found in evaluation.collapses)
    first = f"V(s0) of {quantity(count, 'policy')}: median {at_least(float(np.median(values[:, -1])), 4)}"
    first += f" at radius {number(radii[-1])}" + (f", {collapsed} COLLAPSED" if collapsed else "")
    add_title(figure, first, f"plant {evaluation.plant}, {evaluation.specification or 'specification'}")
    return written(figure, path)


def _view(evaluation: Evaluation, values: Array) -> tuple[float, float]:
    """Limits of the return: medians and attacks in full; a seed whose bound is lost on the way leaves the picture."""
    medians = [np.median(values, axis=0), *(np.median(f.discounted, axis=0) for f in evaluation.attacked.values())]
    shown = np.concatenate([*medians, values[:, 0], evaluation.nominal.discounted])
    shown = shown[np.isfinite(shown)] if np.isfinite(shown).any() else np.zeros(1)
    low, high = float(shown.min()), float(shown.max())
    span = max(high - low, 0.01 * abs(high), 1e-9)
    seen = values[np.isfinite(values)]
    lowest = max(float(seen.min(initial=low)), low - 0.6 * span)
    return lowest - 0.05 * span, high + 0.05 * span


def _band(axes: Axes, radii: Array, values: Array) -> None:
    """95 % interval of the mean, where there is one."""
    intervals = [summary(column).interval for column in values.T]
    if len(values) > 1:
        low, high = np.array([(np.nan, np.nan) if pair is None else pair for pair in intervals]).T
        axes.fill_between(radii, low, high, color=PIPE_FILL, alpha=0.6, linewidth=0, label="95 % of the mean")


def _finite(curve: Array) -> Array:
    """What is not finite leaves a gap."""
    return np.where(np.isfinite(curve), curve, np.nan)
