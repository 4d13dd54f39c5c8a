"""An ONNX graph that is written node by node: rows of numbers, single numbers, layers; equal nodes once.

Every tensor has the shape (1, n). Operators: Gemm, Add, Sub, Mul, Div, Relu, LeakyRelu, Tanh, Sigmoid, Clip, Sin, Cos,
Exp, Log, Sqrt, Concat, Slice; only those that the computation needs.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ...models.onnx_writer import IR_VERSION, OPSET
from ...models.policy import Activation, Affine, Layer
from .exact import rounded

_ACTIVATIONS = {"relu": "Relu", "leaky_relu": "LeakyRelu", "tanh": "Tanh", "sigmoid": "Sigmoid", "clip": "Clip"}


INPUT, OUTPUT = "inputs", "states"


class Graph:
    """A graph with one input row; also an arithmetic of single numbers, see `series.Arithmetic`.

    Parameters
    ----------
    precision : {"float32", "float64"}
    """

    def __init__(self, precision: str) -> None:
        self.precision = precision
        self.known: dict[Any, str] = {}
        self.nodes: list[Any] = []
        self.tensors: list[Any] = []

    def constant(self, value: Fraction) -> str:
        return self.array(np.array([[rounded(value, self.precision)]]))

    def add(self, left: str, right: str) -> str:
        return self.node("Add", left, right)

    def subtract(self, left: str, right: str) -> str:
        return self.node("Sub", left, right)

    def multiply(self, left: str, right: str) -> str:
        return self.node("Mul", left, right)

    def reciprocal(self, operand: str) -> str:
        return self.node("Div", self.constant(Fraction(1)), operand)

    def function(self, name: str, operand: str) -> str:
        return self.node(name.capitalize(), operand)

    def number(self, row: str, position: int) -> str:
        """One number of a row."""
        ends = (self.array(np.array([end], dtype=np.int64)) for end in (position, position + 1, 1))
        return self.node("Slice", row, *ends)

    def row(self, numbers: Sequence[str]) -> str:
        """Single numbers as a row."""
        return numbers[0] if len(numbers) == 1 else self.node("Concat", *numbers, axis=1)

    def layer(self, layer: Layer, row: str) -> str:
        """A layer of a network, applied to a row."""
        if isinstance(layer, Affine):
            weight, bias = self.array(layer.weight), self.array(layer.bias)
            return self.node("Gemm", row, weight, bias, transB=1)
        return self._activation(layer, row)

    def _activation(self, layer: Activation, row: str) -> str:
        operator = _ACTIVATIONS[layer.kind]
        if layer.kind == "clip":
            return self.node(operator, row, *(self.array(np.array(bound)) for bound in (layer.lower, layer.upper)))
        attributes = {"alpha": layer.slope} if layer.kind == "leaky_relu" else {}
        return self.node(operator, row, **attributes)

    def node(self, operator: str, *operands: str, **attributes: Any) -> str:
        """The result of an operator; the same one where it is there already."""
        from onnx import helper

        key = operator, operands, tuple(attributes.items())
        if key not in self.known:
            name = f"n{len(self.nodes)}"
            self.nodes.append(helper.make_node(operator, list(operands), [name], **attributes))
            self.known[key] = name
        return self.known[key]

    def array(self, numbers: Any) -> str:
        """Constant numbers: floats of the graph's precision, whole numbers as they are."""
        from onnx import helper
        from onnx.helper import np_dtype_to_tensor_dtype

        whole = numbers.dtype.kind == "i"
        values = numbers if whole else numbers.astype(self.precision)
        values = np.ascontiguousarray(values).reshape(numbers.shape)
        key = values.dtype.str, values.shape, values.tobytes()
        if key not in self.known:
            name = f"c{len(self.tensors)}"
            kind = np_dtype_to_tensor_dtype(values.dtype)
            little = values.astype(values.dtype.newbyteorder("<")).tobytes()
            self.tensors.append(helper.make_tensor(name, kind, values.shape, little, raw=True))
            self.known[key] = name
        return self.known[key]

    def content(self, inputs: int, output: str, size: int, description: str) -> bytes:
        """The bytes of a file that takes one row of `inputs` numbers and returns one of `size`."""
        from onnx import helper
        from onnx.helper import np_dtype_to_tensor_dtype

        kind = np_dtype_to_tensor_dtype(np.dtype(self.precision))
        # Concat of one operand is a copy: the output has a name of its own in any case
        nodes = [*self.nodes, helper.make_node("Concat", [output], [OUTPUT], axis=1)]
        needed, used = {OUTPUT}, []
        for node in reversed(nodes):  # operands come before what is made of them
            if node.output[0] in needed:
                needed.update(node.input)
                used.append(node)
        graph = helper.make_graph(
            used[::-1],
            "closed_loop",
            [helper.make_tensor_value_info(INPUT, kind, [1, inputs])],
            [helper.make_tensor_value_info(OUTPUT, kind, [1, size])],
            [tensor for tensor in self.tensors if tensor.name in needed],
            doc_string=description,
        )
        opsets = [helper.make_opsetid("", OPSET)]
        model = helper.make_model(graph, opset_imports=opsets, ir_version=IR_VERSION, producer_name="setrl")
        return bytes(model.SerializeToString(deterministic=True))
