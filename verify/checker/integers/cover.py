"""Whether the leaves cover the initial set, and every first set its leaf: in rationals and exact integers."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from ..contract import Bounds
from ..rejection import Rejected
from .fixed import FLOAT_BITS, whole
from .sets import Tracked

Box = list[Bounds]


def cells(tree: Sequence[tuple[int, Fraction] | None], root: Sequence[Bounds]) -> list[Box]:
    """Boxes of a tree's leaves: closed halves on both sides of every cut, so that they cover the root.

    Parameters
    ----------
    tree : sequence of (state, cut) or None
        Preorder, lower halves first; None is a leaf.
    root : sequence of (lower, upper)

    Returns
    -------
    list of boxes

    Raises
    ------
    Rejected
        A cut is outside its box, or the nodes are not exactly one tree.
    """
    nodes = iter(tree)
    found: list[Box] = []
    waiting = [list(root)]
    while waiting:
        box = waiting.pop()
        try:
            node = next(nodes)
        except StopIteration:
            raise Rejected("the tree of cells ends early") from None
        if node is None:
            found.append(box)
            continue
        state, cut = node
        if state not in range(len(box)):
            raise Rejected("the tree of cells cuts what is no state")
        low, high = box[state]
        if not low <= cut <= high:
            raise Rejected("the tree of cells cuts outside a cell")
        for half in ((cut, high), (low, cut)):
            waiting.append([*box[:state], half, *box[state + 1 :]])
    if next(nodes, 0) != 0:
        raise Rejected("the tree of cells has nodes too many")
    return found


def require_inside(box: Sequence[Bounds], start: Tracked) -> None:
    """Require that a first set contains a box of all tracked coordinates.

    Each row moves one coordinate only, so that the set is a box: ``|g_1i| + |g_2i| + ... + r_i`` around c_i.
    """
    if len(box) != len(start.center) or any(len(row) - row.count(0.0) > 1 for row in start.rows):
        raise Rejected("the first set is no box of all tracked coordinates")
    for i, (low, high) in enumerate(box):
        reach = whole(start.radius[i]) + sum(abs(whole(row[i])) for row in start.rows)
        center = whole(start.center[i])
        below, above = Fraction(center - reach, 1 << FLOAT_BITS), Fraction(center + reach, 1 << FLOAT_BITS)
        if not (start.radius[i] >= 0.0 and below <= low and high <= above):
            raise Rejected(f"the first set does not contain its cell in coordinate {i}")
