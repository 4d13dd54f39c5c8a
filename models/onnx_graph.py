"""The bytes of an ONNX file as a checked graph: what is not in here cannot reach the rest of setrl.

The bytes are read once and parsed from memory. Anything that could make the file mean more than its own bytes
(external data, functions, subgraphs, foreign operator domains) is refused before a single operator is looked at.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..specs.errors import PolicyError

Array: TypeAlias = NDArray[Any]

SIZE_LIMIT = 64 * 2**20
"""Largest file that is read, in bytes."""

INPUT_LIMIT = 2**20
"""Largest number of observations."""

OPSETS = range(6, 26)
"""Versions of the ONNX operator set that are understood."""

_BOUNDS_OPERATORS = ("Clip", "Max", "Min")
"""Operators whose constants may be infinite: a bound that does not bind."""


@dataclass(frozen=True)
class Node:
    """One operator: `inputs` and `outputs` are value names, an empty name is an optional input that is absent."""

    operator: str
    inputs: tuple[str, ...]
    outputs: tuple[str, ...]
    attributes: Mapping[str, Any]
    label: str


@dataclass(frozen=True)
class Graph:
    """A graph with one input and one output.

    Attributes
    ----------
    nodes : tuple of Node, in topological order
    constants : mapping of value name to array
        Initializers; the arrays of `Constant` nodes are attributes of their nodes.
    input, output : str
    input_shape : tuple of int
        Without the batch where `batched`.
    batched : bool
        The first dimension of the input is dynamic.
    dtype : numpy dtype of the input, float32 or float64
    opset : int
    content : bytes
    name, digest : str
    """

    nodes: tuple[Node, ...]
    constants: Mapping[str, Array]
    input: str
    output: str
    input_shape: tuple[int, ...]
    batched: bool
    dtype: np.dtype[Any]
    opset: int
    content: bytes
    name: str
    digest: str


def read_bytes(source: str | Path | bytes) -> tuple[bytes, str]:
    """Bytes of a file (or the given bytes) and a name for messages; nothing is read twice.

    Raises
    ------
    PolicyError
        The file is missing, unreadable, or larger than `SIZE_LIMIT`.
    """
    if isinstance(source, bytes):
        content, name = source, "policy"
    else:
        path = Path(source)
        name = path.name
        try:
            with path.open("rb") as file:
                content = file.read(SIZE_LIMIT + 1)
        except OSError as error:
            reason = error.strerror or str(error)
            raise PolicyError(
                f"cannot read the policy: {reason}", where=str(path), remedy="give the path of an ONNX file"
            ) from error
    if len(content) > SIZE_LIMIT:
        raise PolicyError(
            f"the file is larger than {SIZE_LIMIT // 2**20} MiB", where=name, remedy="policies are small networks"
        )
    return content, name


def parse_graph(content: bytes, name: str) -> Graph:
    """Parse the bytes of an ONNX file.

    Parameters
    ----------
    content : bytes
    name : str
        For messages.

    Returns
    -------
    Graph

    Raises
    ------
    PolicyError
        The bytes are not an ONNX model, or the model has more than its own numbers and plain operators.
    """
    model = _decode(content, name)
    problems = _foreign_parts(model)
    if problems:
        raise PolicyError(
            "the model is not self-contained: " + "; ".join(problems),
            where=name,
            remedy="export one plain graph with its weights inside the file",
        )
    opset = _opset(model, name)
    graph = model.graph
    constants = {tensor.name: _array(tensor, name) for tensor in graph.initializer}
    nodes = tuple(_node(node, position, name) for position, node in enumerate(graph.node))
    inputs = [value for value in graph.input if value.name not in constants]
    _require_single(inputs, "input", name)
    _require_single(graph.output, "output", name)
    _require_unique_names(nodes, constants, inputs[0].name, len(graph.initializer), name)
    _require_finite(nodes, constants, name)
    shape, batched, dtype = _input_type(inputs[0], name)
    return Graph(
        nodes=nodes,
        constants=constants,
        input=inputs[0].name,
        output=graph.output[0].name,
        input_shape=shape,
        batched=batched,
        dtype=dtype,
        opset=opset,
        content=content,
        name=name,
        digest=hashlib.sha256(content).hexdigest(),
    )


def _decode(content: bytes, name: str) -> Any:
    import onnx
    from google.protobuf.message import DecodeError

    remedy = "give an ONNX file, exported with its weights inside"
    try:
        model = onnx.load_model_from_string(content)
    except (DecodeError, ValueError, RuntimeError) as error:
        raise PolicyError("the file is not an ONNX model", where=name, remedy=remedy) from error
    if model.ir_version < 1 or not model.opset_import or not model.HasField("graph"):
        raise PolicyError(
            "the file is not an ONNX model: it has no IR version, operator set or graph", where=name, remedy=remedy
        )
    if not all(isinstance(text, str) for text in _texts(model)):
        raise PolicyError("the file is not an ONNX model: a name in it is not UTF-8 text", where=name, remedy=remedy)
    return model


def _texts(model: Any) -> Iterator[Any]:
    """Every name of a model; protobuf hands out bytes where the text is broken."""
    graph = model.graph
    for node in graph.node:
        yield from (node.name, node.op_type, node.domain, *node.input, *node.output)
        for attribute in node.attribute:
            yield from (attribute.name, attribute.ref_attr_name, attribute.t.name)
    for named in (*model.functions, *graph.initializer, *graph.value_info):
        yield named.name
    for value in (*graph.input, *graph.output):
        yield value.name
        yield from (dim.dim_param for dim in value.type.tensor_type.shape.dim)
    yield from (entry.domain for entry in model.opset_import)


def _foreign_parts(model: Any) -> list[str]:
    """Everything that makes the file mean more than its own numbers and plain operators, all of it at once."""
    import onnx

    problems = []
    graph = model.graph
    if model.functions:
        problems.append("functions: " + ", ".join(function.name for function in model.functions))
    if model.training_info:
        problems.append("training information")
    if graph.sparse_initializer:
        problems.append("sparse initializers")
    tensors = list(graph.initializer)
    for position, node in enumerate(graph.node):
        label = node.name or f"node {position}"
        if node.domain not in ("", "ai.onnx"):
            problems.append(f"{node.op_type} ({label}) of the foreign domain {node.domain}")
        for attribute in node.attribute:
            if attribute.type in (onnx.AttributeProto.GRAPH, onnx.AttributeProto.GRAPHS):
                problems.append(f"{node.op_type} ({label}) has a subgraph")
            if attribute.ref_attr_name:
                problems.append(f"{node.op_type} ({label}) refers to a function's attribute")
            if attribute.type == onnx.AttributeProto.TENSOR:
                tensors.append(attribute.t)
    for tensor in tensors:
        if tensor.data_location == onnx.TensorProto.EXTERNAL or tensor.external_data:
            problems.append(f"external data: {tensor.name or 'a constant'}")
    return problems


def _opset(model: Any, name: str) -> int:
    versions = [entry.version for entry in model.opset_import if entry.domain in ("", "ai.onnx")]
    if len(versions) != 1 or versions[0] not in OPSETS:
        received = ", ".join(map(str, versions)) or "none"
        raise PolicyError(
            f"one ONNX operator set of version {OPSETS.start} to {OPSETS.stop - 1} is required, received {received}",
            where=name,
            remedy="export with another opset_version",
        )
    return int(versions[0])


def _array(tensor: Any, name: str) -> Array:
    import onnx

    types = onnx.TensorProto
    if tensor.data_type not in (types.FLOAT, types.DOUBLE, types.INT64, types.INT32, types.BOOL):
        kind = types.DataType.Name(tensor.data_type) if tensor.data_type in types.DataType.values() else "unknown"
        raise PolicyError(
            f"tensor {tensor.name or 'of a constant'} has type {kind}; float32 or float64 is required",
            where=name,
            remedy="export the network in float32 or float64, not quantized",
        )
    try:
        return np.array(onnx.numpy_helper.to_array(tensor))
    except (ValueError, TypeError, RuntimeError) as error:
        raise PolicyError(
            f"tensor {tensor.name or 'of a constant'} does not have as many numbers as its shape says", where=name
        ) from error


def _node(node: Any, position: int, name: str) -> Node:
    import onnx

    attributes: dict[str, Any] = {}
    for attribute in node.attribute:
        if attribute.name in attributes:
            raise PolicyError(f"{node.op_type} has attribute {attribute.name} twice", where=name)
        value = onnx.helper.get_attribute_value(attribute)
        if attribute.type == onnx.AttributeProto.TENSOR:
            value = _array(attribute.t, name)
        elif isinstance(value, bytes):
            value = value.decode("utf-8", "replace")
        attributes[attribute.name] = value
    if not node.output:
        raise PolicyError(f"{node.op_type} ({node.name or f'node {position}'}) has no output", where=name)
    label = node.name or node.output[0] or f"node {position}"
    return Node(node.op_type, tuple(node.input), tuple(node.output), attributes, label)


def _require_single(values: Any, what: str, name: str) -> None:
    if len(values) != 1:
        listed = ", ".join(value.name for value in values) or "none"
        raise PolicyError(
            f"one {what} is required, received {len(values)}: {listed}",
            where=name,
            remedy="export a network that maps one observation vector to one action vector",
        )


def _require_unique_names(
    nodes: tuple[Node, ...], constants: Mapping[str, Array], input_name: str, initializers: int, name: str
) -> None:
    if len(constants) != initializers:
        raise PolicyError("two initializers have the same name", where=name)
    seen = {input_name, *constants}
    for node in nodes:
        for value in node.inputs:
            if value and value not in seen:
                raise PolicyError(
                    f"{node.operator} ({node.label}) reads {value}, which no earlier operator computes", where=name
                )
        for value in node.outputs:
            if value and value in seen:
                raise PolicyError(f"value {value} is defined twice", where=name)
            seen.add(value)


def _require_finite(nodes: tuple[Node, ...], constants: Mapping[str, Array], name: str) -> None:
    bad = []
    tensors = dict(constants)
    for node in nodes:
        if node.operator == "Constant":
            for value in node.attributes.values():
                tensors[node.outputs[0]] = np.asarray(value)
    for key, array in tensors.items():
        if array.dtype.kind != "f" or np.isfinite(array).all():
            continue
        readers = {node.operator for node in nodes if key in node.inputs}
        if np.isnan(array).any() or not readers <= set(_BOUNDS_OPERATORS):
            bad.append(key)
    if bad:
        raise PolicyError(
            "all weights must be finite; not finite: " + ", ".join(bad),
            where=name,
            remedy="training diverged or the export is broken",
        )


def _input_type(value: Any, name: str) -> tuple[tuple[int, ...], bool, np.dtype[Any]]:
    import onnx

    tensor = value.type.tensor_type
    dtypes: dict[int, np.dtype[Any]] = {onnx.TensorProto.FLOAT: np.dtype(np.float32)}
    dtypes[onnx.TensorProto.DOUBLE] = np.dtype(np.float64)
    if not value.type.HasField("tensor_type") or tensor.elem_type not in dtypes:
        raise PolicyError(f"input {value.name} must be a tensor of float32 or float64", where=name)
    if not tensor.HasField("shape") or not tensor.shape.dim:
        raise PolicyError(
            f"input {value.name} has no shape; (batch, observations) is required",
            where=name,
            remedy="export with a declared input shape",
        )
    dims = [dim.dim_value if dim.HasField("dim_value") else None for dim in tensor.shape.dim]
    listed = "(" + ", ".join("dynamic" if dim is None else str(dim) for dim in dims) + ")"
    batched = dims[0] is None
    sizes = [dim for dim in dims[batched:] if dim is not None]
    if len(sizes) != len(dims) - batched or not sizes or any(size < 1 for size in sizes):
        raise PolicyError(
            f"input {value.name} has shape {listed}; only the first dimension (the batch) may be dynamic",
            where=name,
            remedy="export with a fixed number of observations",
        )
    if math.prod(sizes) > INPUT_LIMIT:
        raise PolicyError(f"input {value.name} has {math.prod(sizes)} numbers; the limit is {INPUT_LIMIT}", where=name)
    if not batched and len(sizes) > 1 and sizes[0] != 1:
        raise PolicyError(
            f"input {value.name} has shape {listed}; the batch must be dynamic or 1",
            where=name,
            remedy="export with a batch of one",
        )
    return tuple(sizes), batched, dtypes[tensor.elem_type]
