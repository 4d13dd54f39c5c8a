"""A-priori enclosures: boxes that contain every trajectory over a step, by interval evaluation of the vector field."""

from __future__ import annotations

from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..models.tape import Tape, run
from . import balls, rounding
from .balls import Ball, BallAlgebra

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
        growth = np.array([prior.lower - box.lower, prior.upper - box.upper])
        return growth[:, :, :states] / float(duration)
