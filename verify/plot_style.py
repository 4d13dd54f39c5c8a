"""What all pictures share: colours, labels, boxes, files.

Colours are those of Okabe and Ito, which colour-blind readers tell apart; regions also differ in their hatching,
so that a grey print says the same.
"""

from __future__ import annotations

import io
import textwrap
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import ClosedLoop
from ..specs.files import require_suffix, write_atomically

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

Array = NDArray[np.float64]

FORMATS = (".png", ".pdf", ".svg")
METADATA: dict[str, dict[str, Any]] = {
    ".png": {"Software": None},
    ".pdf": {"CreationDate": None},
    ".svg": {"Date": None},
}
"""No time and no version in a file: the same result gives the same bytes."""

FORBIDDEN, GOAL, PIPE, PIPE_FILL, START = "#D55E00", "#009E73", "#0072B2", "#B9D9EC", "#000000"
LABEL_BOX = {"boxstyle": "round,pad=0.15", "facecolor": "white", "edgecolor": "none", "alpha": 0.85}


def check_path(path: str | None) -> None:
    """Refuse a suffix that cannot be written, before anything is drawn."""
    if path is not None:
        require_suffix(path, FORMATS)


def new_figure(width: float, height: float) -> Figure:
    """A figure of so many inches, without pyplot: no window, no global state."""
    from matplotlib.figure import Figure

    return Figure(figsize=(width, height), layout="constrained")


def add_title(figure: Figure, first: str, second: str) -> None:
    """Two lines over everything: what was found, and of what; a long one is wrapped at the figure's width."""
    columns = int(14 * figure.get_figwidth())
    lines = [textwrap.fill(text, columns) for text in (first, second)]
    figure.suptitle("\n".join(lines), x=0.02, ha="left", fontsize=9.5)


def written(figure: Figure, path: str | None) -> Figure:
    """Write a figure to a file, if there is one; the same picture gives the same bytes."""
    if path is None:
        return figure
    import matplotlib

    suffix = Path(path).suffix.lower()
    buffer = io.BytesIO()
    with matplotlib.rc_context({"hatch.linewidth": 0.5, "svg.hashsalt": "setrl"}):
        figure.savefig(buffer, format=suffix[1:], dpi=150, metadata=METADATA[suffix])
    write_atomically(path, buffer.getvalue())
    return figure


def axis_label(loop: ClosedLoop, state: int) -> str:
    """A state with its unit."""
    name = loop.plant.states[state]
    unit = loop.plant.description.states.get(name, "")
    return f"{name} ({unit})" if unit and unit != "1" else name


def dark(color: str) -> str:
    """The same colour, dark enough for text."""
    from matplotlib.colors import to_hex, to_rgb

    red, green, blue = to_rgb(color)
    return to_hex((0.7 * red, 0.7 * green, 0.7 * blue))


def note(axes: Axes, text: str, place: tuple[float, float], offset: tuple[float, float], side: str = "left") -> None:
    """Small text on a white ground, at an offset in points."""
    axes.annotate(
        text,
        place,
        xytext=offset,
        textcoords="offset points",
        ha=side,
        va="bottom" if side == "center" else "center",
        fontsize=8,
        color="0.1",
        zorder=7,
        clip_on=True,
        bbox={**LABEL_BOX, "boxstyle": "square,pad=0.08"},
    )


def draw_boxes(axes: Axes, bounds: Array, face: str, edge: str, width: float) -> None:
    """Boxes (cells, T, 2, 2) as one collection; what is not finite is left out."""
    from matplotlib.collections import PolyCollection

    flat = bounds.reshape(-1, 2, 2)
    flat = flat[np.isfinite(flat).all(axis=(1, 2))]
    low, high = flat[:, 0], flat[:, 1]
    corners = np.stack([low, np.stack([high[:, 0], low[:, 1]], 1), high, np.stack([low[:, 0], high[:, 1]], 1)], axis=1)
    axes.add_collection(
        PolyCollection(
            list(corners), facecolors=face, edgecolors=edge, linewidths=width, zorder=2, rasterized=len(flat) > 2000
        ),
        autolim=False,
    )


def add_key(figure: Any, flowpipe: bool, candidate: bool) -> None:
    """What the lines and boxes are, below the picture."""
    from matplotlib.lines import Line2D
    from matplotlib.patches import Patch

    entries: list[Any] = []
    if flowpipe:
        entries.append(Patch(facecolor=PIPE_FILL, edgecolor=PIPE, label="boxes around all reachable states"))
    entries.append(Line2D([], [], color="black", linewidth=0.7, label="simulated"))
    entries.append(Line2D([], [], color=START, linewidth=2.0, label="initial set"))
    if candidate:
        entries.append(Line2D([], [], color=FORBIDDEN, marker="X", label="candidate of a violation"))
    figure.legend(handles=entries, loc="outside lower center", ncols=len(entries), frameon=False, fontsize=8)
