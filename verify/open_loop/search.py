"""Branch and bound over the box of a question: cells on which every case is refuted, or a point that violates."""

from __future__ import annotations

from collections import deque
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from ...models.onnx_runtime import Runner
from ...models.policy import Affine, Policy
from ..deadline import Deadline
from .attack import descend, nearest_cases, sample
from .enclosure import FormBounds, bound_forms, influence
from .question import Question
from .replay import Counterexample, replay

Array = NDArray[np.float64]
Flags = NDArray[np.bool_]

MEMORY = 1 << 22
"""Numbers in the largest array of a batch, approximately."""
MOST_CELLS = 512
"""Of a batch."""
MOST_WAITING = 1000
"""Batches that wait before the search goes deep instead of wide."""
REPLAYS = 6
"""Points of one descent, or of one batch, that are replayed."""
SEED = 20240229


@dataclass(frozen=True)
class Cells:
    """A batch of boxes, and the cases that are still open on each.

    Attributes
    ----------
    low, high : array, shape (B, n)
    real, deployed : array of bool, shape (B, cases)
        Cases that are not refuted in exact arithmetic, and for the runtime's outputs.
    """

    low: Array
    high: Array
    real: Flags
    deployed: Flags

    def __getitem__(self, index: NDArray[np.intp] | Flags | slice) -> Cells:
        return Cells(self.low[index], self.high[index], self.real[index], self.deployed[index])


@dataclass
class Budget:
    """What a search may still use, over all questions of a query.

    Attributes
    ----------
    deadline : Deadline
    cells : int
        How many may still be bounded.
    used : int
    """

    deadline: Deadline
    cells: int
    used: int = field(default=0)

    def spend(self, cells: int) -> None:
        """Count cells."""
        self.cells -= cells
        self.used += cells


@dataclass(frozen=True)
class Outcome:
    """What became of one question.

    Attributes
    ----------
    counterexample : Counterexample or None
    real, deployed : bool
        Whether all cases are refuted on the whole box, in exact arithmetic and for the runtime's outputs.
    """

    counterexample: Counterexample | None
    real: bool
    deployed: bool


