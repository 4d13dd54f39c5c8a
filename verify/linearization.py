"""Flow enclosure by conservative linearisation: the classic alternative to 2-jets, and their differential test.

With e = z - z*, z* a point near the middle of the step, and B an a-priori enclosure of all trajectories over the step:

    f(z) in f(z*) + J e + L,    L = 1/2 e' H e for e in B - z*, H the interval Hessian over B and z* [1]_.

L is a box that is constant in time. Its center joins the constant input f(z*), its half-width bounds an arbitrary input
w(t), and the trajectories are known in closed form:

    x(t) in x(0) + (sum_(k>=1) t^k A^(k-1) G/k!) q + int_0^t e^(A (t-s)) w(s) ds,
    G = [J, I],  q = (e(0), f(z*) + mid L),

where A is the states' part of J. The last term lies in ``+-(sum_(k>=1) t^k |A^(k-1)|/k!) rad L``. What the truncated
series leave out is bounded by `ball_matrices.exponential_tail`.

References
----------
.. [1] M. Althoff, O. Stursberg, M. Buss, "Reachability analysis of nonlinear systems with uncertain parameters using
   conservative linearization", CDC 2008, section III.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..models.tape import Tape
from . import balls, rounding
from .ball_matrices import absolute_product, exponential_coefficients, exponential_tail, product
from .balls import Ball
from .picard import a_priori_enclosure, derivative_bounds, growth_rate
from .series import map_jets
from .steps import Step
from .zonotope import Zonotope, append_rows, concatenate, diagonal_rows, linear_map

Array = NDArray[np.float64]


@lru_cache(maxsize=1024)
def time_weights(times: tuple[Fraction, ...], order: int, derivative: int) -> Ball:
    """The derivatives of 1, t, ..., t^K at some times, shape (S, K + 1): exact rationals, rounded once."""
    return balls.rational_matrix(
        [[math.perm(k, derivative) * t ** max(k - derivative, 0) for k in range(order + 1)] for t in times]
    )


@dataclass(frozen=True, kw_only=True)
class LinearStep(Step):
    """One step by conservative linearisation; see `Step` for what every method has.

    `truncation` is the tail, and the remainder without the share that the start set alone causes. The rows of `end` are
    those of `start`, then n rows of this step's remainder.

    Attributes
    ----------
    value, jacobian : Ball
        Time coefficients 0 .. K of the linearised solution from the start set's center, (B, K + 1, n), and of its
        derivative by the start value, (B, K + 1, n, d).
    drive : array, shape (B, K + 1, n)
        Time coefficients of a bound of what the linearisation remainder contributes.
    tail : array, shape (B, n)
        Bound of the sum of all coefficients above K, each times its power of any time up to the duration.
    """

    CELL_AXES: ClassVar[dict[str, int]] = Step.CELL_AXES | {"value": 0, "jacobian": 0, "drive": 0, "tail": 0}

    value: Ball
    jacobian: Ball
    drive: Array
    tail: Array

    def enclose_intervals(self, slabs: int) -> list[Zonotope]:
        """Sets that contain the states at every time of each of `slabs` equal parts of the step.

        Around the middle t_m of a part, with |tau| <= delta, x the polynomial part of the linearised solution:
        ``x(t_m + tau) in x(t_m) + x'(t_m) tau +- delta^2/2 |x''|``. Time is one more generator for the velocity of the
        center; that of a deviation d is bounded by ``|Dx'(t_m)| a``; |x''|, remainder and tail at the part's end.
        """
        return _slabs(self, slabs)


def linear_step(tape: Tape, z: Zonotope, duration: Fraction, order: int, rate: Array | None = None) -> LinearStep:
    """Enclose one step; see the module's formula.

    Parameters
    ----------
    tape : Tape
        Vector field of the first n coordinates; the others are constant over the step.
    z : Zonotope, shape (B, d)
    duration : Fraction
    order : int
        Highest power K of time in the series of the matrix exponential.
    rate : array, shape (2, B, n), optional
        Guess for the a-priori enclosure.

    Returns
    -------
    LinearStep
    """
    states, dimension = len(tape.outputs), z.dimension
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        found, proved = a_priori_enclosure(tape, z.interval, balls.rational(duration), rate)
        prior = tightened(tape, z.interval, found, duration)
        point = expansion_point(tape, z.center, duration)
        domain = hessian_domain(prior, point)
        deviation = balls.subtract(domain, balls.exact(point))
        value, jacobian = _first_order(tape, point)
        hessian = hessian_bounds(tape, domain)
        drift = balls.add(value, lagrange_remainder(hessian, deviation))
        # J itself is only known as a ball: the linear system is the one with its midpoint, the rest is input
        unknown = absolute_product(jacobian.rad, deviation.magnitude[:, :, None])[..., 0]
        drift = Ball(drift.mid, rounding.enlarged(drift.rad + unknown, 1))
        series = _series(jacobian.mid, z, point, drift, order)
        tail = _tail(jacobian.mid[:, :, :states], z, series, drift.rad, duration)
        weights = time_weights((duration,), order, 0)
        linear = linear_map(
            _centred(z), _combine(weights, series.jacobian)[:, 0], _combine(weights, series.value)[:, 0]
        )
        response = _combine(balls.exact(weights.magnitude), balls.exact(series.response))[:, 0].magnitude
        added = absolute_product(response, drift.rad[:, :, None])[..., 0] + tail
        added = rounding.enlarged(rounding.checkable(added), 3)
        image = append_rows(linear, diagonal_rows(added))
        end = concatenate(image, z.coordinates(slice(states, dimension)))
        lasting = lagrange_remainder(hessian, Ball(np.zeros_like(z.center), z.spread)).rad
        shorter = np.maximum(drift.rad - lasting, 0.0)
        truncation = (response @ shorter[:, :, None])[..., 0] + tail
        finite = np.isfinite(end.spread).all(1) & np.isfinite(end.center).all(1)
        drive = absolute_product(series.response, drift.rad[:, None, :, None])[..., 0]
        growth = growth_rate(prior, z.interval, states, duration)
    sound = proved & finite
    return LinearStep(
        start=z,
        duration=duration,
        end=end,
        added=added,
        truncation=truncation,
        sound=sound,
        rate=growth,
        value=series.value,
        jacobian=series.jacobian,
        drive=drive,
        tail=tail,
        prior=found,
    )


def tightened(tape: Tape, box: Ball, prior: Ball, duration: Fraction) -> Ball:
    """``box(X) + [0, h] f(B)`` within B: if B contains every trajectory, so does this.

    Picard iteration inflates its guesses until one fits; the remainder is quadratic in the size of what fitted.
    """
    states = len(tape.outputs)
    rate = derivative_bounds(tape, prior)
    longest = rounding.float_above(duration)
    down = rounding.down(np.minimum(rounding.down(longest * rate.lower), 0.0))
    up = rounding.up(np.maximum(rounding.up(longest * rate.upper), 0.0))
    low, high = prior.lower.copy(), prior.upper.copy()
    low[:, :states] = np.maximum(low[:, :states], rounding.down(box.lower[:, :states] + down))
    high[:, :states] = np.minimum(high[:, :states], rounding.up(box.upper[:, :states] + up))
    return balls.hull(low, high)


def expansion_point(tape: Tape, center: Array, duration: Fraction) -> Array:
    """``c + h/2 f(c)`` in the states, c in the rest, shape (B, d): near the middle of the step. Any point is sound."""
    states = len(tape.outputs)
    point = center.copy()
    point[:, :states] += 0.5 * float(duration) * derivative_bounds(tape, balls.exact(center)).mid
    return point


def hessian_domain(prior: Ball, point: Array) -> Ball:
    """The box that contains every segment from the expansion point to a trajectory; Taylor's theorem needs them."""
    return balls.hull(np.minimum(prior.lower, point), np.maximum(prior.upper, point))


