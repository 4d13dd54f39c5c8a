"""The sampled controller with gradients: observation, network, maps and clip; a batch of points, features first."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import BoundAffine, ClosedLoop
from ...models.float_algebra import Floats
from ...models.policy import Activation, Affine, activate
from .adjoint import TapeAdjoint

Array = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class _Clip:
    """Bounds of the action, (m, 1) each."""

    lower: Array
    upper: Array


Stage: TypeAlias = Affine | Activation | _Clip


@dataclass(frozen=True)
class Decision:
    """One evaluation of a controller and what its gradient needs.

    Attributes
    ----------
    action : array, shape (m, N)
        Clipped, not delayed.
    values : tuple of array
        The input of every stage, features first, then the action.
    slots, twins
        Of the observation's tape; empty where the policy sees the states.
    """

    action: Array
    values: tuple[Array, ...]
    slots: list[Floats]
    twins: dict[int, Floats]


class Controller:
    """``clip(after(network(before(observe(x) + noise))))`` and its vector-Jacobian product.

    Parameters
    ----------
    loop : ClosedLoop
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.observation = None if loop.observation is None else TapeAdjoint(loop.observation)
        stages: list[Stage] = [*_affine(loop.before), *loop.policy.layers, *_affine(loop.after)]
        if loop.clip is not None:
            lower, upper = (np.array([[float(pair[side])] for pair in loop.clip]) for side in (0, 1))
            stages.append(_Clip(lower, upper))
        self.stages = tuple(stages)

    def decide(self, state: Array, noise: Array) -> Decision:
        """Forward pass.

        Parameters
        ----------
        state : array, shape (n, N)
        noise : array, shape (k, N)

        Returns
        -------
        Decision
        """
        slots: list[Floats] = []
        twins: dict[int, Floats] = {}
        value = state + noise if self.observation is None else noise.copy()
        if self.observation is not None:
            slots, twins = self.observation.values(list(state))
            for row, slot in enumerate(self.observation.outputs):
                value[row] += slots[slot]
        values = [value]
        for stage in self.stages:
            if isinstance(stage, Affine):
                value = stage.weight @ value + stage.bias[:, None]
            elif isinstance(stage, Activation):
                value = activate(stage, value)
            else:
                value = np.clip(value, stage.lower, stage.upper)
            values.append(value)
        return Decision(value, tuple(values), slots, twins)

    def pull(self, decision: Decision, gradient: Array) -> tuple[Array, Array]:
        """Backward pass: the gradient in the action becomes gradients in the state and in the noise.

        Parameters
        ----------
        decision : Decision
        gradient : array, shape (m, N)

        Returns
        -------
        array, shape (n, N)
        array, shape (k, N)
        """
        for index in reversed(range(len(self.stages))):
            stage = self.stages[index]
            if isinstance(stage, Affine):
                gradient = stage.weight.T @ gradient
            else:
                gradient = gradient * _slope(stage, decision.values[index], decision.values[index + 1])
        if self.observation is None:
            return gradient, gradient
        state = np.zeros((self.observation.inputs, gradient.shape[1]))
        for row, part in enumerate(self.observation.pull(decision.slots, decision.twins, list(gradient))):
            if part is not None:
                state[row] = part
        return state, gradient


def _slope(stage: Activation | _Clip, x: Array, y: Array) -> Array:
    """Derivative of an elementwise stage at its input x and output y; at a kink one of its two sides."""
    if isinstance(stage, _Clip):
        return np.asarray((x > stage.lower) & (x < stage.upper), dtype=np.float64)
    match stage.kind:
        case "relu":
            return np.asarray(x > 0.0, dtype=np.float64)
        case "leaky_relu":
            return np.where(x >= 0.0, 1.0, stage.slope)
        case "tanh":
            return np.asarray(1.0 - y * y)
        case "sigmoid":
            return np.asarray(y * (1.0 - y))
        case "clip":
            return np.asarray((x > stage.lower) & (x < stage.upper), dtype=np.float64)
    raise AssertionError(f"unknown activation {stage.kind}")


def _affine(given: BoundAffine | None) -> list[Affine]:
    if given is None:
        return []
    return [Affine(np.array(given.matrix, dtype=np.float64), np.array(given.offset, dtype=np.float64))]
