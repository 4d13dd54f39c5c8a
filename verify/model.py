"""A closed loop prepared for the engine: exact numbers as balls, wiring as layers."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundAffine, ClosedLoop
from ..models.policy import Activation, Affine, Layer
from . import rounding

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Model:
    """What the engine needs of a closed loop, computed once.

    Attributes
    ----------
    loop : ClosedLoop
    layers : tuple of Affine and Activation
        The affine map before the network, the network, the affine map after it.
    clip : tuple of arrays or None
        Lower and upper bounds of the action and the distance of these floats from the exact bounds, shape (m,) each.
    observed : array of int or None
        State positions, where the policy sees plain states; None where the observation is a tape.
    varying, constant : array of int
        Disturbances that are free in every period, and those that are constant over the run.
    disturbance_lower, disturbance_upper : array, shape (p,)
        Rounded outward.
    """

    loop: ClosedLoop
    layers: tuple[Layer, ...]
    clip: tuple[Array, Array, Array] | None
    observed: NDArray[np.intp] | None
    varying: NDArray[np.intp]
    constant: NDArray[np.intp]
    disturbance_lower: Array
    disturbance_upper: Array

    @property
    def varying_ball(self) -> tuple[Array, Array]:
        """Center and half-width of every disturbance that is free in every period."""
        low, high = self.disturbance_lower[self.varying], self.disturbance_upper[self.varying]
        return rounding.center_radius(low, high)

    @property
    def states(self) -> int:
        """Number of plant states n."""
        return len(self.loop.plant.states)

    @property
    def inputs(self) -> int:
        """Number of plant inputs m."""
        return len(self.loop.plant.inputs)


def prepare(loop: ClosedLoop) -> Model:
    """Prepare a bound closed loop for the engine."""
    layers: list[Layer] = list(loop.policy.layers)
    if loop.before is not None:
        layers.insert(0, _affine_layer(loop.before))
    if not layers:
        layers = [Affine(np.eye(loop.policy.inputs), np.zeros(loop.policy.inputs))]
    if loop.after is not None:
        layers.append(_affine_layer(loop.after))
    clip = None
    if loop.clip is not None:
        low, low_error = rounding.balls_of(bound[0] for bound in loop.clip)
        high, high_error = rounding.balls_of(bound[1] for bound in loop.clip)
        clip = low, high, np.maximum(low_error, high_error)
    observed = np.arange(len(loop.plant.states)) if loop.observation is None else _plain_selection(loop)
    constant = np.array([i for i, d in enumerate(loop.disturbances) if d.constant], dtype=np.intp)
    varying = np.array([i for i, d in enumerate(loop.disturbances) if not d.constant], dtype=np.intp)
    return Model(
        loop,
        tuple(layers),
        clip,
        observed,
        varying,
        constant,
        np.array([rounding.float_below(d.lower) for d in loop.disturbances]),
        np.array([rounding.float_above(d.upper) for d in loop.disturbances]),
    )


def initial_box(loop: ClosedLoop) -> tuple[Array, Array]:
    """The initial set's bounds rounded outward, shape (n,) each."""
    return (
        np.array([rounding.float_below(low) for low, _ in loop.initial]),
        np.array([rounding.float_above(high) for _, high in loop.initial]),
    )


def observation_radius(loop: ClosedLoop) -> Array:
    """Radius of the observation perturbation rounded up, shape (n_obs,)."""
    return np.array([rounding.float_above(radius) for radius in loop.observation_radius])


def clip_activations(clip: tuple[Array, Array, Array]) -> list[Activation]:
    """One clip per input (their bounds may differ)."""
    return [Activation("clip", lower=float(low), upper=float(high)) for low, high, _ in zip(*clip, strict=True)]


def _affine_layer(affine: BoundAffine) -> Affine:
    rows = [rounding.balls_of(row) for row in affine.matrix]
    offset, offset_error = rounding.balls_of(affine.offset)
    weight, weight_error = np.array([r[0] for r in rows]), np.array([r[1] for r in rows])
    exact = not weight_error.any() and not offset_error.any()
    return Affine(weight, offset) if exact else Affine(weight, offset, weight_error, offset_error)


def _plain_selection(loop: ClosedLoop) -> NDArray[np.intp] | None:
    """Positions, where every component of the observation is a state itself."""
    tape = loop.observation
    if tape is None or any(slot >= len(tape.inputs) for slot in tape.outputs):
        return None
    return np.array(tape.outputs, dtype=np.intp)
