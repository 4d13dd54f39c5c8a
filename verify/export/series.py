"""A vector field's Taylor coefficients in time, as straight-line computations over any arithmetic.

The recurrences are those of `checker.jets` (Griewank and Walther, "Evaluating Derivatives", 2nd ed., SIAM 2008, section
13.2), with coefficients that are anything that can be added and multiplied: the nodes of a graph that is being written,
or bounds of what rounding changes in it. Both are made by the same steps, so that the bounds are of that graph.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, Generic, Protocol, TypeAlias, TypeVar

from ..checker.program import PRIMITIVES, Program

Value = TypeVar("Value")
Term: TypeAlias = Any
"""None for 0, a Fraction, or a value of an arithmetic."""


class Arithmetic(Protocol[Value]):
    """What a computation needs."""

    def constant(self, value: Fraction) -> Value: ...
    def add(self, left: Value, right: Value) -> Value: ...
    def subtract(self, left: Value, right: Value) -> Value: ...
    def multiply(self, left: Value, right: Value) -> Value: ...
    def reciprocal(self, operand: Value) -> Value: ...
    def function(self, name: str, operand: Value) -> Value: ...


class Terms(Generic[Value]):
    """An arithmetic in which zeros, ones and what is known exactly cost nothing.

    Constants meet values at the latest possible moment, so that each is rounded once.
    """

    def __init__(self, arithmetic: Arithmetic[Value]) -> None:
        self.arithmetic = arithmetic

    def value(self, term: Term) -> Value:
        """A term as a value."""
        if term is None or isinstance(term, Fraction):
            return self.arithmetic.constant(term or Fraction(0))
        return term  # type: ignore[no-any-return]

    def add(self, left: Term, right: Term) -> Term:
        """``left + right``."""
        if left is None or right is None:
            return right if left is None else left
        if isinstance(left, Fraction) and isinstance(right, Fraction):
            return (left + right) or None
        return self.arithmetic.add(self.value(left), self.value(right))

    def subtract(self, left: Term, right: Term) -> Term:
        """``left - right``."""
        if right is None:
            return left
        if left is None or isinstance(right, Fraction):
            return self.add(left, self.multiply(Fraction(-1), right))
        return self.arithmetic.subtract(self.value(left), self.value(right))

    def multiply(self, left: Term, right: Term) -> Term:
        """``left * right``."""
        if left is None or right is None:
            return None
        if isinstance(left, Fraction) and isinstance(right, Fraction):
            return (left * right) or None
        for factor, other in ((left, right), (right, left)):
            if isinstance(factor, Fraction) and factor == 1:
                return other
        return self.arithmetic.multiply(self.value(left), self.value(right))

    def convolve(self, left: Sequence[Term], right: Sequence[Term]) -> Term:
        """``sum_j left_j right_j``, over two sequences of one length."""
        total: Term = None
        for a, b in zip(left, right, strict=True):
            total = self.add(total, self.multiply(a, b))
        return total

    def polynomial(self, coefficients: Sequence[Term], time: Term) -> Term:
        """``sum_k coefficients_k time^k``, by Horner's scheme."""
        total: Term = None
        for coefficient in reversed(coefficients):
            total = self.add(coefficient, self.multiply(total, time))
        return total


def flow_series(program: Program, terms: Terms[Any], point: Sequence[Term], count: int) -> list[list[Term]]:
    """Time-Taylor coefficients 0 .. count - 1 of the solution of ``x' = f(x, held)``.

    Parameters
    ----------
    program : Program
        The field: its first inputs are the states, the others are held.
    terms : Terms
    point : sequence of Term
        One per input.
    count : int

    Returns
    -------
    list of list of Term
        Entry [k][i] belongs to coefficient k of state i.
    """
    slots = _Slots(program, terms, point)
    states = len(program.outputs)
    for k in range(count - 1):
        slots.compute(k)
        for slot in range(len(program.inputs)):
            rate = slots.slots[program.outputs[slot]][k] if slot < states else None
            slots.slots[slot].append(terms.multiply(Fraction(1, k + 1), rate))
    return [[slots.slots[i][k] for i in range(states)] for k in range(count)]


def map_values(program: Program, terms: Terms[Any], point: Sequence[Term]) -> list[Term]:
    """A program's outputs, without time."""
    slots = _Slots(program, terms, point)
    slots.compute(0)
    return [slots.slots[slot][0] for slot in program.outputs]


class _Slots:
    """Coefficients of every slot of a program, one order after the other."""

    def __init__(self, program: Program, terms: Terms[Any], point: Sequence[Term]) -> None:
        self.program, self.terms = program, terms
        self.slots: list[list[Term]] = [[x] for x in point] + [[] for _ in program.steps]

    def compute(self, k: int) -> None:
        """Coefficient k of every step."""
        count = len(self.program.inputs)
        # at order 0 a primitive needs its argument only; what serves the recurrences alone is needed from order 1 on
        for position, (operation, operands, constant) in enumerate(self.program.steps):
            if operation == "constant":
                result: Term = None if k or not constant else constant
            else:
                result = self.coefficient(operation, count + position, operands, k)
            self.slots[count + position].append(result)

    def coefficient(self, operation: str, slot: int, operands: tuple[int, ...], k: int) -> Term:
        terms = self.terms
        a, b = self.slots[operands[0]], self.slots[operands[-1]]
        match operation:
            case "*" | "square":
                return terms.convolve(a[: k + 1], b[k::-1])
            case "+":
                return terms.add(a[k], b[k])
            case "-":
                return terms.subtract(a[k], b[k])
            case "neg":
                return terms.multiply(Fraction(-1), a[k])
            case "reciprocal":
                own = self.slots[slot]
                if k == 0:
                    return terms.arithmetic.reciprocal(terms.value(a[0]))
                inner = terms.multiply(own[0], terms.convolve(a[1 : k + 1], own[::-1]))
                return terms.multiply(Fraction(-1), inner)
        if operation not in PRIMITIVES:
            raise AssertionError(f"unknown operation {operation}")
        if k == 0:
            return terms.arithmetic.function(operation, terms.value(a[0]))
        sign = -1 if operation == "cos" else 1
        weighted = [terms.multiply(Fraction(sign * j, k), a[j]) for j in range(1, k + 1)]
        return terms.convolve(weighted, b[k - 1 :: -1])
