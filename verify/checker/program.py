"""Expressions as straight-line programs, in steps whose Taylor coefficients have recurrences."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, TypeAlias

from flint import arb, fmpq

from .expressions import Expression, Name, Number, Operation, Power

Step: TypeAlias = tuple[str, tuple[int, ...], Fraction]

PRIMITIVES = ("sin", "cos", "exp", "log", "sqrt", "tanh")
"""Functions y of a with y' = a' r; their second operand is the slot of r."""


def ball(value: Fraction) -> Any:
    """A ball that contains a rational."""
    return arb(fmpq(value.numerator, value.denominator))


@dataclass(frozen=True)
class Program:
    """Expressions as a list of steps, each distinct subexpression once.

    Attributes
    ----------
    inputs : tuple of str
        Names of the slots 0 .. len(inputs) - 1.
    steps : tuple of (operation, operand slots, constant)
        Step i computes slot len(inputs) + i. Operations are ``constant + - neg * square reciprocal`` and the
        `PRIMITIVES`. Operands are earlier slots; only the r of a primitive may be a later one, or its own.
    outputs : tuple of int
        Slots of the results.
    direct : tuple of int
        Steps that the values of the outputs need; the others only serve the recurrences of primitives.
    """

    inputs: tuple[str, ...]
    steps: tuple[Step, ...]
    outputs: tuple[int, ...]
    direct: tuple[int, ...] = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        count = len(self.inputs)
        needed = reached(self.outputs, lambda slot: () if slot < count else arguments(self.steps[slot - count]))
        object.__setattr__(self, "direct", tuple(slot - count for slot in sorted(needed) if slot >= count))


def arguments(step: Step) -> tuple[int, ...]:
    """Slots that the value of a step is a function of."""
    operation, operands, _ = step
    return operands[:1] if operation in PRIMITIVES else operands


def used_inputs(program: Program) -> tuple[int, ...]:
    """Positions of the inputs that a program reads at all: an operand of a step, or an output itself."""
    read = {slot for _, operands, _ in program.steps for slot in operands} | set(program.outputs)
    return tuple(sorted(slot for slot in read if slot < len(program.inputs)))


def compile_program(expressions: Sequence[Expression], inputs: Sequence[str]) -> Program:
    """Put expressions into a program; a name that is no input is a KeyError.

    Constants are folded in rationals, a division by a constant is a product, any other one a product with the
    reciprocal, and a product of equal factors is a square. What no output needs is left out.
    """
    builder = _Builder(inputs)
    return builder.program([builder.visit(tree) for tree in expressions])


class _Builder:
    def __init__(self, inputs: Sequence[str]) -> None:
        self.inputs = tuple(inputs)
        self.slots: dict[Any, int] = {name: slot for slot, name in enumerate(inputs)}
        self.steps: list[Step] = []
        self.integrands: dict[int, int] = {}
        """Slot of the r of each primitive."""

    def visit(self, tree: Expression) -> int:
        match tree:
            case Number(value):
                return self.constant(value)
            case Name(name):
                return self.slots[name]
            case Power(base, exponent):
                return self.power(self.visit(base), exponent)
            case Operation("tan", (argument,)):
                slot = self.visit(argument)
                return self.divide(self.function("sin", slot), self.function("cos", slot))
            case Operation("*", (left, right)):
                first, second = self.visit(left), self.visit(right)
                return self.emit("square", first) if first == second else self.emit("*", first, second)
            case Operation("/", (left, right)):
                return self.divide(self.visit(left), self.visit(right))
            case Operation(operator, operands):
                slots = map(self.visit, operands)
                return self.function(operator, *slots) if operator in PRIMITIVES else self.emit(operator, *slots)
        raise AssertionError(f"unknown expression {tree!r}")

    def append(self, operation: str, *operands: int, value: Fraction = Fraction(0)) -> int:
        key = (operation, operands, value)
        if key not in self.slots:
            self.slots[key] = len(self.inputs) + len(self.steps)
            self.steps.append(key)
        return self.slots[key]

    def constant(self, value: Fraction) -> int:
        return self.append("constant", value=value)

    def known(self, slot: int) -> Fraction | None:
        operation, _, value = self.steps[slot - len(self.inputs)] if slot >= len(self.inputs) else ("", (), None)
        return value if operation == "constant" else None

    def emit(self, operation: str, *operands: int) -> int:
        numbers = [number for number in map(self.known, operands) if number is not None]
        if len(numbers) == len(operands) and operation in _FOLD:
            return self.constant(_FOLD[operation](*numbers))
        if operation in _NEUTRAL:
            for slot, other in zip(operands, reversed(operands), strict=True):
                if self.known(other) == _NEUTRAL[operation]:
                    return slot
        return self.append(operation, *operands)

    def divide(self, numerator: int, denominator: int) -> int:
        number = self.known(denominator)
        inverse = self.constant(1 / number) if number else self.append("reciprocal", denominator)
        return self.emit("*", numerator, inverse)

    def power(self, base: int, exponent: int) -> int:
        if exponent < 0:
            return self.divide(self.constant(Fraction(1)), self.power(base, -exponent))
        if exponent == 0:
            return self.constant(Fraction(1))
        if exponent == 1:
            return base
        half = self.emit("square", self.power(base, exponent // 2))
        return half if exponent % 2 == 0 else self.emit("*", half, base)

    def function(self, name: str, argument: int) -> int:
        if (name, (argument,), Fraction(0)) in self.slots:
            return self.append(name, argument)
        if name in ("sin", "cos"):  # sin' = a' cos, cos' = -a' sin
            sine, cosine = self.append("sin", argument), self.append("cos", argument)
            self.integrands |= {sine: cosine, cosine: sine}
            return sine if name == "sin" else cosine
        result = self.append(name, argument)
        match name:
            case "exp":  # y' = a' y
                self.integrands[result] = result
            case "log":  # y' = a' / a
                self.integrands[result] = self.append("reciprocal", argument)
            case "sqrt":  # y' = a' / (y + y)
                self.integrands[result] = self.append("reciprocal", self.append("+", result, result))
            case "tanh":  # y' = a' (1 - y^2)
                one = self.constant(Fraction(1))
                self.integrands[result] = self.append("-", one, self.append("square", result))
        return result

    def program(self, outputs: Sequence[int]) -> Program:
        """What the outputs need, numbered without gaps."""
        count = len(self.inputs)
        steps = [
            (operation, (*operands, self.integrands[slot]) if slot in self.integrands else operands, value)
            for slot, (operation, operands, value) in enumerate(self.steps, count)
        ]
        needed = reached(outputs, lambda slot: () if slot < count else steps[slot - count][1])
        kept = [slot for slot in range(count + len(steps)) if slot < count or slot in needed]
        number = {slot: position for position, slot in enumerate(kept)}
        renumbered = [
            (operation, tuple(number[operand] for operand in operands), value)
            for operation, operands, value in (steps[slot - count] for slot in kept[count:])
        ]
        return Program(self.inputs, tuple(renumbered), tuple(number[slot] for slot in outputs))


_FOLD: dict[str, Callable[..., Fraction]] = {
    "+": lambda a, b: a + b,
    "-": lambda a, b: a - b,
    "*": lambda a, b: a * b,
    "neg": lambda a: -a,
    "square": lambda a: a * a,
}
_NEUTRAL = {"+": 0, "*": 1}


def reached(starts: Iterable[int], followers: Callable[[int], Iterable[int]]) -> set[int]:
    """Everything that can be reached from some numbers."""
    found: set[int] = set()
    pending = list(starts)
    while pending:
        number = pending.pop()
        if number not in found:
            found.add(number)
            pending.extend(followers(number))
    return found
