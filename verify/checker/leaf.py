"""The streams of one leaf of a certificate, read into claims and hints. The grammar is the one of docs/certificate.md.

Nothing is decided here but that the streams are complete, that their floats are finite, and that every whole number is
within its range.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import TypeAlias

from ...specs.errors import InputError
from .layout import Condition, Layout

Floats: TypeAlias = tuple[float, ...]
Row: TypeAlias = tuple[float, ...]
Choice: TypeAlias = tuple[Floats, ...] | int
"""Why one set meets a condition: weights of every member's facets (avoid), or the member that contains it."""

MOST_SLABS, MOST_STEPS = 1024, 4096
PRODUCT, BOX, PERTURBATION, NEURON, CLIPPED = range(5)
"""Where a private row of an action set comes from."""
PARALLEL, TWO_LINES = range(2)
"""Forms of what a period claims about the neurons; version 1 of the format has only the first."""


@dataclass(frozen=True)
class Products:
    """Rows whose products are formed one by one (`factors`), and pairs of them that become rows of the image."""

    factors: tuple[int, ...]
    pairs: tuple[tuple[int, int], ...]


@dataclass(frozen=True)
class SetClaim:
    """A set of states: center, one row for every row it depends on, rows of products, half-widths of the box."""

    center: Floats
    rows: tuple[Row, ...]
    fresh: tuple[Row, ...]
    radius: Floats


@dataclass(frozen=True)
class Slabs:
    """Why a condition holds during a step: the number of equal parts, and a choice for each that meets the window."""

    count: int
    choices: tuple[Choice | None, ...]


@dataclass(frozen=True)
class StepClaim:
    """One integrator step.

    Attributes
    ----------
    kept : tuple of int
        Of a step but the first: which of the rows behind the joint set's the step before left are kept.
    start_radius : tuple or None
        Of a step but the first: half-widths of the start's box; the first one starts without a box.
    prior : pair of tuples or None
        Guess of the a-priori enclosure; None in discrete time.
    products : Products or None
        None for the method "linearization".
    end : SetClaim
    slabs : tuple of (Slabs or None)
        One entry per condition.
    """

    kept: tuple[int, ...]
    start_radius: Floats | None
    prior: tuple[Floats, Floats] | None
    products: Products | None
    end: SetClaim
    slabs: tuple[Slabs | None, ...] = ()


@dataclass(frozen=True)
class ActionClaim:
    """A set of actions: rows of the tracked set's factors, private rows with their origins (kind, position), box."""

    center: Floats
    rows: tuple[Row, ...]
    origins: tuple[tuple[int, int], ...]
    private: tuple[Row, ...]
    box: Floats


@dataclass(frozen=True)
class Lines:
    """Slopes for an activation's neurons; of a smooth one also where ``f(x) - slope x`` is: ``offset +- error``."""

    slopes: Floats
    offsets: Floats | None = None
    errors: Floats | None = None


@dataclass(frozen=True)
class TwoLines:
    """Lines below and above each of an activation's neurons: ``slope x + offset``."""

    lower_slopes: Floats
    lower_offsets: Floats
    upper_slopes: Floats
    upper_offsets: Floats


@dataclass(frozen=True)
class PeriodClaim:
    """One control period.

    Attributes
    ----------
    observation : Products or None
        Of the observation map; None where the policy sees plain states.
    seen : SetClaim or None
        What the map makes of the tracked set.
    lines : tuple of Lines
        Of every activation; none with the form TWO_LINES.
    clip_slopes : tuple or None
    action : ActionClaim
    steps : tuple of StepClaim
    kept : tuple of int or None
        Rows of the joint set at the end that the next tracked set keeps; None in the last period.
    radius : tuple or None
        Half-widths of the next tracked set's box.
    points : tuple of (Choice or None)
        One entry per condition: why the set at the end of the period meets it.
    clear : tuple of tuples or None
        Weights that prove that the end is clear of the penalty region; None where the penalty is charged.
    form : int
        What the policy is followed with: PARALLEL (forward) or TWO_LINES (backward).
    two_lines : tuple of TwoLines
        Of every activation; none with the form PARALLEL.
    """

    observation: Products | None
    seen: SetClaim | None
    lines: tuple[Lines, ...]
    clip_slopes: Floats | None
    action: ActionClaim
    steps: tuple[StepClaim, ...]
    kept: tuple[int, ...] | None
    radius: Floats | None
    points: tuple[Choice | None, ...]
    clear: tuple[Floats, ...] | None
    form: int = PARALLEL
    two_lines: tuple[TwoLines, ...] = ()


