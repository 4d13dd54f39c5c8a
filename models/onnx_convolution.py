"""A convolution as the matrix it is: policies that come from image tool chains store plain vectors this way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from .onnx_graph import Node
from .onnx_values import Signal, Unsupported, Value, apply_matrix, require_matrix

ATTRIBUTES = frozenset({"auto_pad", "dilations", "group", "kernel_shape", "pads", "strides"})


def convolve(node: Node, operands: Sequence[Value | None]) -> Signal:
    """``Conv`` of any number of spatial dimensions, groups, strides, zero padding and dilations included.

    Parameters
    ----------
    node : Node
    operands : sequence
        Signal of shape (channels, *spatial) per sample; kernel (outputs, channels / group, *kernel); optional bias.
    """
    signal, kernel, *rest = operands
    if not isinstance(signal, Signal) or not isinstance(kernel, np.ndarray):
        raise Unsupported("needs a signal and a constant kernel")
    full = signal.index.shape
    if len(full) < 3 or kernel.ndim != len(full) or (not signal.batched and full[0] != 1):
        raise Unsupported(f"has values of shape {full[1:]} and a kernel of shape {kernel.shape}")
    channels, *spatial = full[1:]
    outputs, group = kernel.shape[0], int(node.attributes.get("group", 1))
    if kernel.dtype.kind != "f":
        raise Unsupported("needs a floating-point kernel")
    if group < 1 or kernel.shape[1] * group != channels or outputs % group:
        raise Unsupported(f"has {channels} channels and a kernel of shape {kernel.shape}")
    if node.attributes.get("auto_pad", "NOTSET") not in ("NOTSET", "VALID"):
        raise Unsupported("pads automatically; export with explicit pads")
    dims = len(spatial)
    strides = node.attributes.get("strides", [1] * dims)
    dilations = node.attributes.get("dilations", [1] * dims)
    pads = node.attributes.get("pads", [0] * 2 * dims)
    if not (len(strides) == len(dilations) == dims == len(pads) // 2 and len(pads) % 2 == 0):
        raise Unsupported("has strides, dilations or pads of the wrong length")
    if min(*strides, *dilations) < 1 or min(pads) < 0:
        raise Unsupported("has strides or dilations below one, or negative pads")
    sizes = [
        (spatial[d] + pads[d] + pads[dims + d] - dilations[d] * (kernel.shape[2 + d] - 1) - 1) // strides[d] + 1
        for d in range(dims)
    ]
    if min(sizes) < 1:
        raise Unsupported("has a kernel larger than its input")
    cells = int(np.prod(sizes))
    require_matrix(outputs * cells, signal.size)
    matrix = np.zeros((outputs, *sizes, channels, *spatial))
    members, width = outputs // group, kernel.shape[1]
    for target in np.ndindex(*sizes):
        for offset in np.ndindex(*kernel.shape[2:]):
            source = tuple(target[d] * strides[d] - pads[d] + offset[d] * dilations[d] for d in range(dims))
            if any(not 0 <= place < size for place, size in zip(source, spatial, strict=True)):
                continue
            for g in range(group):
                rows = slice(g * members, (g + 1) * members)
                columns = slice(g * width, (g + 1) * width)
                matrix[(rows, *target, columns, *source)] = kernel[(rows, slice(None), *offset)]
    bias = rest[0] if rest else None
    if isinstance(bias, Signal):
        raise Unsupported("needs a constant bias")
    if bias is not None and bias.shape != (outputs,):
        raise Unsupported(f"has {outputs} outputs and a bias of shape {bias.shape}")
    values = np.zeros(outputs) if bias is None else bias.astype(np.float64)
    shape = (outputs, *sizes) if signal.batched else (1, outputs, *sizes)
    flat = matrix.reshape(outputs * cells, signal.size)
    return apply_matrix(signal, flat, np.repeat(values, cells), shape, bare=False)
