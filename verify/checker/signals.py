"""Symbolic values while an ONNX graph is read: stored arrays, and signals that depend on the observation."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from ...specs.errors import PolicyError
from .layers import Layer, Selection
from .movements import broadcast
from .onnx_file import Array, Node


@dataclass(frozen=True)
class Signal:
    """A value that depends on the observation, for a batch of one.

    Attributes
    ----------
    kind : {"float32", "float64"}
        Type in which the file computes it.
    shape : tuple of int
    index : tuple of int
        Which output of the layers stands at each of its places, in C order.
    width : int
        Number of the layers' outputs.
    layers : tuple of Layer
        What computes them from the observation.
    """

    kind: str
    shape: tuple[int, ...]
    index: tuple[int, ...]
    width: int
    layers: tuple[Layer, ...]

    @property
    def size(self) -> int:
        """Number of components."""
        return len(self.index)

    @property
    def settled(self) -> tuple[Layer, ...]:
        """Layers whose outputs are the components in C order."""
        if self.index == tuple(range(self.width)):
            return self.layers
        return (*self.layers, Selection(self.index))


Value: TypeAlias = Array | Signal
Operands: TypeAlias = Sequence[Value | None]


def signal_of(kind: str, shape: tuple[int, ...], layers: tuple[Layer, ...]) -> Signal:
    """The value whose components in C order are what the layers compute."""
    size = math.prod(shape)
    return Signal(kind, shape, tuple(range(size)), size, layers)


def refusal(node: Node, reason: str) -> PolicyError:
    """The error that says why an operator is not checkable."""
    return PolicyError(f"not checkable: the operator {node.operator[:60]!r} {reason}")


def signal_operand(node: Node, value: Value | None) -> Signal:
    """An operand that must depend on the observation."""
    if not isinstance(value, Signal):
        raise refusal(node, "computes with constants only")
    return value


def finite(node: Node, value: Value | None, kind: str) -> Array:
    """A stored array of finite numbers of the type with which it is combined."""
    if not isinstance(value, Array) or value.kind != kind or not all(map(math.isfinite, value.numbers)):
        raise refusal(node, f"needs a constant array of finite {kind} numbers")
    return value


def pair(node: Node, operands: Operands) -> tuple[Signal, Value | None, bool]:
    """The signal of a signal and something else, that other, and whether the signal comes first."""
    first, second = operands
    return (first, second, True) if isinstance(first, Signal) else (signal_operand(node, second), first, False)


def spread(constant: Array, shape: tuple[int, ...]) -> tuple[Any, ...]:
    """The number of a stored array that meets each place of an array of a shape that it does not enlarge."""
    return tuple(constant.numbers[place] for place in broadcast(constant.shape, shape))
