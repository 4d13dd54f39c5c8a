"""Projected gradient ascent on the violation of requirements, all starts of all requirements as one batch.

Every coordinate has its own step, which grows while the gradient keeps its sign and shrinks when it turns: in a linear
loop that ends in the corner sign(gradient), in a curved one at an inner maximum. Columns differ in how soft their
objective is, in their first step, and some aim at one facet at one time first, since the worst time may be one that
nothing can change. Which of these finds the worst trajectory depends on the problem. Now and then the poorer half is
replaced by variations of the best.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .chart import Chart
from .rollout import Rollout
from .severity import Severity

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

SOFTNESS = (0.0, 0.03, 0.1, 0.3)
"""First temperatures of the columns; they fall to a thousandth during the run."""

FIRST_STEPS = (0.5, 0.1)
"""First steps of the columns, in radii."""

GROWTH, SHRINKAGE = 1.3, 0.4
"""Factors of a coordinate's step where the gradient keeps its sign, and where it changes."""

AIMED = 0.6
"""Share of the run in which every second column aims at one facet at one time."""

RENEWALS = (0.2, 0.4, 0.6, 0.8)
"""When, as a share of the run, the poorer half of every group starts again near the best."""

VARIED = 0.2
"""Share of the coordinates that such a start draws anew."""

PATIENCE = 8
"""Iterations between two looks at the progress."""

HOPE = 5.0
"""A group gives up where this many times the progress since the last look would lead no column to a violation."""


@dataclass(frozen=True)
class Climb:
    """The best points of one requirement's group.

    Attributes
    ----------
    amounts : array, shape (N,)
        Largest violation of each column by the rollout, which is not exact; > 0 violates.
    points : array, shape (D, N)
        Where.
    """

    amounts: Array
    points: Array


