"""Collapse: a policy that has become a constant, or whose verified performance is flat because it does nothing.

A volume penalty that is too large ends in a policy that answers every observation with the same action. Its V(s0) does
not depend on the perturbation's radius, which looks like robustness in a plot. A run has collapsed where

- its actions, over the start box and the states that it visits, span at most `CONSTANT` of [-1, 1]; or
- V(s0) changes by at most `FLAT` of itself from the smallest radius to the largest one, and even at the smallest one
  some constant action returns more.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.sampling import inner_bounds
from ..models.simulation import Trajectories
from ..specs.exact import signed_text
from ..verify.wording import at_least, number
from .attacked_returns import Agents, Returns, constant_actions
from .networks import forward
from .task import Task
from .tensor_loop import TensorLoop

Array = NDArray[np.float64]

CONSTANT = 0.02
"""A span of actions, as a share of the 2 that tanh has, up to which a policy counts as constant."""

FLAT = 0.02
"""A relative change of V(s0) over the radii up to which it counts as flat."""

SAMPLES = 256
"""States of the start box at which actions are compared."""

MOST_CONSTANTS = 81
"""Constant actions that are simulated, at most."""


@dataclass(frozen=True)
class Collapse:
    """What was measured of one policy.

    Attributes
    ----------
    span : float
        Largest share of [-1, 1] that a component of the action takes, over all states that were looked at.
    states : int
        How many these were.
    change : float
        ``(V(smallest) - V(largest radius)) / |V(smallest)|``; NaN where there is no bound or only one radius.
    constant_return : float
        Discounted return of the best constant action, from the worst start.
    reasons : tuple of str
        Sentences with the measured numbers; empty where the run has not collapsed.
    """

    span: float
    states: int
    change: float
    constant_return: float
    reasons: tuple[str, ...]

    @property
    def collapsed(self) -> bool:
        """Whether one of the two holds."""
        return bool(self.reasons)


def collapses(
    task: Task,
    agents: Agents,
    starts: Array,
    visited: Trajectories,
    radii: tuple[Fraction, ...],
    verified: Returns,
) -> tuple[Collapse, ...]:
    """Look for collapse, policy by policy.

    Parameters
    ----------
    task : Task
    agents : Agents
    starts : array, shape (K, n)
        Initial states that returns are about.
    visited : Trajectories
        Of the undisturbed loops, S * K of them.
    radii : tuple of Fraction
    verified : Returns, shape (S, E)
        V(s0).

    Returns
    -------
    tuple of Collapse
    """
    spans, states = _spans(task, agents, visited)
    best = float(constant_actions(task, starts, _constants(task.actions)).discounted.min(1).max())
    found = []
    for span, curve in zip(spans.tolist(), verified.discounted, strict=True):
        reasons = []
        if span <= CONSTANT:
            reasons.append(f"its action takes {100.0 * span:.2g} % of [-1, 1] over {states} states")
        small, large = (radii.index(pick(radii)) for pick in (min, max))
        change = np.nan
        if small != large and np.isfinite(curve).all():
            change = float((curve[small] - curve[large]) / max(abs(curve[small]), np.finfo(float).tiny))
            if change <= FLAT and curve[small] < best:
                reasons.append(
                    f"V(s0) is flat, {at_least(curve[small])} at {signed_text(radii[small])} and "
                    f"{at_least(curve[large])} at {signed_text(radii[large])}, below the {number(best)} of a constant "
                    "action"
                )
        found.append(Collapse(span, states, change, best, tuple(reasons)))
    return tuple(found)


def _spans(task: Task, agents: Agents, visited: Trajectories) -> tuple[Array, int]:
    """Share of [-1, 1] that the actions of each policy take, (S,); and over how many states."""
    seeds, size = len(agents.actor), len(task.start)
    path = visited.states[:, :-1].reshape(seeds, -1, size)
    path = np.where(np.isfinite(path), path, path[:, :1])
    lower, upper = np.array([inner_bounds(*bounds) for bounds in task.start]).T
    shares = np.random.default_rng(0).random((SAMPLES, size))
    box = np.clip(np.concatenate([[lower, upper], lower + shares * (upper - lower)]), lower, upper)
    states = np.concatenate([path, np.broadcast_to(box, (seeds, *box.shape))], axis=1)
    actions = forward(agents.layout, agents.actor, TensorLoop(task).observe(torch.from_numpy(states))).numpy()
    spans = (actions.max(1) - actions.min(1)).max(1) / 2.0
    return np.asarray(spans), states.shape[1]


def _constants(actions: int) -> Array:
    """Constant actions to compare with, (A, actions): a grid with zero, or random ones where it would be too large."""
    per_side = int(MOST_CONSTANTS ** (1.0 / actions) + 1e-9)
    per_side -= 1 - per_side % 2
    if per_side >= 3:
        return np.array(list(product(np.linspace(-1.0, 1.0, per_side), repeat=actions)))
    draws = np.random.default_rng(0).uniform(-1.0, 1.0, (MOST_CONSTANTS - 1, actions))
    return np.concatenate([np.zeros((1, actions)), draws])
