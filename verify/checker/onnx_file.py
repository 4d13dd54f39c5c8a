"""The bytes of an ONNX file as operators and stored arrays: plain data, and nothing that the bytes do not contain."""

from __future__ import annotations

import hashlib
import math
import struct
import sys
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.util import find_spec, module_from_spec, spec_from_file_location
from pathlib import Path
from typing import Any

from ...specs.errors import PolicyError

MAX_BYTES = 64 << 20
MAX_RANK = 32
OPSETS = range(6, 26)

# TensorProto.DataType: name, format of one number in raw_data, field of the message that holds the numbers otherwise
_KINDS = {
    1: ("float32", "f", "float_data"),
    11: ("float64", "d", "double_data"),
    6: ("int32", "i", "int32_data"),
    7: ("int64", "q", "int64_data"),
    9: ("bool", "B", "int32_data"),
}
_FIELDS = ("float_data", "double_data", "int32_data", "int64_data", "uint64_data", "string_data")
KINDS = {number: kind for number, (kind, _, _) in _KINDS.items()}
"""Types of numbers that are read, by their number in the format."""


@dataclass(frozen=True)
class Array:
    """Stored numbers, flat, in C order.

    Attributes
    ----------
    kind : {"float32", "float64", "int32", "int64", "bool"}
    shape : tuple of int
    numbers : tuple of float or int
        Of ints where `kind` is no float; infinite numbers are possible, NaN is not.
    """

    kind: str
    shape: tuple[int, ...]
    numbers: tuple[Any, ...]


@dataclass(frozen=True)
class Node:
    """One operator of version `opset`; an empty name in `inputs` is an operand that is left out."""

    operator: str
    opset: int
    attributes: dict[str, Any]
    inputs: tuple[str, ...]
    output: str


@dataclass(frozen=True)
class File:
    """What an ONNX file contains.

    Attributes
    ----------
    arrays : dict
        Stored arrays by name.
    nodes : tuple of Node
    input, output : str
        Names; the input is no stored array.
    kind : {"float32", "float64"}
        Type of the input.
    shape : tuple of int
        Of the input, for a batch of one.
    output_kind : str
        Declared type of the output, "" where none is declared.
    digest : str
        sha256 of the bytes.
    """

    arrays: dict[str, Array]
    nodes: tuple[Node, ...]
    input: str
    output: str
    kind: str
    shape: tuple[int, ...]
    output_kind: str
    digest: str


@cache
def _message_type() -> Any:
    """The generated message class of ONNX models, without the package around it: that would load numpy."""
    if "onnx" in sys.modules:
        return sys.modules["onnx"].ModelProto
    package = find_spec("onnx")
    folder = None if package is None or package.origin is None else Path(package.origin).parent
    if folder is None:
        raise PolicyError("the package onnx is not installed")
    spec = spec_from_file_location("onnx_ml_pb2", folder / "onnx_ml_pb2.py")
    assert spec is not None and spec.loader is not None
    module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module.ModelProto


