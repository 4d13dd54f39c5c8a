"""Taylor series in time whose coefficients are jets in the start values: a tape, differentiated without error.

A tape compiles (once) to a plan: nodes, grouped so that all nodes of one kind on one level are computed by one array
operation. Coefficient k of every node follows from lower ones [1]_:

    product:     (a b)_k = sum_(j=0..k) a_j b_(k-j)
    primitive:   y' = a' r, so y_k = 1/k sum_(j=1..k) (j a_j) r_(k-j)      (sin: r = cos; exp: r = y)
    reciprocal:  q_k = -q_0 sum_(j=1..k) a_j q_(k-j)
    state:       z_k = f(z)_(k-1) / k

References
----------
.. [1] A. Griewank, A. Walther, "Evaluating Derivatives", 2nd ed., SIAM 2008, section 13.2.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ..models.tape import Tape
from . import balls, rounding
from .balls import Ball
from .jets import JetSpace, function_jet, jet_product, jet_space, sincos_jets
from .plan import Group, Plan, plan_of

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class _Convolution:
    """Convolutions of a group of pairs of series: gathered factors of all coefficients so far.

    The radius of ``sum_j a_j b_(k-j)`` is ``sum_j |a| (rb + g |b|) + ra (|b| + rb)``, g |b| the rounding of
    the sum (`rounding.sum_error`).
    """

    def __init__(self, space: JetSpace, terms: int, count: int, batch: int) -> None:
        shape = (terms, count, batch, space.left.size)
        self.space = space
        self.left, self.right = np.empty(shape), np.empty(shape)
        self.left_factors, self.right_factors = np.empty((2, *shape)), np.empty((2, *shape))
        # terms of the sum, and three roundings more for a weight, a divisor and the radius itself
        self.terms = 4 * terms + 3

    def put_left(self, k: int, data: Array, weight: float = 1.0) -> None:
        """Store coefficient k of the left factors, (2, count, B, C), times a small whole number."""
        gathered = data.take(self.space.left, axis=-1)
        if weight != 1.0:
            gathered *= weight
        self.left[k] = gathered[0]
        np.abs(gathered[0], out=self.left_factors[0, k])
        self.left_factors[1, k] = gathered[1]

    def put_right(self, k: int, data: Array, signs: Array | None = None) -> None:
        """Store coefficient k of the right factors, times signs."""
        gathered = data.take(self.space.right, axis=-1)
        magnitude = np.abs(gathered[0])
        if signs is None:
            self.right[k] = gathered[0]
        else:
            np.multiply(gathered[0], signs, out=self.right[k])
        np.add(gathered[1], magnitude, out=self.right_factors[1, k])
        np.add(gathered[1], rounding.sum_error(self.terms, magnitude), out=self.right_factors[0, k])

    def sum(self, lowest: int, k: int, divisor: float = 1.0) -> Ball:
        """``sum_(j=lowest..k) left_j right_(k-j) / divisor``, shape (count, B, C).

        The divisor's own rounding is one unit of the quotient, at most of the sum of magnitudes: `terms` counts it.
        """
        stop = k - lowest
        right = self.right[stop::-1] if stop >= 0 else self.right[:0]
        mid = np.einsum("jvbp,jvbp->vbp", self.left[lowest : k + 1], right)
        factors = self.right_factors[:, stop::-1]
        rad = np.einsum("zjvbp,zjvbp->vbp", self.left_factors[:, lowest : k + 1], factors)
        if self.space.size < mid.shape[-1]:
            mid = np.add.reduceat(mid, self.space.starts, axis=-1)
            rad = np.add.reduceat(rad, self.space.starts, axis=-1)
        if divisor != 1.0:
            mid /= divisor
            rad /= divisor
        return Ball(mid, rounding.enlarged(rad, 8 * k + 20))


class _Evaluation:
    """Storage and recurrences of one evaluation of a plan."""

    def __init__(self, plan: Plan, point: Ball, order: int, terms: int, variables: Indices | None) -> None:
        batch, dimension = point.mid.shape
        by = np.arange(dimension) if variables is None else variables
        self.plan = plan
        self.space = jet_space(order, by.size)
        self.data = np.zeros((2, terms, plan.size, batch, self.space.size))
        self.convolutions: dict[int, _Convolution] = {}
        self.terms = terms
        self.data[0, 0, :dimension, :, 0], self.data[1, 0, :dimension, :, 0] = point.mid.T, point.rad.T
        if order >= 1:
            self.data[0, 0, by, :, 1 + np.arange(by.size)] = 1.0

    def compute(self, k: int) -> None:
        """Coefficient k of every node but the inputs."""
        for number, group in enumerate(self.plan.groups):
            result = getattr(self, "_" + group.kind)(number, group, k)
            if result is not None:
                place = slice(group.start, group.stop)
                self.data[0, k, place], self.data[1, k, place] = result.mid, result.rad

    def integrate(self, states: int, k: int) -> None:
        """Coefficient k of the states: f_(k-1) / k."""
        rate = self.data[:, k - 1, self.plan.outputs]
        value = balls.divide_exact(Ball(rate[0], rate[1]), float(k))
        self.data[0, k, :states], self.data[1, k, :states] = value.mid, value.rad

    def _operand(self, positions: Indices, k: int) -> Ball:
        values = self.data[:, k, positions]
        return Ball(values[0], values[1])

    def _convolution(self, number: int, group: Group) -> _Convolution:
        if number not in self.convolutions:
            batch, count = self.data.shape[3], group.stop - group.start
            self.convolutions[number] = _Convolution(self.space, self.terms, count, batch)
        return self.convolutions[number]

    def _constant(self, number: int, group: Group, k: int) -> Ball | None:
        if k > 0:
            return None
        numbers = balls.rationals([value for value in group.values if value is not None])
        shape = (group.stop - group.start, self.data.shape[3], self.space.size)
        mid, rad = np.zeros(shape), np.zeros(shape)
        mid[:, :, 0], rad[:, :, 0] = numbers.mid[:, None], numbers.rad[:, None]
        return Ball(mid, rad)

    def _add(self, number: int, group: Group, k: int) -> Ball:
        return balls.add(self._operand(group.first, k), self._operand(group.second, k))

    def _subtract(self, number: int, group: Group, k: int) -> Ball:
        return balls.subtract(self._operand(group.first, k), self._operand(group.second, k))

    def _negate(self, number: int, group: Group, k: int) -> Ball:
        return balls.negate(self._operand(group.first, k))

    def _product(self, number: int, group: Group, k: int) -> Ball:
        convolution = self._convolution(number, group)
        convolution.put_left(k, self.data[:, k, group.first])
        convolution.put_right(k, self.data[:, k, group.second])
        return convolution.sum(0, k)

    def _square(self, number: int, group: Group, k: int) -> Ball:
        """A product whose value at k = 0 is the tight interval square."""
        result = self._product(number, group, k)
        if k == 0:
            value = balls.square(self._operand(group.first, 0)[..., :1])
            result.mid[..., :1], result.rad[..., :1] = value.mid, value.rad
        return result

    def _primitive(self, number: int, group: Group, k: int) -> Ball:
        convolution = self._convolution(number, group)
        if k == 0:
            return self._functions(group)
        convolution.put_left(k, self.data[:, k, group.first], float(k))
        convolution.put_right(k - 1, self.data[:, k - 1, group.lagged], group.signs)
        return convolution.sum(1, k, float(k))

    def _functions(self, group: Group) -> Ball:
        """Coefficient 0 of primitives; sine and cosine of one argument always come in pairs, computed together."""
        argument = self._operand(group.first, 0)
        jets: list[Ball] = []
        for i, name in enumerate(group.functions):
            if name == "sin":
                jets += sincos_jets(self.space, argument[i])
            elif name != "cos":
                jets.append(function_jet(self.space, name, argument[i]))
        return Ball(np.array([j.mid for j in jets]), np.array([j.rad for j in jets]))

    def _reciprocal(self, number: int, group: Group, k: int) -> Ball:
        convolution = self._convolution(number, group)
        convolution.put_left(k, self.data[:, k, group.first])
        if k == 0:
            return function_jet(self.space, "reciprocal", self._operand(group.first, 0))
        place = np.arange(group.start, group.stop)
        convolution.put_right(k - 1, self.data[:, k - 1, place])
        return balls.negate(jet_product(self.space, self._operand(place, 0), convolution.sum(1, k)))


def flow_jets(tape: Tape, point: Ball, order: int, terms: int, variables: Indices | None = None) -> Ball:
    """Jets of the time-Taylor coefficients of the flow: z_[k+1] = f(z)_[k] / (k + 1).

    Parameters
    ----------
    tape : Tape
        Vector field of the first n inputs; the other inputs are constant in time.
    point : Ball, shape (B, d)
        Thin for an expansion point, a box for bounds over the box.
    order : int
        Order of the jets in the start values, 0 to 2.
    terms : int
        Number of time coefficients.
    variables : array of int, optional
        Inputs by which the jets differentiate; all by default.

    Returns
    -------
    Ball, shape (terms, n, B, C)
    """
    states = len(tape.outputs)
    evaluation = _Evaluation(plan_of(tape), point, order, terms, variables)
    for k in range(terms):
        if k:
            evaluation.integrate(states, k)
        if k + 1 < terms:
            evaluation.compute(k)
    return Ball(evaluation.data[0, :, :states], evaluation.data[1, :, :states])


def map_jets(tape: Tape, point: Ball, order: int, variables: Indices | None = None) -> Ball:
    """Jets of a tape's outputs (no time): point (B, d) to shape (outputs, B, C); see `flow_jets`."""
    plan = plan_of(tape)
    evaluation = _Evaluation(plan, point, order, 1, variables)
    evaluation.compute(0)
    return Ball(evaluation.data[0, 0, plan.outputs], evaluation.data[1, 0, plan.outputs])
