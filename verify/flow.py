"""Flow enclosure by 2-jets: one integrator step of a batch of joint sets (states, inputs, disturbances).

Inputs and disturbances are constant over a step, so they are states with derivative zero. With the time-Taylor
coefficients phi_k of the flow map as functions of the start point, P = sum_k phi_k(c) t^k, and K the time order:

    z(t) in P(c) + DP(c) d + 1/2 d' H d + z_[K](B) t^K,    H the Hessian of P over the set's enclosing interval,

where B is an a-priori enclosure of all trajectories over the step: box(X) + [0, h] f(B) inside B (Picard).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.tape import Tape, run
from . import balls, rounding
from .balls import Ball, BallAlgebra
from .quadratic_map import enclose_map, half_quadratic
from .series import flow_jets, map_jets, plan_of
from .zonotope import Zonotope, append_rows, concatenate, linear_map, stack_cells

Array = NDArray[np.float64]

PICARD_ITERATIONS = 16


def derivative_bounds(tape: Tape, box: Ball) -> Ball:
    """Interval evaluation of a tape: box of shape (B, d) to (B, outputs)."""
    values = run(tape, BallAlgebra(), [Ball(mid, rad) for mid, rad in zip(box.mid.T, box.rad.T, strict=True)])
    result = np.empty((2, box.mid.shape[0], len(values)))
    for i, value in enumerate(values):
        result[0, :, i], result[1, :, i] = value.mid, value.rad
    return Ball(result[0], result[1])


def a_priori_enclosure(tape: Tape, box: Ball, step: Ball, rate: Array | None = None) -> tuple[Ball, NDArray[np.bool_]]:
    """Boxes that contain every trajectory from `box` over [0, step], by Picard iteration.

    If ``X + [0, h] f(B)`` is contained in B, then B contains all solutions that start in X, they exist on [0, h], and
    the left-hand side encloses them too.

    Parameters
    ----------
    tape : Tape
        Vector field; outputs are the derivatives of the first n inputs, the others are constant.
    box : Ball, shape (B, d)
    step : Ball, shape ()
    rate : array, shape (2, B, n), optional
        Guess of the derivatives' lower and upper bounds, from wherever.

    Returns
    -------
    Ball, shape (B, d)
    array of bool, shape (B,)
        Where inclusion was proved. Elsewhere the box means nothing.
    """
    states = len(tape.outputs)
    with np.errstate(invalid="ignore", over="ignore"):
        least, most = box.lower, box.upper
        start_low, start_high = least[:, :states].copy(), most[:, :states].copy()
        size = box.magnitude[:, :states]
        longest = float(step.upper)

        def reached(slowest: Array, fastest: Array) -> tuple[Array, Array]:
            """X + [0, h] [slowest, fastest]."""
            down = rounding.down(np.minimum(rounding.down(longest * slowest), 0.0))
            up = rounding.up(np.maximum(rounding.up(longest * fastest), 0.0))
            return rounding.down(start_low + down), rounding.up(start_high + up)

        def image(low: Array, high: Array) -> tuple[Array, Array]:
            """X + [0, h] f([low, high])."""
            least[:, :states], most[:, :states] = low, high
            bounds = derivative_bounds(tape, balls.hull(least, most))
            return reached(bounds.lower, bounds.upper)

        low, high = image(start_low, start_high) if rate is None else reached(rate[0], rate[1])
        fits = np.zeros(low.shape, dtype=bool)
        proved = np.zeros(low.shape[0], dtype=bool)
        result_low, result_high = start_low, start_high
        for _ in range(PICARD_ITERATIONS):
            # the image of a slightly larger box has to fit; coordinates that fitted already keep their bounds
            slack = np.maximum(0.5 * ((high - low) - 2.0 * box.rad[:, :states]), 2.0**-40 * size) + rounding.TINY
            low, high = np.where(fits, low, low - slack), np.where(fits, high, high + slack)
            new_low, new_high = image(low, high)
            fits = (new_low >= low) & (new_high <= high) & np.isfinite(new_low) & np.isfinite(new_high)
            fresh = fits.all(1) & ~proved
            result_low = np.where(fresh[:, None], new_low, result_low)
            result_high = np.where(fresh[:, None], new_high, result_high)
            proved |= fresh
            if proved.all():
                break
            low, high = np.where(fits, low, new_low), np.where(fits, high, new_high)
        least[:, :states], most[:, :states] = result_low, result_high
        found = balls.hull(least, most)
    if rate is None or proved.all():
        return found, proved
    # a bad guess must not cost a proof that exists without it
    again, proved_again = a_priori_enclosure(tape, box, step)
    old = proved[:, None]
    return Ball(np.where(old, found.mid, again.mid), np.where(old, found.rad, again.rad)), proved | proved_again


def growth_rate(prior: Ball, box: Ball, states: int, duration: Fraction) -> Array:
    """Growth of an a-priori box per second, shape (2, B, n): a guess for the next step, not a bound."""
    with np.errstate(invalid="ignore", over="ignore"):
        growth = np.stack([prior.lower - box.lower, prior.upper - box.upper])
        return growth[:, :, :states] / float(duration)


def image_of(tape: Tape, z: Zonotope, rows: int) -> tuple[Zonotope, Array]:
    """Enclose the image of a zonotope under a tape (observation maps, discrete-time plants); see `enclose_map`."""
    used = plan_of(tape).used
    center = _cells_first(map_jets(tape, balls.exact(z.center), 1, used))
    box = _cells_first(map_jets(tape, z.interval, 2, used))
    jacobian = _spread_columns(center[..., 1:], used, z.dimension)
    return enclose_map(center[..., 0], jacobian, box[..., 1 + used.size :], used, z, rows)


def _spread_columns(jacobian: Ball, variables: NDArray[np.intp], dimension: int) -> Ball:
    """A Jacobian by some variables as one by all of them, zero elsewhere."""
    mid, rad = (np.zeros((*jacobian.mid.shape[:-1], dimension)) for _ in range(2))
    mid[..., variables], rad[..., variables] = jacobian.mid, jacobian.rad
    return Ball(mid, rad)


def powers(time: Ball, terms: int) -> Ball:
    """1, t, t^2, ..., shape (terms, *time.shape)."""
    values = [balls.exact(np.ones_like(time.mid))]
    for _ in range(terms - 1):
        values.append(balls.multiply(values[-1], time))
    return Ball(np.stack([v.mid for v in values]), np.stack([v.rad for v in values]))


def combine(weights: Ball, coefficients: Ball) -> Ball:
    """``sum_k weights[s, k] coefficients[k]``: weights (S, K), coefficients (K, ...) to (S, ...)."""
    terms = weights.mid.shape[1]
    shape = (weights.mid.shape[0], *coefficients.mid.shape[1:])
    mid, rad = coefficients.mid.reshape(terms, -1), coefficients.rad.reshape(terms, -1)
    size = np.abs(mid)
    spread = weights.magnitude @ (rad + rounding.sum_error(terms, size)) + weights.rad @ size
    return Ball((weights.mid @ mid).reshape(shape), rounding.enlarged(spread, terms + 8).reshape(shape))


def largest(weights: Ball, coefficients: Ball) -> Array:
    """Upper bound of ``sum_k |weights[s, k]| |coefficients[k]|``, shape (S, ...)."""
    terms = weights.mid.shape[1]
    total = weights.magnitude @ coefficients.magnitude.reshape(terms, -1)
    shape = (weights.mid.shape[0], *coefficients.mid.shape[1:])
    return rounding.enlarged(total, terms + 2).reshape(shape)  # type: ignore[no-any-return]


@lru_cache(maxsize=256)
def step_weights(duration: Fraction, terms: int) -> Ball:
    """Powers of a step's duration, shape (1, terms)."""
    values = powers(balls.rational(duration), terms)
    return Ball(values.mid[None], values.rad[None])


