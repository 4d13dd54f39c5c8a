"""Axes of a drawing in SVG: from numbers to pixels, ticks, labels. Colours are classes; the page's theme has them."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from ...wording import number
from .markup import Markup, join, tag

LEFT, RIGHT, TOP, BOTTOM = 58.0, 14.0, 14.0, 42.0


@dataclass(frozen=True)
class Frame:
    """A rectangle of the drawing and the numbers at its edges.

    Attributes
    ----------
    x, y : (lower, upper)
        In the data's units.
    width, height : float
        Of the rectangle, in pixels.
    left, top : float
        Its corner.
    """

    x: tuple[float, float]
    y: tuple[float, float]
    width: float
    height: float
    left: float = LEFT
    top: float = TOP

    @property
    def right(self) -> float:
        """Pixels from the left to the right edge."""
        return self.left + self.width

    @property
    def bottom(self) -> float:
        """Pixels from the top to the lower edge."""
        return self.top + self.height

    def px(self, x: float) -> float:
        """Pixels from the left, never far outside the rectangle."""
        return self.left + self.width * _share(x, self.x)

    def py(self, y: float) -> float:
        """Pixels from the top."""
        return self.bottom - self.height * _share(y, self.y)

    def box(self, low_x: float, low_y: float, high_x: float, high_y: float) -> str:
        """Path of a box."""
        left, right = self.px(low_x), self.px(high_x)
        top, bottom = self.py(high_y), self.py(low_y)
        return f"M{_short(left)} {_short(top)}h{_short(right - left)}v{_short(bottom - top)}h{_short(left - right)}z"

    def line(self, points: Iterable[Sequence[float]], closed: bool = False) -> str:
        """Path through points."""
        places = [f"{_short(self.px(x))} {_short(self.py(y))}" for x, y in points]
        return f"M{'L'.join(places)}{'z' if closed else ''}" if places else ""

    def axes(self, x_label: str, y_label: str, x_ticks: Sequence[float] | None = None) -> Markup:
        """Grid lines, tick labels and the names of both axes."""
        parts: list[Markup] = []
        for value in ticks(*self.x, count=5) if x_ticks is None else x_ticks:
            at = _short(self.px(value))
            parts.append(tag("path", d=f"M{at} {_short(self.top)}V{_short(self.bottom)}", class_="grid"))
            parts.append(label(number(value), self.px(value), self.bottom + 15, "middle", "tick"))
        for value in ticks(*self.y, count=max(3, min(5, int(self.height / 34)))):
            at = _short(self.py(value))
            parts.append(tag("path", d=f"M{_short(self.left)} {at}H{_short(self.right)}", class_="grid"))
            parts.append(label(number(value), self.left - 6, self.py(value) + 4, "end", "tick"))
        outline = f"M{_short(self.left)} {_short(self.top)}V{_short(self.bottom)}H{_short(self.right)}"
        parts.append(tag("path", d=outline, class_="axis"))
        if x_label:
            parts.append(label(x_label, self.left + self.width / 2, self.bottom + 33, "middle", "axis-name"))
        if y_label:
            middle = self.top + self.height / 2
            turned = f"rotate(-90 12 {_short(middle)})"
            parts.append(
                tag("text", y_label, x=12, y=_short(middle), text_anchor="middle", class_="axis-name", transform=turned)
            )
        return join(parts)


def _share(value: float, ends: tuple[float, float]) -> float:
    low, high = ends
    return min(max((value - low) / (high - low), -1.0), 2.0)


def _short(value: float) -> str:
    return f"{round(value, 1):g}"


def drawing(width: float, height: float, title: str, description: str, *content: object) -> Markup:
    """An SVG element with a title and a description for those who do not see it.

    Parameters
    ----------
    width, height : float
        Pixels.
    title, description : str
    *content : Markup
    """
    return tag(
        "svg",
        tag("title", title),
        tag("desc", description),
        *content,
        role="img",
        aria_label=title,
        viewBox=f"0 0 {_short(width)} {_short(height)}",
        width=_short(width),
        height=_short(height),
    )


def label(text: str, x: float, y: float, anchor: str, class_: str) -> Markup:
    """Text at a place; `anchor` is "start", "middle" or "end"."""
    return tag("text", text, x=_short(x), y=_short(y), text_anchor=anchor, class_=class_)


def mark(kind: str, x: float, y: float, size: float = 4.0) -> Markup:
    """A dot that tells the verdict by its shape: filled, small, hollow, or a cross.

    Parameters
    ----------
    kind : str
        "VERIFIED", "CLAIMED", "FALSIFIED" or anything else.
    x, y, size : float
        Pixels.
    """
    if kind == "FALSIFIED":
        high, back = _short(2 * size), _short(-2 * size)
        path = f"M{_short(x - size)} {_short(y - size)}l{high} {high}m{back} 0l{high} {back}"
        return tag("path", d=path, class_="mark-falsified")
    if kind == "CLAIMED":
        size *= 0.6
    class_ = {"VERIFIED": "mark-verified", "CLAIMED": "mark-claimed"}.get(kind, "mark-unknown")
    return tag("circle", cx=_short(x), cy=_short(y), r=_short(size), class_=class_)


def ticks(low: float, high: float, count: int = 5) -> list[float]:
    """About `count` round numbers within an interval: multiples of 1, 2 or 5 times a power of ten."""
    rough = (high - low) / max(count, 1)
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(factor * power for factor in (1.0, 2.0, 5.0, 10.0) if factor * power >= 0.7 * rough)
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [float(f"{k * step:.12g}") for k in range(first, last + 1)]
