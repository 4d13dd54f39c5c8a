"""Plain float64 arithmetic for a tape: simulation, never a proof."""

from __future__ import annotations

from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np

Floats: TypeAlias = Any
"""A float64 array of any shape, or a Python float."""


class FloatAlgebra:
    """Operations of `models.tape.Algebra` on float64 arrays; shapes broadcast, constants are Python floats."""

    def constant(self, value: Fraction) -> Floats:
        return float(value)

    def add(self, left: Floats, right: Floats) -> Floats:
        return left + right

    def subtract(self, left: Floats, right: Floats) -> Floats:
        return left - right

    def multiply(self, left: Floats, right: Floats) -> Floats:
        return left * right

    def divide(self, left: Floats, right: Floats) -> Floats:
        return np.divide(left, right)

    def negate(self, operand: Floats) -> Floats:
        return -operand

    def square(self, operand: Floats) -> Floats:
        return operand * operand

    def sincos(self, operand: Floats) -> tuple[Floats, Floats]:
        return np.sin(operand), np.cos(operand)

    def exp(self, operand: Floats) -> Floats:
        return np.exp(operand)

    def log(self, operand: Floats) -> Floats:
        return np.log(operand)

    def sqrt(self, operand: Floats) -> Floats:
        return np.sqrt(operand)

    def tanh(self, operand: Floats) -> Floats:
        return np.tanh(operand)
