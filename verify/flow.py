"""Flow enclosure by 2-jets: one integrator step of a batch of joint sets (states, inputs, disturbances).

Inputs and disturbances are constant over a step, so they are states with derivative zero. With the time-Taylor
coefficients phi_k of the flow map as functions of the start point, P = sum_k phi_k(c) t^k, and K the time order:

    z(t) in P(c) + DP(c) d + 1/2 d' H d + z_[K](B) t^K,    H the Hessian of P over the set's enclosing interval,

where B is an a-priori enclosure of all trajectories over the step: box(X) + [0, h] f(B) inside B (Picard).
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from fractions import Fraction
from typing import ClassVar

import numpy as np
from numpy.typing import NDArray

from ..models.tape import Tape
from . import balls, rounding
from .balls import Ball
from .picard import a_priori_enclosure, growth_rate
from .plan import plan_of
from .quadratic_map import Products, enclose_map, half_quadratic
from .series import flow_jets, map_jets
from .steps import Step
from .time_weights import combine, largest, slab_weights, step_weights
from .zonotope import Zonotope, append_rows, concatenate, linear_map

Array = NDArray[np.float64]


def image_of(tape: Tape, z: Zonotope, rows: int) -> tuple[Zonotope, Array, Products]:
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


@dataclass(frozen=True, kw_only=True)
class JetStep(Step):
    """One step by 2-jets; see `Step` for what every method has.

    Attributes
    ----------
    value, jacobian, hessian : Ball
        Time coefficients 0 .. K - 1 of the flow: (K, B, n), (K, B, n, d) at the center, (K, B, n, v (v + 1)/2) by the
        `variables` over the enclosing interval.
    variables : array of int, shape (v,)
        Coordinates on which the vector field depends.
    remainder : Ball, shape (B, n)
        Time coefficient K over the a-priori box.
    products : Products or None
        Whose products the last rows of `end` are.
    """

    CELL_AXES: ClassVar[dict[str, int]] = Step.CELL_AXES | {"value": 1, "jacobian": 1, "hessian": 1, "remainder": 0}
    EVIDENCE: ClassVar[tuple[str, ...]] = (*Step.EVIDENCE, "products")

    value: Ball
    jacobian: Ball
    hessian: Ball
    variables: NDArray[np.intp]
    remainder: Ball
    products: Products | None

    def enclose_intervals(self, slabs: int) -> list[Zonotope]:
        """Sets that contain the states at every time of each of `slabs` equal parts of the step.

        Around the middle t_m of a part, with |tau| <= delta: P(t_m + tau) in P(t_m) + P'(t_m) tau +- delta^2/2 |P''|,
        time as one more generator; DP(t) d in DP(t_m) d +- (|DP'(t_m)| delta + |DP''| delta^2/2) a; the second-order
        and remainder terms at the part's end.
        """
        return _slabs(self, slabs)


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
        image, added, products = enclose_map(
            combine(head, value)[0], combine(head, jacobian)[0], combine(head, hessian)[0], used, z, rows
        )
        rest = balls.multiply(remainder, weights[0, order])
        shifted = balls.add(Ball(image.center, np.zeros_like(image.center)), rest)
        radius = rounding.enlarged(image.radius + rounding.checkable(shifted.rad), 2)
        image = Zonotope(shifted.mid, image.generators, radius)
        end = concatenate(image, z.coordinates(slice(states, dimension)))
        finite = np.isfinite(end.spread).all(1) & np.isfinite(end.center).all(1)
    added = rounding.enlarged(added + rest.magnitude, 2)
    growth = growth_rate(prior, box, states, duration)
    sound = proved & finite
    truncation = rest.magnitude
    return JetStep(
        start=z,
        duration=duration,
        end=end,
        added=added,
        truncation=truncation,
        sound=sound,
        rate=growth,
        value=value,
        jacobian=jacobian,
        hessian=hessian,
        variables=used,
        remainder=remainder,
        prior=prior,
        products=products,
    )


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
    extra = rounding.enlarged(rounding.checkable(extra), 4 * spread.shape[1] + 26)
    deviation = replace(start, center=np.zeros_like(start.center))
    result = []
    for part in range(slabs):
        linear = linear_map(deviation, jacobian[part], value[part])
        radius = rounding.enlarged(linear.radius + extra[part], 1)
        result.append(append_rows(Zonotope(linear.center, linear.generators, radius), time_rows[part][:, None, :]))
    return result
