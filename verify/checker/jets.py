"""Taylor series in time whose coefficients are jets in the start values, in ball arithmetic.

Coefficient k of every slot of a program follows from lower ones (Griewank and Walther, "Evaluating Derivatives", 2nd
ed., SIAM 2008, section 13.2):

    product      (a b)_k = sum_(j=0..k) a_j b_(k-j)
    primitive    y' = a' r, so y_k = 1/k sum_(j=1..k) (j a_j) r_(k-j)
    reciprocal   q_k = -q_0 sum_(j=1..k) a_j q_(k-j)
    state        z_k = f(z)_(k-1) / k

These recurrences are written once, over an algebra of coefficients (`jet_algebra`) that are balls or jets.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from flint import arb

from .jet_algebra import Algebra, Jet, algebra_of
from .program import Program, ball, used_inputs

__all__ = ["Jet", "flow_jets", "map_jets", "used_inputs"]


def flow_jets(
    program: Program, point: Sequence[Any], order: int, terms: int, variables: Sequence[int]
) -> list[list[Jet]]:
    """Jets of the time-Taylor coefficients of the flow: z_[k+1] = f(z)_[k] / (k + 1).

    Parameters
    ----------
    program : Program
        Vector field of the first len(outputs) inputs, the states; the other inputs are constant in time.
    point : sequence of balls
        One per input: thin for an expansion point, wide for bounds over a box.
    order : int
        Order of the jets in the start values, 0 to 2.
    terms : int
        Number of time coefficients.
    variables : sequence of int
        Inputs by which the jets differentiate.

    Returns
    -------
    list of list of Jet
        Entry [k][i] belongs to coefficient k of state i. Where the field is not defined on all of the point, every
        number is NaN.
    """
    states = len(program.outputs)
    series = _Series(program, point, algebra_of(order, len(variables)), variables)
    for k in range(terms):
        if k:
            series.integrate(states, k)
        if k + 1 < terms:
            series.compute(k, last=k + 2 == terms)
    return [[series.jet(slot, k) for slot in range(states)] for k in range(terms)]


def map_jets(program: Program, point: Sequence[Any], order: int, variables: Sequence[int]) -> list[Jet]:
    """Jets of a program's outputs, without time; see `flow_jets`."""
    series = _Series(program, point, algebra_of(order, len(variables)), variables)
    series.compute(0, last=True)
    return [series.jet(slot, 0) for slot in program.outputs]


class _Series:
    """Coefficients of every slot of a program, one after the other."""

    def __init__(self, program: Program, point: Sequence[Any], algebra: Algebra, variables: Sequence[int]) -> None:
        if len(point) != len(program.inputs):
            raise AssertionError(f"the program has {len(program.inputs)} inputs, got {len(point)}")
        number = {position: i for i, position in enumerate(variables)}
        self.program = program
        self.algebra = algebra
        self.slots: list[list[Any]] = [[algebra.variable(x, number.get(i))] for i, x in enumerate(point)]
        self.slots += [[] for _ in program.steps]
        self.weighted: dict[int, list[Any]] = {}
        """j a_j for the arguments a of primitives, from j = 1."""
        self.pairs: dict[int, tuple[Any, Any]] = {}
        self.defined = True

    def compute(self, k: int, last: bool) -> None:
        """Coefficient k of every step; of the steps that the outputs need themselves where it is the last one."""
        count, steps = len(self.program.inputs), self.program.steps
        for position in self.program.direct if last else range(len(steps)):
            operation, operands, constant = steps[position]
            if operation == "constant":
                result = None if k else self.algebra.variable(ball(constant), None)
            else:
                result = self.coefficient(operation, count + position, operands, k)
            self.slots[count + position].append(result)

    def integrate(self, states: int, k: int) -> None:
        """Coefficient k of the inputs: f_(k-1) / k for the states, none for the others."""
        inverse = 1 / arb(k)
        for slot in range(len(self.program.inputs)):
            rate = self.slots[self.program.outputs[slot]][k - 1] if slot < states else None
            self.slots[slot].append(self.algebra.scale(rate, inverse))

    def jet(self, slot: int, k: int) -> Jet:
        """A coefficient with its zeros written out."""
        found = self.algebra.jet(self.slots[slot][k])
        # a number that would be finite in spite of an undefined one elsewhere is no bound of anything
        return found if self.defined else [arb.nan()] * len(found)

    def coefficient(self, operation: str, slot: int, operands: tuple[int, ...], k: int) -> Any:
        algebra = self.algebra
        a, b = self.slots[operands[0]], self.slots[operands[-1]]
        match operation:
            case "*":
                return algebra.convolve(a, b[k::-1])
            case "+":
                return algebra.add(a[k], b[k])
            case "-":
                return algebra.subtract(a[k], b[k])
            case "neg":
                return algebra.subtract(None, a[k])
            case "square":
                return self.square(a, k) if k else algebra.square(a[0])
        if k == 0:
            return self.start(operation, operands[0], a[0])
        if operation == "reciprocal":
            y = self.slots[slot]
            return algebra.subtract(None, algebra.convolve([y[0]], [algebra.convolve(a[1:], y[::-1])]))
        weighted = self.weighted.setdefault(operands[0], [])
        if len(weighted) < k:
            weighted.append(algebra.scale(a[k], k))
        inverse = 1 / arb(-k if operation == "cos" else k)
        return algebra.scale(algebra.convolve(weighted, b[k - 1 :: -1]), inverse)

    def square(self, a: list[Any], k: int) -> Any:
        """``sum_(j=0..k) a_j a_(k-j)``, equal products once."""
        half = (k + 1) // 2
        twice = self.algebra.scale(self.algebra.convolve(a[:half], a[k : k - half : -1]), 2)
        middle = [] if k % 2 else [a[half]]
        return self.algebra.add(twice, self.algebra.convolve(middle, middle))

    def start(self, operation: str, argument: int, a: Any) -> Any:
        """Coefficient 0 of a function."""
        if operation in ("sin", "cos"):
            if argument not in self.pairs:
                self.pairs[argument] = self.algebra.sincos(a)
            result = self.pairs[argument][operation == "cos"]
        else:
            result = self.algebra.function(operation, a)
        self.defined = self.defined and bool(self.algebra.value(result).is_finite())
        return result
