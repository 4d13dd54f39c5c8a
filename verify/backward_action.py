"""The set of actions of one period between two linear bounds of the policy.

With L o + c <= action <= U o + C for every observation o, the rows of the set are those of (L + U)/2 and its box is
what both bounds leave of them, row by row; that is sound for any rows, so these need no rounding care.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import rounding
from .action_sets import ActionSet, merged_set
from .backward import Chain, follow
from .backward_lines import Lines
from .backward_slopes import chosen, searched_slopes
from .balls import exact
from .deployed import conversion_error, deployed_error
from .model import Model, clip_activations
from .options import Options
from .relaxations import relax, residual_bounds
from .zonotope import Zonotope, linear_map

Array = NDArray[np.float64]


def backward_set(model: Model, options: Options, inputs: Zonotope, shared: int, noise: slice) -> ActionSet:
    """Action set of a set of observations.

    Parameters
    ----------
    model : Model
    options : Options
    inputs : Zonotope, shape (B, o)
        What the policy sees, the perturbation included.
    shared : int
        Number of leading rows that keep their identity.
    noise : slice
        Where the perturbation is among the other rows.

    Returns
    -------
    ActionSet
    """
    slopes = searched_slopes(model.layers, inputs, "gap")
    chain, bounds, lines = follow(model.layers, inputs, chosen(slopes))
    seen = chain.range()
    error = np.zeros_like(seen.lower)
    if options.deployed:
        error = deployed_error(model.layers, bounds, model.loop.policy.precision)
    stated = [array for line in lines for array in _four(line)]
    if model.clip is not None:
        low, high = rounding.down(seen.lower - error), rounding.up(seen.upper + error)
        between, inexact = _clip(model, low, high)
        chain.between(between)
        error = rounding.enlarged(np.abs(between.lower_slope) * error, 1)
        if options.deployed:
            precision = model.loop.policy.precision
            bounds_error = [conversion_error(bound, inexact, precision) for bound in model.clip[:2]]
            error = rounding.enlarged(error + np.maximum(*bounds_error), 1)
        stated.append(between.lower_slope)
    z = _between_bounds(chain, shared, error)
    return merged_set(z, shared, options.action_rows, noise, error, tuple(stated), np.zeros(0, dtype=np.intp))


def _four(lines: Lines) -> tuple[Array, ...]:
    return lines.lower_slope, lines.lower_offset, lines.upper_slope, lines.upper_offset


def _clip(model: Model, low: Array, high: Array) -> tuple[Lines, Array]:
    """Parallel lines of the specification's clip on [low, high], and how far its bounds are from floats."""
    assert model.clip is not None
    inexact = model.clip[2]
    slopes, least, most = [], [], []
    for i, activation in enumerate(clip_activations(model.clip)):
        ends = low[:, i : i + 1], high[:, i : i + 1]
        slope = relax(activation, *ends).slope
        below, above = residual_bounds(activation, slope, *ends)
        slopes.append(slope)
        least.append(rounding.lower(below, inexact[i]))
        most.append(rounding.upper(above, inexact[i]))
    slope = np.concatenate(slopes, 1)
    return Lines(slope, np.concatenate(least, 1), slope, np.concatenate(most, 1)), inexact


def _between_bounds(chain: Chain, shared: int, error: Array) -> Zonotope:
    """A set that contains what is between the bounds, `error` included; rows are the inputs'."""
    inputs = chain.inputs
    lower, upper = (linear_map(inputs, exact(matrix), offset) for matrix, offset in chain.sides())
    center = 0.5 * lower.center + 0.5 * upper.center
    rows = 0.5 * lower.generators + 0.5 * upper.generators
    if chain.size == 1:
        rows = np.concatenate([rows[:, :shared], np.zeros_like(rows[:, shared:])], 1)  # they merge into the box
    count = rows.shape[1]
    left = [
        np.abs(side.center - center) + np.abs(side.generators - rows).sum(1) + side.radius for side in (lower, upper)
    ]
    return Zonotope(center, rows, rounding.enlarged(np.maximum(*left) + error, count + 4))
