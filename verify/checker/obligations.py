"""All obligations of one leaf: its claims, followed from the initial set to the horizon.

Each period is proved from the claims alone: tracked set, action set, ends of the steps, next tracked set. The tracked
coordinates are the states, the constant disturbances and the actions that are still delayed.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, ctx

from .action import Policy, check_action
from .between import Motion
from .conditions import margin_of, separation, support_of
from .contract import Bounds, Contract
from .cover import Box, contains
from .image import Start, image_of, require_image
from .layout import Layout
from .leaf import Floats, Leaf, PeriodClaim, Row, SetClaim, StepClaim, meets
from .linear_step import LinearMotion, follow_linear
from .program import Program, ball, compile_program
from .rejection import Rejected, require_within
from .reward import worst_cost
from .step import follow

PRECISION = 64
"""Bits. More would prove the same: the claims leave room for it."""


@dataclass(frozen=True)
class Setting:
    """What all leaves of a certificate share.

    Attributes
    ----------
    contract : Contract
    layout : Layout
    policy : Policy
    field : Program
        The plant's dynamics, of states, inputs and disturbances.
    order : int
        Order of the expansions in time.
    """

    contract: Contract
    layout: Layout
    policy: Policy
    field: Program
    order: int

    @classmethod
    def of(cls, contract: Contract, layout: Layout, policy: Policy, order: int) -> Setting:
        """Prepare."""
        plant = contract.plant
        field = compile_program(plant.dynamics, (*plant.states, *plant.inputs, *plant.disturbances))
        return cls(contract, layout, policy, field, order)


@dataclass(frozen=True)
class Found:
    """What a leaf's proofs show.

    Attributes
    ----------
    margins : tuple of float
        Per condition, a lower bound of the smallest margin (reach: of the largest).
    value, undiscounted : float
        Lower bounds of the return; 0 without a reward.
    """

    margins: tuple[float, ...]
    value: float
    undiscounted: float


def check_leaf(setting: Setting, leaf: Leaf, box: Box) -> Found:
    """Prove everything that is claimed about one leaf.

    Parameters
    ----------
    setting : Setting
    leaf : Leaf
    box : Box
        Of initial states that the leaf is responsible for.

    Returns
    -------
    Found

    Raises
    ------
    Rejected
    """
    with ctx.workprec(PRECISION):
        return _Walk(setting).through(leaf, box)


class _Walk:
    def __init__(self, setting: Setting) -> None:
        self.setting = setting
        self.layout = setting.layout
        self.margins: list[Any] = [None] * len(setting.layout.conditions)
        self.costs: list[Any] = []

    def through(self, leaf: Leaf, box: Box) -> Found:
        layout = self.layout
        if not contains(leaf, [*box, *self._held()]):
            raise Rejected("the first set does not contain its part of the initial set")
        self._check_disturbances(leaf)
        current = Start(leaf.center, leaf.rows, leaf.radius)
        self._points(leaf.points, _states_of(current, layout.states), Fraction(0))
        for number, period in enumerate(leaf.periods):
            what = f"period {number}"
            current = _unboxed(current)
            states = _states_of(current, layout.states)
            check_action(self.setting.policy, states, period, f"{what}: the set of actions")
            joint = self._joint(current, period, leaf)
            last = self._steps(joint, period, number)
            end = Start(last.center, (*last.rows, *last.fresh), last.radius)
            self._points(period.points, end, layout.period * (number + 1))
            self._charge(period, end, what)
            if period.kept is not None and period.radius is not None:
                current = self._link(current, period, end, what)
        if any(margin is None for margin in self.margins):
            raise Rejected("a requirement is not proved at any time")
        return self._found()

    def _held(self) -> list[Bounds]:
        """Exact ranges of what is tracked besides the states."""
        contract, layout = self.setting.contract, self.layout
        held = [contract.disturbances[i].bounds for i in layout.constant]
        return held + [(value, value) for _ in range(layout.delay) for value in contract.delayed_action]

    def _check_disturbances(self, leaf: Leaf) -> None:
        given = zip(self.layout.varying, leaf.disturbance_center, leaf.disturbance_spread, strict=True)
        for i, center, spread in given:
            low, high = self.setting.contract.disturbances[i].bounds
            if not (Fraction(center) - Fraction(spread) <= low and high <= Fraction(center) + Fraction(spread)):
                raise Rejected("a disturbance's range is not contained in the claimed one")

    def _joint(self, current: Start, period: PeriodClaim, leaf: Leaf) -> Start:
        """States, actions, disturbances together; rows: the tracked set's, the action's private ones, disturbances'."""
        layout, action = self.layout, period.action
        states, inputs, delay = layout.states, layout.inputs, layout.delay
        first = states + len(layout.constant)
        if delay:
            applied, rows = (
                current.center[first : first + inputs],
                [row[first : first + inputs] for row in current.rows],
            )
        else:
            applied, rows = action.center, list(action.rows)
        nothing = (0.0,) * inputs
        private = [*action.private, *(_unit(i, r, inputs) for i, r in enumerate(action.box))]
        count = states + inputs
        constant = dict(zip(layout.constant, range(states, first), strict=True))
        size = len(self.setting.contract.disturbances)
        joint = [
            (*row[:states], *u, *(row[constant[i]] if i in constant else 0.0 for i in range(size)))
            for row, u in zip(current.rows, rows, strict=True)
        ]
        joint += [((0.0,) * states + (nothing if delay else tuple(u)) + (0.0,) * size) for u in private]
        for i, spread in zip(layout.varying, leaf.disturbance_spread, strict=True):
            joint.append((0.0,) * count + _unit(i, spread, size))
        varying = dict(zip(layout.varying, leaf.disturbance_center, strict=True))
        disturbance = [current.center[constant[i]] if i in constant else varying[i] for i in range(size)]
        center = (*current.center[:states], *applied, *disturbance)
        return Start(center, joint, (0.0,) * len(center))

    def _steps(self, joint: Start, period: PeriodClaim, number: int) -> SetClaim:
        """Follow the steps of a period; the last one's end."""
        layout, what = self.layout, f"period {number}"
        states = layout.states
        if layout.discrete:
            claim = period.steps[0]
            assert claim.products is not None
            image = image_of(self.setting.field, joint, claim.products)
            require_image(image, joint, claim.end, f"{what}: the end")
            return claim.end
        duration = layout.period / len(period.steps)
        begin = layout.period * number
        start, held, count = joint, joint.center[states:], len(joint.rows)
        for position, claim in enumerate(period.steps):
            if claim.start_radius is not None:
                start = self._kept(joint, period.steps[position - 1].end, claim, count)
            place = f"{what}, step {position}"
            motion = self._follow(start, duration, claim, place)
            self._between(motion, claim, begin + duration * position, place)
        assert len(held) == len(joint.center) - states
        return period.steps[-1].end

    def _follow(self, start: Start, duration: Fraction, claim: StepClaim, what: str) -> Motion | LinearMotion:
        by = follow if self.layout.method == "jets" else follow_linear
        try:
            return by(self.setting.field, start, duration, self.setting.order, claim)
        except Rejected as rejected:
            raise Rejected(f"{what}: {rejected}") from None

    def _kept(self, joint: Start, before: SetClaim, claim: StepClaim, count: int) -> Start:
        """The start of a later step: the joint set's rows and some of those behind them; the others go into the box."""
        states = self.layout.states
        rows = [*before.rows, *before.fresh]
        chosen = {*range(count), *(count + i for i in claim.kept)}
        assert claim.start_radius is not None
        _require_dropped(rows, chosen, before.radius, claim.start_radius, "a later step's start")
        tail = [row[states:] for row in joint.rows]
        nothing = (0.0,) * (len(joint.center) - states)
        kept = [(*row, *(tail[i] if i < count else nothing)) for i, row in enumerate(rows) if i in chosen]
        center = (*before.center, *joint.center[states:])
        return Start(center, kept, (*claim.start_radius, *nothing))

    def _link(self, current: Start, period: PeriodClaim, end: Start, what: str) -> Start:
        """The next tracked set: rows of the joint set at the end, the others in the box."""
        layout, action = self.layout, period.action
        states, inputs = layout.states, layout.inputs
        first = states + len(layout.constant)
        shared, count = len(current.rows), len(end.rows)
        private = [*action.private, *(_unit(i, r, inputs) for i, r in enumerate(action.box))]
        computed = [*action.rows, *private]
        nothing = (0.0,) * inputs
        rows = []
        for position, row in enumerate(end.rows):
            old = current.rows[position] if position < shared else (0.0,) * layout.tracked
            new = computed[position] if position < len(computed) else nothing
            queue = (*old[first + inputs :], *new) if layout.delay else ()
            rows.append((*row, *old[states:first], *queue))
        queue = (*current.center[first + inputs :], *action.center) if layout.delay else ()
        center = (*end.center, *current.center[states:first], *queue)
        boxed = (*end.radius, *((0.0,) * (layout.tracked - states)))
        assert period.kept is not None and period.radius is not None and count == len(rows)
        chosen = set(period.kept)
        _require_dropped(rows, chosen, boxed, period.radius, f"{what}: the link to the next set")
        return Start(center, [row for i, row in enumerate(rows) if i in chosen], period.radius)

    def _points(self, choices: Sequence[Any], states: Start, time: Fraction) -> None:
        for number, condition in enumerate(self.layout.conditions):
            requirement = condition.requirement
            if not condition.by_points or not requirement.start <= time <= requirement.end:
                continue
            if requirement.kind == "reach" and choices[number] is None:
                continue
            what = f"{requirement.name} at {float(time):g} s"
            margin = margin_of(requirement.kind, requirement.region, choices[number], support_of(states), what)
            self._note(number, margin, best=requirement.kind == "reach")

    def _between(self, motion: Motion | LinearMotion, claim: StepClaim, begin: Fraction, what: str) -> None:
        """Every time-interval set of a step that a condition asks for."""
        for number, condition in enumerate(self.layout.conditions):
            slabs = claim.slabs[number]
            if slabs is None:
                continue
            requirement = condition.requirement
            for part in range(slabs.count):
                if meets(condition, begin, motion.duration, part, slabs.count):
                    place = f"{what}: {requirement.name}"
                    least = motion.between(part, slabs.count).least
                    self._note(
                        number, margin_of(requirement.kind, requirement.region, slabs.choices[part], least, place)
                    )

    def _note(self, number: int, margin: Any, best: bool = False) -> None:
        known = self.margins[number]
        if known is not None:
            margin = known.max(margin) if best else known.min(margin)
        self.margins[number] = margin

    def _charge(self, period: PeriodClaim, end: Start, what: str) -> None:
        reward = self.setting.contract.reward
        if reward is None:
            return
        cost = worst_cost(reward, end)
        if period.clear is None:
            cost += ball(reward.penalty) if reward.region else 0
        else:
            for member, weights in zip(reward.region, period.clear, strict=True):
                if not bool(separation(member, weights, support_of(end), what) > 0):
                    raise Rejected(f"{what}: the end is not proved clear of the penalty region")
        self.costs.append(cost)

    def _found(self) -> Found:
        reward, value, plain, factor = self.setting.contract.reward, arb(0), arb(0), arb(1)
        if reward is not None:
            for cost in self.costs:
                value, plain = value - factor * cost, plain - cost
                factor *= ball(reward.discount)
        return Found(tuple(below(margin) for margin in self.margins), below(value), below(plain))


def below(value: Any) -> float:
    """A float that is not above any point of a ball."""
    nearest = float(value.lower())
    while not bool(arb(nearest) <= value):
        nearest = math.nextafter(nearest, -math.inf)
    return nearest


def _unit(position: int, length: float, size: int) -> Row:
    return tuple(length if i == position else 0.0 for i in range(size))


def _states_of(tracked: Start, states: int) -> Start:
    return Start(tracked.center[:states], [row[:states] for row in tracked.rows], tracked.radius[:states])


def _unboxed(tracked: Start) -> Start:
    """The same set, its box as rows."""
    size = len(tracked.center)
    boxed = [_unit(i, r, size) for i, r in enumerate(tracked.radius) if r != 0.0]
    return Start(tracked.center, [*tracked.rows, *boxed], (0.0,) * size)


def _require_dropped(rows: Sequence[Row], kept: set[int], radius: Floats, room: Floats, what: str) -> None:
    """Require that a box has room for a smaller one and for the rows that are not kept."""
    dropped = [row for i, row in enumerate(rows) if i not in kept]
    needed = []
    for i, r in enumerate(radius):
        needed.append(sum((abs(arb(row[i])) for row in dropped), arb(r)))
    require_within(needed, room, what)