def lagrange_remainder(hessian: Ball, deviation: Ball) -> Ball:
    """Enclose ``1/2 e' H e``.

    Parameters
    ----------
    hessian : Ball, shape (B, n, d (d + 1)/2)
        Upper triangles: off-diagonal entries count twice.
    deviation : Ball, shape (B, d)
        The box of e.

    Returns
    -------
    Ball, shape (B, n)
    """
    rows, columns = np.triu_indices(deviation.mid.shape[1])
    crossed = balls.multiply(deviation[:, rows], deviation[:, columns])
    squares = balls.scale(balls.square(deviation), 0.5)
    diagonal = rows == columns
    crossed.mid[:, diagonal], crossed.rad[:, diagonal] = squares.mid, squares.rad
    return product(hessian, crossed[:, :, None])[..., 0]


@dataclass(frozen=True)
class _Series:
    """Time coefficients 0 .. K of the linearised solution.

    `value` (B, K + 1, n) and `jacobian` (B, K + 1, n, d) are those of `LinearStep`; `response` (B, K + 1, n, n) bounds
    the absolute values of those of ``int_0^t e^(A s) ds``.
    """

    value: Ball
    jacobian: Ball
    response: Array


def _series(jacobian: Array, z: Zonotope, point: Array, drift: Ball, order: int) -> _Series:
    """Series of ``x' = J (z - point) + mid(drift)``: its matrices, applied to the center before bounds are taken."""
    batch, states, dimension = jacobian.shape
    identity = np.tile(np.eye(states), (batch, 1, 1))
    maps = exponential_coefficients(jacobian[:, :, :states], np.concatenate([jacobian, identity], -1), order)
    offset = balls.subtract(balls.exact(z.center), balls.exact(point))
    constant = _joined(offset, balls.exact(drift.mid), 1)[:, None, :, None]
    whole = np.concatenate([identity, np.zeros((batch, states, dimension - states))], -1)[:, None]
    return _Series(
        _joined(balls.exact(z.center[:, None, :states]), product(maps, constant)[..., 0], 1),
        _joined(balls.exact(whole), maps[..., :dimension], 1),
        np.concatenate([np.zeros_like(identity[:, None]), maps[..., dimension:].magnitude], 1),
    )


