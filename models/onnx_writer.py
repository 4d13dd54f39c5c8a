"""A chain of layers as an ONNX file that every runtime and every verifier of the field reads."""

from __future__ import annotations

from collections.abc import Sequence
from hashlib import sha256
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np

from ..specs.errors import PolicyError
from ..specs.files import write_atomically
from .policy import Affine, Layer

OPSET = 13
IR_VERSION = 8
"""Old enough for the external verifiers that pin their onnxruntime."""

_OPERATORS = {"relu": "Relu", "leaky_relu": "LeakyRelu", "tanh": "Tanh", "sigmoid": "Sigmoid", "clip": "Clip"}


def write_policy(
    path: str | Path,
    layers: Sequence[Layer],
    *,
    precision: str = "float32",
    name: str = "policy",
    description: str = "",
) -> str:
    """Write a policy network as ONNX: one Gemm per affine map, one operator per activation, a dynamic batch.

    The file is whole or not there; see `specs.files.write_atomically`.

    Parameters
    ----------
    path : str or path
    layers : sequence of Affine and Activation
        Starting with an affine map.
    precision : {"float32", "float64"}
        Numbers that are not exact in it are rounded to nearest.
    name, description : str
        Graph name and documentation in the file.

    Returns
    -------
    str
        sha256 of the bytes.

    Raises
    ------
    PolicyError
        The layers do not fit each other, or a number is not finite in `precision`.
    InputError
        The file cannot be written.
    """
    content = policy_bytes(layers, precision=precision, name=name, description=description)
    write_atomically(path, content)
    return sha256(content).hexdigest()


def policy_bytes(
    layers: Sequence[Layer], *, precision: str = "float32", name: str = "policy", description: str = ""
) -> bytes:
    """The bytes that `write_policy` writes; deterministic."""
    from onnx import TensorProto, helper

    if precision not in ("float32", "float64"):
        raise PolicyError(f"precision must be float32 or float64, received {precision}")
    inputs, outputs = _sizes(layers)
    dtype = np.dtype(precision)
    kind = TensorProto.FLOAT if precision == "float32" else TensorProto.DOUBLE
    nodes: list[Any] = []
    tensors: list[Any] = []
    value = "observation"
    for position, layer in enumerate(layers):
        result = "action" if position == len(layers) - 1 else f"layer_{position}"
        constants, attributes = _parts(layer, position, dtype)
        operator = "Gemm" if isinstance(layer, Affine) else _OPERATORS[layer.kind]
        tensors += [_tensor(key, array, kind) for key, array in constants.items()]
        names = [value, *constants]
        nodes.append(helper.make_node(operator, names, [result], name=f"{operator}_{position}", **attributes))
        value = result
    graph = helper.make_graph(
        nodes,
        name,
        [helper.make_tensor_value_info("observation", kind, ["batch", inputs])],
        [helper.make_tensor_value_info("action", kind, ["batch", outputs])],
        tensors,
        doc_string=description,
    )
    opsets = [helper.make_opsetid("", OPSET)]
    model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="setrl")
    return bytes(model.SerializeToString(deterministic=True))


def _sizes(layers: Sequence[Layer]) -> tuple[int, int]:
    affine = [layer for layer in layers if isinstance(layer, Affine)]
    if not layers or not isinstance(layers[0], Affine):
        raise PolicyError("a network starts with an affine map")
    for first, second in pairwise(affine):
        if first.weight.shape[0] != second.weight.shape[1]:
            raise PolicyError(
                f"a layer returns {first.weight.shape[0]} numbers, the next one takes {second.weight.shape[1]}"
            )
    for layer in affine:
        if layer.bias.shape != layer.weight.shape[:1]:
            raise PolicyError(f"a matrix of shape {layer.weight.shape} has a bias of shape {layer.bias.shape}")
    return affine[0].weight.shape[1], affine[-1].weight.shape[0]


def _parts(layer: Layer, position: int, dtype: np.dtype[Any]) -> tuple[dict[str, Any], dict[str, Any]]:
    """Constant inputs by name and attributes of one layer's operator."""
    if isinstance(layer, Affine):
        parts = {f"weight_{position}": layer.weight, f"bias_{position}": layer.bias}
        return {key: _rounded(array, dtype) for key, array in parts.items()}, {"transB": 1}
    if layer.kind == "clip":
        bounds = {f"lower_{position}": layer.lower, f"upper_{position}": layer.upper}
        return {key: np.asarray(bound, dtype=dtype) for key, bound in bounds.items()}, {}
    return {}, {"alpha": float(np.float32(layer.slope))} if layer.kind == "leaky_relu" else {}


def _rounded(array: Any, dtype: np.dtype[Any]) -> Any:
    with np.errstate(over="ignore"):
        values = np.ascontiguousarray(np.asarray(array).astype(dtype))
    if not np.isfinite(values).all():
        raise PolicyError(f"all weights must be finite in {dtype}", remedy="training diverged")
    return values


def _tensor(name: str, array: Any, kind: int) -> Any:
    from onnx import helper

    little = array.astype(array.dtype.newbyteorder("<"))
    return helper.make_tensor(name, kind, array.shape, little.tobytes(), raw=True)
