"""HTML and SVG as values: what is text is quoted, what is markup is a type of its own.

There is no way to put a string into a page without quoting it but to call `Markup` on it, which only constants are.
"""

from __future__ import annotations

import html
from collections.abc import Iterable

from .text import visible

_VOID = ("br", "col", "hr", "meta")


class Markup(str):
    """Text that is markup already."""

    __slots__ = ()


def tag(name: str, /, *children: object, **attributes: str | int | float | bool | None) -> Markup:
    """An element.

    Parameters
    ----------
    name : str
    *children : Markup, str, None, or an iterable of these
        A str is quoted, None is nothing.
    **attributes : str, number, bool or None
        ``class_`` is ``class``, ``stroke_width`` is ``stroke-width``; None and False are left out, True has no value.
    """
    written = "".join(_attribute(key, value) for key, value in attributes.items())
    if name in _VOID:
        return Markup(f"<{name}{written}>")
    return Markup(f"<{name}{written}>{join(children)}</{name}>")


def join(children: Iterable[object]) -> Markup:
    """Everything in one piece of markup, quoted where it is text."""
    return Markup("".join(_child(child) for child in children))


def quoted(text: str) -> Markup:
    """Text as it stands in an element or in a quoted attribute."""
    return Markup(html.escape(visible(text), quote=True))


def _child(child: object) -> str:
    if child is None:
        return ""
    if isinstance(child, Markup):
        return child
    if isinstance(child, str):
        return quoted(child)
    if isinstance(child, Iterable):
        return join(child)
    return quoted(str(child))


def _attribute(key: str, value: str | int | float | bool | None) -> str:
    if value is None or value is False:
        return ""
    name = key.rstrip("_").replace("_", "-")
    if value is True:
        return f" {name}"
    text = str(value)  # never cut: it may be the path of a drawing
    return f' {name}="{html.escape(visible(text, len(text)), quote=True)}"'
