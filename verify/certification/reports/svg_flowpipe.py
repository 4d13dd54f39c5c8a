"""The picture of a flowpipe as inline SVG: regions, boxes around all reachable states, initial set, witness."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from ...wording import number
from .markup import Markup, join, tag
from .svg_frame import BOTTOM, LEFT, RIGHT, TOP, Frame, drawing, label

WIDTH = 460.0
_INNER = WIDTH - LEFT - RIGHT


def draw(picture: Mapping[str, Any], title: str) -> Markup:
    """The drawing of what `picture.picture_of` kept.

    Parameters
    ----------
    picture : mapping
    title : str
        What it is a picture of.
    """
    return _plane(picture, title) if picture["kind"] == "plane" else _times(picture, title)


def _described(picture: Mapping[str, Any], what: str) -> str:
    parts = [what]
    if picture["truncated_at"] is not None:
        parts.append(f"From {number(picture['truncated_at'])} s on there are no finite boxes for some initial states.")
    if picture["witness"] is not None:
        parts.append(f"A trajectory that violates the requirement is marked at {number(picture['witness']['time'])} s.")
    return " ".join(parts)


def _plane(picture: Mapping[str, Any], title: str) -> Markup:
    (left, low), (right, high) = zip(*picture["view"], strict=True)
    width, height = _INNER, 330.0
    if picture["equal"]:
        height = width * (high - low) / (right - left)
        if height > 400.0:
            width, height = width * 400.0 / height, 400.0
        if height < 150.0:
            low, high = _widened(low, high, 150.0 / height)
            height = 150.0
    frame = Frame((left, right), (low, high), width, height)
    x_name, y_name = (_axis_name(axis) for axis in picture["axes"])
    boxes = "".join(frame.box(*box) for box in picture["boxes"])
    points = "".join(frame.box(*box) for box in picture["points"])
    start = picture["initial"]
    regions = [region for region in picture["regions"] if region["polygons"]]
    clip = tag("svg", *_inside(picture, frame, regions, boxes, points), **_window(frame), class_="clip")
    above = [
        *(_region_label(region, frame) for region in regions),
        label("start", frame.px((start[0] + start[2]) / 2), frame.py(start[3]) - 6, "middle", "note"),
        *(_clock_label(entry, frame) for entry in _apart(picture["clock"], frame)),
    ]
    names = ", ".join(f"{region['kind']} {region['name']}" for region in regions)
    what = f"Boxes around all reachable states in the plane of {x_name} and {y_name}, with the regions: {names}."
    return drawing(
        WIDTH, height + TOP + BOTTOM, title, _described(picture, what), frame.axes(x_name, y_name), clip, *above
    )


def _window(frame: Frame) -> dict[str, Any]:
    """Attributes of an inner drawing that shows the frame's rectangle and nothing beside it, in the same pixels."""
    box = (frame.left, frame.top, frame.width, frame.height)
    x, y, width, height = (f"{value:.1f}" for value in box)
    return {"x": x, "y": y, "width": width, "height": height, "viewBox": f"{x} {y} {width} {height}"}


def _inside(
    picture: Mapping[str, Any], frame: Frame, regions: Sequence[Mapping[str, Any]], boxes: str, points: str
) -> list[Markup | None]:
    start, witness = picture["initial"], picture["witness"]
    corner = frame.px(start[0]), frame.py(start[3])
    size = max(frame.px(start[2]) - corner[0], 5.0), max(frame.py(start[1]) - corner[1], 5.0)
    middle = frame.px((start[0] + start[2]) / 2), frame.py((start[1] + start[3]) / 2)
    return [
        *(_region(region, frame, False) for region in regions),
        tag("path", d=boxes, class_="pipe") if boxes else None,
        tag("path", d=points, class_="pipe-points") if points else None,
        *(_region(region, frame, True) for region in regions),
        None if witness is None else _witness(witness, frame),
        tag(
            "rect",
            x=f"{middle[0] - size[0] / 2:.1f}",
            y=f"{middle[1] - size[1] / 2:.1f}",
            width=f"{size[0]:.1f}",
            height=f"{size[1]:.1f}",
            class_="start",
        ),
    ]


def _widened(low: float, high: float, factor: float) -> tuple[float, float]:
    middle, half = (low + high) / 2, (high - low) / 2 * factor
    return middle - half, middle + half


def _axis_name(axis: Mapping[str, str]) -> str:
    return f"{axis['name']} ({axis['unit']})" if axis["unit"] else axis["name"]


def _region(region: Mapping[str, Any], frame: Frame, edge: bool) -> Markup:
    """A region's ground, below the boxes, or its hatching and edge, above them."""
    outline = "".join(frame.line(corners, closed=True) for corners in region["polygons"])
    kind = region["kind"]
    if kind == "stay" and len(region["polygons"]) == 1:
        outside = frame.box(frame.x[0], frame.y[0], frame.x[1], frame.y[1]) + outline
        return tag("path", d=outside, fill_rule="evenodd", class_="outside-edge" if edge else "outside")
    return tag("path", d=outline, class_=f"{kind}-edge" if edge else kind)


def _region_label(region: Mapping[str, Any], frame: Frame) -> Markup:
    corners = region["polygons"][0]
    text = f"{region['name']} {region['window']}".strip()
    if region["shadow"]:
        text += " (other states too)"
    x = sum(corner[0] for corner in corners) / len(corners)
    y = sum(corner[1] for corner in corners) / len(corners)
    place = frame.py(y) + 4
    if region["kind"] == "reach":
        place = min(frame.py(min(corner[1] for corner in corners)) + 14, frame.bottom - 4)
    if region["kind"] == "stay":
        place = max(frame.py(max(corner[1] for corner in corners)) + 14, frame.top + 12)
    return label(_cut(text), frame.px(x), place, "middle", f"name {region['kind']}-name")


