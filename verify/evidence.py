"""What the engine found for a cell, as the numbers of a certificate: claims, and hints that a checker need not trust.

A leaf's evidence is two streams, floats and whole numbers, whose grammar docs/certificate.md states. Rows that are zero
in every coordinate (padding of the batch) are left out: positions of rows are those of the stream, not of the arrays.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from .action_sets import TWO_LINES
from .closed_loop import Period
from .model import Model
from .quadratic_map import Products
from .requirements import Monitor, SetProof
from .steps import Step
from .zonotope import Zonotope

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class LeafEvidence:
    """The two streams of one cell that was proved."""

    floats: Array
    integers: NDArray[np.int32]


@dataclass(frozen=True)
class _StepClaim:
    """One step (or a discrete-time plant's map) of a group of cells; the end set has state coordinates only."""

    begin: Fraction
    duration: Fraction
    start_rows: int
    kept: Indices | None
    start_radius: Array | None
    prior: tuple[Array, Array] | None
    products: Products | None
    end: Zonotope


@dataclass(frozen=True)
class _Group:
    cells: dict[int, int]
    steps: tuple[_StepClaim, ...]


@dataclass
class _Stream:
    floats: list[Array] = field(default_factory=list)
    integers: list[int] = field(default_factory=list)

    def put(self, *arrays: Any) -> None:
        self.floats += [np.ravel(np.asarray(array, dtype=np.float64)) for array in arrays]

    def count(self, *numbers: Any) -> None:
        for number in numbers:
            self.integers += np.ravel(number).tolist()


@dataclass
class Recorder:
    """Keeps what a certificate needs of one batch of cells on its way through the horizon.

    Attributes
    ----------
    model : Model
    periods : list
        Periods that were seen, with the position of every cell in them.
    """

    model: Model
    periods: list[tuple[Period, dict[int, int], tuple[_Group, ...]]] = field(default_factory=list)

    def see(self, period: Period) -> None:
        """Take note of one period; the time coefficients of its steps are not kept."""
        states = self.model.states
        groups = []
        for group in period.flow.groups:
            cells = {int(cell): place for place, cell in enumerate(period.index[group.cells])}
            groups.append(_Group(cells, tuple(self._claims(period, group, states))))
        places = {int(cell): place for place, cell in enumerate(period.index)}
        thin = _without_flow(period)
        self.periods.append((thin, places, tuple(groups)))

    def _claims(self, period: Period, group: Any, states: int) -> list[_StepClaim]:
        loop = self.model.loop
        begin = loop.period * period.number
        if not group.steps:
            end = period.end[group.cells]
            rows = period.joint_rows
            return [_StepClaim(begin, loop.period, rows, None, None, None, group.products, end)]
        claims = []
        for number, step in enumerate(group.steps):
            first = number == 0
            claims.append(
                _StepClaim(
                    begin + number * step.duration,
                    step.duration,
                    step.start.generators.shape[1],
                    None if first else group.kept[number - 1],
                    None if first else step.start.radius[:, :states],
                    _bounds(step, states),
                    getattr(step, "products", None),
                    step.end.coordinates(slice(0, states)),
                )
            )
        return claims

    def leaf(self, cell: int, monitors: list[Monitor], clear: dict[tuple[int, int], Any]) -> LeafEvidence:
        """The streams of a cell that was proved.

        Parameters
        ----------
        cell : int
        monitors : list of Monitor
        clear : dict of (cell, period) to tuple of array
            Weights of the penalty region's facets where a set is provably clear of it.
        """
        stream = _Stream()
        first = self.periods[0][0].tracked
        rows = first.generators[cell]
        present = np.flatnonzero(rows.any(1))
        stream.count(present.size)
        stream.put(first.center[cell], rows[present], first.radius[cell])
        model = self.model
        middle, spread = model.varying_ball
        stream.put(middle, spread)
        for monitor in monitors:
            if monitor.by_points and monitor.requirement.start == 0:
                _put_choices(stream, monitor, monitor.proofs.get((cell, Fraction(0))))
        for number in range(len(self.periods)):
            present = self._period(stream, number, cell, present, monitors)
            if model.loop.reward is not None and model.loop.reward.penalty_region:
                weights = clear.get((cell, number))
                stream.count(0 if weights is None else 1)
                stream.put(*(weights or ()))
        floats = np.concatenate([np.zeros(0), *stream.floats])
        return LeafEvidence(floats, np.array(stream.integers, dtype=np.int32))

    def _period(self, stream: _Stream, number: int, cell: int, present: Indices, monitors: list[Monitor]) -> Indices:
        """One period; takes and returns which rows of the tracked set are in the stream."""
        period, places, groups = self.periods[number]
        place = places[cell]
        tracked, choices, computed = period.tracked, period.choices, period.computed
        count, dimension = tracked.generators.shape[1:]
        boxed = np.flatnonzero(tracked.radius[place] > 0.0)
        shared = np.concatenate([present, count + boxed])
        origins, lines = choices.origins, choices.lines
        if choices.forms is not None:
            stream.count(choices.forms[place])
            lines = choices.two_lines if choices.forms[place] == TWO_LINES else lines
        if choices.products is not None and choices.seen is not None:
            where = np.full(count + dimension, -1)
            where[shared] = np.arange(shared.size)
            fresh = _put_products(stream, choices.products[place], where)
            rows = choices.seen.generators[place]
            stream.put(choices.seen.center[place], rows[shared], rows[count + dimension + fresh])
            stream.put(choices.seen.radius[place])
            origins = origins.copy()
            origins[fresh, 1] = np.arange(fresh.size)
        stream.put(*(line[place] for line in lines))
        generators = computed.generators[place]
        private = choices.kept[place]
        first, inputs = count + dimension, self.model.inputs
        real = np.flatnonzero(generators[first : first + private.size].any(1))
        stream.put(computed.center[place], generators[shared])
        stream.count(real.size, origins[private[real]])
        stream.put(generators[first + real], generators[first + private.size :].diagonal())
        # positions of the joint set's rows in the stream, by positions in the arrays; -1 where a row is zero
        varying = self.model.varying.size
        kept = np.concatenate([shared, first + real, first + private.size + np.arange(inputs + varying)])
        joint = first + private.size + inputs + varying
        where = np.full(joint, -1)
        where[kept] = np.arange(kept.size)
        group = next(group for group in groups if cell in group.cells)
        where, rows = self._steps(stream, group, group.cells[cell], where, kept.size)
        if number + 1 < len(self.periods):
            following = self.periods[number + 1]
            after, position = following[0].tracked, following[1][cell]
            present = np.flatnonzero(after.generators[position].any(1))
            links = where[period.kept[place][present]]
            if (links < 0).any():
                raise AssertionError("a row of the tracked set is not in the stream")
            _put_dropped(stream, links, rows)
            stream.put(after.radius[position])
        end = self.model.loop.period * (number + 1)
        for monitor in monitors:
            _put_proofs(stream, monitor, cell, group.steps, end)
        return present

    def _steps(self, stream: _Stream, group: _Group, place: int, where: Indices, joint: int) -> tuple[Indices, int]:
        """The steps of a period; takes and returns positions in the stream by positions in the arrays.

        And how many rows there are in the stream at the end.
        """
        continuous = not self.model.loop.plant.discrete
        if continuous:
            stream.count(len(group.steps))
        given, rows = where.size, joint
        for step in group.steps:
            if step.kept is not None and step.start_radius is not None:
                chosen = step.kept[place]
                later = where[chosen[given:]]
                real = np.flatnonzero(later >= 0)
                _put_dropped(stream, later[real] - joint, rows - joint)
                stream.put(step.start_radius[place])
                moved = np.full(step.start_rows - given, -1)
                moved[real] = joint + np.arange(real.size)
                where, rows = np.concatenate([where[:given], moved]), joint + real.size
            if step.prior is not None:
                stream.put(step.prior[0][place], step.prior[1][place])
            if step.products is not None:
                fresh = _put_products(stream, step.products[place], where)
            else:
                fresh = np.arange(step.end.dimension)
            generators = step.end.generators[place]
            stream.put(step.end.center[place], generators[_inverse(where, rows)])
            stream.put(generators[step.start_rows + fresh], step.end.radius[place])
            added = np.full(generators.shape[0] - step.start_rows, -1)
            added[fresh] = rows + np.arange(fresh.size)
            where, rows = np.concatenate([where, added]), rows + fresh.size
        return where, rows


def _without_flow(period: Period) -> Any:
    """A period without what its flow computed on the way."""
    flow = replace(period.flow, groups=())
    return replace(period, flow=flow)


def _bounds(step: Step, states: int) -> tuple[Array, Array]:
    prior = step.prior
    assert prior is not None
    return prior.lower[:, :states], prior.upper[:, :states]


def _inverse(where: Indices, rows: int) -> Indices:
    """Positions in the arrays, by positions in the stream."""
    result = np.zeros(rows, dtype=np.intp)
    present = np.flatnonzero(where >= 0)
    result[where[present]] = present
    return result


def _put_products(stream: _Stream, products: Products, where: Indices) -> Indices:
    """Factors by their positions in the stream, and the pairs; returns which products are not zero by themselves."""
    factors = where[products.factors]
    real = np.flatnonzero(factors >= 0)
    position = np.full(factors.size, -1)
    position[real] = np.arange(real.size)
    pairs = position[products.pairs]
    fresh = np.flatnonzero((pairs >= 0).all(1))
    stream.count(real.size, factors[real], fresh.size, pairs[fresh])
    return fresh


def _put_dropped(stream: _Stream, kept: Indices, count: int) -> None:
    """Which of `count` rows are not kept; fewer numbers than those that are."""
    dropped = np.setdiff1d(np.arange(count), kept)
    stream.count(dropped.size, dropped)


def _put_proofs(stream: _Stream, monitor: Monitor, cell: int, steps: tuple[_StepClaim, ...], end: Fraction) -> None:
    """Why one requirement holds in one period of one cell."""
    window = monitor.requirement
    if monitor.by_points:
        if window.start <= end <= window.end:
            _put_choices(stream, monitor, monitor.proofs.get((cell, end)))
        return
    for step in steps:
        if window.start <= step.begin + step.duration and step.begin <= window.end:
            proof = monitor.proofs[cell, step.begin]
            stream.count(proof.slabs)
            _put_choices(stream, monitor, proof)


def _put_choices(stream: _Stream, monitor: Monitor, proof: SetProof | None) -> None:
    if monitor.requirement.kind == "avoid":
        assert proof is not None
        for weights in (choice for choice in proof.choices if choice is not None):
            stream.put(*weights)
        return
    if proof is None:  # `reach` at another instant
        stream.count(-1)
        return
    stream.count([choice for choice in proof.choices if choice is not None])
