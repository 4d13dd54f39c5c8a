"""How much perturbation a policy withstands: the largest radius that is VERIFIED, the smallest that is FALSIFIED.

A smaller perturbation is one of the larger one's, so in truth everything below a VERIFIED radius holds and everything
above a FALSIFIED one fails. What can be proved is less: between the two may be a gap about which nothing is known.
"""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np

from ..models.binding import bind
from ..models.closed_loop import ClosedLoop, Plant
from ..models.perturbation import radii_by_name
from ..models.policy import Policy
from ..specs.errors import InputError, UsageError
from ..specs.exact import signed_text
from ..specs.specification import Specification
from .contradiction import require_no_contradiction
from .deadline import Deadline
from .model import initial_box
from .options import Options
from .radius_bisection import largest, smallest
from .radius_claims import QUIET, claims, claims_between
from .radius_search import RadiusSearch
from .result import Result, Verdict
from .verifier import load, verify

SPLITS = 128
"""Most cells of the initial set in a search, where nothing else is asked for: many radii are tried, and most fail."""

FIRST = Fraction(1, 100)
"""Smallest radius that is doubled until `most`; the specification's own one or the resolution where that is larger."""

MOST, RESOLUTION = Fraction(10), Fraction(1, 1000)


def search_radius(
    policy: Policy | str | os.PathLike[str],
    specification: Specification | str | os.PathLike[str],
    *,
    most: Fraction = MOST,
    resolution: Fraction = RESOLUTION,
    least: Fraction = Fraction(0),
    options: Options | None = None,
    plant: Plant | None = None,
    deadline: Deadline | None = None,
    check: bool = True,
    workers: int | None = None,
    progress: Any = None,
) -> RadiusSearch:
    """Search the largest radius that is VERIFIED and the smallest that is FALSIFIED.

    First the engine alone, initial set uncut: `least` and radii that double until `most` in one batch, then between the
    last that it proves and the next one, seven at a time. Then violations: from `most` down to the smallest radius with
    a proved witness, by bisection. Last, where ``options.splits`` lets the initial set be cut, what is between the two.
    Every answer that is returned is a verdict of `verifier.verify`.

    Parameters
    ----------
    policy : Policy or path
        An ONNX file.
    specification : Specification, path or shipped name
        With a requirement.
    most, resolution, least : Fraction
        ``0 <= least <= most``, ``resolution > 0``.
    options : Options, optional
        Of every verification; ``Options(splits=SPLITS)`` by default.
    plant : Plant, optional
        Instead of the plant that the specification names. Then there is no evidence, hence nothing is VERIFIED.
    deadline : Deadline, optional
        Instead of one made from ``options.timeout``. It ends the search with what was found.
    check : bool
        Whether the checker has to accept certificates; without it the verified side is only CLAIMED.
    workers : int, optional
        Processes of the checker.
    progress : callable, optional
        As of `verifier.verify`.

    Returns
    -------
    RadiusSearch

    Raises
    ------
    SetrlError
        Wrong input; InputError where there is no requirement, because then every radius holds.
    AssertionError
        A radius is VERIFIED and a smaller one FALSIFIED.
    """
    _require_range(least, most, resolution)
    network, contract = load(policy, specification)
    if not contract.requirements:
        raise InputError(
            "a specification without requirements holds at every radius",
            where=contract.source or None,
            remedy="say what has to hold: requirements: [...]",
        )
    options = options or Options(splits=SPLITS)
    search = _Search(
        network, contract, plant, options, deadline or Deadline.after(options.timeout), check, workers, progress
    )
    grid = _doubling(max(*search.loop.observation_radius, FIRST, resolution), least, most)
    uncut = replace(options, splits=1)

    # a certificate before the search goes on: where time runs out there is something to show
    proved, above = search.claimed_on(grid, uncut)
    search.verified_of(proved, uncut)
    if proved and above:
        proved += search.claimed_between(proved[-1], above[0], resolution, uncut)
    low = search.verified_of(sorted(proved), uncut)
    unclaimed = low is None
    if low is None and search.ask(least, options, "cells").verdict.positive:
        low = least
    search.falsify(grid, least if low is None else low, resolution, uncut)
    if low is not None and (unclaimed or search.cuts):
        search.cut(grid, low, resolution)
    return search.outcome(least, most, resolution)


