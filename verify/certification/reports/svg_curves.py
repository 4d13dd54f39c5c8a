"""Curves as inline SVG: V(s0) over the radius, margins over the control periods, radii that a search tried."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise

from ....specs.errors import SetrlError
from ....specs.exact import exact_decimal
from ...wording import number
from ..document import Outcome, RadiusFound, RequirementRow, Row
from .markup import Markup, tag
from .svg_frame import BOTTOM, LEFT, RIGHT, TOP, Frame, drawing, label, mark

WIDTH = 460.0
_INNER = WIDTH - LEFT - RIGHT
LARGEST = 10**9
"""No axis of radii goes further."""


def exact(radius: str) -> Fraction | None:
    """A radius as a number; None where the text is none that a radius could have."""
    try:
        value = exact_decimal(radius)
    except SetrlError:
        return None
    return value if 0 <= value <= LARGEST else None


def draw_values(rows: Sequence[tuple[float, Row]], title: str) -> Markup:
    """V(s0) over the perturbation radius.

    Parameters
    ----------
    rows : sequence of (radius, Row)
        In ascending order; filled marks are VERIFIED, hollow ones bounds of the engine without a certificate.
    title : str
    """
    known = [(radius, row.value.discounted, row.outcome) for radius, row in rows if row.value is not None]
    places = [(radius, value, outcome) for radius, value, outcome in known if value is not None]
    radii = [radius for radius, _ in rows]
    frame = Frame(_padded(radii), _padded([value for _, value, _ in places]), _INNER, 190.0)
    lines: list[Markup] = []
    for (x, y, outcome), (next_x, next_y, following) in pairwise(places):
        proved = outcome is following is Outcome.VERIFIED
        path = frame.line([(x, y), (next_x, next_y)])
        lines.append(tag("path", d=path, class_="curve" if proved else "curve unproved"))
    marks = [mark(outcome.value, frame.px(x), frame.py(y)) for x, y, outcome in places]
    without = [radius for radius, row in rows if row.value is None or row.value.discounted is None]
    below = [label("no bound", frame.px(radius), frame.bottom - 5, "middle", "note") for radius in without]
    said = "; ".join(f"{number(x)}: {number(y)} {outcome.value}" for x, y, outcome in places)
    description = f"Lower bounds of the return by radius. {said}."
    axes = frame.axes("radius of the observation perturbation", "V(s0), lower bound")
    return drawing(WIDTH, 190.0 + TOP + BOTTOM, title, description, axes, *lines, *marks, *below)


def _padded(values: Sequence[float]) -> tuple[float, float]:
    """Ends of an axis with some room."""
    if not values:
        return 0.0, 1.0
    low, high = min(values), max(values)
    room = 0.08 * (high - low) or abs(high) * 0.1 or 1.0
    return low - room, high + room


def draw_margins(requirement: RequirementRow, period: float, title: str) -> Markup | None:
    """A requirement's margin in every control period, with the line that it must not cross; None without any.

    Parameters
    ----------
    requirement : RequirementRow
    period : float
        Seconds.
    title : str
    """
    known = [margin for margin in requirement.curve if margin is not None]
    if not known or period <= 0.0:
        return None
    horizon = period * max(len(requirement.curve) - 1, 1)
    ends = _with_zero(known)
    frame = Frame((0.0, horizon), ends, _INNER, 110.0)
    path, open_ = "", False
    for position, margin in enumerate(requirement.curve):
        if margin is None:
            open_ = False
            continue
        begin = period * max(position - 1, 0)
        x, y, end = frame.px(begin), frame.py(max(margin, ends[0])), frame.px(period * position)
        path += f"{'L' if open_ else 'M'}{x:.1f} {y:.1f}H{end:.1f}"
        open_ = True
    floor = frame.py(0.0)
    parts = [
        tag("path", d=frame.box(0.0, frame.y[0], horizon, 0.0), class_="below-zero") if frame.y[0] < 0.0 else None,
        frame.axes("time (s)", "margin"),
        tag("path", d=f"M{LEFT:g} {floor:.1f}H{frame.right:g}", class_="zero"),
        tag("path", d=path, class_="curve"),
    ]
    if min(known) < ends[0]:
        parts.append(label(f"↓ {number(min(known))}", frame.right - 6, frame.bottom - 7, "end", "note"))
    if len(known) == 1:  # a line of no length
        at = next(k for k, margin in enumerate(requirement.curve) if margin is not None)
        parts.append(
            tag("circle", cx=f"{frame.px(period * at):.1f}", cy=f"{frame.py(known[0]):.1f}", r="3.5", class_="dot")
        )
    description = f"Smallest {number(min(known))}, largest {number(max(known))}; above zero is proof."
    return drawing(WIDTH, 110.0 + TOP + BOTTOM, title, description, *parts)


def _with_zero(values: Sequence[float]) -> tuple[float, float]:
    """Ends of an axis that shows zero; what falls far below it is cut, so that the margins before can be read."""
    low, high = min([*values, 0.0]), max([*values, 0.0])
    if high > 0.0:
        low = max(low, -2.0 * high)
    room = 0.08 * (high - low) or 1.0
    return low - room if low < 0.0 else 0.0 - room / 2, high + room


def draw_search(found: RadiusFound, title: str) -> Markup | None:
    """The radii that a search tried, on a line; None where there are none.

    Parameters
    ----------
    found : RadiusFound
    title : str
    """
    tried = [(float(value), verdict) for text, verdict in found.tried if (value := exact(text)) is not None]
    if not tried:
        return None
    frame = Frame((0.0, max(radius for radius, _ in tried) * 1.05 or 1.0), (0.0, 1.0), _INNER, 26.0)
    verified = 0.0 if found.verified is None else float(exact(found.verified) or 0)
    middle = frame.py(0.5)
    line = tag("path", d=f"M{LEFT:g} {middle:.1f}H{frame.right:g}", class_="axis")
    proved = tag("path", d=f"M{LEFT:g} {middle:.1f}H{frame.px(verified):.1f}", class_="radius")
    marks = [mark(verdict, frame.px(radius), middle, 4.5) for radius, verdict in tried]
    scale = frame.bottom + 15
    shown = sorted({0.0, *(radius for radius, _ in tried)})
    labels: list[Markup] = []
    last = -1e9
    for radius in shown:
        at = frame.px(radius)
        if at - last > 44.0:
            labels.append(label(number(radius), at, scale, "middle", "tick"))
            last = at
    axis = label(
        "radius of the observation perturbation", frame.left + frame.width / 2, scale + 18, "middle", "axis-name"
    )
    description = "; ".join(f"{number(radius)}: {verdict}" for radius, verdict in tried)
    return drawing(WIDTH, 26.0 + TOP + BOTTOM, title, description, line, proved, *marks, *labels, axis)