class Ascent:
    """One run of the ascent, a group of columns per requirement.

    Parameters
    ----------
    rollout : Rollout
    chart : Chart
    severities : sequence of Severity
        One per group.
    starts : sequence of array, shape (D, N_g)
        One per group.
    generator : numpy.random.Generator
    """

    def __init__(
        self,
        rollout: Rollout,
        chart: Chart,
        severities: Sequence[Severity],
        starts: Sequence[Array],
        generator: np.random.Generator,
    ) -> None:
        self.rollout, self.chart, self.severities, self.generator = rollout, chart, tuple(severities), generator
        self.points = np.concatenate(list(starts), axis=1)
        count = self.points.shape[1]
        ends = np.cumsum([start.shape[1] for start in starts])
        self.groups = [np.arange(end - start.shape[1], end) for start, end in zip(starts, ends, strict=True)]
        self.open = [True] * len(self.groups)
        self.best, self.amounts = self.points.copy(), np.full(count, -np.inf)
        self.softness, self.steps = np.zeros(count), np.zeros(count)
        self.aims: Indices = np.full(count, -1, dtype=np.intp)
        self.aimed, self.seen = np.full(count, -np.inf), np.full(count, -np.inf)
        for group in self.groups:
            role = generator.permutation(group.size)
            self.softness[group] = np.array(SOFTNESS)[role % len(SOFTNESS)]
            self.steps[group] = np.array(FIRST_STEPS)[role // len(SOFTNESS) % len(FIRST_STEPS)]
        self.step = np.broadcast_to(self.steps, self.points.shape).copy()
        self.gradient = np.zeros_like(self.points)

    def climbs(self) -> list[Climb]:
        """What every group found so far."""
        return [Climb(self.amounts[group], self.best[:, group]) for group in self.groups]

    def run(
        self,
        iterations: int,
        stop: Callable[[], bool] | None = None,
        satisfied: Callable[[int, Climb], bool] | None = None,
    ) -> None:
        """Climb.

        Parameters
        ----------
        iterations : int
        stop : callable, optional
            Says when time is up.
        satisfied : callable, optional
            Asked every few iterations whether a group (its number) that found a violation needs to climb no longer.
        """
        for turn in range(iterations):
            if not self._step(turn / iterations, stop):
                return
            if any(turn == round(moment * iterations) for moment in RENEWALS):
                self._renew()
            if turn % PATIENCE == PATIENCE - 1:
                self._look(turn >= 2 * PATIENCE - 1, satisfied)
                if not any(self.open):
                    return

    def _step(self, share: float, stop: Callable[[], bool] | None) -> bool:
        """One rollout and one step of all open groups; whether there was time for it."""
        columns = np.concatenate([group for group, open_ in zip(self.groups, self.open, strict=True) if open_])
        trace = self.rollout.run(self.chart.choices(self.points[:, columns]), stop)
        if trace is None:
            return False
        seeds = self._measure(columns, trace.states, share)
        gradient = self.chart.pull(self.rollout.pull(trace, seeds))
        gradient = np.where(np.isfinite(gradient), gradient, 0.0)
        turn = gradient * self.gradient[:, columns]
        step = self.step[:, columns]
        step = np.where(turn > 0.0, np.minimum(GROWTH * step, 2.0), np.where(turn < 0.0, SHRINKAGE * step, step))
        self.step[:, columns], self.gradient[:, columns] = step, gradient
        self.points[:, columns] = np.clip(self.points[:, columns] + step * np.sign(gradient), -1.0, 1.0)
        return True

    def _measure(self, columns: Indices, states: Array, share: float) -> Array:
        """Enter the amounts of all open groups; what their states have to do."""
        seeds = np.empty_like(states)
        place = 0
        for severity, group, open_ in zip(self.severities, self.groups, self.open, strict=True):
            if not open_:
                continue
            part = slice(place, place + group.size)
            place += group.size
            aims = self.aims[group] if share < AIMED else np.full(group.size, -1, dtype=np.intp)
            softness = self.softness[group] * 1e-3**share
            amounts, table, seeds[:, :, part] = severity.measure(states[:, :, part], softness, aims)
            better = group[amounts > self.amounts[group]]
            self.best[:, better] = self.points[:, better]
            self.amounts[group] = np.maximum(self.amounts[group], amounts)
            at = np.flatnonzero(aims >= 0)
            aimed = amounts.copy()
            aimed[at] = table[aims[at], at]
            self.aimed[group] = np.maximum(self.aimed[group], aimed)
            if share == 0.0 and table.size:
                self._aim(group, table)
        return seeds

    def _aim(self, group: Indices, table: Array) -> None:
        """Give every second column an aim: those that may get furthest, judged by how far the starts spread."""
        top = table.max(1)
        low = np.where(np.isfinite(table), table, np.inf).min(1)
        promise = np.where(np.isfinite(top) & (top > low), 2.0 * top - low, -np.inf)
        order = np.argsort(-promise)[: max(group.size // 4, 1)]
        order = order[np.isfinite(promise[order])]
        chosen = self.generator.permutation(group)[: group.size // 2]
        if order.size:
            self.aims[chosen] = order[np.arange(chosen.size) % order.size]

    def _renew(self) -> None:
        """The poorer half of every group starts again from one of its best points, a few coordinates drawn anew."""
        for group, open_ in zip(self.groups, self.open, strict=True):
            if not open_:
                continue
            order = group[np.argsort(-self.amounts[group])]
            poor, good = order[group.size // 2 :], order[: max(group.size // 8, 1)]
            parents = self.best[:, self.generator.choice(good, poor.size)]
            drawn = self.generator.random(parents.shape) < VARIED
            self.points[:, poor] = np.where(drawn, self.generator.uniform(-1.0, 1.0, parents.shape), parents)
            self.step[:, poor] = self.steps[poor]
            self.gradient[:, poor] = 0.0

    def _look(self, experienced: bool, satisfied: Callable[[int, Climb], bool] | None) -> None:
        """Close the groups that found enough, and those in which no column's progress would do."""
        for number, group in enumerate(self.groups):
            if not self.open[number]:
                continue
            aimed = self.aimed[group]
            if self.amounts[group].max() > 0.0:
                if satisfied is not None and satisfied(number, Climb(self.amounts[group], self.best[:, group])):
                    self.open[number] = False
            elif experienced and not (-aimed <= HOPE * (aimed - self.seen[group])).any():
                self.open[number] = False
            self.seen[group] = aimed