@dataclass(frozen=True)
class SlabWeights:
    """Weights of the time coefficients for every part of a step.

    Attributes
    ----------
    half : float
        Upper bound of half the parts' width.
    value, velocity : Ball, shape (S, K)
        Of the state and its time derivative at the parts' middles.
    last, second_derivative : Ball, shape (S, K)
        Of bounds of the state and of its second derivative up to the parts' ends.
    remainder : array, shape (S,)
        Upper bound of the parts' end to the power K.
    """

    half: float
    value: Ball
    velocity: Ball
    last: Ball
    second_derivative: Ball
    remainder: Array


@lru_cache(maxsize=256)
def slab_weights(duration: Fraction, slabs: int, terms: int) -> SlabWeights:
    """Weights for `slabs` equal parts of a step."""
    middle = powers(balls.rationals([duration * (2 * part + 1) / (2 * slabs) for part in range(slabs)]), terms)
    last = powers(balls.rationals([duration * (part + 1) / slabs for part in range(slabs)]), terms + 1)
    middle, last = Ball(middle.mid.T, middle.rad.T), Ball(last.mid.T, last.rad.T)
    count = np.arange(terms, dtype=np.float64)

    def derivative(weights: Ball, by: int) -> Ball:
        """Weights of the by-th time derivative: k (k - 1) ... (k - by + 1) t^(k - by), zero for k < by."""
        factor = count.copy()
        for i in range(1, by):
            factor = factor * (count - i)
        zero = np.zeros((slabs, by))
        mid = np.concatenate([zero, weights.mid[:, : terms - by]], 1)
        rad = np.concatenate([zero, weights.rad[:, : terms - by]], 1)
        return balls.multiply(Ball(mid, rad), balls.exact(factor))

    return SlabWeights(
        float(balls.rational(duration / (2 * slabs)).upper),
        middle,
        derivative(middle, 1),
        last[:, :terms],
        derivative(last, 2),
        last.upper[:, terms],
    )


