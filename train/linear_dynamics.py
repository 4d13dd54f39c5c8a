"""Plants that are linear: decided exactly from the tape, and solved exactly over one control period.

``x' = A x + B u + E d + c`` with the inputs and disturbances held for h seconds has the solution
``x(h) = Phi x + Gamma [u; d] + gamma``, the first rows of ``expm(h [[A, B, E, c], [0, 0, 0, 0]])``.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..models.float_algebra import FloatAlgebra
from ..models.tape import Tape, run

Array = NDArray[np.float64]
Number: TypeAlias = "Fraction | float"
"""Exact, except where it comes out of a function, as in ``sqrt(2)*x``."""


@dataclass(frozen=True)
class _Form:
    """``coefficients @ inputs + constant``."""

    coefficients: tuple[Number, ...]
    constant: Number

    @property
    def is_constant(self) -> bool:
        return not any(self.coefficients)


_Value: TypeAlias = "_Form | None"
"""None: not known to be affine."""


class _AffineForms:
    """Operations of `models.tape.Algebra` on affine forms of `size` inputs."""

    def __init__(self, size: int) -> None:
        self.size = size

    def constant(self, value: Fraction) -> _Value:
        return self._number(value)

    def add(self, left: _Value, right: _Value) -> _Value:
        return self._combination(left, 1, right)

    def subtract(self, left: _Value, right: _Value) -> _Value:
        return self._combination(left, -1, right)

    def multiply(self, left: _Value, right: _Value) -> _Value:
        if left is None or right is None:
            return None
        if left.is_constant:
            return _scaled(right, left.constant)
        return _scaled(left, right.constant) if right.is_constant else None

    def divide(self, left: _Value, right: _Value) -> _Value:
        if left is None or right is None or not right.is_constant or right.constant == 0:
            return None
        return _scaled(left, 1 / right.constant)

    def negate(self, operand: _Value) -> _Value:
        return None if operand is None else _scaled(operand, Fraction(-1))

    def square(self, operand: _Value) -> _Value:
        return self.multiply(operand, operand)

    def sincos(self, operand: _Value) -> tuple[_Value, _Value]:
        return self._function("sin", operand), self._function("cos", operand)

    def exp(self, operand: _Value) -> _Value:
        return self._function("exp", operand)

    def log(self, operand: _Value) -> _Value:
        return self._function("log", operand)

    def sqrt(self, operand: _Value) -> _Value:
        return self._function("sqrt", operand)

    def tanh(self, operand: _Value) -> _Value:
        return self._function("tanh", operand)

    def _number(self, value: Number) -> _Form:
        return _Form((Fraction(0),) * self.size, value)

    def _combination(self, left: _Value, sign: int, right: _Value) -> _Value:
        if left is None or right is None:
            return None
        pairs = zip(left.coefficients, right.coefficients, strict=True)
        return _Form(tuple(a + sign * b for a, b in pairs), left.constant + sign * right.constant)

    def _function(self, name: str, operand: _Value) -> _Value:
        """A function of a constant is a constant; of anything else it is not affine."""
        if operand is None or not operand.is_constant:
            return None
        algebra, argument = FloatAlgebra(), float(operand.constant)
        with np.errstate(all="ignore"):
            if name in ("sin", "cos"):
                value = float(algebra.sincos(argument)[name == "cos"])
            else:
                value = float(getattr(algebra, name)(argument))
        return self._number(value) if np.isfinite(value) else None


def _scaled(form: _Form, factor: Number) -> _Form:
    return _Form(tuple(factor * entry for entry in form.coefficients), factor * form.constant)


def affine_map(tape: Tape) -> tuple[Array, Array] | None:
    """Matrix (outputs, inputs) and offset (outputs,) of a tape; None where it is not affine in its inputs.

    Decided in rational arithmetic: ``x*y - x*y`` counts as not affine, ``2*x - x - x`` as zero.
    """
    size = len(tape.inputs)
    units = [_Form(tuple(Fraction(i == j) for j in range(size)), Fraction(0)) for i in range(size)]
    forms = run(tape, _AffineForms(size), [*units])
    known = [form for form in forms if form is not None]
    if len(known) < len(forms):
        return None
    matrix = np.array([[float(entry) for entry in form.coefficients] for form in known]).reshape(len(known), size)
    return matrix, np.array([float(form.constant) for form in known])


def exact_step(matrix: Array, offset: Array, period: float) -> tuple[Array, Array]:
    """Solution of ``x' = matrix @ [x; v] + offset`` after `period` seconds with v held.

    Parameters
    ----------
    matrix : array, shape (n, n + held)
    offset : array, shape (n,)
    period : float
        Seconds.

    Returns
    -------
    matrix : array, shape (n, n + held)
    offset : array, shape (n,)
        ``x(period) = matrix @ [x(0); v] + offset``.
    """
    from scipy.linalg import expm

    size, width = matrix.shape
    augmented = np.zeros((width + 1, width + 1))
    augmented[:size, :width], augmented[:size, width] = matrix, offset
    solution = np.asarray(expm(augmented * period))
    return solution[:size, :width], solution[:size, width]