def read_file(content: bytes) -> File:
    """Read a file of plain operators with one input and one output; `PolicyError` for everything else."""
    from google.protobuf.message import DecodeError

    if len(content) > MAX_BYTES:
        raise PolicyError(f"the network has more than {MAX_BYTES} bytes")
    try:
        model = _message_type().FromString(content)
    except (DecodeError, ValueError) as error:
        raise PolicyError("the bytes are no ONNX model") from error
    versions = [entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")]
    graph = model.graph
    if len(versions) != 1 or versions[0] not in OPSETS:
        raise PolicyError("not checkable: an unknown operator set")
    if model.functions or model.training_info or graph.sparse_initializer:
        raise PolicyError("not checkable: functions, training information or sparse numbers")
    arrays: dict[str, Array] = {}
    for tensor in graph.initializer:
        if not tensor.name or tensor.name in arrays:
            raise PolicyError(f"not checkable: {tensor.name[:60]!r} is defined twice")
        arrays[tensor.name] = _array(tensor)
    inputs = [value for value in graph.input if value.name not in arrays]
    if len(inputs) != 1 or not inputs[0].name or len(graph.output) != 1:
        raise PolicyError("not checkable: one input and one output are required")
    kind, shape = _input_type(inputs[0].type.tensor_type)
    declared = graph.output[0].type.tensor_type.elem_type
    return File(
        arrays=arrays,
        nodes=tuple(_node(node, versions[0]) for node in graph.node),
        input=inputs[0].name,
        output=graph.output[0].name,
        kind=kind,
        shape=shape,
        output_kind=KINDS.get(declared, "unknown") if declared else "",
        digest=hashlib.sha256(content).hexdigest(),
    )


def _input_type(tensor: Any) -> tuple[str, tuple[int, ...]]:
    """Type and shape of an input; a batch whose size is open is a batch of one."""
    kind = KINDS.get(tensor.elem_type, "")
    if kind not in ("float32", "float64"):
        raise PolicyError("not checkable: an input of float32 or float64 is required")
    dims = [dim.dim_value if dim.HasField("dim_value") else None for dim in tensor.shape.dim]
    if len(dims) > 1 and dims[0] is None:
        dims[0] = 1
    shape = tuple(dim for dim in dims if dim is not None)
    if not shape or len(shape) != len(dims) or min(shape) < 1 or (len(shape) > 1 and shape[0] != 1):
        raise PolicyError("not checkable: an input of shape (batch, observations) is required")
    return kind, shape


def _node(node: Any, opset: int) -> Node:
    if node.domain not in ("", "ai.onnx"):
        raise PolicyError(f"not checkable: {node.op_type[:60]!r} of another domain")
    if not node.output or not node.output[0] or any(node.output[1:]):
        raise PolicyError(f"not checkable: {node.op_type[:60]!r} without or with several outputs")
    return Node(node.op_type, opset, _attributes(node), tuple(node.input), node.output[0])


def _attributes(node: Any) -> dict[str, Any]:
    """Numbers, texts and arrays beside an operator; a float is the stored float32 number."""
    readers: dict[int, Callable[[Any], Any]] = {
        1: lambda entry: entry.f,
        2: lambda entry: entry.i,
        3: lambda entry: entry.s,
        4: lambda entry: _array(entry.t),
        6: lambda entry: _stored("float32", (len(entry.floats),), entry.floats),
        7: lambda entry: _stored("int64", (len(entry.ints),), entry.ints),
    }
    found: dict[str, Any] = {}
    for entry in node.attribute:
        if entry.type not in readers or entry.ref_attr_name or entry.name in found:
            raise PolicyError(f"not checkable: the attribute {entry.name[:60]!r} of {node.op_type[:60]!r}")
        found[entry.name] = readers[entry.type](entry)
    return found


def _array(tensor: Any) -> Array:
    """The numbers of a stored array, all of them inside the file and in one place."""
    what = f"not checkable: the array {tensor.name[:60]!r}"
    if tensor.data_type not in _KINDS or tensor.external_data or tensor.data_location or tensor.HasField("segment"):
        raise PolicyError(f"{what} has an unknown type or is not in the file")
    kind, code, field = _KINDS[tensor.data_type]
    raw = tensor.HasField("raw_data")
    if any(len(getattr(tensor, other)) for other in _FIELDS if raw or other != field):
        raise PolicyError(f"{what} is stored twice")
    if len(tensor.dims) > MAX_RANK or min(tensor.dims, default=0) < 0:
        raise PolicyError(f"{what} has a negative dimension, or too many")
    layout = f"<{len(tensor.raw_data) // struct.calcsize(f'<{code}')}{code}"
    if raw and struct.calcsize(layout) != len(tensor.raw_data):
        raise PolicyError(f"{what} is incomplete")
    return _stored(kind, tuple(tensor.dims), struct.unpack(layout, tensor.raw_data) if raw else getattr(tensor, field))


def _stored(kind: str, shape: tuple[int, ...], numbers: Sequence[Any]) -> Array:
    flat = tuple(numbers)
    if len(flat) != math.prod(shape):
        raise PolicyError("not checkable: an array does not have as many numbers as its shape says")
    if kind.startswith("float") and any(map(math.isnan, flat)):
        raise PolicyError("not checkable: an array contains what is no number")
    if kind == "bool" and not set(flat) <= {0, 1}:
        raise PolicyError("not checkable: a truth value that is neither 0 nor 1")
    return Array(kind, shape, flat)
