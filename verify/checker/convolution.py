"""A convolution as the rows of the matrix it is."""

from __future__ import annotations

import itertools
import math
from typing import Any

from ...specs.errors import PolicyError
from .movements import MAX_NUMBERS, Shape, whole
from .onnx_file import Array, Node

Rows = tuple[tuple[float, ...], ...]


def convolution_rows(node: Node, kernel: Array, shape: Shape) -> tuple[Shape, Rows]:
    """Spatial sizes of a convolution's result, and its matrix on values in C order.

    ``y_(m, o) = sum_(c, k) W_(m, c, k) x_(g C + c, o stride - pad + k dilation)``, where g = m // (M / groups) is the
    group of output channel m, C the number of channels in a group, and x is 0 outside.

    Parameters
    ----------
    node : Node
    kernel : Array, shape (M, C, *kernel)
    shape : tuple of int
        (1, channels, *spatial) of the values.

    Returns
    -------
    sizes : tuple of int
    rows : tuple of tuples of float
        One per output, in C order of (M, *sizes).

    Raises
    ------
    PolicyError
        The shapes do not fit, or the padding is left to the runtime.
    """
    dims = len(shape) - 2
    if dims < 1 or shape[0] != 1 or len(kernel.shape) != len(shape):
        raise PolicyError(f"not checkable: Conv of values of shape {shape} with a kernel of shape {kernel.shape}")
    (outputs, width, *window), (channels, *spatial) = kernel.shape, shape[1:]
    groups = node.attributes.get("group", 1)
    if groups < 1 or min(kernel.shape) < 1 or width * groups != channels or outputs % groups:
        raise PolicyError(f"not checkable: Conv of {channels} channels with a kernel of shape {kernel.shape}")
    if node.attributes.get("auto_pad", b"NOTSET") not in (b"NOTSET", b"VALID"):
        raise PolicyError("not checkable: Conv that pads automatically")
    if node.attributes.get("auto_pad") == b"VALID" and "pads" in node.attributes:
        raise PolicyError("not checkable: Conv with two kinds of padding")
    strides, dilations = _numbers(node, "strides", 1, dims, 1), _numbers(node, "dilations", 1, dims, 1)
    pads = _numbers(node, "pads", 0, 2 * dims, 0)
    if "kernel_shape" in node.attributes and _numbers(node, "kernel_shape", 1, dims, 1) != tuple(window):
        raise PolicyError("not checkable: Conv with a kernel of another shape than declared")
    sizes = tuple(
        (spatial[d] + pads[d] + pads[dims + d] - dilations[d] * (window[d] - 1) - 1) // strides[d] + 1
        for d in range(dims)
    )
    if min(sizes) < 1 or outputs * math.prod(sizes) * channels * math.prod(spatial) > MAX_NUMBERS:
        raise PolicyError(f"not checkable: Conv whose result has the sizes {sizes}")
    taps = list(itertools.product(*map(range, window)))
    rows: list[tuple[float, ...]] = []
    for output, cell in itertools.product(range(outputs), itertools.product(*map(range, sizes))):
        row = [0.0] * (channels * math.prod(spatial))
        lowest = output // (outputs // groups) * width
        for channel, (number, tap) in itertools.product(range(width), enumerate(taps)):
            source = [cell[d] * strides[d] - pads[d] + tap[d] * dilations[d] for d in range(dims)]
            if all(0 <= place < size for place, size in zip(source, spatial, strict=True)):
                position = lowest + channel
                for place, size in zip(source, spatial, strict=True):
                    position = position * size + place
                row[position] = kernel.numbers[(output * width + channel) * len(taps) + number]
        rows.append(tuple(row))
    return sizes, tuple(rows)


def _numbers(node: Node, name: str, otherwise: int, count: int, least: int) -> tuple[Any, ...]:
    found = whole(node.attributes.get(name), f"{name} of Conv")
    found = (otherwise,) * count if found is None else found
    if len(found) != count or min(found) < least:
        raise PolicyError(f"not checkable: Conv with {name} {found}")
    return found
