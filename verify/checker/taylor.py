"""Taylor expansions of an ODE's solution in ball arithmetic, with a remainder that is proved.

For x' = f(x, p), x(0) = x0, and a box B that contains the solution on [0, h]:

    x(t) in sum_(k<K) X_k(x0) t^k + X_K(B) t^K,     0 <= t <= h,

where X_k(y) is the k-th Taylor coefficient of the solution that starts at y. B is proved by Picard iteration: the
solution exists and stays in ``x0 + [0, h] f(B)`` where that lies within B. Guesses (of B, of h) may be anything; only
that inclusion and the finiteness of every coefficient count.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

from flint import arb, ctx, fmpq

from .expressions import Expression, Name, Number, Operation, Power

Vector: TypeAlias = list[Any]

PICARD_TRIES = 8
SMALLEST_STEP, MOST_STEPS = 2**14, 1000
"""Where the expansion gives up: parts of a duration that are smaller, or more of them."""


def ball(value: Fraction) -> Any:
    """A ball that contains a rational."""
    return arb(fmpq(value.numerator, value.denominator))


def between(low: Fraction, high: Fraction) -> Any:
    """A ball that contains ``[low, high]``."""
    return ball(low).union(ball(high))


@dataclass(frozen=True)
class Program:
    """Expressions as a list of operations, each distinct subexpression once.

    Slot i < len(inputs) is an input; the others are ``(operation, operand slots, constant)``. `outputs` are slots.
    """

    inputs: tuple[str, ...]
    steps: tuple[tuple[str, tuple[int, ...], Fraction], ...]
    outputs: tuple[int, ...]


def compile_program(expressions: Sequence[Expression], inputs: Sequence[str]) -> Program:
    """Put expressions into a program; a name that is no input is a KeyError."""
    slots: dict[Any, int] = {name: slot for slot, name in enumerate(inputs)}
    steps: list[tuple[str, tuple[int, ...], Fraction]] = []

    def emit(operation: str, *operands: int, value: Fraction = Fraction(0)) -> int:
        key = (operation, operands, value)
        if key not in slots:
            slots[key] = len(inputs) + len(steps)
            steps.append(key)
        return slots[key]

    def power(base: int, exponent: int) -> int:
        if exponent == 0:
            return emit("constant", value=Fraction(1))
        if exponent < 0:
            return emit("/", emit("constant", value=Fraction(1)), power(base, -exponent))
        half = power(base, exponent // 2) if exponent > 1 else base
        if exponent == 1:
            return base
        square = emit("*", half, half)
        return square if exponent % 2 == 0 else emit("*", square, base)

    def visit(tree: Expression) -> int:
        match tree:
            case Number(value):
                return emit("constant", value=value)
            case Name(name):
                return slots[name]
            case Power(base, exponent):
                return power(visit(base), exponent)
            case Operation("tan", (argument,)):
                slot = visit(argument)
                return emit("/", emit("sin", slot), emit("cos", slot))
            case Operation(operator, operands):
                return emit(operator, *map(visit, operands))
        raise AssertionError(f"unknown expression {tree!r}")

    outputs = tuple(visit(tree) for tree in expressions)
    return Program(tuple(inputs), tuple(steps), outputs)


class _Expansion:
    """Taylor coefficients of every slot of a program, order by order."""

    def __init__(self, program: Program) -> None:
        self.program = program
        count = len(program.inputs) + len(program.steps)
        self.slots: list[Vector] = [[] for _ in range(count)]
        self.partners: list[Vector] = [[] for _ in range(count)]
        """cos beside sin, sin beside cos, 1 - tanh^2 beside tanh: their recurrences need each other."""

    def extend(self, inputs: Sequence[Any]) -> Vector:
        """Append one order: coefficients of the inputs in, of the outputs out."""
        for slot, value in enumerate(inputs):
            self.slots[slot].append(value)
        order = len(self.slots[0]) - 1
        for position, (operation, operands, constant) in enumerate(self.program.steps):
            slot = len(self.program.inputs) + position
            if operation == "constant":
                self.slots[slot].append(ball(constant) if order == 0 else arb(0))
            else:
                self.slots[slot].append(self.coefficient(operation, slot, [self.slots[i] for i in operands], order))
        return [self.slots[slot][order] for slot in self.program.outputs]

    def coefficient(self, operation: str, slot: int, operands: list[Vector], k: int) -> Any:
        a, b = operands[0], operands[-1]
        match operation:
            case "+":
                return a[k] + b[k]
            case "-":
                return a[k] - b[k]
            case "neg":
                return -a[k]
            case "*":
                return _convolution(a, b, 0, k)
            case "/":  # q b = a
                return (a[k] - _convolution(b, self.slots[slot], 1, k)) / b[0]
        return self.function(operation, self.slots[slot], self.partners[slot], a, k)

    def function(self, name: str, y: Vector, partner: Vector, a: Vector, k: int) -> Any:
        if k == 0:
            partner.extend(_partner_of(name, a[0]))
            return a[0].sqrt() if name == "sqrt" else getattr(a[0], name)()
        match name:
            case "exp":  # y' = y a'
                return _weighted(a, y, k) / k
            case "log":  # a y' = a'
                return (a[k] - _weighted(y, a, k - 1, k) / k) / a[0]
            case "sqrt":  # y y = a
                return (a[k] - sum((y[j] * y[k - j] for j in range(1, k)), arb(0))) / (2 * y[0])
            case "sin" | "cos":  # sin' = cos a', cos' = -sin a'
                sign = 1 if name == "sin" else -1
                result = sign * _weighted(a, partner, k) / k
                partner.append(-sign * _weighted(a, y, k) / k)
                return result
            case "tanh":  # y' = (1 - y^2) a'
                result = _weighted(a, partner, k) / k
                partner.append(-sum((u * v for u, v in zip([*y, result], reversed([*y, result]), strict=True)), arb(0)))
                return result
        raise AssertionError(f"unknown function {name}")


def _partner_of(name: str, a: Any) -> Vector:
    match name:
        case "sin":
            return [a.cos()]
        case "cos":
            return [a.sin()]
        case "tanh":
            return [1 - a.tanh() * a.tanh()]
    return []


def _convolution(a: Vector, b: Vector, first: int, k: int) -> Any:
    """``sum_(j=first..k) a_j b_(k-j)``."""
    return sum((a[j] * b[k - j] for j in range(first, k + 1)), arb(0))


def _weighted(a: Vector, y: Vector, last: int, k: int | None = None) -> Any:
    """``sum_(j=1..last) j a_j y_(k-j)``, k = last where it is not given."""
    order = last if k is None else k
    return sum((j * a[j] * y[order - j] for j in range(1, last + 1)), arb(0))


def evaluate(program: Program, inputs: Sequence[Any]) -> Vector:
    """Enclose a program's outputs for all points of a vector of balls."""
    return _Expansion(program).extend(inputs)


