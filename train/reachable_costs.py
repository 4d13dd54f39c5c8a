"""What the reward and the requirements say about sets, differentiable: `verify.performance` and `verify.requirements`.

    max_Z w'|s - s*| = max over sigma in {-1, 1}^p of |(sigma w)'(c - s*)| + sum_j |(sigma w)'g_j|,

over the p nonzero weights; for p above `verify.performance.MOST_PATTERNS` bounded by w'(|c - s*| + |G| 1).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import product

import numpy as np
import torch

from ..models.closed_loop import BoundPolytope, BoundRequirement, BoundReward
from ..verify.performance import MOST_PATTERNS
from ..verify.separation import prepare_polytope
from .networks import Tensor

EDGE = 0.1
"""A penalty is charged in full or not at all, but differentiated as ``sigmoid(-margin / (half-width of the set +
EDGE))``: sets on either side of the region's edge feel it. In the unit of the region's facets."""


def _floats(values: Sequence[Fraction]) -> Tensor:
    return torch.tensor([float(value) for value in values], dtype=torch.float64)


@dataclass(frozen=True)
class Polytope:
    """``{x : normals @ x <= bounds}``, and the directions ``weights @ normals`` that may separate a set from it."""

    normals: Tensor
    bounds: Tensor
    directions: Tensor
    levels: Tensor

    @classmethod
    def of(cls, polytope: BoundPolytope) -> Polytope:
        """Exact numbers to floats; the directions that the verifier tries."""
        facets = prepare_polytope(polytope)
        weights = torch.from_numpy(facets.weights)
        normals, bounds = torch.from_numpy(facets.normals.mid), torch.from_numpy(facets.bounds.mid)
        return cls(normals, bounds, weights @ normals, weights @ bounds)

    def inside(self, terms: Tensor) -> Tensor:
        """``min_i bounds_i - max_Z normals_i.z`` for sets (S, n, P, 1 + q), shape (S, P): > 0 where contained."""
        image = _mapped(self.normals, terms)
        most = image[..., 0] + image[..., 1:].abs().sum(-1)
        return (self.bounds[:, None] - most).amin(1)

    def apart(self, terms: Tensor) -> tuple[Tensor, Tensor]:
        """Best separation ``min_Z l.z - level``, > 0 where disjoint, and the set's half-width that way; (S, P) each."""
        image = _mapped(self.directions, terms)
        width = image[..., 1:].abs().sum(-1)
        margin, which = (image[..., 0] - width - self.levels[:, None]).max(1)
        return margin, width.gather(1, which[:, None])[:, 0]


def _mapped(matrix: Tensor, terms: Tensor) -> Tensor:
    """Linear map of sets, (k, n) and (S, n, P, 1 + q) to (S, k, P, 1 + q)."""
    image = torch.bmm(matrix.expand(terms.shape[0], -1, -1), terms.flatten(2))
    return image.unflatten(2, terms.shape[2:])


class Costs:
    """Worst cost of a period over a set at its end, and its penalty.

    Parameters
    ----------
    reward : BoundReward
    """

    def __init__(self, reward: BoundReward) -> None:
        weights, target = _floats(reward.weights), _floats(reward.target)
        self.discount, self.penalty = float(reward.discount), float(reward.penalty)
        used = weights.nonzero()[:, 0]
        if len(used) <= MOST_PATTERNS:
            signs = [(1.0, *rest) for rest in product((-1.0, 1.0), repeat=max(len(used) - 1, 0))]
            patterns = torch.tensor([row[: len(used)] for row in signs], dtype=torch.float64)
        else:
            patterns = torch.eye(len(used), dtype=torch.float64)
        self.together = len(used) > MOST_PATTERNS
        self.patterns = torch.zeros((len(patterns), len(weights)), dtype=torch.float64)
        self.patterns[:, used] = patterns * weights[used]
        self.shift = -(self.patterns @ target)[:, None]
        self.region = [Polytope.of(member) for member in reward.penalty_region]

    def __call__(self, terms: Tensor) -> Tensor:
        """Costs of sets (S, n, P, 1 + q), shape (S, P); a penalty is charged in full where the set may touch."""
        image = _mapped(self.patterns, terms)
        each = (image[..., 0] + self.shift).abs() + image[..., 1:].abs().sum(-1)
        cost = each.sum(1) if self.together else each.amax(1)
        if not (self.region and self.penalty):
            return cost
        margins, widths = zip(*(member.apart(terms) for member in self.region), strict=True)
        margin, which = torch.stack(margins).min(0)
        width = torch.stack(widths).gather(0, which[None])[0].detach()
        smooth = torch.sigmoid(-margin / (width + EDGE))
        touched = (margin <= 0.0).to(smooth)
        return cost + self.penalty * (touched + smooth - smooth.detach())


class Margins:
    """Margin of one requirement over the sets at periods' ends: > 0 where every one (reach: some one) satisfies it.

    Parameters
    ----------
    requirement : BoundRequirement
    period : Fraction
    periods : int
        Of the horizon.
    """

    def __init__(self, requirement: BoundRequirement, period: Fraction, periods: int) -> None:
        self.kind = requirement.kind
        self.members = [Polytope.of(member) for member in requirement.region]
        times = [k for k in range(periods + 1) if requirement.start <= k * period <= requirement.end]
        nearest = int(np.clip(round(requirement.start / period), 0, periods))
        self.numbers = frozenset(times or [nearest])
        """Periods whose ends lie in the window, 0 the start; the nearest one where there is none."""

    def at(self, terms: Tensor) -> Tensor:
        """Margin of one set, (S, n, P, 1 + q) to (S, P)."""
        if self.kind == "avoid":
            return torch.stack([member.apart(terms)[0] for member in self.members]).amin(0)
        return torch.stack([member.inside(terms) for member in self.members]).amax(0)

    def over(self, margins: Sequence[Tensor]) -> Tensor:
        """Of the whole window: the smallest, of `reach` the largest."""
        stacked = torch.stack(list(margins))
        return stacked.amax(0) if self.kind == "reach" else stacked.amin(0)
