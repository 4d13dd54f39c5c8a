"""Requirements checked on everything reachable: signed margins, positive only where proved.

avoid: every time-interval set (or the time-point set of a time-point window) is disjoint from every member of the
union. stay: every such set is contained in one member of the union. reach: at one sampling instant of the window the
time-point set is contained in one member.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement, ClosedLoop
from .options import Options
from .separation import (
    Facets,
    containment_margins,
    facet_separation,
    mixed_separation,
    prepare_polytope,
    program_separation,
)
from .steps import Step
from .zonotope import Zonotope, stack_cells

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class SetProof:
    """What proves a requirement for one integrator step, or for one time-point set of one cell.

    Attributes
    ----------
    slabs : int
        Equal parts of the step; 0 for a time-point set.
    choices : tuple
        One entry per part: None outside the window; `avoid`: the weights of every member's facets, (f,) each; `stay`
        and `reach`: the position of the member that contains the set.
    """

    slabs: int
    choices: tuple[Any, ...]


@dataclass
class Monitor:
    """Margins of one requirement for a batch of cells.

    Attributes
    ----------
    requirement : BoundRequirement
    margin : array, shape (cells,)
        Smallest margin so far (reach: largest), +inf (reach: -inf) before the window.
    time : array, shape (cells,)
        Seconds at which it occurred; NaN before the window.
    failed : array of bool, shape (cells,)
        The requirement cannot be proved for this cell any more.
    failed_at : array, shape (cells,)
        Seconds of the first set without a proof; NaN where there is none.
    failing : dict of int to Zonotope
        That set, of one cell: where to look for a witness and how to split.
    curve : array, shape (cells, T + 1)
        Smallest margin of every control period: entry 0 is time 0, entry k is ((k-1) period, k period]; NaN where
        nothing was looked at.
    proofs : dict of (cell, seconds) to SetProof
        For every step that begins, and every time-point set, at that time.
    """

    requirement: BoundRequirement
    members: tuple[Facets, ...]
    options: Options
    margin: Array
    time: Array
    failed: Bools
    failed_at: Array
    failing: dict[int, Zonotope]
    curve: Array
    by_points: bool = False
    """Whether time-point sets decide; else time-interval sets do."""
    proofs: dict[tuple[int, Fraction], SetProof] = field(default_factory=dict)

    @classmethod
    def create(cls, requirement: BoundRequirement, cells: int, options: Options, loop: ClosedLoop) -> Monitor:
        """A monitor that has seen nothing."""
        instant = requirement.start == requirement.end and requirement.start % loop.period == 0
        return cls(
            requirement,
            tuple(prepare_polytope(member) for member in requirement.region),
            options,
            np.full(cells, -np.inf if requirement.kind == "reach" else np.inf),
            np.full(cells, np.nan),
            np.zeros(cells, dtype=bool),
            np.full(cells, np.nan),
            {},
            np.full((cells, loop.periods + 1), np.nan),
            loop.plant.discrete or instant or requirement.kind == "reach",
        )

    @property
    def proved(self) -> Bools:
        """Cells whose margin is a proof; complete only when the horizon's end was seen."""
        return (self.margin > 0.0) & np.isfinite(self.margin) & ~self.failed

    def observe_start(self, start: Zonotope) -> None:
        """Look at the initial sets of all cells (time 0), unless the first time-interval set contains them anyway."""
        window = self.requirement
        if window.start == 0 and self.by_points:
            numbers = np.zeros(start.batch, dtype=np.intp)
            self._observe_points(np.arange(start.batch), [Fraction(0)] * start.batch, start, numbers)

    def observe_points(self, index: Indices, times: Sequence[Fraction], sets: Zonotope, numbers: Indices) -> None:
        """Look at time-point sets: reach, time-point windows, and everything of a discrete-time plant.

        `numbers` are the entries of `curve` that the sets belong to.
        """
        window = self.requirement
        if not self.by_points:
            return
        chosen = np.array([window.start <= time <= window.end for time in times], dtype=bool)
        if not chosen.any():
            return
        kept = [time for time, use in zip(times, chosen, strict=True) if use]
        self._observe_points(index[chosen], kept, sets[chosen], numbers[chosen])

    def _observe_points(self, index: Indices, times: Sequence[Fraction], sets: Zonotope, numbers: Indices) -> None:
        margins, chosen = self._intervals(sets, coarse=False)
        margins = np.where(np.isnan(margins), -np.inf, margins)
        programs = self._improve_by_program(margins[:, None], sets) if self.requirement.kind == "avoid" else {}
        for position in np.flatnonzero(margins > 0.0).tolist():
            choice = programs.get((position, 0)) or self._choice(chosen[position])
            self.proofs[int(index[position]), times[position]] = SetProof(0, (choice,))
        self._record(index, margins, np.array([float(time) for time in times]), sets, numbers)

    def _choice(self, chosen: Indices) -> Any:
        """What `SetProof.choices` says about one set, from the row of `_intervals`."""
        if self.requirement.kind == "avoid":
            return tuple(member.weights[i] for member, i in zip(self.members, chosen.tolist(), strict=True))
        return int(chosen[0])

    def observe_steps(self, index: Indices, begins: Sequence[Fraction], step: Step, numbers: Indices) -> None:
        """Look at the time-interval sets of integrator steps: coarse slabs first, finer ones where they are needed.

        `numbers` are the entries of `curve` that the steps belong to.
        """
        window = self.requirement
        if self.by_points:
            return
        chosen = [window.start <= begin + step.duration and begin <= window.end for begin in begins]
        cells = np.flatnonzero(chosen)
        if not cells.size:
            return
        current = step if cells.size == len(begins) else step.select(cells)
        slabs = 1
        while True:
            starts = [begins[cell] for cell in cells.tolist()]
            finest = 4 * slabs > self.options.slabs
            margin, worst, sets, choices = self._slabs(current, slabs, starts, finest)
            proved = margin > 0.0
            for i in np.flatnonzero(proved).tolist():
                self.proofs[int(index[cells[i]]), starts[i]] = SetProof(slabs, choices(i))
            final = np.flatnonzero(proved | finest)
            middles = [float(starts[i] + step.duration * (2 * int(worst[i]) + 1) / (2 * slabs)) for i in final]
            worst_sets = sets[final * slabs + worst[final]]
            self._record(index[cells[final]], margin[final], np.array(middles), worst_sets, numbers[cells[final]])
            if final.size == cells.size:
                return
            left = np.flatnonzero(~(proved | finest))
            cells, current, slabs = cells[left], current.select(left), 4 * slabs

    def _slabs(
        self, step: Step, slabs: int, begins: Sequence[Fraction], finest: bool
    ) -> tuple[Array, Indices, Zonotope, Callable[[int], tuple[Any, ...]]]:
        """Smallest margin over the slabs inside the window, which slab, and all sets, slab by slab of each cell.

        Last, a function that says for a cell what `SetProof.choices` are.
        """
        window, width = self.requirement, step.duration / slabs
        parts = step.time_intervals(slabs)
        batch = parts[0].batch
        order = np.arange(batch * slabs).reshape(slabs, batch).T.ravel()
        sets = stack_cells(parts)[order] if slabs > 1 else parts[0]
        margins, chosen = self._intervals(sets, coarse=slabs == 1)
        margins, chosen = margins.reshape(batch, slabs), chosen.reshape(batch, slabs, -1)
        known: dict[Fraction, list[bool]] = {}
        for begin in begins:
            if begin not in known:
                ends = [(begin + width * part, begin + width * (part + 1)) for part in range(slabs)]
                known[begin] = [low <= window.end and high >= window.start for low, high in ends]
        wanted = np.array([known[begin] for begin in begins])
        # a bound that is not a number is no bound; outside the window nothing is asked
        margins = np.where(wanted, np.where(np.isnan(margins), -np.inf, margins), np.inf)
        programs: dict[tuple[int, int], tuple[Array, ...]] = {}
        if finest and self.requirement.kind == "avoid":
            programs = self._improve_by_program(margins, sets)
        worst = margins.argmin(1)

        def choices(cell: int) -> tuple[Any, ...]:
            return tuple(
                (programs.get((cell, slab)) or self._choice(chosen[cell, slab])) if wanted[cell, slab] else None
                for slab in range(slabs)
            )

        return np.take_along_axis(margins, worst[:, None], 1)[:, 0], worst, sets, choices

    def _improve_by_program(self, margins: Array, sets: Zonotope) -> dict[tuple[int, int], tuple[Array, ...]]:
        """Try a linear program for the slabs that simple directions miss narrowly; stop at a cell's first failure.

        Changes `margins`; returns the weights of the members' facets by (cell, slab) where it did.
        """
        slabs = margins.shape[1]
        found = {}
        for cell in np.flatnonzero((margins <= 0.0).any(1)):
            for slab in np.argsort(margins[cell]):
                margin = margins[cell, slab]
                z = sets[[cell * slabs + slab]]
                reach = max(member.program_range for member in self.members) * float(z.spread.max())
                if not (-reach < margin <= 0.0):
                    break
                pairs = [_best_of(program_separation(z, member), z, member) for member in self.members]
                best = min(value for value, _ in pairs)
                if best > margin:
                    margins[cell, slab] = best
                    found[int(cell), int(slab)] = tuple(weights for _, weights in pairs)
                if not (margins[cell, slab] > 0.0):
                    break
        return found

    def _intervals(self, z: Zonotope, coarse: bool) -> tuple[Array, Indices]:
        """Margins of sets that must satisfy the requirement at every time they cover, shape (B,).

        And why: `avoid`: which of each member's weights, shape (B, members); else which member, shape (B, 1).
        """
        if self.requirement.kind == "avoid":
            apart = [facet_separation(z, m) if coarse else mixed_separation(z, m) for m in self.members]
            return np.min([margin for margin, _ in apart], axis=0), np.stack([which for _, which in apart], 1)
        inside = np.array([containment_margins(z, member).min(1) for member in self.members])
        return inside.max(0), inside.argmax(0)[:, None]

    def _record(self, index: Indices, margins: Array, times: Array, sets: Zonotope, numbers: Indices) -> None:
        """Enter margins; a cell may occur more than once."""
        np.fmin.at(self.curve, (index, numbers), margins)
        best = self.requirement.kind == "reach"
        for position, cell in enumerate(index.tolist()):
            margin, time = float(margins[position]), float(times[position])
            first = np.isnan(self.time[cell])
            if first or (margin > self.margin[cell] if best else margin < self.margin[cell]):
                self.margin[cell], self.time[cell] = margin, time
                if best and not (margin > 0.0):
                    self.failing[cell] = sets[[position]]
                elif best:
                    self.failing.pop(cell, None)
            if not best and not (margin > 0.0):
                self.failed[cell] = True
                if not (self.failed_at[cell] <= time):
                    self.failed_at[cell] = time
                    self.failing[cell] = sets[[position]]

    def finish(self) -> None:
        """The horizon's end was seen: without a proof by now (nobody may have looked), the requirement has failed."""
        unproved = ~((self.margin > 0.0) & np.isfinite(self.margin))
        fresh = unproved & ~self.failed
        self.failed_at[fresh] = self.time[fresh]
        self.failed |= unproved


def _best_of(program: tuple[float, Array], z: Zonotope, member: Facets) -> tuple[float, Array]:
    """The better of a linear program's direction and the simple ones."""
    margin, which = mixed_separation(z, member)
    simple = float(margin[0])
    return program if program[0] > simple else (simple, member.weights[int(which[0])])
