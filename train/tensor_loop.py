"""A closed loop on torch tensors, for adversaries that differentiate through it; float64, fast, never a proof."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import torch

from ..models.closed_loop import BoundAffine
from .dynamics import Discretisation
from .networks import Tensor
from .tape_programs import TorchAlgebra, run_on_tensors
from .task import Task

SUBSTEPS = 2
"""Runge-Kutta steps per period: an adversary only searches here, what it finds is simulated exactly."""

SOFTNESS = 0.05
"""Width of the edge of a penalty's region, in which its charge falls from 1 to 0, in units of the facet's normal."""


class TensorLoop:
    """What surrounds the network in one control period, differentiable; leading axes are lanes.

    Parameters
    ----------
    task : Task

    Attributes
    ----------
    delayed_action : Tensor, shape (m,)
        What acts during the first `delay` periods.
    delay : int
    forces_center, forces_radius : Tensor, shape (d,)
        Bounds of the disturbances.
    discounts : Tensor, shape (T,)
    """

    def __init__(self, task: Task) -> None:
        loop = task.loop
        reward = loop.reward
        assert reward is not None, "a task has a reward"
        self.loop = loop
        self.dynamics = Discretisation(loop.plant, loop.period, SUBSTEPS)
        self.before, self.after = _affine(loop.before), _affine(loop.after)
        self.clip = None if loop.clip is None else tuple(_tensor([b[side] for b in loop.clip]) for side in (0, 1))
        self.delay, self.delayed_action = loop.delay, _tensor(loop.delayed_action)
        lower, upper = (_tensor([getattr(b, side) for b in loop.disturbances]) for side in ("lower", "upper"))
        self.forces_center, self.forces_radius = (lower + upper) / 2, (upper - lower) / 2
        self.weights, self.target = _tensor(reward.weights), _tensor(reward.target)
        self.penalty = float(reward.penalty)
        self.region = [(_tensor(member.normals), _tensor(member.bounds)) for member in reward.penalty_region]
        self.discounts = torch.tensor(float(reward.discount), dtype=torch.float64) ** torch.arange(loop.periods)

    def observe(self, state: Tensor) -> Tensor:
        """What the network is given without perturbation: (..., n) to (..., inputs)."""
        if self.loop.observation is not None:
            state = run_on_tensors(self.loop.observation, TorchAlgebra(state), state.unbind(-1))
        return state if self.before is None else state @ self.before[0].T + self.before[1]

    def act(self, output: Tensor) -> Tensor:
        """What the controller makes of the network's output: (..., actions) to (..., m)."""
        if self.after is not None:
            output = output @ self.after[0].T + self.after[1]
        return output if self.clip is None else output.clamp(self.clip[0], self.clip[1])

    def advance(self, state: Tensor, action: Tensor, force: Tensor) -> Tensor:
        """State at the end of the period."""
        moved: Tensor = self.dynamics.advance(state, action, force)
        return moved

    def cost(self, state: Tensor) -> Tensor:
        """``w' |s - target|``, plus the penalty with a soft edge: a step has no gradient for an adversary to use."""
        cost = (state - self.target).abs() @ self.weights
        if not self.region:
            return cost
        depths = [(bounds - state @ normals.T).amin(-1) for normals, bounds in self.region]
        inside = torch.stack(depths).amax(0) / SOFTNESS
        return cost + self.penalty * inside.sigmoid()


def _affine(bound: BoundAffine | None) -> tuple[Tensor, Tensor] | None:
    return None if bound is None else (_tensor(bound.matrix), _tensor(bound.offset))


def _tensor(values: Sequence[Any]) -> Tensor:
    return torch.from_numpy(np.array(values, dtype=np.float64))