@dataclass(frozen=True)
class JetStep:
    """One integrator step of a batch of joint sets.

    Attributes
    ----------
    start : Zonotope, shape (B, d)
        States first, then what is constant over the step.
    duration : Fraction
    value, jacobian, hessian : Ball
        Time coefficients 0 .. K - 1 of the flow: (K, B, n), (K, B, n, d) at the center, (K, B, n, v (v + 1)/2) by the
        `variables` over the enclosing interval.
    variables : array of int, shape (v,)
        Coordinates on which the vector field depends.
    remainder : Ball, shape (B, n)
        Time coefficient K over the a-priori box.
    end : Zonotope, shape (B, d)
        Joint set at the end.
    added : array, shape (B, n)
        Half-width that this step added in all.
    truncation : array, shape (B, n)
        The part of it that shorter steps would diminish: the time remainder.
    sound : array of bool, shape (B,)
        Whether the a-priori enclosure was proved and everything is finite; elsewhere the step means nothing.
    rate : array, shape (2, B, n)
        Growth of the a-priori box per second: a guess for the next step, not a bound.
    """

    start: Zonotope
    duration: Fraction
    value: Ball
    jacobian: Ball
    hessian: Ball
    variables: NDArray[np.intp]
    remainder: Ball
    end: Zonotope
    added: Array
    truncation: Array
    sound: NDArray[np.bool_]
    rate: Array
    slabs: dict[int, list[Zonotope]] = field(default_factory=dict, repr=False, compare=False)
    """Time-interval sets that were already asked for."""

    def select(self, cells: Any) -> JetStep:
        """The same step of some cells."""
        return JetStep(
            self.start[cells],
            self.duration,
            self.value[:, cells],
            self.jacobian[:, cells],
            self.hessian[:, cells],
            self.variables,
            self.remainder[cells],
            self.end[cells],
            self.added[cells],
            self.truncation[cells],
            self.sound[cells],
            self.rate[:, cells],
        )

    @classmethod
    def join(cls, steps: Sequence[JetStep]) -> JetStep:
        """Steps of equal duration as one batch, cells one after the other."""
        first = steps[0]
        return cls(
            stack_cells([step.start for step in steps]),
            first.duration,
            balls.concatenate([step.value for step in steps], 1),
            balls.concatenate([step.jacobian for step in steps], 1),
            balls.concatenate([step.hessian for step in steps], 1),
            first.variables,
            balls.concatenate([step.remainder for step in steps], 0),
            stack_cells([step.end for step in steps]),
            np.concatenate([step.added for step in steps]),
            np.concatenate([step.truncation for step in steps]),
            np.concatenate([step.sound for step in steps]),
            np.concatenate([step.rate for step in steps], 1),
        )

    def time_intervals(self, slabs: int) -> list[Zonotope]:
        """Sets that contain the states at every time of each of `slabs` equal parts of the step.

        Around the middle t_m of a part, with |tau| <= delta: P(t_m + tau) in P(t_m) + P'(t_m) tau +- delta^2/2 |P''|,
        time as one more generator; DP(t) d in DP(t_m) d +- (|DP'(t_m)| delta + |DP''| delta^2/2) a; the second-order
        and remainder terms at the part's end.
        """
        if slabs in self.slabs:
            return self.slabs[slabs]
        result = _slabs(self, slabs)
        self.slabs[slabs] = result
        return result


def _cells_first(jets: Ball) -> Ball:
    """(..., n, B, C) to (..., B, n, C)."""
    return Ball(np.swapaxes(jets.mid, -3, -2), np.swapaxes(jets.rad, -3, -2))


STACKED_CELLS = 4
"""Up to so many cells, one evaluation of three stacked points is faster than three of the orders that are needed."""


