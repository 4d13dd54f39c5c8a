"""An arithmetic that bounds what the rounding of constants changes in a computation that is otherwise exact."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb

from ..checker import ranges
from ..checker.program import ball
from .exact import rounded


@dataclass(frozen=True)
class Known:
    """The exact computation is in the ball `value`; the written one differs from it by at most `error`."""

    value: Any
    error: Any

    @property
    def written(self) -> Any:
        """A ball that contains both."""
        return self.value + arb(0, self.error.upper())


@dataclass(frozen=True)
class RoundingBounds:
    """See `series.Arithmetic`; constants are rounded to `precision`, operations are exact."""

    precision: str

    def constant(self, value: Fraction) -> Known:
        return Known(ball(value), ball(abs(Fraction(rounded(value, self.precision)) - value)))

    def add(self, left: Known, right: Known) -> Known:
        return Known(left.value + right.value, left.error + right.error)

    def subtract(self, left: Known, right: Known) -> Known:
        return Known(left.value - right.value, left.error + right.error)

    def multiply(self, left: Known, right: Known) -> Known:
        error = abs(left.value) * right.error + abs(right.written) * left.error
        # a square is not negative, whatever its ball's product with itself is
        value = ranges.square(left.value) if left is right else left.value * right.value
        return Known(value, error)

    def reciprocal(self, operand: Known) -> Known:
        # 1/a' - 1/a = (a - a')/(a a')
        error = operand.error * abs(ranges.reciprocal(operand.value) * ranges.reciprocal(operand.written))
        return Known(ranges.reciprocal(operand.value), error)

    def function(self, name: str, operand: Known) -> Known:
        value, both = operand.value, operand.written
        match name:
            case "sin" | "cos":
                return Known(ranges.sincos(value)[name == "cos"], operand.error)
            case "tanh":
                return Known(ranges.tanh(value), operand.error)
            case "exp":
                return Known(ranges.exp(value), ranges.exp(both) * operand.error)
            case "log":
                return Known(ranges.log(value), ranges.reciprocal(both) * operand.error)
            case "sqrt":
                return Known(ranges.sqrt(value), ranges.reciprocal(2 * ranges.sqrt(both)) * operand.error)
        raise AssertionError(f"unknown function {name}")
