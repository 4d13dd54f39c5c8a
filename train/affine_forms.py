"""Affine forms over torch: the algebra that carries the reachable sets of the trainer through a plant's tape.

A form is ``x = c + sum_j g_j b_j + r e`` with b in [-1, 1]^q shared by all forms of one evaluation, and e in [-1, 1]
its own. Affine operations are exact [1]_; a function f of one operand becomes ``f(c) + f'(c) d`` and the exact range of
what is left: where its curvature has one sign that range is between 0 and the value at an end; of sin and cos the inner
extremes are known, of tanh the relaxation of `verify.relaxations` is taken.

In float64 a form contains what it should up to rounding. Nothing rests on it: these sets give directions in which to
move a policy, and what it is worth then is decided by `setrl.verify`. Gradients are finite everywhere, at radius zero
too.

References
----------
.. [1] L. H. de Figueiredo, J. Stolfi, "Affine arithmetic: concepts and applications", Numerical Algorithms 37, 2004.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction
from functools import cached_property
from typing import TypeAlias

import torch

from .networks import Tensor
from .relaxation_gradients import center_and_radius, enclosed_sincos, relaxed_tanh, with_center

SMALLEST = 1e-9
"""Where an operand reaches the edge of a function's domain: the share of its center (or the value) it is kept at."""
LARGEST_EXPONENT = 300.0


@dataclass(frozen=True)
class AffineForm:
    """A batch of forms.

    Attributes
    ----------
    terms : Tensor, shape (..., 1 + q)
        Center and generators.
    remainder : Tensor, shape (...), or float
        Half-width r >= 0 of the box.
    """

    terms: Tensor
    remainder: Tensor | float = 0.0

    @cached_property
    def _extent(self) -> tuple[Tensor, Tensor]:
        return center_and_radius(self.terms)

    @property
    def center(self) -> Tensor:
        """c, shape (...)."""
        return self._extent[0]

    @property
    def generators(self) -> Tensor:
        """The coefficients g_j, shape (..., q)."""
        return self.terms[..., 1:]

    @property
    def radius(self) -> Tensor:
        """|g| 1 + r, shape (...)."""
        return self._extent[1] + self.remainder


Form: TypeAlias = AffineForm | float
"""A form, or a number that is known."""


