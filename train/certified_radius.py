"""The certified radius: the largest perturbation for which a policy provably keeps the whole specification."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any

import numpy as np

from ..models.closed_loop import Plant
from ..models.policy import Policy
from ..verify.closed_loop import Engine
from ..verify.deadline import Deadline
from ..verify.model import initial_box, observation_radius, prepare
from ..verify.options import Options
from ..verify.result import Verdict
from ..verify.splitting import FAILED, PROVED, InitialSet, explore
from ..verify.verifier import verify
from .task import Task

INSIDE = 7
"""Radii between two known ones that are tried in one batch: three bisections at once."""

QUIET: dict[str, Any] = {"over": "ignore", "invalid": "ignore"}
"""A grid of radii goes on until sets overflow; the engine says so by a bound of -inf, numpy need not say it too."""


def certified_radius(
    task: Task,
    policy: Policy,
    radii: Sequence[Fraction],
    resolution: Fraction,
    *,
    options: Options | None = None,
    plant: Plant | None = None,
) -> Fraction | None:
    """Search the largest radius at which every requirement is VERIFIED.

    The engine alone searches, first on the grid and then between its last radius that is proved and the next one, all
    radii of a round in one batch. What is returned was accepted by the checker.

    Parameters
    ----------
    task : Task
    policy : Policy
        Read from a file: a certificate is about its bytes.
    radii : sequence of Fraction
        Grid, in any order; the largest component of the perturbation.
    resolution : Fraction
        The search ends when the radii it could still find are closer than this; positive.
    options : Options, optional
        Of every verification; ``Options(splits=1)`` by default: the initial set is not split.
    plant : Plant, optional
        Instead of the plant that the specification names. Then there is no evidence, hence no radius.

    Returns
    -------
    Fraction or None
        None where no radius of the grid is VERIFIED, 0 included if it is in the grid; and where the specification
        requires nothing.
    """
    specification = task.loop.specification
    if not specification.requirements:
        return None
    options = options or Options(splits=1)

    grid = sorted(set(radii))
    proved = [radius for radius, fine in zip(grid, _claimed(task, policy, grid, options), strict=True) if fine]
    if not proved:
        return None
    above = [radius for radius in grid if radius > proved[-1]]
    between = []
    if above:
        low, high = proved[-1], above[0]
        while high - low > resolution:
            candidates = _between(low, high, resolution)
            answers = _claimed(task, policy, candidates, options)
            edges = [low, *candidates, high]
            # the first gap: a radius above one that failed is not looked at, whatever the engine says of it
            low, high = next(pair for pair, fine in zip(pairwise(edges), [*answers, False], strict=True) if not fine)
            between += [radius for radius, fine in zip(candidates, answers, strict=True) if fine and radius <= low]
    for radius in reversed([*proved, *sorted(between)]):
        names = radii_by_name(task, policy, radius)
        with np.errstate(**QUIET):
            result = verify(policy, specification, options=options, epsilon=names, plant=plant)
        if result.verdict is Verdict.VERIFIED:
            return radius
    return None


def radii_by_name(task: Task, policy: Policy, radius: Fraction) -> dict[str, Fraction]:
    """Observation radius by name where the largest is `radius`: the specification's proportions, exact."""
    loop = task.bound(policy, radius)
    return dict(zip(loop.observation_names, loop.observation_radius, strict=True))


def _claimed(task: Task, policy: Policy, radii: Sequence[Fraction], options: Options) -> list[bool]:
    """What the engine says of each radius. Nobody looks for violations here: that takes longer than the proofs."""
    loops = [task.bound(policy, radius) for radius in radii]
    model = prepare(loops[0])
    engine = Engine(model, options, InitialSet.of(*initial_box(model.loop)).free.size + model.constant.size)
    perturbations = np.stack([observation_radius(loop) for loop in loops])
    with np.errstate(**QUIET):
        found = explore(engine, perturbations, Deadline.after(options.timeout))
    leaves = [found.cells_of(problem, PROVED, FAILED) for problem in range(len(loops))]
    return [cells.size > 0 and bool((found.status[cells] == PROVED).all()) for cells in leaves]


def _between(low: Fraction, high: Fraction, resolution: Fraction) -> list[Fraction]:
    """At most `INSIDE` radii strictly between two, on multiples of the resolution above `low`."""
    count = -(-(high - low) // resolution)  # gaps, the last one may be smaller
    return [
        low + resolution * step
        for step in sorted({count * part // (INSIDE + 1) for part in range(1, INSIDE + 1)} - {0})
    ]
