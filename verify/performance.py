"""Verified performance: a lower bound of the discounted return over all perturbations.

Reward per period ``r = -w'|s_next - s*| - penalty [s_next in O]``, w >= 0. The worst cost of one set is exact by sign
patterns over the p nonzero weights,

    max_Z w'|s - s*| = max over sigma in {-1, 1}^p of (sigma w)'(c - s*) + sum_j |(sigma w)'g_j| + w'r,

and for p > 12 bounded by w'(|c - s*| + a). The penalty is charged whenever the time-point set may touch O. Summing the
per-step maxima bounds the return of every trajectory from below; it is equal to the worst return only where one
trajectory attains all of them.
"""

from __future__ import annotations

from dataclasses import dataclass, field
from itertools import product

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundReward
from . import balls, rounding
from .balls import Ball, rational, rationals
from .separation import Facets, mixed_separation, prepare_polytope
from .zonotope import Zonotope, linear_map

Array = NDArray[np.float64]

MOST_PATTERNS = 12
"""Largest number of weighted states for which all sign patterns are tried."""


@dataclass(frozen=True)
class RewardModel:
    """A reward in floats with the distance from its exact numbers."""

    weights: Ball
    target: Ball
    discount: Ball
    penalty: Ball
    region: tuple[Facets, ...]

    @classmethod
    def prepare(cls, reward: BoundReward) -> RewardModel:
        """Exact reward to balls."""
        return cls(
            rationals(reward.weights),
            rationals(reward.target),
            rational(reward.discount),
            rational(reward.penalty),
            tuple(prepare_polytope(member) for member in reward.penalty_region),
        )


def worst_cost(z: Zonotope, weights: Ball, target: Ball) -> Array:
    """Upper bound of ``max w'|s - s*|`` over each set.

    Parameters
    ----------
    z : Zonotope, shape (B, n)
    weights, target : Ball, shape (n,)

    Returns
    -------
    array, shape (B,)
    """
    used = np.flatnonzero((weights.mid != 0.0) | (weights.rad != 0.0))
    if used.size == 0:
        return np.zeros(z.batch)
    # D = diag(w) (s - s*) restricted to the weighted states; then its largest 1-norm
    scaled = linear_map(
        z.coordinates(used),
        Ball(np.diag(weights.mid[used]), np.diag(weights.rad[used])),
        balls.negate(balls.multiply(weights[used], target[used])),
    )
    if used.size > MOST_PATTERNS:
        return rounding.enlarged(scaled.interval.magnitude.sum(1), used.size)  # type: ignore[no-any-return]
    # a pattern and its negative: half of them, the center's term by absolute value
    patterns = np.array([(1.0, *signs) for signs in product((-1.0, 1.0), repeat=used.size - 1)])
    center = np.abs(scaled.center @ patterns.T)
    generators = np.abs(scaled.generators @ patterns.T).sum(1)
    count = scaled.generators.shape[1]
    size = rounding.enlarged((scaled.spread + np.abs(scaled.center)).sum(1), used.size + 2)
    best = (center + generators).max(1) + scaled.radius.sum(1)
    error = rounding.product_error(used.size + count + 2, size, count + 1)
    return rounding.enlarged(best + error, used.size + 4)  # type: ignore[no-any-return]


@dataclass
class Performance:
    """Costs of every period of every cell, and what they add up to: V(s0).

    Attributes
    ----------
    reward : RewardModel
    costs : array, shape (cells, T)
        Upper bounds of the periods' costs, penalties included; inf where no enclosure was seen.
    clear : dict of (cell, period) to tuple of array
        Why there is no penalty: weights of every member's facets.
    """

    reward: RewardModel
    costs: Array
    clear: dict[tuple[int, int], tuple[Array, ...]] = field(default_factory=dict)

    @classmethod
    def create(cls, reward: BoundReward, cells: int, periods: int) -> Performance:
        """Nothing seen yet."""
        return cls(RewardModel.prepare(reward), np.full((cells, periods), np.inf))

    def observe(self, index: NDArray[np.intp], numbers: NDArray[np.intp], end: Zonotope) -> None:
        """Charge periods, given the sets at their ends."""
        reward = self.reward
        cost = worst_cost(end, reward.weights, reward.target)
        if reward.region:
            apart = [mixed_separation(end, member) for member in reward.region]
            clear = np.all([margin > 0.0 for margin, _ in apart], axis=0)
            for i in np.flatnonzero(clear).tolist():
                weights = tuple(m.weights[which[i]] for m, (_, which) in zip(reward.region, apart, strict=True))
                self.clear[int(index[i]), int(numbers[i])] = weights
            cost = np.where(clear, cost, rounding.up(cost + float(reward.penalty.upper)))
        self.costs[index, numbers] = np.where(np.isfinite(cost), cost, np.inf)

    def value(self) -> tuple[Array, Array]:
        """V(s0) per cell, discounted and not, shape (cells,); -inf where a period is missing."""
        periods = self.costs.shape[1]
        factor, weights = balls.exact(1.0), []
        for _ in range(periods):
            weights.append(float(factor.upper))
            factor = balls.multiply(factor, self.reward.discount)
        discounted = rounding.enlarged((self.costs * np.array(weights)).sum(1), periods + 2)
        return -discounted, -rounding.enlarged(self.costs.sum(1), periods)