def coefficients(program: Program, state: Sequence[Any], held: Sequence[Any], order: int) -> list[Vector]:
    """Taylor coefficients 0 .. order of the solution that starts at `state`, inputs and disturbances `held`."""
    expansion = _Expansion(program)
    found = [list(state)]
    for k in range(order):
        rest = list(held) if k == 0 else [arb(0)] * len(held)
        slope = expansion.extend([*found[k], *rest])
        found.append([value / (k + 1) for value in slope])
    return found


@dataclass(frozen=True)
class Segment:
    """The solution on ``[start, start + length]``; the last coefficient is the one over `box`, the remainder's."""

    start: Fraction
    length: Fraction
    coefficients: list[Vector]
    box: Vector

    def at(self, time: Fraction) -> Vector:
        """Enclosure at one exact time."""
        return self._evaluated(ball(time - self.start), time, time)

    def over(self, first: Fraction, last: Fraction) -> Vector:
        """Enclosure of all states between two times."""
        return self._evaluated(between(first - self.start, last - self.start), first, last)

    def _evaluated(self, t: Any, first: Fraction, last: Fraction) -> Vector:
        if not self.start <= first <= last <= self.start + self.length:
            raise AssertionError("a time outside the segment")
        total = self.coefficients[-1]
        for row in reversed(self.coefficients[:-1]):
            total = [a + t * b for a, b in zip(row, total, strict=True)]
        return total


def solve(
    program: Program, state: Sequence[Any], held: Sequence[Any], duration: Fraction
) -> tuple[list[Segment], Vector] | None:
    """Enclose the solution on ``[0, duration]`` at the precision in force.

    Parameters
    ----------
    program : Program
        The vector field; inputs are states and what is held constant.
    state : sequence of balls
    held : sequence of balls
    duration : Fraction

    Returns
    -------
    (list of Segment, vector of balls) or None
        The parts and the final state; None where no solution could be proved to exist up to the end.
    """
    segments: list[Segment] = []
    time, current, length = Fraction(0), list(state), duration
    while time < duration:
        if len(segments) == MOST_STEPS:
            return None
        segment = _step(program, current, held, time, min(length, duration - time), duration / SMALLEST_STEP)
        if segment is None:
            return None
        segments.append(segment)
        time += segment.length
        current = segment.at(time)
        length = 2 * segment.length
    return segments, current


def _step(
    program: Program, state: Vector, held: Sequence[Any], start: Fraction, length: Fraction, least: Fraction
) -> Segment | None:
    order = ctx.prec // 5
    found = coefficients(program, state, held, order - 1)
    if not _finite(*found):
        return None
    while length > 2 * least and not _negligible(found[-1], state, length, order - 1):
        length /= 2
    while length >= least:
        box = _a_priori(program, state, held, length)
        if box is not None:
            last = coefficients(program, box, held, order)[order]
            if _finite(last) and (length < 2 * least or _negligible(last, found[0], length, order)):
                return Segment(start, length, [*found, last], box)
        length /= 2
    return None


def _negligible(last: Vector, state: Vector, length: Fraction, order: int) -> bool:
    """Whether the remainder is as small as the rounding; decides how long a step is, nothing else."""
    power = ball(length) ** order
    return all(
        bool(abs(value) * power < (1 + abs(x)) * arb(2) ** -(ctx.prec - 8))
        for value, x in zip(last, state, strict=True)
    )


def _a_priori(program: Program, state: Vector, held: Sequence[Any], length: Fraction) -> Vector | None:
    """A box that provably contains the solution on ``[0, length]``."""
    time = between(Fraction(0), length)

    def picard(box: Vector) -> Vector:
        slope = evaluate(program, [*box, *held])
        return [x + time * v for x, v in zip(state, slope, strict=True)]

    image = picard(state)
    for _ in range(PICARD_TRIES):
        if not _finite(image):
            return None
        # any guess will do
        box = [arb(y.mid(), y.rad() * arb(1.25) + arb(2) ** -(ctx.prec // 2)) for y in image]
        image = picard(box)
        if _finite(image) and all(b.contains(y) for b, y in zip(box, image, strict=True)):
            return image
    return None


def _finite(*rows: Vector) -> bool:
    return all(bool(value.is_finite()) for row in rows for value in row)
