"""The straight-line tape an expression compiles to.

One tape runs over every algebra: floats (simulation), jets (flow enclosure), intervals (a-priori enclosure), later
tensors and balls. An algebra is an object with the methods that `run` calls; it never sees the syntax tree.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any, Protocol, TypeVar

from ..specs.expressions import Binary, Call, Expression, Name, Negate, Number, Power

Value = TypeVar("Value")


class Algebra(Protocol[Value]):
    """What a tape needs: one method per operation. `sincos` returns both, because their recurrences need each other."""

    def constant(self, value: Fraction) -> Value: ...
    def add(self, left: Value, right: Value) -> Value: ...
    def subtract(self, left: Value, right: Value) -> Value: ...
    def multiply(self, left: Value, right: Value) -> Value: ...
    def divide(self, left: Value, right: Value) -> Value: ...
    def negate(self, operand: Value) -> Value: ...
    def square(self, operand: Value) -> Value: ...
    def sincos(self, operand: Value) -> tuple[Value, Value]: ...
    def exp(self, operand: Value) -> Value: ...
    def log(self, operand: Value) -> Value: ...
    def sqrt(self, operand: Value) -> Value: ...
    def tanh(self, operand: Value) -> Value: ...


@dataclass(frozen=True)
class Instruction:
    """``slot = operation(operands)``; the slot is the instruction's position after the inputs.

    `sin` and `cos` of one slot are computed together by `run`. `constant` has no operands but a value.
    """

    operation: str
    operands: tuple[int, ...]
    value: Fraction | None = None


@dataclass(frozen=True)
class Tape:
    """A straight-line program.

    Attributes
    ----------
    inputs : tuple of str
        Names of the input slots 0 .. len(inputs) - 1.
    instructions : tuple of Instruction
        Instruction i writes slot len(inputs) + i and reads lower slots only.
    outputs : tuple of int
        Slots of the results.
    """

    inputs: tuple[str, ...]
    instructions: tuple[Instruction, ...]
    outputs: tuple[int, ...]
    _hash: int = field(init=False, repr=False, compare=False)

    def __post_init__(self) -> None:
        # what is derived from a tape is cached by the tape, in hot loops: its constants are hashed once
        object.__setattr__(self, "_hash", hash((self.inputs, self.instructions, self.outputs)))

    def __hash__(self) -> int:
        return self._hash


class _Compiler:
    """Hash-consing: one slot per distinct subexpression, so ``sin(x)`` written twice is computed once."""

    def __init__(self, inputs: Sequence[str]) -> None:
        self.inputs = tuple(inputs)
        self.instructions: list[Instruction] = []
        self.slots: dict[Instruction, int] = {}

    def emit(self, operation: str, *operands: int, value: Fraction | None = None) -> int:
        known = [self.constant_of(slot) for slot in operands]
        if operation in _FOLD and all(number is not None for number in known):
            folded = _FOLD[operation](*known)
            if folded is not None:
                return self.emit("constant", value=folded)
        if operation == "divide" and known[1]:
            return self.emit("multiply", operands[0], self.emit("constant", value=1 / known[1]))
        if operation in _NEUTRAL:
            for slot, number in zip(operands, reversed(known), strict=True):
                if number == _NEUTRAL[operation]:
                    return slot
        instruction = Instruction(operation, operands, value)
        if instruction not in self.slots:
            self.slots[instruction] = len(self.inputs) + len(self.instructions)
            self.instructions.append(instruction)
        return self.slots[instruction]

    def constant_of(self, slot: int) -> Fraction | None:
        index = slot - len(self.inputs)
        if index < 0 or self.instructions[index].operation != "constant":
            return None
        return self.instructions[index].value

    def compile(self, node: Expression, names: Mapping[str, Expression]) -> int:
        match node:
            case Number(value):
                return self.emit("constant", value=value)
            case Name(name):
                if name in self.inputs:
                    return self.inputs.index(name)
                return self.compile(names[name], names)
            case Negate(operand):
                return self.emit("negate", self.compile(operand, names))
            case Binary(operator, left, right):
                operation = {"+": "add", "-": "subtract", "*": "multiply", "/": "divide"}[operator]
                first, second = self.compile(left, names), self.compile(right, names)
                if operation == "multiply" and first == second:
                    return self.emit("square", first)
                return self.emit(operation, first, second)
            case Power(base, exponent):
                return self.power(self.compile(base, names), exponent)
            case Call("tan", argument):
                slot = self.compile(argument, names)
                return self.emit("divide", self.emit("sin", slot), self.emit("cos", slot))
            case Call(function, argument):
                return self.emit(function, self.compile(argument, names))
        raise AssertionError(f"unknown node {node!r}")

    def power(self, slot: int, exponent: int) -> int:
        if exponent < 0:
            return self.emit("divide", self.emit("constant", value=Fraction(1)), self.power(slot, -exponent))
        if exponent == 0:
            return self.emit("constant", value=Fraction(1))
        if exponent == 1:
            return slot
        half = self.emit("square", self.power(slot, exponent // 2))
        return half if exponent % 2 == 0 else self.emit("multiply", half, slot)


_FOLD: dict[str, Callable[..., Fraction | None]] = {
    "add": lambda a, b: a + b,
    "subtract": lambda a, b: a - b,
    "multiply": lambda a, b: a * b,
    "divide": lambda a, b: a / b if b != 0 else None,
    "negate": lambda a: -a,
    "square": lambda a: a * a,
}


_NEUTRAL = {"add": 0, "multiply": 1}


def compile_tape(
    expressions: Sequence[Expression], inputs: Sequence[str], names: Mapping[str, Expression] | None = None
) -> Tape:
    """Compile expressions into one tape that computes all of them.

    Parameters
    ----------
    expressions : sequence of Expression
    inputs : sequence of str
        Names that become input slots.
    names : mapping, optional
        Parameters: what any other name stands for. A name in neither is a KeyError; callers check names first, where
        they can say the line.

    Returns
    -------
    Tape
        Constants are folded exactly (in rationals), a division by one is a product with its reciprocal, and
        instructions that no output needs are dropped.
    """
    compiler = _Compiler(inputs)
    outputs = [compiler.compile(expression, names or {}) for expression in expressions]
    return _without_dead_code(Tape(compiler.inputs, tuple(compiler.instructions), tuple(outputs)))


def _without_dead_code(tape: Tape) -> Tape:
    count = len(tape.inputs)
    needed = set(tape.outputs)
    for index in range(len(tape.instructions) - 1, -1, -1):
        if count + index in needed:
            needed.update(tape.instructions[index].operands)
    renumber = {slot: slot for slot in range(count)}
    kept: list[Instruction] = []
    for index, instruction in enumerate(tape.instructions):
        if count + index in needed:
            renumber[count + index] = count + len(kept)
            operands = tuple(renumber[slot] for slot in instruction.operands)
            kept.append(Instruction(instruction.operation, operands, instruction.value))
    return Tape(tape.inputs, tuple(kept), tuple(renumber[slot] for slot in tape.outputs))


def run(tape: Tape, algebra: Algebra[Value], inputs: Sequence[Value]) -> list[Value]:
    """Run a tape over an algebra.

    Parameters
    ----------
    tape : Tape
    algebra : Algebra
    inputs : sequence
        One value per input slot.

    Returns
    -------
    list
        One value per output.
    """
    if len(inputs) != len(tape.inputs):
        raise AssertionError(f"tape has {len(tape.inputs)} inputs, got {len(inputs)}")
    slots: list[Any] = list(inputs)
    pairs: dict[int, tuple[Any, Any]] = {}
    for instruction in tape.instructions:
        operands = [slots[slot] for slot in instruction.operands]
        if instruction.operation == "constant":
            slots.append(algebra.constant(instruction.value))  # type: ignore[arg-type]
        elif instruction.operation in ("sin", "cos"):
            slot = instruction.operands[0]
            if slot not in pairs:
                pairs[slot] = algebra.sincos(*operands)
            slots.append(pairs[slot][instruction.operation == "cos"])
        else:
            slots.append(getattr(algebra, instruction.operation)(*operands))
    return [slots[slot] for slot in tape.outputs]
