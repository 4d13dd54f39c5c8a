"""How bad a batch of trajectories is for one requirement, and which way every sampled state has to move to be worse.

The amount is a nest of largest and smallest: over times, members of the region and facets. Its derivative sees one
facet at one time and zigzags where two compete, so gradients may be taken of a softened nest; amounts never are.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import BoundRequirement
from .candidates import window

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


class Severity:
    """Amount of violation by a rollout's states, with derivatives.

    ``outside(x) = min_members max_facets C_i x - d_i``; avoid: ``max_t -outside``, stay: ``max_t outside``,
    reach: ``min_t outside``.

    Parameters
    ----------
    requirement : BoundRequirement
    times : array, shape (S,)
        Of the rollout's states.
    substeps : int
        States per control period.
    period : float
        Seconds.

    Attributes
    ----------
    samples : array of int, shape (W,)
        Indices of the states that count.
    """

    def __init__(self, requirement: BoundRequirement, times: Array, substeps: int, period: float) -> None:
        self.requirement = requirement
        self.sign = -1.0 if requirement.kind == "avoid" else 1.0
        self.samples = np.flatnonzero(window(requirement, times, substeps, period))
        if not self.samples.size and requirement.kind != "reach":  # a window between two states
            self.samples = np.array([np.abs(times - float(requirement.start)).argmin()])
        self.normals = [np.array(member.normals, dtype=np.float64) for member in requirement.region]
        self.bounds = [np.array(member.bounds, dtype=np.float64) for member in requirement.region]

    def measure(self, states: Array, softness: Array, aims: Indices) -> tuple[Array, Array, Array]:
        """Amounts, and the gradient of the softened amounts.

        Parameters
        ----------
        states : array, shape (S, n, N)
        softness : array, shape (N,)
            Temperature of the softened choices, as a share of the range of the amount over the window; 0: the worst
            facet at the worst time only.
        aims : array of int, shape (N,)
            The one aim (row of the table returned) that is to grow; -1: the amount.

        Returns
        -------
        array, shape (N,)
            > 0 violates. -inf where a state is not finite.
        array, shape (aims, N)
            Sufficient for a violation where any is > 0: the amounts of single times, or (stay in one polytope) of
            single facets at single times. No rows for reach, which has to be violated at every time.
        array, shape (S, n, N)
        """
        places = states[self.samples]
        facets = [c @ places - d[:, None] for c, d in zip(self.normals, self.bounds, strict=True)]  # (W, facets, N)
        members = np.stack([values.max(1) for values in facets])  # (members, W, N)
        amounts = self.sign * members.min(0)
        amounts = np.where(np.isnan(amounts), -np.inf, amounts)
        scale = softness * _range(amounts)
        held, columns = self.requirement.kind == "reach", np.flatnonzero(aims >= 0)
        single = self.requirement.kind == "stay" and len(facets) == 1
        amount = amounts.min(0) if held else amounts.max(0)
        table = amounts[:0] if held else facets[0].reshape(-1, amount.size) if single else amounts
        row, facet = np.divmod(aims[columns], facets[0].shape[1]) if single else (aims[columns], aims[columns])
        times = _soft(-amounts if held else amounts, scale, 0)
        times[:, columns] = 0.0
        times[row, columns] = 1.0
        chosen = _soft(-members, scale, 0)
        seeds = np.zeros_like(states)
        for normals, values, weight in zip(self.normals, facets, chosen, strict=True):
            share = _soft(values, scale, 1)  # (W, facets, N)
            if single:
                share[:, :, columns] = 0.0
                share[:, facet, columns] = 1.0
            seeds[self.samples] += normals.T @ (share * (self.sign * times * weight)[:, None])
        finite = np.where(np.isfinite(table), table, -np.inf)
        return np.where(np.isfinite(amount), amount, -np.inf), finite, seeds


def _range(amounts: Array) -> Array:
    """Largest minus smallest over the window, or the size where there is one sample; 1 where that says nothing."""
    width = amounts.max(0) - amounts.min(0) if len(amounts) > 1 else np.abs(amounts[0])
    return np.where(np.isfinite(width) & (width > 0.0), width, 1.0)


def _soft(values: Array, scale: Array, axis: int) -> Array:
    """Weights of a softened maximum over an axis; a tiny scale shares them among the largest alone."""
    distance = values - values.max(axis, keepdims=True)
    with np.errstate(over="ignore"):  # to minus infinity, whose weight is zero
        weights = np.exp(distance / np.maximum(scale, np.finfo(np.float64).tiny))
    return np.asarray(weights / weights.sum(axis, keepdims=True))
