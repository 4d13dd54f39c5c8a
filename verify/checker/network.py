"""The policy network, read from the bytes of its ONNX file and evaluated in ball arithmetic.

Only chains of the common operators are read; for anything else the answer is "not checkable", never a guess. The
meaning is the one of exact real arithmetic on the stored numbers.
"""

from __future__ import annotations

import hashlib
import math
import struct
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from flint import arb, arb_mat

from ...specs.errors import PolicyError

MAX_BYTES = 64 << 20
OPSETS = range(6, 26)

Vector: TypeAlias = list[Any]
Layer: TypeAlias = Callable[[Vector], Vector]


@dataclass(frozen=True)
class Network:
    """A chain of layers, each a function of balls; `inputs` and `outputs` are the sizes, `digest` the bytes' sha256."""

    inputs: int
    outputs: int
    layers: tuple[Layer, ...]
    digest: str

    def __call__(self, x: Vector) -> Vector:
        """Enclose the network's output for every point of a vector of balls."""
        for layer in self.layers:
            x = layer(x)
        return x


@dataclass(frozen=True)
class _Constant:
    """A stored array, flat, in C order."""

    shape: tuple[int, ...]
    numbers: tuple[float, ...]
    whole: bool


@dataclass(frozen=True)
class _Signal:
    """A value that depends on the observation, for a batch of one: `shape` and what computed it."""

    shape: tuple[int, ...]
    layers: tuple[Layer, ...]

    @property
    def size(self) -> int:
        return math.prod(self.shape)