def _tail(rate: Array, z: Zonotope, series: _Series, drift_radius: Array, duration: Fraction) -> Array:
    """What the series leave out up to the end of the step, shape (B, n): for all start values and inputs together."""
    order = series.value.mid.shape[1] - 1
    last = series.value.magnitude[:, -1, :, None]
    last = last + absolute_product(series.jacobian.magnitude[:, -1], z.spread[..., None])
    last = last + absolute_product(series.response[:, -1], drift_radius[..., None])
    last = rounding.enlarged(last[..., 0] * rounding.float_above(duration**order), 3)
    return exponential_tail(rounding.enlarged(np.abs(rate) * rounding.float_above(duration), 1), last, order)


def _first_order(tape: Tape, point: Array) -> tuple[Ball, Ball]:
    """f and J at a point: shapes (B, n) and (B, n, d)."""
    jets = map_jets(tape, balls.exact(point), 1)
    jets = Ball(np.swapaxes(jets.mid, 0, 1), np.swapaxes(jets.rad, 0, 1))
    return jets[..., 0], jets[..., 1:]


def hessian_bounds(tape: Tape, box: Ball) -> Ball:
    """Upper triangles of the Hessians over a box, shape (B, n, d (d + 1)/2)."""
    jets = map_jets(tape, box, 2)
    first = 1 + box.mid.shape[1]
    return Ball(np.swapaxes(jets.mid, 0, 1)[..., first:], np.swapaxes(jets.rad, 0, 1)[..., first:])


def _centred(z: Zonotope) -> Zonotope:
    return replace(z, center=np.zeros_like(z.center))


def _joined(first: Ball, second: Ball, axis: int) -> Ball:
    return Ball(np.concatenate([first.mid, second.mid], axis), np.concatenate([first.rad, second.rad], axis))


def _combine(weights: Ball, coefficients: Ball) -> Ball:
    """``sum_k weights[s, k] coefficients[:, k]``: (S, K + 1) and (B, K + 1, ...) to (B, S, ...)."""
    batch, terms, *rest = coefficients.mid.shape
    flat = Ball(coefficients.mid.reshape(batch, terms, -1), coefficients.rad.reshape(batch, terms, -1))
    result = product(weights, flat)
    shape = (batch, weights.mid.shape[0], *rest)
    return Ball(result.mid.reshape(shape), result.rad.reshape(shape))


def _slabs(step: LinearStep, slabs: int) -> list[Zonotope]:
    """Time-interval sets of equal parts of a step; see `LinearStep.time_intervals`."""
    order = step.value.mid.shape[1] - 1
    width = step.duration / slabs
    middles = tuple(width * part + width / 2 for part in range(slabs))
    ends = tuple(width * (part + 1) for part in range(slabs))
    delta = rounding.float_above(width / 2)
    spread = step.start.spread[:, None, :, None]
    value = _combine(time_weights(middles, order, 0), step.value)
    jacobian = _combine(time_weights(middles, order, 0), step.jacobian)
    velocity = _combine(time_weights(middles, order, 1), step.value)
    drift = absolute_product(_combine(time_weights(middles, order, 1), step.jacobian).magnitude, spread)[..., 0]
    bends = step.value.magnitude + absolute_product(step.jacobian.magnitude, spread)[..., 0]
    bend = absolute_product(time_weights(ends, order, 2).magnitude, rounding.enlarged(bends, 1))
    driven = absolute_product(time_weights(ends, order, 0).magnitude, step.drive)
    time_rows = velocity.mid * delta
    extra = (velocity.rad + drift) * delta + rounding.relative_error(time_rows, 1) + 0.5 * delta * delta * bend
    extra = rounding.enlarged(rounding.checkable(extra + driven + step.tail[:, None]), 10)
    result = []
    for part in range(slabs):
        linear = linear_map(_centred(step.start), jacobian[:, part], value[:, part])
        radius = rounding.enlarged(linear.radius + extra[:, part], 1)
        result.append(append_rows(Zonotope(linear.center, linear.generators, radius), time_rows[:, part, None]))
    return result
