"""Tanh and Sigmoid as the installed onnxruntime computes them: networks of one operator, to be measured."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from .onnx_writer import IR_VERSION, OPSET, policy_bytes
from .policy import Activation, Affine

ElementaryRunner: TypeAlias = Callable[[Any], Any]

OPERATORS = {"tanh": "Tanh", "sigmoid": "Sigmoid"}


def elementary_runner(function: str, precision: str, *, fused: bool = False) -> ElementaryRunner:
    """One operator on onnxruntime's CPU provider, one thread.

    Parameters
    ----------
    function : {"tanh", "sigmoid"}
    precision : {"float32", "float64"}
    fused : bool
        Put an identity matrix product before the operator, with which the runtime may fuse it.

    Returns
    -------
    callable
        Maps an array (B,) of the precision's type to one of the same shape and type; may be called by several threads.
    """
    import onnxruntime

    content = _fused(function, precision) if fused else _alone(function, precision)
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    (declared,) = session.get_inputs()

    def run(values: Any) -> Any:
        (result,) = session.run(None, {declared.name: values[:, None]})
        return result[:, 0]

    return run


def _fused(function: str, precision: str) -> bytes:
    return policy_bytes([Affine(np.eye(1), np.zeros(1)), Activation(function)], precision=precision)


def _alone(function: str, precision: str) -> bytes:
    from onnx import TensorProto, helper

    kind = TensorProto.FLOAT if precision == "float32" else TensorProto.DOUBLE
    value, result = (helper.make_tensor_value_info(name, kind, ["batch", 1]) for name in ("value", "result"))
    node = helper.make_node(OPERATORS[function], ["value"], ["result"])
    graph = helper.make_graph([node], "elementary", [value], [result])
    opsets = [helper.make_opsetid("", OPSET)]
    return bytes(helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION).SerializeToString())
