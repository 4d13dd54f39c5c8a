"""Requirements checked on everything reachable: signed margins, positive only where proved.

avoid: every time-interval set (or the time-point set of a time-point window) is disjoint from every member of the
union. stay: every such set is contained in one member of the union. reach: at one sampling instant of the window the
time-point set is contained in one member.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement
from .closed_loop import Period
from .integrator import Step
from .options import Options
from .separation import (
    Facets,
    containment_margins,
    facet_separation,
    mixed_separation,
    prepare_polytope,
    program_separation,
)
from .zonotope import Zonotope

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass
class Monitor:
    """Margins of one requirement for all cells of a caller.

    Attributes
    ----------
    requirement : BoundRequirement
    margin : array, shape (cells,)
        Smallest margin so far (reach: largest), +inf (reach: -inf) before the window.
    time : array, shape (cells,)
        Seconds at which it occurred; NaN before the window.
    failed : array of bool, shape (cells,)
        The requirement cannot be proved for this cell any more.
    failing : dict of int to Zonotope
        The first set, of one cell, for which the proof failed: where to look for a witness and how to split.
    """

    requirement: BoundRequirement
    members: tuple[Facets, ...]
    options: Options
    margin: Array
    time: Array
    failed: Bools
    failing: dict[int, Zonotope]

    @classmethod
    def create(cls, requirement: BoundRequirement, cells: int, options: Options) -> Monitor:
        """A monitor that has seen nothing."""
        start = -np.inf if requirement.kind == "reach" else np.inf
        return cls(
            requirement,
            tuple(prepare_polytope(member) for member in requirement.region),
            options,
            np.full(cells, start),
            np.full(cells, np.nan),
            np.zeros(cells, dtype=bool),
            {},
        )

    @property
    def proved(self) -> Bools:
        """Cells whose margin is a proof; complete only when the horizon's end was seen."""
        return (self.margin > 0.0) & np.isfinite(self.margin) & ~self.failed

    def observe_start(self, index: Indices, start: Zonotope, discrete: bool) -> None:
        """Look at the initial set (time 0), unless the first time-interval set contains it anyway."""
        window = self.requirement
        if window.start == 0 and (window.kind == "reach" or window.end == 0 or discrete):
            self._record(index, self._points(start), 0.0, start)

    def observe(self, period: Period, length: Fraction) -> None:
        """Look at one control period: its time-interval sets and the set at its end."""
        window = self.requirement
        begin, end = length * period.number, length * (period.number + 1)
        if window.start == window.end or window.kind == "reach" or self._discrete(period):
            if window.start <= end <= window.end:
                self._record(period.index, self._points(period.end), float(end), period.end)
            return
        if window.end < begin or window.start > end:
            return
        for group in period.flow.groups:
            now = begin
            for step in group.steps:
                until = now + step.duration
                if window.start <= until and now <= window.end:
                    self._observe_step(period.index[group.cells], step, now)
                now = until

    def _discrete(self, period: Period) -> bool:
        return not any(group.steps for group in period.flow.groups)

    def _observe_step(self, index: Indices, step: Step, begin: Fraction) -> None:
        """Coarse slabs first, finer ones for the cells that need them."""
        states = step.added.shape[1]
        slabs = 1
        cells = np.arange(index.size)
        current = step
        while True:
            margin, worst, sets = self._slabs(current, slabs, begin, last=4 * slabs > self.options.slabs)
            proved = margin > 0.0
            final = proved | (4 * slabs > self.options.slabs)
            for position in np.flatnonzero(final):
                place = (
                    Zonotope(
                        sets.center[position, worst[position]][None, :states],
                        sets.generators[position, worst[position]][None],
                        sets.radius[position, worst[position]][None],
                    )
                    if not proved[position]
                    else None
                )
                when = float(begin + step.duration * (2 * int(worst[position]) + 1) / (2 * slabs))
                self._record_one(int(index[cells[position]]), float(margin[position]), when, place)
            if final.all():
                return
            cells = cells[~final]
            current = current.select(np.flatnonzero(~final))
            slabs *= 4

    def _slabs(self, step: Step, slabs: int, begin: Fraction, last: bool) -> tuple[Array, Indices, Zonotope]:
        """Margins of the slabs inside the window: the smallest per cell, which slab, and all sets (B, S, ...)."""
        window = self.requirement
        width = step.duration / slabs
        sets = step.time_intervals(slabs)
        wanted = [begin + width * s <= window.end and begin + width * (s + 1) >= window.start for s in range(slabs)]
        batch = sets[0].batch
        stacked = Zonotope(
            np.stack([z.center for z in sets], 1),
            np.stack([z.generators for z in sets], 1),
            np.stack([z.radius for z in sets], 1),
        )
        flat = Zonotope(
            stacked.center.reshape(batch * slabs, -1),
            stacked.generators.reshape(batch * slabs, *stacked.generators.shape[2:]),
            stacked.radius.reshape(batch * slabs, -1),
        )
        margins = self._intervals(flat, coarse=slabs == 1).reshape(batch, slabs)
        margins[:, ~np.array(wanted)] = np.inf
        if last and self.requirement.kind == "avoid":
            self._improve_by_program(margins, stacked)
        worst = margins.argmin(1)
        margin = np.take_along_axis(margins, worst[:, None], 1)[:, 0]
        return np.where(np.isnan(margins).any(1), -np.inf, margin), worst, stacked

    def _improve_by_program(self, margins: Array, sets: Zonotope) -> None:
        """Try a linear program for the slabs that simple directions miss narrowly; stop at a cell's first failure."""
        for cell in range(margins.shape[0]):
            for slab in np.argsort(margins[cell]):
                margin = margins[cell, slab]
                z = Zonotope(sets.center[cell, [slab]], sets.generators[cell, [slab]], sets.radius[cell, [slab]])
                reach = max(member.program_range for member in self.members) * float(z.spread.max())
                if not (-reach < margin <= 0.0):
                    break
                best = min(max(program_separation(z, member)[0], self._one(z, member)) for member in self.members)
                margins[cell, slab] = max(margin, best)
                if not (margins[cell, slab] > 0.0):
                    break

    def _one(self, z: Zonotope, member: Facets) -> float:
        return float(mixed_separation(z, member)[0])

    def _intervals(self, z: Zonotope, coarse: bool) -> Array:
        """Margins of sets that must satisfy the requirement at every time they cover, shape (B,)."""
        if self.requirement.kind == "avoid":
            check = (lambda z, m: facet_separation(z, m)[0]) if coarse else mixed_separation
            return np.min([check(z, member) for member in self.members], axis=0)  # type: ignore[no-any-return]
        inside = [containment_margins(z, member).min(1) for member in self.members]
        return np.max(inside, axis=0)  # type: ignore[no-any-return]

    def _points(self, z: Zonotope) -> Array:
        margins = self._intervals(z, coarse=False)
        if self.requirement.kind == "avoid":
            padded = Zonotope(z.center[:, None], z.generators[:, None], z.radius[:, None])
            grid = margins[:, None].copy()
            self._improve_by_program(grid, padded)
            margins = grid[:, 0]
        return np.where(np.isnan(margins), -np.inf, margins)

    def _record(self, index: Indices, margins: Array, time: float, z: Zonotope) -> None:
        for position, cell in enumerate(index):
            place = z[position : position + 1] if not (margins[position] > 0.0) else None
            self._record_one(int(cell), float(margins[position]), time, place)

    def _record_one(self, cell: int, margin: float, time: float, place: Zonotope | None) -> None:
        if self.requirement.kind == "reach":
            if margin > self.margin[cell] or np.isnan(self.time[cell]):
                self.margin[cell], self.time[cell] = margin, time
                if place is not None:
                    self.failing[cell] = place
            return
        if margin < self.margin[cell] or np.isnan(self.time[cell]):
            self.margin[cell], self.time[cell] = margin, time
        if not (margin > 0.0):
            if not self.failed[cell] and place is not None:
                self.failing[cell] = place
            self.failed[cell] = True

    def finish(self) -> None:
        """The horizon's end was seen: a reach requirement without a proof has failed; a window nobody saw has, too."""
        self.failed |= ~((self.margin > 0.0) & np.isfinite(self.margin))


def widest_facet_text(requirement: BoundRequirement, z: Zonotope) -> str:
    """Text of the facet that decides the margin of a set: for messages."""
    best_text, best = "", -np.inf
    for member in requirement.region:
        facets = prepare_polytope(member)
        if requirement.kind == "avoid":
            margin, which = facet_separation(z, facets)
            value, text = float(margin[0]), facets.texts[int(which[0])]
        else:
            margins = containment_margins(z, facets)[0]
            value, text = float(margins.min()), facets.texts[int(margins.argmin())]
        if value > best or not best_text:
            best, best_text = value, text
    return best_text
