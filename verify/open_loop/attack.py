"""Search for points that look like counterexamples: samples, and descent along gradients, in plain floats."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...models.policy import Affine, Policy, activate
from ..deadline import Deadline
from ..relaxations import relax
from .question import Question

Array = NDArray[np.float64]

STARTS = 64
"""Points from which one descent starts."""
STEPS = 24
CASES = 32
"""Cases of a question that are attacked, those that the samples come nearest to."""


def sample(question: Question, generator: np.random.Generator, count: int = STARTS) -> Array:
    """The middle of the box, corners, and points in between, shape (count, n)."""
    middle, radius = 0.5 * question.low + 0.5 * question.high, 0.5 * question.high - 0.5 * question.low
    share = generator.uniform(-1.0, 1.0, (count, len(middle)))
    share[1::2] = np.sign(share[1::2])
    share[0] = 0.0
    return np.clip(middle + radius * share, question.low, question.high)


def nearest_cases(policy: Policy, question: Question, points: Array) -> NDArray[np.intp]:
    """Cases by how near one of the points comes to violating them, at most `CASES`."""
    with np.errstate(invalid="ignore", over="ignore"):
        worst = question.worst_of_case(question.values(points, policy(points)))
    return np.argsort(np.nanmin(np.where(np.isnan(worst), np.inf, worst), 0), kind="stable")[:CASES]


def descend(policy: Policy, question: Question, case: int, points: Array, deadline: Deadline) -> Array:
    """Move points towards where a case's largest form is smallest; returns the best place of each, best first.

    Parameters
    ----------
    policy : Policy
    question : Question
    case : int
    points : array, shape (N, n)
    deadline : Deadline

    Returns
    -------
    array, shape (N, n)
    """
    rows = question.rows[question.starts[case] :][: len(question.cases[case].constraints)]
    radius = 0.5 * question.high - 0.5 * question.low
    best, least = points, np.full(len(points), np.inf)
    with np.errstate(invalid="ignore", over="ignore"):
        for step in 0.5 * np.geomspace(1.0, 2.0**-10, STEPS):
            values, gradient = value_and_gradient(policy, question, rows, points)
            better = values < least
            best, least = np.where(better[:, None], points, best), np.where(better, values, least)
            if deadline.expired:
                break
            moved = points - step * radius * np.sign(np.nan_to_num(gradient))
            points = np.clip(moved, question.low, question.high)
    return best[np.argsort(least, kind="stable")]


def value_and_gradient(
    policy: Policy, question: Question, rows: NDArray[np.intp], points: Array
) -> tuple[Array, Array]:
    """The largest of some forms at points, and its gradient there: shapes (N,) and (N, n)."""
    seen, value = [], points
    for layer in policy.layers:
        seen.append(value)
        value = value @ layer.weight.T + layer.bias if isinstance(layer, Affine) else activate(layer, value)
    forms = question.values(points, value)[:, rows]
    worst = rows[np.argmax(forms, axis=1)]
    gradient = question.outputs.mid[worst]
    for layer, x in zip(reversed(policy.layers), reversed(seen), strict=True):
        # on a point, the slope of a relaxation is the derivative, or near it
        gradient = gradient @ layer.weight if isinstance(layer, Affine) else gradient * relax(layer, x, x).slope
    return forms.max(1), gradient + question.inputs.mid[worst]