def read_network(content: bytes) -> Network:
    """Read a network; `PolicyError` where it is not a chain of operators that are checkable."""
    import onnx
    from google.protobuf.message import DecodeError

    if len(content) > MAX_BYTES:
        raise PolicyError(f"the network has more than {MAX_BYTES} bytes")
    try:
        model = onnx.ModelProto.FromString(content)
    except (DecodeError, ValueError) as error:
        raise PolicyError("the bytes are no ONNX model") from error
    versions = [entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")]
    graph = model.graph
    if len(versions) != 1 or versions[0] not in OPSETS or model.functions or graph.sparse_initializer:
        raise PolicyError("not checkable: functions, sparse numbers or an unknown operator set")
    values: dict[str, _Constant | _Signal] = {}
    for tensor in graph.initializer:
        _define(values, tensor.name, _tensor(tensor))
    inputs = [value for value in graph.input if value.name not in values]
    if len(inputs) != 1 or len(graph.output) != 1:
        raise PolicyError("not checkable: one input and one output are required")
    start = _Signal(_input_shape(inputs[0]), ())
    _define(values, inputs[0].name, start)
    for node in graph.node:
        if node.domain not in ("", "ai.onnx") or len(node.output) != 1:
            raise PolicyError(f"not checkable: {node.op_type} of another domain or with several outputs")
        if any(name and name not in values for name in node.input):
            raise PolicyError(f"not checkable: {node.op_type} reads what no earlier operator computes")
        operands = [values[name] if name else None for name in node.input]
        _define(values, node.output[0], _apply(node.op_type, _attributes(node), operands))
    output = values.get(graph.output[0].name)
    if not isinstance(output, _Signal):
        raise PolicyError("not checkable: the output does not depend on the input")
    return Network(start.size, output.size, output.layers, hashlib.sha256(content).hexdigest())


def _define(values: dict[str, _Constant | _Signal], name: str, value: _Constant | _Signal) -> None:
    if name in values:
        raise PolicyError(f"not checkable: {name[:60]!r} is defined twice")
    values[name] = value


def _tensor(tensor: Any) -> _Constant:
    """Numbers of a stored array: float32, float64 and int64, inside the file."""
    kinds = {1: ("f", 4, "float_data"), 11: ("d", 8, "double_data"), 7: ("q", 8, "int64_data")}
    if tensor.data_type not in kinds or tensor.external_data or tensor.data_location:
        raise PolicyError(f"not checkable: the array {tensor.name[:60]!r} has an unknown type or is not in the file")
    code, width, field = kinds[tensor.data_type]
    count = math.prod(tensor.dims)
    if min(tensor.dims, default=0) < 0:
        raise PolicyError("not checkable: a negative dimension")
    if tensor.HasField("raw_data"):
        numbers: tuple[float, ...] = (
            struct.unpack(f"<{count}{code}", tensor.raw_data) if len(tensor.raw_data) == count * width else ()
        )
    else:
        numbers = tuple(getattr(tensor, field))
    if len(numbers) != count or any(math.isnan(x) for x in numbers):
        raise PolicyError(f"not checkable: the array {tensor.name[:60]!r} is incomplete or not finite")
    return _Constant(tuple(tensor.dims), numbers, code == "q")


def _input_shape(value: Any) -> tuple[int, ...]:
    if value.type.tensor_type.elem_type not in (1, 11):
        raise PolicyError("not checkable: an input of float32 or float64 is required")
    dims = [dim.dim_value if dim.HasField("dim_value") else None for dim in value.type.tensor_type.shape.dim]
    if len(dims) > 1:
        dims[0] = 1 if dims[0] is None else dims[0]
    if not dims or any(dim is None or dim < 1 for dim in dims) or (len(dims) > 1 and dims[0] != 1):
        raise PolicyError("not checkable: an input of shape (batch, observations) is required")
    return tuple(int(dim or 0) for dim in dims)


def _attributes(node: Any) -> dict[str, Any]:
    """Numbers and arrays beside an operator; floats are the stored float32 numbers."""
    readers: dict[int, Callable[[Any], Any]] = {1: lambda e: e.f, 2: lambda e: e.i, 4: lambda e: _tensor(e.t)}
    found: dict[str, Any] = {}
    for entry in node.attribute:
        if entry.type not in readers or entry.ref_attr_name or entry.name in found:
            raise PolicyError(f"not checkable: the attribute {entry.name[:60]!r} of {node.op_type}")
        found[entry.name] = readers[entry.type](entry)
    return found


_KNOWN = {
    "Gemm": {"alpha", "beta", "transA", "transB"},
    "LeakyRelu": {"alpha"},
    "Clip": {"min", "max"},
    "Flatten": {"axis"},
    "Reshape": {"allowzero"},
    "Cast": {"to", "saturate"},
    "Constant": {"value"},
    **{name: set() for name in ("MatMul", "Add", "Sub", "Mul", "Div", "Neg", "Relu", "Tanh", "Sigmoid", "Identity")},
}


def _apply(operator: str, attributes: dict[str, Any], operands: Sequence[Any]) -> _Constant | _Signal:
    if operator not in _KNOWN or set(attributes) - _KNOWN[operator]:
        raise PolicyError(
            f"not checkable: the operator {operator[:60]} with {', '.join(attributes) or 'no'} attributes"
        )
    if operator == "Constant":
        value = attributes.get("value")
        if not isinstance(value, _Constant):
            raise PolicyError("not checkable: a Constant without an array")
        return value
    if operator in ("Add", "Sub", "Mul", "Div"):
        return _arithmetic(operator, operands)
    if not operands or not isinstance(operands[0], _Signal):
        if operator == "Identity" and operands and isinstance(operands[0], _Constant):
            return operands[0]
        raise PolicyError(f"not checkable: {operator} of constants")
    signal, rest = operands[0], list(operands[1:])
    if operator in ("Gemm", "MatMul"):
        return _product(operator, attributes, signal, rest)
    if operator in ("Flatten", "Reshape", "Identity", "Cast"):
        return _trivial(operator, attributes, signal, rest)
    if rest and operator != "Clip":
        raise PolicyError(f"not checkable: {operator} with {len(operands)} operands")
    return _Signal(signal.shape, (*signal.layers, _elementwise(operator, attributes, rest)))


def _trivial(operator: str, attributes: dict[str, Any], signal: _Signal, rest: list[Any]) -> _Signal:
    """What only moves numbers, and moves none: the result is (1, n)."""
    if operator == "Identity" and not rest:
        return signal
    if operator == "Cast" and not rest:
        # narrowing is part of the deployed semantics only; anywhere but at the input the file itself would round
        if attributes.get("to") == 11 or (attributes.get("to") == 1 and not signal.layers):
            return signal
        raise PolicyError("not checkable: a Cast that rounds")
    flat = (1, signal.size)
    if operator == "Flatten" and not rest and attributes.get("axis", 1) == 1 and len(signal.shape) >= 2:
        return _Signal(flat, signal.layers)
    if operator == "Reshape" and len(rest) == 1 and isinstance(rest[0], _Constant) and rest[0].whole:
        target = rest[0].numbers
        rows = (1, -1) if attributes.get("allowzero", 0) else (0, 1, -1)
        if len(target) == 2 and target[0] in rows and target[1] in (signal.size, -1) and target != (-1, -1):
            return _Signal(flat, signal.layers)
    raise PolicyError(f"not checkable: a {operator} to something else than (batch, n)")


def _floats(value: Any, what: str) -> tuple[float, ...]:
    if not isinstance(value, _Constant) or value.whole or not all(map(math.isfinite, value.numbers)):
        raise PolicyError(f"not checkable: {what} must be finite constants")
    return value.numbers


def _row(value: Any, size: int, what: str) -> Vector:
    """A constant that is one number, or a row of `size` numbers behind dimensions of 1; as exact balls."""
    numbers = _floats(value, what)
    if len(numbers) == 1 and len(value.shape) <= 2:
        return [arb(numbers[0])] * size
    if len(value.shape) > 2 or value.shape[-1:] != (size,) or len(numbers) != size:
        raise PolicyError(f"not checkable: {what} of shape {value.shape} for {size} values")
    return [arb(number) for number in numbers]


def _arithmetic(operator: str, operands: Sequence[Any]) -> _Signal:
    signals = [operand for operand in operands if isinstance(operand, _Signal)]
    if len(operands) != 2 or len(signals) != 1 or signals[0].shape[-1] != signals[0].size:
        raise PolicyError(f"not checkable: {operator} of something else than a vector and a constant")
    first = isinstance(operands[0], _Signal)
    if len(signals[0].shape) > 2 or (operator == "Div" and not first):
        raise PolicyError(f"not checkable: {operator} by a signal")
    c = _row(operands[1 if first else 0], signals[0].size, f"the operand of {operator}")
    functions: dict[str, Callable[[Any, Any], Any]] = {
        "Add": lambda x, y: x + y,
        "Sub": (lambda x, y: x - y) if first else (lambda x, y: y - x),
        "Mul": lambda x, y: x * y,
        "Div": lambda x, y: x / y,
    }
    function = functions[operator]
    layer: Layer = lambda x: [function(a, b) for a, b in zip(x, c, strict=True)]  # noqa: E731
    return _Signal(signals[0].shape, (*signals[0].layers, layer))


def _product(operator: str, attributes: dict[str, Any], signal: _Signal, rest: list[Any]) -> _Signal:
    """``alpha x W + beta C`` on a row vector x."""
    if not rest or attributes.get("transA", 0) or (operator == "Gemm" and len(signal.shape) != 2):
        raise PolicyError(f"not checkable: {operator} of this form")
    numbers = _floats(rest[0], f"the matrix of {operator}")
    if len(rest[0].shape) != 2 or signal.shape[-1] != signal.size or len(rest) > (2 if operator == "Gemm" else 1):
        raise PolicyError(f"not checkable: {operator} of this shape")
    rows, columns = rest[0].shape
    stored = arb_mat(rows, columns, list(numbers))
    matrix = stored if attributes.get("transB", 0) else stored.transpose()
    count = matrix.nrows()
    if matrix.ncols() != signal.size or count == 0:
        raise PolicyError(f"not checkable: {operator} with a matrix that does not fit")
    alpha, beta = (arb(float(attributes.get(key, 1.0))) for key in ("alpha", "beta"))
    bias = _row(rest[1], count, "the bias") if len(rest) > 1 and rest[1] is not None else [arb(0)] * count

    def layer(x: Vector) -> Vector:
        product = matrix * arb_mat(len(x), 1, x)
        return [alpha * y + beta * b for y, b in zip(product.entries(), bias, strict=True)]

    return _Signal((*signal.shape[:-1], count), (*signal.layers, layer))


def _elementwise(operator: str, attributes: dict[str, Any], rest: list[Any]) -> Layer:
    if operator == "Clip":
        bounds = [attributes.get("min"), attributes.get("max")]
        for position, operand in enumerate(rest):
            if operand is None:
                continue
            if position > 1 or not isinstance(operand, _Constant) or operand.whole or len(operand.numbers) != 1:
                raise PolicyError("not checkable: Clip with bounds that are not two numbers")
            bounds[position] = operand.numbers[0]
        low, high = (-math.inf if bounds[0] is None else bounds[0]), (math.inf if bounds[1] is None else bounds[1])
        if not low <= high or low == math.inf or high == -math.inf:
            raise PolicyError("not checkable: Clip to an empty interval")
        return lambda x: [clip(a, arb(low), arb(high)) for a in x]
    slope = arb(float(attributes.get("alpha", struct.unpack("<f", struct.pack("<f", 0.01))[0])))
    functions: dict[str, Callable[[Any], Any]] = {
        "Relu": lambda a: a.max(arb(0)),
        "LeakyRelu": lambda a: a.max(arb(0)) + slope * a.min(arb(0)),
        "Tanh": lambda a: a.tanh(),
        "Sigmoid": lambda a: ((a / 2).tanh() + 1) / 2,
        "Neg": lambda a: -a,
    }
    function = functions[operator]
    return lambda x: [function(a) for a in x]


def clip(value: Any, low: Any, high: Any) -> Any:
    """``min(max(value, low), high)`` of balls; bounds may be infinite."""
    value = value if low == arb("-inf") else value.max(low)
    return value if high == arb("inf") else value.min(high)
