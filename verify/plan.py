"""A tape compiled for Taylor series: nodes, grouped so that one array operation computes all of a kind on one level."""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..models.tape import Tape, run

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class Node:
    """One series. `operands` are needed up to coefficient k for coefficient k; `lagged` (the r of a primitive, times
    `sign`) only up to k - 1.
    """

    kind: str
    operands: tuple[int, ...] = ()
    lagged: int = -1
    sign: int = 1
    function: str = ""
    value: Fraction | None = None


class _Builder:
    """The algebra of nodes for `models.tape.run`: records the graph."""

    def __init__(self) -> None:
        self.nodes: list[Node] = []
        self.known: dict[Node, int] = {}

    def new(self, node: Node) -> int:
        self.nodes.append(node)
        return len(self.nodes) - 1

    def shared(self, node: Node) -> int:
        if node not in self.known:
            self.known[node] = self.new(node)
        return self.known[node]

    def lag(self, node: int, lagged: int, sign: int = 1) -> int:
        """Set what a primitive integrates, once that node exists."""
        self.nodes[node] = replace(self.nodes[node], lagged=lagged, sign=sign)
        return node

    def primitive(self, function: str, a: int) -> int:
        return self.new(Node("primitive", (a,), function=function))

    def constant(self, value: Fraction) -> int:
        return self.shared(Node("constant", value=value))

    def add(self, a: int, b: int) -> int:
        return self.new(Node("add", (a, b)))

    def subtract(self, a: int, b: int) -> int:
        return self.new(Node("subtract", (a, b)))

    def negate(self, a: int) -> int:
        return self.new(Node("negate", (a,)))

    def multiply(self, a: int, b: int) -> int:
        return self.new(Node("product", (a, b)))

    def square(self, a: int) -> int:
        return self.new(Node("square", (a, a)))

    def reciprocal(self, a: int) -> int:
        return self.shared(Node("reciprocal", (a,)))

    def divide(self, a: int, b: int) -> int:
        return self.multiply(a, self.reciprocal(b))

    def sincos(self, a: int) -> tuple[int, int]:
        sine, cosine = self.primitive("sin", a), self.primitive("cos", a)
        return self.lag(sine, cosine), self.lag(cosine, sine, -1)

    def exp(self, a: int) -> int:
        result = self.primitive("exp", a)
        return self.lag(result, result)

    def log(self, a: int) -> int:
        return self.lag(self.primitive("log", a), self.reciprocal(a))

    def sqrt(self, a: int) -> int:
        result = self.primitive("sqrt", a)
        return self.lag(result, self.reciprocal(self.add(result, result)))

    def tanh(self, a: int) -> int:
        result = self.primitive("tanh", a)
        return self.lag(result, self.subtract(self.constant(Fraction(1)), self.square(result)))


@dataclass(frozen=True)
class Group:
    """Nodes of one kind on one level: positions `start` .. `stop` of the storage.

    `first` and `second` are the positions of the operands, `lagged` of what primitives integrate, `signs` its signs,
    shape (V, 1, 1).
    """

    kind: str
    start: int
    stop: int
    first: Indices
    second: Indices
    lagged: Indices
    signs: Array
    functions: tuple[str, ...]
    values: tuple[Fraction | None, ...]


@dataclass(frozen=True)
class Plan:
    """A tape as groups of series.

    Attributes
    ----------
    inputs : int
        Positions 0 .. inputs - 1 are the tape's inputs; with a time dimension the first ones are the states.
    groups : tuple of Group
        In the order in which coefficient k is computed.
    outputs : array of int
        Position of each output.
    used : array of int
        Inputs that the tape reads at all. The flow of a vector field is the identity in the others (plus a motion that
        does not depend on them), so nothing needs to be differentiated by them.
    unused_states : array of int
        States (inputs at the positions of outputs) that are not used.
    size : int
        Number of series.
    """

    inputs: int
    groups: tuple[Group, ...]
    outputs: Indices
    used: Indices
    unused_states: Indices
    size: int


@lru_cache(maxsize=64)
def plan_of(tape: Tape) -> Plan:
    """Compile a tape."""
    builder = _Builder()
    inputs = [builder.new(Node("input")) for _ in tape.inputs]
    outputs = run(tape, builder, inputs)
    nodes = builder.nodes
    levels: list[int] = []

    def level(i: int) -> int:
        return levels[i] if i < len(levels) else -1

    for node in nodes:
        # operands always precede their node; only `lagged` may point forward
        levels.append(0 if node.kind == "input" else 1 + max((level(i) for i in node.operands), default=0))
    keys = sorted({(levels[i], node.kind) for i, node in enumerate(nodes) if node.kind != "input"})
    position = {i: i for i in range(len(inputs))}
    members_of = {}
    for key in keys:
        members_of[key] = [i for i, node in enumerate(nodes) if (levels[i], node.kind) == key]
        for i in members_of[key]:
            position[i] = len(position)
    groups = []
    for key in keys:
        members = members_of[key]
        chosen = [nodes[i] for i in members]
        start = position[members[0]]

        def operand(number: int, chosen: list[Node] = chosen) -> Indices:
            return np.array([position[n.operands[number]] for n in chosen if len(n.operands) > number], dtype=np.intp)

        lagged = np.array([position[n.lagged] for n in chosen if n.lagged >= 0], dtype=np.intp)
        signs = np.array([float(n.sign) for n in chosen])[:, None, None]
        functions, values = tuple(n.function for n in chosen), tuple(n.value for n in chosen)
        groups.append(
            Group(key[1], start, start + len(members), operand(0), operand(1), lagged, signs, functions, values)
        )
    outs = np.array([position[i] for i in outputs], dtype=np.intp)
    read = {i for node in nodes for i in node.operands} | set(outputs)
    used = np.array(sorted(i for i in read if i < len(inputs)), dtype=np.intp)
    unused = np.array([i for i in range(min(len(outputs), len(inputs))) if i not in read], dtype=np.intp)
    return Plan(len(inputs), tuple(groups), outs, used, unused, len(nodes))
