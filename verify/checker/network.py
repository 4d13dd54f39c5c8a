"""The policy network, read from the bytes of its ONNX file and evaluated in ball arithmetic.

Only chains of the common operators are read, for a batch of one observation; for anything else the answer is "not
checkable", never a guess. The meaning is the one of exact real arithmetic on the stored numbers.
"""

from __future__ import annotations

from dataclasses import dataclass

from ...specs.errors import PolicyError
from .layers import Dense, Layer, Vector, apply
from .movements import MAX_NUMBERS
from .onnx_file import File, read_file
from .operators import apply_operator
from .signals import Signal, Value, signal_of


@dataclass(frozen=True)
class Network:
    """A chain of layers.

    Attributes
    ----------
    inputs, outputs : int
    layers : tuple of Layer
    precision : {"float32", "float64"}
        Type in which the deployed network computes: float32 where anything on the way is.
    digest : str
        sha256 of the file's bytes.
    """

    inputs: int
    outputs: int
    layers: tuple[Layer, ...]
    precision: str
    digest: str

    def __call__(self, x: Vector) -> Vector:
        """Enclose the network's output for every point of a vector of balls."""
        for layer in self.layers:
            x = apply(layer, x)
        return x


def read_network(content: bytes) -> Network:
    """Read a network; `PolicyError` where it is not a chain of operators that are checkable."""
    file = read_file(content)
    values = _walk(file)
    output = values.get(file.output)
    if not isinstance(output, Signal):
        raise PolicyError("not checkable: the output does not depend on the input")
    if file.output_kind not in ("", output.kind):
        raise PolicyError(f"not checkable: the output is {output.kind}, declared {file.output_kind}")
    kinds = {value.kind for value in values.values() if isinstance(value, Signal)}
    inputs = values[file.input]
    assert isinstance(inputs, Signal)
    precision = "float32" if "float32" in kinds else "float64"
    return Network(inputs.size, output.size, output.settled, precision, file.digest)


def _walk(file: File) -> dict[str, Value]:
    """Every value of the graph by name."""
    start = signal_of(file.kind, file.shape, ())
    values: dict[str, Value] = {**file.arrays, file.input: start}
    numbers = start.size
    for node in file.nodes:
        if node.output in values:
            raise PolicyError(f"not checkable: {node.output[:60]!r} is defined twice")
        if any(name and name not in values for name in node.inputs):
            raise PolicyError(f"not checkable: {node.operator[:60]!r} reads what no earlier operator computes")
        value = apply_operator(node, [values[name] if name else None for name in node.inputs])
        values[node.output] = value
        numbers += _numbers(value)
        if numbers > 2 * MAX_NUMBERS:
            raise PolicyError(f"not checkable: a graph of more than {2 * MAX_NUMBERS} numbers")
    return values


def _numbers(value: Value) -> int:
    if not isinstance(value, Signal):
        return len(value.numbers)
    last = value.layers[-1] if value.layers else None
    return value.size + (len(last.matrix) * len(last.matrix[0]) if isinstance(last, Dense) else 0)