class Search:
    """Decides one question.

    Parameters
    ----------
    policy : Policy
    runner : callable
        The network as the runtime runs it.
    question : Question
    budget : Budget
    """

    def __init__(self, policy: Policy, runner: Runner, question: Question, budget: Budget) -> None:
        self.policy, self.runner, self.question, self.budget = policy, runner, question, budget
        widths = [layer.weight.shape[0] for layer in policy.layers if isinstance(layer, Affine)]
        widest = max([policy.inputs, *widths, len(question.outputs.mid), question.rows.size])
        rows = policy.inputs + sum(widths)
        self.batch = int(np.clip(MEMORY // (widest * rows), 1, MOST_CELLS))
        self.influence = influence(policy, question)

    def run(self) -> Outcome:
        """Attack, then refute cell by cell; what is refuted in exact arithmetic only is refined at the end."""
        found = self.attack()
        if found is not None or not self.question.rows.size:
            return Outcome(found, False, False)
        before = self.budget.used
        waiting, aside, whole = deque([self.root()]), deque[Cells](), True
        while waiting and self.may_continue:
            cells = self.take(waiting)
            bounds = self.bound(cells)
            cells = refuted(self.question, cells, bounds)
            open_cells = np.asarray(cells.real.any(1))
            half = np.asarray(cells.deployed.any(1)) & ~open_cells
            if half.any():
                aside.append(cells[half])
            if not open_cells.any():
                continue
            found = self.try_cells(cells, bounds, open_cells)
            if found is not None:
                return Outcome(found, False, False)
            # a cell that cannot be halved ends the proof, and not the search
            whole &= self.split(cells, bounds, open_cells, cells.real, waiting)
        if waiting or not whole:
            return Outcome(None, False, False)
        return Outcome(None, True, self.refine(aside, self.budget.used - before + self.batch))

    def refine(self, waiting: deque[Cells], cells_left: int) -> bool:
        """Refute for the runtime too, with about the work that exact arithmetic took, and half of what is left.

        What the runtime may be off does not shrink with a cell, so a margin that is smaller ends in no proof.
        """
        least = max(self.budget.cells - cells_left, self.budget.cells // 2)
        while waiting and self.may_continue and self.budget.cells > least:
            cells = self.take(waiting)
            bounds = self.bound(cells)
            cells = refuted(self.question, cells, bounds)
            still = np.asarray(cells.deployed.any(1))
            if still.any() and not self.split(cells, bounds, still, cells.deployed, waiting):
                return False
        return not waiting

    @property
    def may_continue(self) -> bool:
        """Whether there is time and room for another batch."""
        return self.budget.cells > 0 and not self.budget.deadline.expired

    def root(self) -> Cells:
        """The whole box, with every case open."""
        every = np.ones((1, len(self.question.cases)), dtype=bool)
        return Cells(self.question.low[None], self.question.high[None], every, every)

    def take(self, waiting: deque[Cells]) -> Cells:
        """A batch: the largest cells, or where too many wait, the smallest."""
        count = min(self.batch, self.budget.cells)
        pop = waiting.popleft if len(waiting) < MOST_WAITING else waiting.pop
        parts = [pop()]
        while waiting and sum(len(part.low) for part in parts) < count:
            parts.append(pop())
        cells = Cells(
            np.concatenate([part.low for part in parts]),
            np.concatenate([part.high for part in parts]),
            np.concatenate([part.real for part in parts]),
            np.concatenate([part.deployed for part in parts]),
        )
        if len(cells.low) > count:
            waiting.appendleft(cells[count:])
        return cells[:count]

    def bound(self, cells: Cells) -> FormBounds:
        """Bound the forms on a batch."""
        self.budget.spend(len(cells.low))
        return bound_forms(self.policy, self.question, cells.low, cells.high)

    def attack(self) -> Counterexample | None:
        """Samples, then descents from them, case by case."""
        question = self.question
        points = sample(question, np.random.default_rng(SEED))
        if not question.rows.size:
            return replay(self.policy, self.runner, question, 0, points[0])
        for case in nearest_cases(self.policy, question, points):
            if self.budget.deadline.expired:
                return None
            found = self.try_points(int(case), descend(self.policy, question, int(case), points, self.budget.deadline))
            if found is not None:
                return found
        return None

    def try_cells(self, cells: Cells, bounds: FormBounds, chosen: Flags) -> Counterexample | None:
        """Try the middle of every open cell, and the corner at which its least proved form seems smallest."""
        index = np.flatnonzero(chosen)
        rows = self.rows_of(bounds, index, cells.real)
        middle, radius = 0.5 * cells.low + 0.5 * cells.high, 0.5 * cells.high - 0.5 * cells.low
        corner = middle[index] - radius[index] * np.sign(np.nan_to_num(bounds.generators[index, :, rows]))
        points = np.concatenate([middle[index], corner])
        with np.errstate(invalid="ignore", over="ignore"):
            worst = self.question.worst_of_case(self.question.values(points, self.policy(points)))
        near = np.where(np.isfinite(worst), worst, np.inf)
        best = np.argsort(near.min(1), kind="stable")[:REPLAYS]
        for place in best[near.min(1)[best] <= 0.0]:
            found = self.try_points(int(near[place].argmin()), points[place][None])
            if found is not None:
                return found
        return None

    def try_points(self, case: int, points: Array) -> Counterexample | None:
        """Replay the points on which a case is violated in plain floats, or violated but for rounding."""
        with np.errstate(invalid="ignore", over="ignore"):
            values = self.question.values(points, self.policy(points))
            worst = self.question.worst_of_case(values)[:, case]
            # a filter and no proof: what it lets pass is replayed
            scale = 1e-6 * (1.0 + np.abs(self.question.bound.mid).max())
        for point in points[worst <= scale][:REPLAYS]:
            found = replay(self.policy, self.runner, self.question, case, point)
            if found is not None:
                return found
        return None

    def rows_of(self, bounds: FormBounds, index: NDArray[np.intp], open_cases: Flags) -> NDArray[np.intp]:
        """Per cell: of its least proved open case, the row that is nearest to a proof."""
        lower = np.where(np.isnan(bounds.lower[index]), -np.inf, bounds.lower[index])
        per_case = np.where(open_cases[index], self.question.worst_of_case(lower), np.inf)
        cases = per_case.argmin(1)
        return np.array([self.question.row_of(int(c), v) for c, v in zip(cases, lower, strict=True)], dtype=np.intp)

    def split(self, cells: Cells, bounds: FormBounds, chosen: Flags, open_cases: Flags, waiting: deque[Cells]) -> bool:
        """Halve the chosen cells, each in the input with the widest effect, and put the halves at the end.

        Returns
        -------
        bool
            Whether all of them have a middle.
        """
        index = np.flatnonzero(chosen)
        middle = 0.5 * cells.low[index] + 0.5 * cells.high[index]
        possible = (cells.low[index] < middle) & (middle < cells.high[index])
        divisible = np.asarray(possible.any(1))
        index, middle, possible = index[divisible], middle[divisible], possible[divisible]
        if not index.size:
            return False
        rows = self.rows_of(bounds, index, open_cases)
        low, high = cells.low[index], cells.high[index]
        share = self.influence[rows] * (high - low)
        total = share.sum(1, keepdims=True)
        share = np.divide(share, total, out=np.zeros_like(share), where=total > 0.0)
        effect = np.abs(bounds.generators[index, :, rows]) + share * bounds.rest[index, rows][:, None]
        # where nothing is known the widest input is cut
        effect = np.where(np.isfinite(effect).all(1, keepdims=True), effect, high - low)
        place = np.where(possible, effect, -1.0).argmax(1)
        each = np.arange(len(index))
        cut = middle[each, place]
        left_high, right_low = high.copy(), low.copy()
        left_high[each, place], right_low[each, place] = cut, cut
        parts = cells[index]
        halves = Cells(
            np.concatenate([low, right_low]),
            np.concatenate([left_high, high]),
            np.concatenate([parts.real, parts.real]),
            np.concatenate([parts.deployed, parts.deployed]),
        )
        waiting.append(halves)
        return bool(divisible.all())


def refuted(question: Question, cells: Cells, bounds: FormBounds) -> Cells:
    """Cells without the cases of which some form is proved positive; a bound that is not finite proves nothing."""
    real = question.any_of_case(np.isfinite(bounds.lower) & (bounds.lower > 0.0))
    deployed = question.any_of_case(np.isfinite(bounds.deployed) & (bounds.deployed > 0.0))
    return Cells(cells.low, cells.high, cells.real & ~real, cells.deployed & ~deployed)


def search_all(policy: Policy, runner: Runner, questions: tuple[Question, ...], budget: Budget) -> Iterator[Outcome]:
    """Decide questions one after the other, until one has a counterexample."""
    for question in questions:
        outcome = Search(policy, runner, question, budget).run()
        yield outcome
        if outcome.counterexample is not None:
            return
