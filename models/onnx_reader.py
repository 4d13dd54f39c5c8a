"""An ONNX file as a `Policy`: one chain of affine maps and activations with exactly the file's numbers."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..specs.errors import PolicyError
from .onnx_graph import Graph, parse_graph, read_bytes
from .onnx_operators import apply_operator, supported_operators
from .onnx_runtime import require_agreement
from .onnx_values import MATRIX_LIMIT, Signal, Unsupported, Value, new_signal, settled
from .policy import Affine, Layer, Policy


@dataclass(frozen=True)
class _Walk:
    """What became of a graph: its output where everything was understood, and every problem met on the way."""

    output: Signal | None
    precision: str
    problems: tuple[str, ...]


def read_policy(source: str | Path | bytes) -> Policy:
    """Read a policy network from an ONNX file.

    The bytes are read once; the network is understood by this reader and run by onnxruntime from the same bytes, and
    both must agree on fixed random points.

    Parameters
    ----------
    source : path or bytes

    Returns
    -------
    Policy

    Raises
    ------
    PolicyError
        The file is not a self-contained ONNX model, contains something that is not supported (all of it is listed at
        once), or the reader and onnxruntime disagree.
    """
    graph = parse_graph(*read_bytes(source))
    walk = _walk(graph)
    if walk.problems:
        raise PolicyError(
            "the network contains what is not supported: " + "; ".join(walk.problems),
            where=graph.name,
            remedy="supported operators: " + ", ".join(supported_operators()),
        )
    if walk.output is None:
        raise PolicyError("the output does not depend on the input", where=graph.name, remedy="export the network")
    policy = _policy(graph, walk.output, walk.precision)
    require_agreement(policy)
    return policy


def describe_policy(source: str | Path | bytes) -> dict[str, Any]:
    """What is in an ONNX file, for people; unsupported operators are listed, not raised.

    Parameters
    ----------
    source : path or bytes

    Returns
    -------
    dict
        ``name``, ``digest`` (sha256), ``bytes``, ``opset``, ``inputs``, ``outputs`` (None where unsupported),
        ``batch`` ("dynamic" or "fixed"), ``precision``, ``operators`` (name to count), ``parameters`` (count of
        floating-point constants), ``layers`` (list of text), ``problems`` (list of text), ``supported`` (bool).

    Raises
    ------
    PolicyError
        The file is not a self-contained ONNX model.
    """
    graph = parse_graph(*read_bytes(source))
    walk = _walk(graph)
    layers = settled(walk.output) if walk.output is not None and not walk.problems else ()
    constants = [array for array in graph.constants.values() if array.dtype.kind == "f"]
    constants += [
        value
        for node in graph.nodes
        for value in node.attributes.values()
        if isinstance(value, np.ndarray) and value.dtype.kind == "f"
    ]
    return {
        "name": graph.name,
        "digest": graph.digest,
        "bytes": len(graph.content),
        "opset": graph.opset,
        "inputs": int(np.prod(graph.input_shape)),
        "outputs": walk.output.size if walk.output is not None else None,
        "batch": "dynamic" if graph.batched else "fixed",
        "precision": walk.precision,
        "operators": dict(Counter(node.operator for node in graph.nodes)),
        "parameters": sum(array.size for array in constants),
        "layers": [describe_layer(layer) for layer in layers],
        "problems": list(walk.problems),
        "supported": walk.output is not None and not walk.problems,
    }


def describe_layer(layer: Layer) -> str:
    """One layer in words: ``affine 4 -> 64``, ``relu``, ``clip [-1, 1]``."""
    if isinstance(layer, Affine):
        rows, columns = layer.weight.shape
        return f"affine {columns} -> {rows}"
    if layer.kind == "clip":
        return f"clip [{layer.lower:g}, {layer.upper:g}]"
    return f"leaky_relu {layer.slope:g}" if layer.kind == "leaky_relu" else layer.kind


def _walk(graph: Graph) -> _Walk:
    """Run the graph over symbolic values. A value that could not be understood is absent; what reads it is skipped,
    except that its operator must be a supported one, so that one run lists every unsupported operator.
    """
    start = new_signal((), graph.input_shape, graph.batched, graph.dtype)
    values: dict[str, Value] = {graph.input: start, **graph.constants}
    problems: list[str] = []
    dtypes = {graph.dtype}
    entries = 0
    supported = supported_operators()
    for node in graph.nodes:
        known = all(not name or name in values for name in node.inputs)
        try:
            if node.operator not in supported:
                raise Unsupported("is not a supported operator")
            if not known:
                continue
            value = apply_operator(node, [values[name] if name else None for name in node.inputs])
        except Unsupported as problem:
            problems.append(f"{node.operator} ({node.label}) {problem}")
            continue
        values[node.outputs[0]] = value
        if isinstance(value, Signal):
            dtypes.add(value.dtype)
            last = value.layers[-1] if value.layers else None
            entries += last.weight.size if isinstance(last, Affine) else 0
            if entries > 2 * MATRIX_LIMIT:
                problems.append(f"the layers have more than {2 * MATRIX_LIMIT} matrix entries")
                break
    output = values.get(graph.output)
    precision = "float32" if np.dtype(np.float32) in dtypes else "float64"
    return _Walk(output if isinstance(output, Signal) else None, precision, tuple(problems))


def _policy(graph: Graph, output: Signal, precision: str) -> Policy:
    return Policy(
        layers=settled(output),
        inputs=int(np.prod(graph.input_shape)),
        outputs=output.size,
        precision=precision,
        name=graph.name,
        digest=graph.digest,
        content=graph.content,
        operators=tuple(node.operator for node in graph.nodes),
        opset=graph.opset,
    )
