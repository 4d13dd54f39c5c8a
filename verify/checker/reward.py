"""The obligation of the reward bound: the worst cost of every period's end, summed.

``max_Z w'|s - s*|`` is the largest of ``(sigma w)'(c - s*) + sum_j |(sigma w)'g_j| + w'r`` over sign patterns sigma of
the weighted states; beyond `MOST_PATTERNS` states it is bounded by ``w'(|c - s*| + a)``.
"""

from __future__ import annotations

from itertools import product
from typing import Any

from flint import arb, arb_mat

from .contract import Reward
from .image import Start
from .program import ball

MOST_PATTERNS = 12
"""Most weighted states for which all sign patterns are tried; it decides how tight a bound is, nothing else."""


def worst_cost(reward: Reward, end: Start) -> Any:
    """A ball whose upper end is not below the cost of any state of the set, penalty apart."""
    used = [i for i, weight in enumerate(reward.weights) if weight]
    if not used:
        return arb(0)
    weights = [ball(reward.weights[i]) for i in used]
    away = [w * (arb(end.center[i]) - ball(reward.target[i])) for w, i in zip(weights, used, strict=True)]
    boxed = sum((w * end.radius[i] for w, i in zip(weights, used, strict=True)), arb(0))
    if len(used) > MOST_PATTERNS:
        spread = end.spread
        rows = sum((w * (arb(spread[i]) - end.radius[i]) for w, i in zip(weights, used, strict=True)), arb(0))
        return sum(map(abs, away), arb(0)) + rows + boxed
    scaled = [w * row[i] for row in end.rows for w, i in zip(weights, used, strict=True)]
    count, size = len(end.rows), len(used)
    best = arb(0)
    for signs in product((1, -1), repeat=size - 1):
        pattern = (1, *signs)
        center = abs(sum((s * a for s, a in zip(pattern, away, strict=True)), arb(0)))
        rows = arb(0)
        if count:
            rows = sum(map(abs, (arb_mat(count, size, scaled) * arb_mat(size, 1, list(pattern))).entries()), arb(0))
        best = best.max(center + rows)
    return best + boxed