def _cut(text: str) -> str:
    return text if len(text) <= 40 else f"{text[:38]}…"


def _apart(clock: Sequence[Sequence[float]], frame: Frame) -> list[Sequence[float]]:
    """Times whose labels do not cover each other; the last one first."""
    kept: list[Sequence[float]] = []
    for entry in reversed(clock):
        place = frame.px(entry[1]), frame.py(entry[2])
        inside = frame.left <= place[0] <= frame.right - 24 and frame.top <= place[1] <= frame.bottom
        far = all(max(abs(place[0] - frame.px(o[1])), 2 * abs(place[1] - frame.py(o[2]))) > 40 for o in kept)
        if inside and far:
            kept.append(entry)
    return kept


def _clock_label(entry: Sequence[float], frame: Frame) -> Markup:
    time, x, y = entry
    dot = tag("circle", cx=f"{frame.px(x):.1f}", cy=f"{frame.py(y):.1f}", r="2", class_="clock")
    return join([dot, label(f"{number(time)} s", frame.px(x) + 7, frame.py(y) - 7, "start", "note")])


def _witness(witness: Mapping[str, Any], frame: Frame) -> Markup:
    x, y = witness["path"][witness["mark"]]
    return join([tag("path", d=frame.line(witness["path"]), class_="witness"), _cross(frame.px(x), frame.py(y))])


def _cross(x: float, y: float) -> Markup:
    return tag("path", d=f"M{x - 5:.1f} {y - 5:.1f}l10 10m0 -10l-10 10", class_="witness-mark")


def _times(picture: Mapping[str, Any], title: str) -> Markup:
    panels = picture["panels"]
    height = 150.0 if len(panels) <= 2 else 96.0
    gap = 22.0
    horizon = picture["horizon"]
    parts: list[Markup] = []
    for number_, panel in enumerate(panels):
        low, high = panel["view"]
        frame = Frame(
            (-0.015 * horizon, 1.015 * horizon), (low, high), _INNER, height, LEFT, TOP + number_ * (height + gap)
        )
        last = number_ == len(panels) - 1
        parts += _panel(panel, picture["witness"], frame, "time (s)" if last else "")
    total = TOP + len(panels) * (height + gap) - gap + BOTTOM
    what = f"Bounds over time of {', '.join(panel['name'] for panel in panels)}, with what the requirements say."
    return drawing(WIDTH, total, title, _described(picture, what), *parts)


def _panel(panel: Mapping[str, Any], witness: Mapping[str, Any] | None, frame: Frame, x_name: str) -> list[Markup]:
    boxes = "".join(frame.box(*box) for box in panel["boxes"])
    low, high = panel["initial"]
    inside: list[Markup | None] = [
        *(band for entry in panel["bands"] for band in _band(entry, frame, False)),
        tag("path", d=boxes, class_="pipe-times") if boxes else None,
        *(band for entry in panel["bands"] for band in _band(entry, frame, True)),
    ]
    if witness is not None and panel["path"]:
        places = list(zip(witness["times"], panel["path"], strict=True))
        x, y = places[witness["mark"]]
        inside += [tag("path", d=frame.line(places), class_="witness"), _cross(frame.px(x), frame.py(y))]
    middle = (low + high) / 2
    tall = max(frame.py(low) - frame.py(high), 5.0)
    inside.append(
        tag(
            "rect",
            x=f"{frame.px(0.0) - 2:.1f}",
            y=f"{frame.py(middle) - tall / 2:.1f}",
            width="4",
            height=f"{tall:.1f}",
            class_="start",
        )
    )
    clip = tag("svg", *inside, **_window(frame), class_="clip")
    names = [_band_label(entry, frame) for entry in panel["bands"]]
    return [frame.axes(x_name, _axis_name(panel)), clip, *(name for name in names if name is not None)]


def _band(band: Mapping[str, Any], frame: Frame, edge: bool) -> list[Markup]:
    start, end = band["window"]
    if start == end:
        wide = 0.012 * (frame.x[1] - frame.x[0])
        start, end = start - wide, end + wide
    low = frame.y[0] if band["lower"] is None else band["lower"]
    high = frame.y[1] if band["upper"] is None else band["upper"]
    if band["outside"]:
        sides = [(frame.y[0], low)] if band["lower"] is not None else []
        sides += [(high, frame.y[1])] if band["upper"] is not None else []
        path = "".join(frame.box(start, bottom, end, top) for bottom, top in sides)
        return [tag("path", d=path, class_="outside-edge" if edge else "outside")] if path else []
    kind = band["kind"]
    return [tag("path", d=frame.box(start, low, end, high), class_=f"{kind}-edge" if edge else kind)]


def _band_label(band: Mapping[str, Any], frame: Frame) -> Markup | None:
    upper = frame.y[1] if band["upper"] is None else min(band["upper"], frame.y[1])
    late = band["window"][0] > 0.5 * frame.x[1]
    at = band["window"][0] if late else band["window"][1]
    place = min(max(frame.py(upper) + 13, frame.top + 12), frame.bottom - 4)
    return label(_cut(band["name"]), frame.px(at) - 6, place, "end", f"name {band['kind']}-name")
