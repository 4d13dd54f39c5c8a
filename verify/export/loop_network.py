"""The closed loop, unrolled over some periods, as one network.

    x_(k+1) = sum_(j<=order) phi_j(x_k, u_k, d_k) h^j + w_k,    u_k = controller(observation(x_k) + e_k),

with e_k, d_k, w_k in boxes; and at a share s of period k, s in [0, 1]: sum_j phi_j (h s)^j + v_k. The inputs are
numbers in their own units: the box that a query gives them is the only place where their size is written.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, Literal, TypeAlias

from ...specs.specification import Bounds
from ..checker.layout import observation_program
from .graph import Graph
from .loop_bounds import Remainder, held_terms, remainders, step_values
from .period_network import Controller
from .series import Term, Terms, map_values
from .sources import Source

Output: TypeAlias = tuple[Literal["at", "during"], int]
"""``("at", k)``: the state at sampling instant k; ``("during", k)``: at some time of period k."""


@dataclass(frozen=True)
class Input:
    """One input of an unrolled loop.

    Attributes
    ----------
    kind : str
        "initial" state, "perturbation" of an observed component, "disturbance", "remainder" at a period's end or
        "during" it, or "share" of a period.
    period : int or None
        None where it does not belong to a period.
    position : int
        Which state, component or disturbance.
    bounds : Bounds
        Every value that it can have.
    """

    kind: str
    period: int | None
    position: int
    bounds: Bounds


@dataclass(frozen=True)
class Loop:
    """What the networks of one leaf are made of.

    Attributes
    ----------
    source : Source
    leaf : int
    order : int
        Of the polynomials.
    remainders : tuple of Remainder
        Of every period that can be unrolled.
    controller : Controller
    """

    source: Source
    leaf: int
    order: int
    remainders: tuple[Remainder, ...]
    controller: Controller

    @classmethod
    def of(cls, source: Source, leaf: int, periods: int, order: int) -> Loop:
        """Bound what is left out; `InputError` where that is not possible."""
        found = tuple(remainders(source, leaf, periods, order))
        return cls(source, leaf, order, found, Controller.of(source))


@dataclass(frozen=True)
class LoopNetwork:
    """A network.

    Attributes
    ----------
    inputs : tuple of Input
        In order.
    outputs : tuple of Output
        Each stands for n numbers, a state.
    content : bytes
        Of the ONNX file: input (1, inputs), output (1, n outputs).
    """

    inputs: tuple[Input, ...]
    outputs: tuple[Output, ...]
    content: bytes


def loop_network(loop: Loop, outputs: Sequence[Output]) -> LoopNetwork:
    """The network that computes some states, with the inputs that these need.

    Parameters
    ----------
    loop : Loop
    outputs : sequence of Output
        At least one.

    Returns
    -------
    LoopNetwork
    """
    builder = _Builder(loop)
    rows = {output: builder.state(output) for output in sorted(outputs, key=lambda output: (output[1], output[0]))}
    numbers = [builder.terms.value(term) for output in outputs for term in rows[output]]
    graph = builder.graph
    content = graph.content(len(builder.inputs), graph.row(numbers), len(numbers), "closed loop, unrolled")
    return LoopNetwork(tuple(builder.inputs), tuple(outputs), content)


class _Builder:
    def __init__(self, loop: Loop) -> None:
        self.loop, self.source = loop, loop.source
        self.graph = Graph(loop.controller.precision)
        self.terms = Terms(self.graph)
        self.inputs: list[Input] = []
        box = self.source.boxes[loop.leaf]
        self.states: list[list[Term]] = [[self.input("initial", None, i, *side) for i, side in enumerate(box)]]
        """States at the sampling instants so far."""
        self.held: list[list[Term]] = []
        """Actions and disturbances of the periods so far."""
        self.waiting: list[list[Term]] = [list(self.source.contract.delayed_action) for _ in range(self.layout.delay)]
        self.constant: dict[int, Term] = {}

    @property
    def layout(self) -> Any:
        return self.source.layout

    def input(self, kind: str, period: int | None, position: int, low: Fraction, high: Fraction) -> str:
        self.inputs.append(Input(kind, period, position, Bounds(low, high)))
        return self.graph.number("inputs", len(self.inputs) - 1)

    def state(self, output: Output) -> list[Term]:
        kind, number = output
        if kind == "at":
            while len(self.states) <= number:
                self.advance()
            return self.states[number]
        while len(self.states) <= number:
            self.advance()
        self.hold(number)
        share = self.input("share", number, 0, Fraction(0), Fraction(1))
        return self.moved(number, share, "during", self.loop.remainders[number].during)

    def advance(self) -> None:
        """One period more."""
        number = len(self.states) - 1
        self.hold(number)
        end = self.moved(number, Fraction(1), "remainder", self.loop.remainders[number].end)
        self.states.append(end)

    def moved(self, number: int, share: Term, kind: str, rest: Sequence[Bounds | None]) -> list[Term]:
        point = [*self.states[number], *self.held[number]]
        field = self.source.setting.field
        values = step_values(field, self.terms, point, self.source, self.loop.order, share)
        return [
            value if bounds is None else self.terms.add(value, self.input(kind, number, i, bounds.lower, bounds.upper))
            for i, (value, bounds) in enumerate(zip(values, rest, strict=True))
        ]

    def hold(self, number: int) -> None:
        """Actions and disturbances of a period, where they are not there yet."""
        if len(self.held) == number:
            self.waiting.append(self.action(number))
            self.held.append([*self.waiting.pop(0), *self.disturbances(number)])

    def action(self, number: int) -> list[Term]:
        graph, terms = self.graph, self.terms
        seen = map_values(observation_program(self.source.contract), terms, self.states[number])
        for i, radius in enumerate(self.source.radius):
            if radius:
                seen[i] = terms.add(seen[i], self.input("perturbation", number, i, -radius, radius))
        row = graph.row([terms.value(term) for term in seen])
        for written in self.loop.controller.layers:
            row = graph.layer(written.layer, row)
        return [graph.number(row, i) for i in range(self.layout.inputs)]

    def disturbances(self, number: int) -> list[Term]:
        found: list[Term] = []
        given = zip(self.source.contract.disturbances, held_terms(self.source), strict=True)
        for i, (entry, fixed) in enumerate(given):
            if fixed is not None:
                found.append(fixed)
            elif not entry.constant:
                found.append(self.input("disturbance", number, i, *entry.bounds))
            else:
                if i not in self.constant:
                    self.constant[i] = self.input("disturbance", None, i, *entry.bounds)
                found.append(self.constant[i])
        return found
