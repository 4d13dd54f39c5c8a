"""Small ONNX models for tests, built operator by operator."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from onnx import TensorProto, helper, numpy_helper

Shape = Sequence[int | str | None]
Node = tuple[str, Sequence[str], str, dict[str, Any]]


def model_of(
    nodes: Sequence[Any],
    constants: dict[str, Any] | None = None,
    *,
    shape: Shape = ("batch", 4),
    dtype: int = TensorProto.FLOAT,
    opset: int = 13,
    ir_version: int = 8,
) -> Any:
    """A model with input ``x``, output ``y``; a node is (operator, inputs, output, attributes)."""
    made = [helper.make_node(op, list(ins), [out], **attributes) for op, ins, out, attributes in nodes]
    tensors = [numpy_helper.from_array(np.asarray(value), name) for name, value in (constants or {}).items()]
    graph = helper.make_graph(
        made,
        "test",
        [helper.make_tensor_value_info("x", dtype, shape)],
        [helper.make_tensor_value_info("y", output_type(nodes, dtype), None)],
        tensors,
    )
    return helper.make_model(graph, opset_imports=[helper.make_opsetid("", opset)], ir_version=ir_version)


def output_type(nodes: Sequence[Any], dtype: int) -> int:
    casts = [attributes["to"] for op, _, _, attributes in nodes if op == "Cast"]
    return int(casts[-1]) if casts else dtype


def bytes_of(*arguments: Any, **options: Any) -> bytes:
    return bytes(model_of(*arguments, **options).SerializeToString())


def random(*shape: int, seed: int = 1, dtype: Any = np.float32) -> Any:
    return np.random.default_rng(seed).normal(size=shape).astype(dtype)