def largest_verified(
    policy: Policy,
    specification: Specification,
    radii: Sequence[Fraction],
    resolution: Fraction,
    *,
    options: Options,
    plant: Plant | None = None,
) -> Fraction | None:
    """Search the largest radius that is VERIFIED, on a grid and then above the grid's last one that is.

    The engine alone searches; what is returned was accepted by the checker.

    Parameters
    ----------
    policy : Policy
    specification : Specification
    radii : sequence of Fraction
        The grid, in any order.
    resolution : Fraction
        The search ends when the radii it could still find are closer than this; positive.
    options : Options
        Of every verification. A timeout is that of each.
    plant : Plant, optional
        Instead of the plant that the specification names. Then there is no evidence, hence no radius.

    Returns
    -------
    Fraction or None
        None where no radius of the grid is VERIFIED.
    """
    search = _Search(policy, specification, plant, options, None)
    proved, above = search.claimed_on(sorted(set(radii)), options)
    if proved and above:
        proved += search.claimed_between(proved[-1], above[0], resolution, options)
    return search.verified_of(proved, options)


@dataclass
class _Search:
    """One policy and specification at any radius, and what is known of it."""

    policy: Policy
    specification: Specification
    plant: Plant | None
    options: Options
    deadline: Deadline | None
    check: bool = True
    workers: int | None = None
    progress: Any = None
    results: dict[Fraction, Result] = field(default_factory=dict)
    claimed: dict[Fraction, bool] = field(default_factory=dict)
    timings: dict[str, float] = field(default_factory=dict)

    def __post_init__(self) -> None:
        self.loop = bind(self.specification, self.policy, self.plant)

    @property
    def over(self) -> bool:
        return self.deadline is not None and self.deadline.expired

    @property
    def cuts(self) -> bool:
        """Whether cutting the initial set is allowed and cuts anything."""
        low, high = initial_box(self.loop)
        return self.options.splits > 1 and bool((low < high).any())

    def bound(self, radius: Fraction) -> ClosedLoop:
        return bind(self.specification, self.policy, self.loop.plant, radii_by_name(self.loop, radius))

    def claimed_on(self, grid: Sequence[Fraction], options: Options) -> tuple[list[Fraction], list[Fraction]]:
        """Radii of an ascending grid that the engine proves, and those above the last of them."""
        started = time.perf_counter()
        deadline = self.deadline or Deadline.after(options.timeout)
        answers = claims(self.bound, grid, options, deadline, self.progress)
        self._took("engine", started)
        self.claimed |= dict(zip(grid, answers, strict=True))
        proved = [radius for radius, fine in zip(grid, answers, strict=True) if fine]
        return proved, [radius for radius in grid if proved and radius > proved[-1]]

    def claimed_between(self, low: Fraction, high: Fraction, resolution: Fraction, options: Options) -> list[Fraction]:
        """Radii between the two that the engine proves, ascending."""
        started = time.perf_counter()
        tried = claims_between(self.bound, low, high, resolution, options, self.deadline, self.progress)
        self._took("engine", started)
        self.claimed |= tried
        return sorted(radius for radius, fine in tried.items() if fine)

    def verified_of(self, radii: Sequence[Fraction], options: Options) -> Fraction | None:
        """The last of ascending radii that the checker accepts."""
        for radius in reversed(radii):
            if self.over and radius not in self.results:
                continue
            result = self.results.get(radius) or self.ask(radius, options, "verification")
            if result.verdict.positive:
                return radius
        return None

    def ask(self, radius: Fraction, options: Options, phase: str) -> Result:
        """The verdict of one radius; a decided one is kept whatever is asked later."""
        started = time.perf_counter()
        with np.errstate(**QUIET):
            result = verify(
                self.policy,
                self.specification,
                options=options,
                epsilon=radii_by_name(self.loop, radius),
                plant=self.plant,
                progress=self.progress,
                deadline=self.deadline,
                check=self.check,
                workers=self.workers,
            )
        self._took(phase, started)
        known = self.results.get(radius)
        if known is None or known.verdict is Verdict.UNKNOWN:
            self.results[radius] = result
        return result

    def falsify(self, grid: Sequence[Fraction], low: Fraction, resolution: Fraction, options: Options) -> None:
        """Find the smallest radius with a proved violation, where the least one has none."""

        def refuted(radius: Fraction) -> bool:
            known = self.results.get(radius)
            if known is None or known.verdict is Verdict.UNKNOWN:
                known = self.ask(radius, options, "falsification")
            return known.verdict is Verdict.FALSIFIED

        if self._falsified() is None:
            smallest(refuted, grid, low, resolution, lambda: self.over)

    def cut(self, grid: Sequence[Fraction], low: Fraction, resolution: Fraction) -> None:
        """Verify above a VERIFIED radius with cut initial sets, up to what is FALSIFIED."""

        def holds(radius: Fraction) -> bool:
            return self.ask(radius, self.options, "cells").verdict.positive

        largest(holds, grid, low, self._falsified(), resolution, lambda: self.over)

    def outcome(self, least: Fraction, most: Fraction, resolution: Fraction) -> RadiusSearch:
        verified = max((radius for radius, result in self.results.items() if result.verdict.positive), default=None)
        falsified = self._falsified()
        require_no_contradiction(list(self.results.values()))
        if verified is not None and falsified is not None and verified >= falsified:
            raise AssertionError(
                f"verified at the radius {signed_text(verified)} and falsified at {signed_text(falsified)}"
            )
        verdicts = {
            radius: Verdict.CLAIMED if fine else Verdict.UNKNOWN
            for radius, fine in self.claimed.items()
            if fine or falsified is None or radius < falsified  # above, nobody asked for more than a proof
        }
        verdicts |= {radius: result.verdict for radius, result in self.results.items()}
        return RadiusSearch(
            verified=verified,
            verified_result=None if verified is None else self.results[verified],
            falsified=falsified,
            falsified_result=None if falsified is None else self.results[falsified],
            unproved_result=self.results.get(least) if verified is None else None,
            tried=tuple(sorted(verdicts.items())),
            least=least,
            most=most,
            resolution=resolution,
            stopped=self.deadline.word if self.deadline is not None and self.over else "",
            timings=self.timings,
        )

    def _falsified(self) -> Fraction | None:
        found = (radius for radius, result in self.results.items() if result.verdict is Verdict.FALSIFIED)
        return min(found, default=None)

    def _took(self, phase: str, started: float) -> None:
        self.timings[phase] = self.timings.get(phase, 0.0) + time.perf_counter() - started


def _doubling(radius: Fraction, least: Fraction, most: Fraction) -> list[Fraction]:
    """`least`, a radius and its doubles below `most`, and `most`; ascending."""
    grid = {least, most}
    while radius < most:
        grid |= {radius} if radius > least else set()
        radius *= 2
    return sorted(grid)


def _require_range(least: Fraction, most: Fraction, resolution: Fraction) -> None:
    if not resolution > 0:
        raise UsageError(f"a positive number is required, received {signed_text(resolution)}", where="resolution")
    if not 0 <= least <= most:
        raise UsageError(
            f"the radii from {signed_text(least)} to {signed_text(most)} are none",
            where="most",
            remedy="choose the least radius not negative, and the largest not below it",
        )


__all__ = ["FIRST", "MOST", "RESOLUTION", "SPLITS", "RadiusSearch", "largest_verified", "search_radius"]
