"""ONNX operators that only move numbers: which number of the old array stands at each place of the new one."""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from ...specs.errors import PolicyError
from .onnx_file import MAX_RANK, Array, Node

Shape: TypeAlias = tuple[int, ...]
Arrangement: TypeAlias = tuple[Shape, tuple[int, ...] | None]
"""New shape and, for each of its places in C order, a place of the old array in C order; None: all in their order."""
Operands: TypeAlias = Sequence[Array | None]

MAX_NUMBERS = 1 << 24
"""Most numbers of one array."""


def lattice(axes: Sequence[Sequence[int]]) -> tuple[int, ...]:
    """Sums of one offset from each axis, in C order."""
    if math.prod(len(offsets) for offsets in axes) > MAX_NUMBERS:
        raise PolicyError(f"not checkable: an array of more than {MAX_NUMBERS} numbers")
    places = [0]
    for offsets in axes:
        places = [place + offset for place in places for offset in offsets]
    return tuple(places)


def offsets_of(shape: Shape) -> list[range]:
    """Offsets along each axis of an array in C order; `lattice` of them counts from 0."""
    strides = [math.prod(shape[axis + 1 :]) for axis in range(len(shape))]
    return [range(0, size * stride, stride) for size, stride in zip(shape, strides, strict=True)]


def broadcast(small: Shape, shape: Shape) -> tuple[int, ...]:
    """Places of an array of shape `small` that meet the places of a larger one which it does not enlarge."""
    padded = (1,) * (len(shape) - len(small)) + small
    if len(small) > len(shape) or any(a not in (1, b) for a, b in zip(padded, shape, strict=True)):
        raise PolicyError(f"not checkable: a constant of shape {small} with values of shape {shape}")
    axes = zip(offsets_of(padded), padded, shape, strict=True)
    return lattice([offsets if a == b else [0] * b for offsets, a, b in axes])


def joined(shapes: Sequence[Shape], parts: Sequence[tuple[Any, ...]], axis: int) -> tuple[Shape, tuple[Any, ...]]:
    """Shape and entries of arrays that are put one after the other along an axis."""
    first = shapes[0]
    if any(shape[:axis] != first[:axis] or shape[axis + 1 :] != first[axis + 1 :] for shape in shapes):
        raise PolicyError("not checkable: Concat of shapes that do not fit")
    if sum(map(len, parts)) > MAX_NUMBERS:
        raise PolicyError(f"not checkable: an array of more than {MAX_NUMBERS} numbers")
    runs = [math.prod(shape[axis:]) for shape in shapes]
    entries = [
        entry
        for block in range(math.prod(first[:axis]))
        for part, run in zip(parts, runs, strict=True)
        for entry in part[block * run : (block + 1) * run]
    ]
    return (*first[:axis], sum(shape[axis] for shape in shapes), *first[axis + 1 :]), tuple(entries)


def axis_of(node: Node, axis: int, rank: int, since: int = 11) -> int:
    """An axis counted from 0; before the operator set `since` a negative one has no meaning."""
    if not -rank <= axis < rank or (axis < 0 and node.opset < since):
        raise PolicyError(f"not checkable: axis {axis} of {node.operator} on {rank} dimensions")
    return axis + rank if axis < 0 else axis


def whole(value: Array | None, what: str) -> tuple[int, ...] | None:
    """The integers of a list of integers; None where it is left out."""
    if value is None:
        return None
    if value.kind not in ("int32", "int64") or len(value.shape) != 1:
        raise PolicyError(f"not checkable: {what} must be a list of integers")
    return value.numbers


def _listed(node: Node, rest: Operands, position: int, name: str, since: int) -> tuple[int, ...] | None:
    """Integers that were an attribute before the operator set `since` and are an operand from then on."""
    value = node.attributes.get(name) if node.opset < since else rest[position] if position < len(rest) else None
    return whole(value, f"{name} of {node.operator}")


def _axes(node: Node, axes: tuple[int, ...], rank: int) -> set[int]:
    found = {axis_of(node, axis, rank) for axis in axes}
    if len(found) != len(axes):
        raise PolicyError(f"not checkable: {node.operator} names an axis twice")
    return found


