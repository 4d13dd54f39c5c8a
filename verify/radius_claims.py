"""What the engine alone says of many perturbation radii: quick, in batches, and not yet proved."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np

from ..models.closed_loop import ClosedLoop
from .closed_loop import Engine
from .deadline import Deadline
from .model import initial_box, observation_radius, prepare
from .options import Options
from .radius_bisection import between
from .splitting import FAILED, PROVED, Exploration, InitialSet, explore

Progress: TypeAlias = Callable[[Exploration], None]
Bound: TypeAlias = Callable[[Fraction], ClosedLoop]
"""The closed loop at a radius: the largest component of the observation's perturbation."""

INSIDE = 7
"""Radii between two known ones that are tried in one batch: three bisections at once."""

QUIET: dict[str, Any] = {"over": "ignore", "invalid": "ignore"}
"""A grid of radii goes on until sets overflow; the engine says so by a bound of -inf, numpy need not say it too."""


def claims(
    bound: Bound,
    radii: Sequence[Fraction],
    options: Options,
    deadline: Deadline,
    progress: Progress | None = None,
) -> list[bool]:
    """Whether the engine proves every requirement, for each radius. Nobody looks for violations: that takes longer.

    Parameters
    ----------
    bound : callable
    radii : sequence of Fraction
        At least one.
    options : Options
    deadline : Deadline
        What is not proved by then is not claimed.
    progress : callable, optional

    Returns
    -------
    list of bool
    """
    loops = [bound(radius) for radius in radii]
    model = prepare(loops[0])
    engine = Engine(model, options, InitialSet.of(*initial_box(model.loop)).free.size + model.constant.size)
    perturbations = np.stack([observation_radius(loop) for loop in loops])
    with np.errstate(**QUIET):
        found = explore(engine, perturbations, deadline, progress)
    leaves = [found.cells_of(problem, PROVED, FAILED) for problem in range(len(loops))]
    return [cells.size > 0 and bool((found.status[cells] == PROVED).all()) for cells in leaves]


def claims_between(
    bound: Bound,
    low: Fraction,
    high: Fraction,
    resolution: Fraction,
    options: Options,
    deadline: Deadline | None = None,
    progress: Progress | None = None,
) -> dict[Fraction, bool]:
    """Search the engine's largest radius between one that it proves and one that it does not.

    Parameters
    ----------
    bound : callable
    low, high : Fraction
        Claimed, and not.
    resolution : Fraction
        The search ends when the two are not farther apart than this; positive.
    options : Options
    deadline : Deadline, optional
        Ends the search; a new one after ``options.timeout`` for every round by default.
    progress : callable, optional

    Returns
    -------
    dict of radius to bool
        Every radius that was tried. Those that the search builds on are below the first gap: a radius above one that
        failed is tried in the same round, but is no answer, whatever the engine says of it.
    """
    tried: dict[Fraction, bool] = {}
    while high - low > resolution and not (deadline is not None and deadline.expired):
        candidates = between(low, high, resolution, INSIDE)
        answers = claims(bound, candidates, options, deadline or Deadline.after(options.timeout), progress)
        edges = [low, *candidates, high]
        low, high = next(pair for pair, fine in zip(pairwise(edges), [*answers, False], strict=True) if not fine)
        tried |= {radius: fine and radius <= low for radius, fine in zip(candidates, answers, strict=True)}
    return tried
