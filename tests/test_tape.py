"""A tape computes what its expressions say, with exact constants and no work done twice."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from setrl.models.float_algebra import FloatAlgebra
from setrl.models.tape import Algebra, Instruction, Tape, compile_tape, run
from setrl.specs.expressions import Number, parse_expression


class ExactAlgebra:
    """Rationals; the functions are marked, not computed."""

    def constant(self, value: Fraction) -> Any:
        return value

    def add(self, left: Any, right: Any) -> Any:
        return left + right

    def subtract(self, left: Any, right: Any) -> Any:
        return left - right

    def multiply(self, left: Any, right: Any) -> Any:
        return left * right

    def divide(self, left: Any, right: Any) -> Any:
        return left / right

    def negate(self, operand: Any) -> Any:
        return -operand

    def square(self, operand: Any) -> Any:
        return operand * operand

    def sincos(self, operand: Any) -> Any:
        raise AssertionError("no exact value")

    exp = log = sqrt = tanh = sincos


class CountingAlgebra(FloatAlgebra):
    """Counts what is computed."""

    def __init__(self) -> None:
        self.sincos_calls = 0

    def sincos(self, operand: Any) -> Any:
        self.sincos_calls += 1
        return super().sincos(operand)


def tape_of(*texts: str, inputs: tuple[str, ...] = ("x", "y"), **parameters: str) -> Tape:
    names = {name: Number(Fraction(value)) for name, value in parameters.items()}
    return compile_tape([parse_expression(text) for text in texts], inputs, names)


def operations(tape: Tape) -> list[str]:
    return [instruction.operation for instruction in tape.instructions]


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("x + y - 0.1", lambda x, y: x + y - Fraction(1, 10)),
        ("-(x - y)*x", lambda x, y: -(x - y) * x),
        ("x/y + y/3", lambda x, y: x / y + y / 3),
        ("x**5 - y**-3", lambda x, y: x**5 - 1 / y**3),
        ("x*x + (x*y)**2", lambda x, y: x * x + (x * y) ** 2),
        ("x**0 + 1e-3*x**1", lambda x, y: 1 + x / 1000),
        ("(k + 1)/(2*k)*x", lambda x, y: (Fraction("0.05") + 1) / (2 * Fraction("0.05")) * x),
        ("0*x + 1*y + 0", lambda x, y: y),
    ],
)
def test_rational_expressions_are_computed_exactly(text: str, expected: Any) -> None:
    tape = tape_of(text, k="0.05")
    for point in [(Fraction(3, 7), Fraction(-5, 11)), (Fraction(-2), Fraction(1, 3))]:
        assert run(tape, ExactAlgebra(), list(point)) == [expected(*point)]


@pytest.mark.parametrize("function", ["sin", "cos", "tan", "exp", "log", "sqrt", "tanh"])
def test_functions_are_those_of_numpy_on_arrays_of_any_shape(function: str) -> None:
    points = np.random.default_rng(1).uniform(0.1, 1.2, size=(2, 3, 4))
    (value,) = run(tape_of(f"{function}(x)", inputs=("x",)), FloatAlgebra(), [points])
    np.testing.assert_allclose(value, getattr(np, function)(points), rtol=1e-14)


def test_a_subexpression_that_is_written_twice_is_computed_once() -> None:
    tape = tape_of("sin(x*y)*cos(x*y)", "x*y + sin(x*y)")
    assert operations(tape).count("multiply") == 2 and operations(tape).count("sin") == 1


def test_sine_and_cosine_of_one_slot_are_one_call() -> None:
    algebra = CountingAlgebra()
    sine, cosine, tangent = run(tape_of("sin(x)", "cos(x)", "tan(x)"), algebra, [0.3, 0.0])
    assert algebra.sincos_calls == 1
    assert (sine, cosine) == (np.sin(0.3), np.cos(0.3)) and abs(tangent - np.tan(0.3)) < 1e-15


def test_constants_are_folded_in_rationals() -> None:
    tape = tape_of("(0.1 + 0.2)*3*x", inputs=("x",))
    assert [i.value for i in tape.instructions if i.operation == "constant"] == [Fraction(9, 10)]
    assert operations(tape) == ["constant", "multiply"]


def test_a_division_by_a_constant_is_an_exact_product() -> None:
    tape = tape_of("x/3", inputs=("x",))
    assert operations(tape) == ["constant", "multiply"] and tape.instructions[0].value == Fraction(1, 3)


def test_neutral_elements_leave_no_instruction() -> None:
    assert tape_of("1*x + 0", "0 + y*1").instructions == ()
    assert tape_of("x/k", inputs=("x",), k="1").instructions == ()


def test_a_division_by_a_constant_zero_stays_for_the_algebra_to_refuse() -> None:
    with pytest.raises(ZeroDivisionError):
        run(tape_of("x/(k - 1)", inputs=("x",), k="1"), ExactAlgebra(), [Fraction(1)])


def test_instructions_that_no_output_needs_are_dropped() -> None:
    tape = tape_of("x", "y + 2*3*0.5")
    assert operations(tape) == ["constant", "add"]


@pytest.mark.parametrize(("exponent", "products"), [(2, 1), (3, 2), (8, 3), (15, 6)])
def test_powers_are_computed_by_repeated_squaring(exponent: int, products: int) -> None:
    tape = tape_of(f"x**{exponent}", inputs=("x",))
    assert len(tape.instructions) == products


def test_every_instruction_reads_earlier_slots_only() -> None:
    tape = tape_of("sin(x)/(1 + exp(-y)) - x**3", "tanh(x*y)/sqrt(2)")
    for position, instruction in enumerate(tape.instructions):
        assert all(slot < len(tape.inputs) + position for slot in instruction.operands)
        assert isinstance(instruction, Instruction)


def test_a_wrong_number_of_inputs_is_a_broken_invariant() -> None:
    algebra: Algebra[Any] = FloatAlgebra()
    with pytest.raises(AssertionError, match="tape has 2 inputs, got 1"):
        run(tape_of("x + y"), algebra, [1.0])