def _reshape(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    target = whole(rest[0] if rest else None, "the shape of Reshape")
    if target is None or min(target, default=0) < -1 or target.count(-1) > 1:
        raise PolicyError("not checkable: Reshape to no shape")
    if not node.attributes.get("allowzero", 0):
        if any(size == 0 and axis >= len(shape) for axis, size in enumerate(target)):
            raise PolicyError("not checkable: Reshape that keeps a dimension which does not exist")
        target = tuple(shape[axis] if size == 0 else size for axis, size in enumerate(target))
    count, known = math.prod(shape), math.prod(size for size in target if size != -1)
    if -1 in target and known > 0:
        target = tuple(count // known if size == -1 else size for size in target)
    if -1 in target or math.prod(target) != count:
        raise PolicyError(f"not checkable: Reshape of {shape} to {target}")
    return target, None


def _flatten(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    axis = node.attributes.get("axis", 1)
    axis = len(shape) if axis == len(shape) else axis_of(node, axis, len(shape))
    return (math.prod(shape[:axis]), math.prod(shape[axis:])), None


def _squeeze(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    axes = _listed(node, rest, 0, "axes", 13)
    if axes == ():  # runtimes take an empty list for one that is left out
        raise PolicyError("not checkable: Squeeze of no axes")
    ones = {axis for axis, size in enumerate(shape) if size == 1}
    dropped = ones if axes is None else _axes(node, axes, len(shape))
    if not dropped <= ones:
        raise PolicyError("not checkable: Squeeze of a dimension that is not 1")
    return tuple(size for axis, size in enumerate(shape) if axis not in dropped), None


def _unsqueeze(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    axes = _listed(node, rest, 0, "axes", 13)
    if axes is None or len(shape) + len(axes) > MAX_RANK:
        raise PolicyError("not checkable: Unsqueeze without axes, or with too many")
    rank = len(shape) + len(axes)
    inserted, kept = _axes(node, axes, rank), iter(shape)
    return tuple(1 if axis in inserted else next(kept) for axis in range(rank)), None


def _transpose(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    order = whole(node.attributes.get("perm"), "perm of Transpose")
    order = tuple(reversed(range(len(shape)))) if order is None else order
    if sorted(order) != list(range(len(shape))):
        raise PolicyError("not checkable: Transpose by no permutation")
    offsets = offsets_of(shape)
    return tuple(shape[axis] for axis in order), lattice([offsets[axis] for axis in order])


def _slice(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    starts, ends, axes = (_listed(node, rest, at, name, 10) for at, name in enumerate(("starts", "ends", "axes")))
    steps = whole(rest[3] if len(rest) > 3 else None, "steps of Slice")
    if starts is None or ends is None:
        raise PolicyError("not checkable: Slice without starts and ends")
    axes = tuple(range(len(starts))) if axes is None else axes
    steps = (1,) * len(starts) if steps is None else steps
    if not len(starts) == len(ends) == len(axes) == len(steps) or 0 in steps:
        raise PolicyError("not checkable: Slice with lists of different lengths or a step of 0")
    _axes(node, axes, len(shape))
    offsets: list[Sequence[int]] = list(offsets_of(shape))
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        axis = axis_of(node, axis, len(shape))
        size = shape[axis]
        # a negative place counts from the end; what is still outside moves to the nearest place that a walk in the
        # step's direction may start from, or stop in front of
        start, end = (place + size if place < 0 else place for place in (start, end))
        if step > 0:
            walk = range(min(max(start, 0), size), min(max(end, 0), size), step)
        else:
            walk = range(min(max(start, 0), size - 1), min(max(end, -1), size - 1), step)
        offsets[axis] = [offsets[axis][place] for place in walk]
    return tuple(map(len, offsets)), lattice(offsets)


def _gather(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    places = rest[0] if rest else None
    if places is None or places.kind not in ("int32", "int64"):
        raise PolicyError("not checkable: Gather without constant indices")
    axis = axis_of(node, node.attributes.get("axis", 0), len(shape), since=1)
    offsets: list[Sequence[int]] = list(offsets_of(shape))
    offsets[axis] = [offsets[axis][axis_of(node, place, shape[axis])] for place in places.numbers]
    return (*shape[:axis], *places.shape, *shape[axis + 1 :]), lattice(offsets)


def _identity(node: Node, rest: Operands, shape: Shape) -> Arrangement:
    return shape, None


MOVEMENTS: dict[str, Callable[[Node, Operands, Shape], Arrangement]] = {
    "Reshape": _reshape,
    "Flatten": _flatten,
    "Squeeze": _squeeze,
    "Unsqueeze": _unsqueeze,
    "Transpose": _transpose,
    "Slice": _slice,
    "Gather": _gather,
    "Identity": _identity,
}
"""Operator to a function of the node, its operands but the first, and the first one's shape."""
