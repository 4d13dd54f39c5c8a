"""ONNX operators that move numbers without arithmetic, on any array: weights, or the positions of a signal."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from .onnx_graph import Node
from .onnx_values import Unsupported, require_size

Array: TypeAlias = NDArray[Any]


MAX_RANK = 32
"""Largest number of dimensions."""


def integers(node: Node, operands: Sequence[Array | None], position: int, attribute: str) -> list[int] | None:
    """Integers that old operator sets pass as an attribute and new ones as an input; None where there are none."""
    if attribute in node.attributes:
        value = node.attributes[attribute]
        entries = [int(entry) for entry in value] if isinstance(value, (list, tuple)) else [int(value)]
    else:
        operand = operands[position] if position < len(operands) else None
        if operand is None:
            return None
        if operand.dtype.kind != "i":
            raise Unsupported(f"needs integers for {attribute}")
        entries = [int(entry) for entry in operand.ravel()]
    if attribute in ("axes", "perm") and any(abs(entry) > MAX_RANK for entry in entries):
        raise Unsupported(f"has {attribute} {entries}")
    return entries


def _reshape(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    target = integers(node, operands, 1, "shape")
    if target is None:
        raise Unsupported("has no constant target shape")
    if not node.attributes.get("allowzero", 0):
        if any(size == 0 and axis >= array.ndim for axis, size in enumerate(target)):
            raise Unsupported(f"target shape {target} copies a dimension that does not exist")
        target = [array.shape[axis] if size == 0 else size for axis, size in enumerate(target)]
    try:
        return array.reshape(target)
    except ValueError:
        raise Unsupported(f"cannot turn shape {array.shape[1:]} of one sample into {target}") from None


def _flatten(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    axis = int(node.attributes.get("axis", 1))
    axis += array.ndim if axis < 0 else 0
    return array.reshape(int(np.prod(array.shape[:axis])), -1)


def _squeeze(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    axes = integers(node, operands, 1, "axes")
    try:
        return np.squeeze(array) if axes is None else np.squeeze(array, tuple(axes))
    except ValueError:
        raise Unsupported(f"cannot drop axes {axes}") from None


def _unsqueeze(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    axes = integers(node, operands, 1, "axes")
    if axes is None:
        raise Unsupported("has no constant axes")
    try:
        return np.expand_dims(array, tuple(axes))
    except ValueError:
        raise Unsupported(f"cannot insert axes {axes}") from None


def _transpose(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    order = integers(node, (), 1, "perm")
    try:
        return np.transpose(array, None if order is None else tuple(order))
    except ValueError:
        raise Unsupported(f"has permutation {order} for {array.ndim} dimensions") from None


def _slices(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    starts, ends = integers(node, operands, 1, "starts"), integers(node, operands, 2, "ends")
    if starts is None or ends is None:
        raise Unsupported("has no constant starts and ends")
    axes = integers(node, operands, 3, "axes") or list(range(len(starts)))
    steps = integers(node, operands, 4, "steps") or [1] * len(starts)
    if not len(starts) == len(ends) == len(axes) == len(steps) or 0 in steps:
        raise Unsupported("has starts, ends, axes and steps of different lengths, or a zero step")
    where = [slice(None)] * array.ndim
    for axis, start, end, step in zip(axes, starts, ends, steps, strict=True):
        if not -array.ndim <= axis < array.ndim:
            raise Unsupported(f"has axis {axis} for {array.ndim} dimensions")
        where[axis] = slice(start, end, step)
    return array[tuple(where)]


def _gather(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    indices = operands[1] if len(operands) > 1 else None
    if indices is None or indices.dtype.kind != "i":
        raise Unsupported("needs constant integer indices")
    axis = int(node.attributes.get("axis", 0))
    try:
        require_size(indices.size * (array.size // max(array.shape[axis], 1)))
        return np.take(array, indices, axis=axis)
    except (IndexError, ValueError):
        raise Unsupported(f"has indices out of range for shape {array.shape}") from None


def _identity(node: Node, operands: Sequence[Array | None], array: Array) -> Array:
    return array


MOVEMENTS: dict[str, tuple[Callable[[Node, Sequence[Array | None], Array], Array], frozenset[str]]] = {
    "Reshape": (_reshape, frozenset({"shape", "allowzero"})),
    "Flatten": (_flatten, frozenset({"axis"})),
    "Squeeze": (_squeeze, frozenset({"axes"})),
    "Unsqueeze": (_unsqueeze, frozenset({"axes"})),
    "Transpose": (_transpose, frozenset({"perm"})),
    "Slice": (_slices, frozenset({"starts", "ends", "axes"})),
    "Gather": (_gather, frozenset({"axis"})),
    "Identity": (_identity, frozenset()),
}
"""Operator to (function of the array that is moved, attributes that are understood)."""