@dataclass(frozen=True)
class Leaf:
    """Everything that is claimed about one cell of the cover.

    Attributes
    ----------
    center, rows, radius
        The tracked set at the start.
    disturbance_center, disturbance_spread : tuple
        Of the disturbances that are free in every period.
    points : tuple of (Choice or None)
        One entry per condition: why the initial set meets it.
    periods : tuple of PeriodClaim
    """

    center: Floats
    rows: tuple[Row, ...]
    radius: Floats
    disturbance_center: Floats
    disturbance_spread: Floats
    points: tuple[Choice | None, ...]
    periods: tuple[PeriodClaim, ...]


class _Streams:
    def __init__(self, floats: Sequence[float], integers: Sequence[int]) -> None:
        if not all(map(math.isfinite, floats)):
            raise InputError("the certificate contains a number that is not finite")
        self.floats, self.integers = tuple(floats), tuple(integers)
        self.next_float = self.next_integer = 0

    def take(self, count: int) -> Floats:
        start = self.next_float
        self.next_float += count
        if self.next_float > len(self.floats):
            raise InputError("the certificate's floats end early")
        return self.floats[start : self.next_float]

    def half_widths(self, count: int) -> Floats:
        found = self.take(count)
        if not all(x >= 0.0 for x in found):
            raise InputError("the certificate has a half-width below 0")
        return found

    def rows(self, count: int, width: int) -> tuple[Row, ...]:
        flat = self.take(count * width)
        return tuple(flat[i * width : (i + 1) * width] for i in range(count))

    def whole(self, least: int, most: int) -> int:
        if self.next_integer >= len(self.integers):
            raise InputError("the certificate's whole numbers end early")
        number = self.integers[self.next_integer]
        self.next_integer += 1
        if not least <= number <= most:
            raise InputError(f"the certificate has {number} where a number from {least} to {most} is required")
        return number

    def positions(self, below: int) -> tuple[int, ...]:
        """A list of different positions in increasing order."""
        found = tuple(self.whole(0, below - 1) for _ in range(self.whole(0, below)))
        if any(a >= b for a, b in pairwise(found)):
            raise InputError("the certificate's positions of rows are not in increasing order")
        return found

    def kept(self, count: int) -> tuple[int, ...]:
        """Positions of rows that stay; the stream has those that are dropped."""
        dropped = set(self.positions(count))
        return tuple(i for i in range(count) if i not in dropped)

    def products(self, rows: int) -> Products:
        factors = self.positions(rows)
        size = len(factors)
        pairs = []
        for _ in range(self.whole(0, size * (size + 1) // 2)):
            first = self.whole(0, size - 1)
            pairs.append((first, self.whole(first, size - 1)))
        if len(set(pairs)) != len(pairs):
            raise InputError("the certificate has a pair of factors twice")
        return Products(factors, tuple(pairs))

    def choice(self, condition: Condition) -> Choice:
        region = condition.requirement.region
        if condition.requirement.kind == "avoid":
            return tuple(self.take(len(member)) for member in region)
        return self.whole(0, len(region) - 1)

    def point(self, condition: Condition, time: Fraction) -> Choice | None:
        """Why a time-point set meets a condition, where it is asked for; `reach` may have no answer."""
        requirement = condition.requirement
        if not condition.by_points or not requirement.start <= time <= requirement.end:
            return None
        if requirement.kind != "reach":
            return self.choice(condition)
        member = self.whole(-1, len(requirement.region) - 1)
        return None if member < 0 else member

    def slabs(self, condition: Condition, begin: Fraction, duration: Fraction) -> Slabs | None:
        """Why the sets during a step meet a condition, where any of them is asked for."""
        requirement = condition.requirement
        if condition.by_points or begin > requirement.end or begin + duration < requirement.start:
            return None
        count = self.whole(1, MOST_SLABS)
        return Slabs(
            count,
            tuple(
                self.choice(condition) if meets(condition, begin, duration, part, count) else None
                for part in range(count)
            ),
        )


def meets(condition: Condition, begin: Fraction, duration: Fraction, part: int, count: int) -> bool:
    """Whether a part of a step has a time in common with a condition's window; both are closed."""
    low, high = begin + duration * part / count, begin + duration * (part + 1) / count
    return low <= condition.requirement.end and high >= condition.requirement.start


def read_leaf(layout: Layout, floats: Sequence[float], integers: Sequence[int]) -> Leaf:
    """Read the streams of one leaf; `InputError` where they are not exactly of the grammar."""
    streams = _Streams(floats, integers)
    width = layout.tracked
    center = streams.take(width)
    rows = streams.rows(streams.whole(0, len(integers) + len(floats)), width)
    radius = streams.half_widths(width)
    varying = len(layout.varying)
    disturbance = streams.take(varying), streams.half_widths(varying)
    points = tuple(streams.point(condition, Fraction(0)) for condition in layout.conditions)
    periods, count = [], len(rows) + _boxed(radius)
    for number in range(layout.periods):
        period = _read_period(layout, streams, number, count)
        periods.append(period)
        if period.kept is not None and period.radius is not None:
            count = len(period.kept) + _boxed(period.radius)
    if streams.next_float != len(streams.floats) or streams.next_integer != len(streams.integers):
        raise InputError("the certificate has numbers behind its last period")
    return Leaf(center, rows, radius, *disturbance, points, tuple(periods))


def _boxed(radius: Floats) -> int:
    """Rows that a box adds when it becomes rows."""
    return sum(r != 0.0 for r in radius)


def _read_period(layout: Layout, streams: _Streams, number: int, shared: int) -> PeriodClaim:
    form = streams.whole(PARALLEL, TWO_LINES) if layout.version > 1 else PARALLEL
    observation, seen = _read_observation(layout, streams, shared) if layout.observed is None else (None, None)
    lines, two_lines = _read_lines(layout, streams, form)
    clip_slopes = streams.take(layout.inputs) if layout.clipped else None
    action = _read_action(layout, streams, shared, observation)
    joint = shared + len(action.private) + layout.inputs + len(layout.varying)
    begin = layout.period * number
    steps: list[StepClaim] = []
    rows = joint
    count = 1 if layout.discrete else streams.whole(1, MOST_STEPS)
    for position in range(count):
        step = _read_step(layout, streams, joint, rows, position)
        rows = len(step.end.rows) + len(step.end.fresh)
        steps.append(step)
    kept = radius = None
    if number + 1 < layout.periods:
        kept, radius = streams.kept(rows), streams.half_widths(layout.tracked)
    points, proofs = [], []
    for condition in layout.conditions:
        points.append(streams.point(condition, begin + layout.period))
        duration = layout.period / count
        proofs.append([streams.slabs(condition, begin + duration * i, duration) for i in range(count)])
    clear = None
    if layout.penalty and streams.whole(0, 1):
        clear = tuple(streams.take(facets) for facets in layout.penalty)
    checked = tuple(
        StepClaim(s.kept, s.start_radius, s.prior, s.products, s.end, tuple(proof[i] for proof in proofs))
        for i, s in enumerate(steps)
    )
    return PeriodClaim(
        observation, seen, lines, clip_slopes, action, checked, kept, radius, tuple(points), clear, form, two_lines
    )


def _read_observation(layout: Layout, streams: _Streams, shared: int) -> tuple[Products, SetClaim]:
    products, size = streams.products(shared), layout.observations
    center, mapped = streams.take(size), streams.rows(shared, size)
    fresh = streams.rows(len(products.pairs), size)
    return products, SetClaim(center, mapped, fresh, streams.half_widths(size))


def _read_lines(layout: Layout, streams: _Streams, form: int) -> tuple[tuple[Lines, ...], tuple[TwoLines, ...]]:
    """What is claimed about the neurons; the second only with the form TWO_LINES."""
    if form == TWO_LINES:
        return (), tuple(TwoLines(*(streams.take(size) for _ in range(4))) for size in layout.neurons)
    lines = tuple(
        Lines(*(streams.take(size) for _ in range(3 if smooth else 1)))
        for size, smooth in zip(layout.neurons, layout.smooth, strict=True)
    )
    return lines, ()


def _read_action(layout: Layout, streams: _Streams, shared: int, observation: Products | None) -> ActionClaim:
    center, rows = streams.take(layout.inputs), streams.rows(shared, layout.inputs)
    products = 0 if observation is None else len(observation.pairs)
    boxed = 0 if observation is None else layout.observations
    clipped = layout.inputs if layout.clipped else 0
    sizes = (products, boxed, layout.observations, sum(layout.neurons), clipped)
    origins = []
    for _ in range(streams.whole(0, sum(sizes))):
        kind = streams.whole(PRODUCT, CLIPPED)
        origins.append((kind, streams.whole(0, sizes[kind] - 1)))
    if len(set(origins)) != len(origins):
        raise InputError("the certificate has a private row of an action twice")
    private = streams.rows(len(origins), layout.inputs)
    return ActionClaim(center, rows, tuple(origins), private, streams.half_widths(layout.inputs))


def _read_step(layout: Layout, streams: _Streams, joint: int, rows: int, position: int) -> StepClaim:
    states = layout.states
    kept: tuple[int, ...] = ()
    start_radius = None
    if position:
        kept, start_radius = streams.kept(rows - joint), streams.half_widths(states)
    count = joint + len(kept)
    prior = None if layout.discrete else (streams.take(states), streams.take(states))
    products = None
    if layout.discrete or layout.method == "jets":
        products = streams.products(count)
    center, mapped = streams.take(states), streams.rows(count, states)
    fresh = streams.rows(states if products is None else len(products.pairs), states)
    return StepClaim(kept, start_radius, prior, products, SetClaim(center, mapped, fresh, streams.half_widths(states)))
