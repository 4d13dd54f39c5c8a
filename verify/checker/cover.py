"""The split tree of a certificate: boxes that cover the initial set, in rationals.

The root is the specification's initial box. A node cuts its box at a rational in one state; both halves are closed, so
the leaves cover the root whatever the cuts are.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, TypeAlias

from ...specs.errors import InputError
from .contract import Bounds
from .leaf import Leaf

Box: TypeAlias = tuple[Bounds, ...]


def leaf_boxes(tree: Sequence[Any], root: Box) -> list[Box]:
    """Boxes of the leaves of a tree.

    Parameters
    ----------
    tree : sequence
        Nodes in preorder: ``[state, cut]`` with both halves behind it, lower half first, or None for a leaf.
    root : tuple of (lower, upper)

    Returns
    -------
    list of boxes
        In the order of the leaves.

    Raises
    ------
    InputError
        The nodes are not one whole tree.
    """
    waiting, leaves = [root], []
    for node in tree:
        if not waiting:
            raise InputError("the certificate's tree has nodes that belong to nothing")
        box = waiting.pop()
        if node is None:
            leaves.append(box)
            continue
        state, cut = node
        if not 0 <= state < len(root) or not box[state][0] <= cut <= box[state][1]:
            raise InputError("the certificate's tree cuts a box where it is not")
        halves = ((box[state][0], cut), (cut, box[state][1]))
        waiting += [(*box[:state], half, *box[state + 1 :]) for half in reversed(halves)]
    if waiting:
        raise InputError("the certificate's tree is not complete")
    return leaves


def contains(leaf: Leaf, box: Sequence[Bounds]) -> bool:
    """Whether the set of a leaf contains a box of the tracked coordinates; a yes needs rows of one coordinate each.

    ``|c_i - middle_i| + half_i <= sum_j |g_ji| + r_i`` for every i, and every row moves one coordinate.
    """
    if len(box) != len(leaf.center) or any(sum(x != 0.0 for x in row) > 1 for row in leaf.rows):
        return False
    for i, (low, high) in enumerate(box):
        reach = sum((abs(Fraction(row[i])) for row in leaf.rows), Fraction(leaf.radius[i]))
        center = Fraction(leaf.center[i])
        if not (leaf.radius[i] >= 0.0 and center - reach <= low and high <= center + reach):
            return False
    return True