def _three_jets(
    tape: Tape, z: Zonotope, box: Ball, prior: Ball, order: int, used: NDArray[np.intp]
) -> tuple[Ball, Ball, Ball]:
    """Jets at the center (order 1), over the enclosing interval (order 2) and over the a-priori box (order 0)."""
    center = balls.exact(z.center)
    if z.batch > STACKED_CELLS:
        jets = [flow_jets(tape, p, o, order + (o == 0), used) for p, o in ((center, 1), (box, 2), (prior, 0))]
        return _cells_first(jets[0]), _cells_first(jets[1]), _cells_first(jets[2])
    points = (center, box, prior)
    stacked = Ball(np.concatenate([p.mid for p in points]), np.concatenate([p.rad for p in points]))
    together = _cells_first(flow_jets(tape, stacked, 2, order + 1, used))
    count = z.batch
    return together[:, :count], together[:, count : 2 * count], together[:, 2 * count :]


def jet_step(tape: Tape, z: Zonotope, duration: Fraction, order: int, rows: int, rate: Array | None = None) -> JetStep:
    """Enclose one step; see the module's formula.

    Parameters
    ----------
    tape : Tape
        Vector field of the first n coordinates.
    z : Zonotope, shape (B, d)
    duration : Fraction
    order : int
        Time order K.
    rows : int
        New generators of the quadratic map.
    rate : array, shape (2, B, n), optional
        Guess for the a-priori enclosure.

    Returns
    -------
    JetStep
    """
    states, dimension = len(tape.outputs), z.dimension
    box, weights = z.interval, step_weights(duration, order + 1)
    prior, proved = a_priori_enclosure(tape, box, weights[0, 1], rate)
    with np.errstate(invalid="ignore", over="ignore"):
        plan = plan_of(tape)
        used = plan.used
        center, over_box, prior_jets = _three_jets(tape, z, box, prior, order, used)
        remainder = prior_jets[order, ..., 0]
        value = center[:order, ..., 0]
        jacobian = _spread_columns(center[:order, ..., 1 : 1 + used.size], used, dimension)
        jacobian.mid[0, :, plan.unused_states, plan.unused_states] = 1.0
        hessian = over_box[:order, ..., 1 + used.size :]
        head = weights[:, :order]
        image, added = enclose_map(
            combine(head, value)[0], combine(head, jacobian)[0], combine(head, hessian)[0], used, z, rows
        )
        rest = balls.multiply(remainder, weights[0, order])
        shifted = balls.add(Ball(image.center, np.zeros_like(image.center)), rest)
        image = Zonotope(shifted.mid, image.generators, rounding.enlarged(image.radius + shifted.rad, 1))
        end = concatenate(image, z.coordinates(slice(states, dimension)))
        finite = np.isfinite(end.spread).all(1) & np.isfinite(end.center).all(1)
    added = rounding.enlarged(added + rest.magnitude, 2)
    growth = growth_rate(prior, box, states, duration)
    sound = proved & finite
    truncation = rest.magnitude
    return JetStep(z, duration, value, jacobian, hessian, used, remainder, end, added, truncation, sound, growth)


def _slabs(step: JetStep, slabs: int) -> list[Zonotope]:
    """Time-interval sets of equal parts of a step; see `JetStep.time_intervals`."""
    weights = slab_weights(step.duration, slabs, step.value.mid.shape[0])
    start = step.start
    spread = start.spread
    value = combine(weights.value, step.value)
    jacobian = combine(weights.value, step.jacobian)
    velocity = combine(weights.velocity, step.value)
    delta = weights.half
    time_rows = velocity.mid * delta
    bend = 0.5 * delta * delta
    extra = velocity.rad * delta + rounding.relative_error(time_rows, 1)
    extra = extra + bend * largest(weights.second_derivative, step.value)
    drift = delta * combine(weights.velocity, step.jacobian).magnitude
    drift = drift + bend * largest(weights.second_derivative, step.jacobian)
    extra = extra + (drift @ spread[:, :, None])[..., 0]
    extra = extra + half_quadratic(largest(weights.last, step.hessian), spread[:, step.variables])
    extra = extra + step.remainder.magnitude * weights.remainder[:, None, None]
    extra = rounding.enlarged(extra, 4 * spread.shape[1] + 24)
    deviation = replace(start, center=np.zeros_like(start.center))
    result = []
    for part in range(slabs):
        linear = linear_map(deviation, jacobian[part], value[part])
        radius = rounding.enlarged(linear.radius + extra[part], 1)
        result.append(append_rows(Zonotope(linear.center, linear.generators, radius), time_rows[part][:, None, :]))
    return result