class AffineFormAlgebra:
    """Operations of `models.tape.Algebra` on affine forms; leading dimensions broadcast, constants are numbers."""

    def constant(self, value: Fraction) -> Form:
        return float(value)

    def add(self, left: Form, right: Form) -> Form:
        return shifted(left, right, 1.0)

    def subtract(self, left: Form, right: Form) -> Form:
        if isinstance(left, float):
            return shifted(self.negate(right), left, 1.0)
        return shifted(left, right, -1.0)

    def negate(self, operand: Form) -> Form:
        return -operand if isinstance(operand, float) else AffineForm(-operand.terms, operand.remainder)

    def multiply(self, left: Form, right: Form) -> Form:
        if isinstance(left, float) and isinstance(right, float):
            return left * right
        if isinstance(left, float):
            left, right = right, left
        assert isinstance(left, AffineForm)
        if isinstance(right, float):
            return AffineForm(left.terms * right, left.remainder * abs(right))
        # products of one factor with itself are in [0, 1]: half of them moves the center
        diagonal = left.generators * right.generators
        half = 0.5 * diagonal.sum(-1)
        first, second = left.terms[..., :1], right.terms[..., :1]
        middle = torch.addcmul(half[..., None], first, second)
        terms = torch.cat([middle, first * right.generators + second * left.generators], -1)
        rest = left.radius * right.radius - 0.5 * diagonal.abs().sum(-1)
        rest = rest + left.center.abs() * right.remainder + right.center.abs() * left.remainder
        return AffineForm(terms, rest)

    def divide(self, left: Form, right: Form) -> Form:
        if isinstance(right, float):
            return self.multiply(left, 1.0 / right)
        center = torch.where(right.center.abs() < SMALLEST, SMALLEST, right.center)
        ends = center * (1.0 + _ends(right) / center).clamp(min=SMALLEST)
        return self.multiply(left, _curved(right, center.reciprocal(), -center.square().reciprocal(), 1.0 / ends, ends))

    def square(self, operand: Form) -> Form:
        if isinstance(operand, float):
            return operand * operand
        half = 0.5 * operand.radius.square()
        return _linear(operand, operand.center.square() + half, 2.0 * operand.center, half)

    def sincos(self, operand: Form) -> tuple[Form, Form]:
        if isinstance(operand, float):
            return math.sin(operand), math.cos(operand)
        sine, cosine = enclosed_sincos(operand.center, operand.radius)
        return _linear(operand, *sine), _linear(operand, *cosine)

    def exp(self, operand: Form) -> Form:
        if isinstance(operand, float):
            return math.exp(operand)
        value = operand.center.clamp(max=LARGEST_EXPONENT).exp()
        ends = operand.center + _ends(operand)
        return _curved(operand, value, value, ends.clamp(max=LARGEST_EXPONENT).exp(), ends)

    def log(self, operand: Form) -> Form:
        if isinstance(operand, float):
            return math.log(operand)
        center = operand.center.clamp(min=SMALLEST)
        ends = torch.maximum(center + _ends(operand), SMALLEST * center)
        return _curved(operand, center.log(), center.reciprocal(), ends.log(), ends)

    def sqrt(self, operand: Form) -> Form:
        if isinstance(operand, float):
            return math.sqrt(operand)
        center = operand.center.clamp(min=SMALLEST)
        ends = torch.maximum(center + _ends(operand), SMALLEST * center)
        return _curved(operand, center.sqrt(), 0.5 * center.rsqrt(), ends.sqrt(), ends)

    def tanh(self, operand: Form) -> Form:
        if isinstance(operand, float):
            return math.tanh(operand)
        radius = operand.radius
        slope, offset, error = relaxed_tanh(operand.center - radius, operand.center + radius)
        return _linear(operand, torch.addcmul(offset, slope, operand.center), slope, error)


def shifted(form: Form, other: Form, factor: float) -> Form:
    """``form + factor other``.

    Parameters
    ----------
    form, other : AffineForm or float
    factor : float

    Returns
    -------
    AffineForm or float
    """
    if isinstance(other, float):
        if isinstance(form, float):
            return form + factor * other
        if other == 0.0:
            return form
        unit = form.terms.new_zeros(form.terms.shape[-1])
        unit[0] = factor * other
        return AffineForm(form.terms + unit, form.remainder)
    if isinstance(form, float):
        return shifted(AffineForm(other.terms * factor, other.remainder * abs(factor)), form, 1.0)
    remainder = form.remainder + abs(factor) * other.remainder
    return AffineForm(torch.add(form.terms, other.terms, alpha=factor), remainder)


def _ends(operand: AffineForm) -> Tensor:
    """Deviations of the ends from the center, stacked in front."""
    radius = operand.radius
    return torch.stack([radius, -radius])


def _linear(operand: AffineForm, center: Tensor, slope: Tensor, error: Tensor) -> AffineForm:
    """``center + slope d +- error``, d the operand's deviation."""
    terms = with_center(operand.terms, slope, center)
    # most remainders are still the number zero: nothing to record
    spread = 0.0 if isinstance(operand.remainder, float) else slope.abs() * operand.remainder
    return AffineForm(terms, spread + error)


def _curved(operand: AffineForm, value: Tensor, slope: Tensor, at_ends: Tensor, ends: Tensor) -> AffineForm:
    """Apply a function whose curvature has one sign: the rest of its tangent is between 0 and the larger end's."""
    residual = at_ends - value - slope * (ends - operand.center)
    low, high = residual.amin(0).clamp(max=0.0), residual.amax(0).clamp(min=0.0)
    return _linear(operand, value + 0.5 * (low + high), slope, 0.5 * (high - low))
