"""What the checker does not understand of an ONNX file is "not checkable", never guessed."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from onnx import TensorProto
from onnx_models import bytes_of, model_of, random

from setrl.specs.errors import PolicyError
from setrl.verify.checker.network import read_network

W, V = random(4, 6, seed=1), random(6, 2, seed=2)
DOUBLES = {"dtype": TensorProto.DOUBLE}
REFUSED: dict[str, tuple[list[Any], dict[str, Any], dict[str, Any]]] = {
    "unknown operator": ([("Sin", "x", "y", {})], {}, {}),
    "skip connection": ([("Relu", "x", "h", {}), ("Add", "xh", "y", {})], {}, {}),
    "weights on the left": ([("MatMul", "Wx", "y", {})], {"W": W}, {}),
    "weights on the left that fit": ([("MatMul", "Wx", "y", {})], {"W": random(6, 4)}, {"shape": (4,)}),
    "column of constants": ([("Add", "xa", "y", {})], {"a": random(4, 1)}, {}),
    "wrong matrix": ([("MatMul", "xV", "y", {})], {"V": V}, {}),
    "wrong transposed matrix": ([("Gemm", "xW", "y", {"transB": 1})], {"W": W}, {}),
    "product of three axes": ([("Gemm", "xW", "y", {})], {"W": W}, {"shape": (1, 2, 2)}),
    "transposed input": ([("Gemm", "xW", "y", {"transA": 1})], {"W": W}, {}),
    "narrowing cast": (
        [("Relu", "x", "h", {}), ("Cast", "h", "y", {"to": TensorProto.FLOAT})],
        {},
        DOUBLES,
    ),
    "rounded constant": (
        [("Cast", "a", "h", {"to": TensorProto.FLOAT}), ("Add", "xh", "y", {})],
        {"a": np.full(4, 0.1)},
        {},
    ),
    "cast to whole numbers": ([("Cast", "x", "y", {"to": TensorProto.INT64})], {}, {}),
    "constants of another type": ([("Add", "xa", "y", {})], {"a": np.ones(4)}, {}),
    "several rows": ([("Relu", "x", "y", {})], {}, {"shape": (2, 4)}),
    "a constant per row": ([("Add", "xa", "y", {})], {"a": random(3, 4)}, {}),
    "division by the input": ([("Div", "ax", "y", {})], {"a": random(4)}, {}),
    "division by zero": ([("Div", "xa", "y", {})], {"a": np.zeros(4, np.float32)}, {}),
    "infinite weight": ([("Add", "xa", "y", {})], {"a": np.array([np.inf] * 4, dtype=np.float32)}, {}),
    "nan": ([("Clip", "xa", "y", {})], {"a": np.float32(np.nan)}, {}),
    "nan beside an operator": (
        [("Constant", [], "a", {"value_float": np.nan}), ("Max", "xa", "y", {})],
        {},
        {},
    ),
    "nan that nothing reads": ([("Relu", "x", "y", {})], {"a": np.float32(np.nan)}, {}),
    "bound of another type": ([("Clip", "xa", "y", {})], {"a": np.float64(0)}, {}),
    "empty clip": ([("Clip", "xlh", "y", {})], {"l": np.float32(1), "h": np.float32(0)}, {}),
    "bounds per neuron": ([("Max", "xa", "y", {})], {"a": random(4)}, {}),
    "negative slope": ([("LeakyRelu", "x", "y", {"alpha": -0.5})], {}, {}),
    "constant output": ([("Identity", "a", "y", {})], {"a": random(4)}, {}),
    "arithmetic on constants": ([("Add", "aa", "h", {}), ("Add", "xh", "y", {})], {"a": random(4)}, {}),
    "unknown attribute": ([("Flatten", "x", "y", {"axes": 0})], {}, {}),
    "attribute of another type": ([("LeakyRelu", "x", "y", {"alpha": 1})], {}, {}),
    "attribute of an older operator set": ([("Clip", "x", "y", {"min": 0.0})], {}, {"opset": 11}),
    "operand of a newer operator set": ([("Clip", "xa", "y", {})], {"a": np.float32(0)}, {"opset": 10}),
    "broadcasting of an older operator set": ([("Add", "xa", "y", {"broadcast": 1})], {"a": random(4)}, {"opset": 6}),
    "addition in an older operator set": ([("Add", "xa", "y", {})], {"a": random(4)}, {"opset": 6}),
    "spread bound of an older operator set": ([("Max", "xa", "y", {})], {"a": np.float32(0)}, {"opset": 7}),
    "dropout without test mode": ([("Dropout", "x", "y", {})], {}, {"opset": 6}),
    "dropout in training mode": ([("Dropout", "xrt", "y", {})], {"r": np.float32(0.5), "t": np.array(True)}, {}),
    "different values joined": ([("Relu", "x", "h", {}), ("Concat", "xh", "y", {"axis": 1})], {}, {}),
    "constants joined": ([("Concat", "xa", "y", {"axis": 1})], {"a": random(1, 4)}, {}),
    "place outside": ([("Gather", "xi", "y", {"axis": 1})], {"i": [4]}, {}),
    "negative place of an older operator set": ([("Gather", "xi", "y", {"axis": 1})], {"i": [-1]}, {"opset": 10}),
    "axis outside": ([("Flatten", "x", "y", {"axis": 3})], {}, {}),
    "axis named twice": ([("Slice", "xsea", "y", {})], {"s": [0, 1], "e": [4, 3], "a": [1, -1]}, {}),
    "step of zero": ([("Slice", "xseat", "y", {})], {"s": [0], "e": [4], "a": [1], "t": [0]}, {}),
    "nothing left": ([("Slice", "xsea", "y", {})], {"s": [3], "e": [3], "a": [1]}, {}),
    "another size": ([("Reshape", "xs", "y", {})], {"s": [1, 3]}, {}),
    "two open sizes": ([("Reshape", "xs", "y", {})], {"s": [-1, -1]}, {}),
    "squeezed values": ([("Squeeze", "xa", "y", {})], {"a": [1]}, {}),
    "no permutation": ([("Transpose", "x", "y", {"perm": [0, 0]})], {}, {}),
    "automatic padding": (
        [("Conv", "xk", "y", {"auto_pad": "SAME_UPPER"})],
        {"k": random(1, 1, 3)},
        {"shape": (1, 1, 4)},
    ),
    "two kinds of padding": (
        [("Conv", "xk", "y", {"auto_pad": "VALID", "pads": [1, 1]})],
        {"k": random(1, 1, 3)},
        {"shape": (1, 1, 4)},
    ),
    "another kernel than declared": (
        [("Conv", "xk", "y", {"kernel_shape": [2]})],
        {"k": random(1, 1, 3)},
        {"shape": (1, 1, 4)},
    ),
    "bias of another length": (
        [("Conv", "xkb", "y", {})],
        {"k": random(3, 1, 2), "b": random(1)},
        {"shape": (1, 1, 4)},
    ),
    "groups that do not fit": ([("Conv", "xk", "y", {"group": 2})], {"k": random(3, 1, 1)}, {"shape": (1, 2, 4)}),
    "defined twice": ([("Relu", "x", "y", {}), ("Tanh", "x", "y", {})], {}, {}),
    "read before it is computed": ([("Relu", "h", "y", {}), ("Tanh", "x", "h", {})], {}, {}),
    "unknown operator beside the way": ([("Sin", "x", "h", {}), ("Relu", "x", "y", {})], {}, {}),
    "huge selection": (
        [("Gather", "xi", "h", {"axis": 1}), ("Gather", "hi", "y", {"axis": 1})],
        {"i": np.zeros((1, 5000), np.int64)},
        {},
    ),
    "new operator set": ([("Relu", "x", "y", {})], {}, {"opset": 3}),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_understood_is_not_checkable(name: str) -> None:
    nodes, constants, options = REFUSED[name]
    with pytest.raises(PolicyError, match="not checkable"):
        read_network(bytes_of(nodes, constants, **options))


def test_an_array_that_is_stored_twice_or_outside_is_not_checkable() -> None:
    for change in ("twice", "segment", "elsewhere", "training", "declared"):
        model = model_of([("Add", "xa", "y", {})], {"a": random(4)})
        tensor = model.graph.initializer[0]
        match change:
            case "twice":
                tensor.float_data.extend([1.0, 2.0, 3.0, 4.0])
            case "segment":
                tensor.segment.begin = 0
            case "elsewhere":
                tensor.data_location = TensorProto.EXTERNAL
            case "training":
                model.training_info.add()
            case "declared":
                model.graph.output[0].type.tensor_type.elem_type = TensorProto.DOUBLE
        with pytest.raises(PolicyError, match="not checkable"):
            read_network(model.SerializeToString())


@pytest.mark.parametrize("content", [b"", b"no model", b"\x00" * 100])
def test_bytes_that_are_no_model_are_refused(content: bytes) -> None:
    with pytest.raises(PolicyError):
        read_network(content)
