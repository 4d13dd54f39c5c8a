"""Whether a claim of a certificate is false, decided without the checker's enclosures.

Every claim is local: it is judged at exact points of the claimed set before it, by balls of 96 bits around what the
policy or the plant makes of them, or in rationals; a margin and a value by whole trajectories. "" means that nothing
false was found.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from certificate_points import Affine, Array, F, exact_point, judge, unboxed
from certificate_streams import Certificate
from certificate_trajectories import Question, false_header
from flint import ctx

from setrl.models.simulation import act, derivative, observe
from setrl.verify.checker.cover import leaf_boxes
from setrl.verify.checker.leaf import Leaf, PeriodClaim, SetClaim
from setrl.verify.checker.loop import _action
from setrl.verify.checker.program import ball
from setrl.verify.checker.taylor import evaluate, solve

BITS, SUBSTEPS = 96, 6
"""Precision of what is shown; steps of the float integration per claimed step."""


def falsity(question: Question, given: Certificate, honest: Certificate | None = None) -> str:
    """What is false about a certificate's leaves, its cover and its header's numbers.

    Parameters
    ----------
    question : Question
    given : Certificate
    honest : Certificate, optional
        One whose claims are true: those that it shares are not looked at again.
    """
    with ctx.workprec(BITS), np.errstate(all="ignore"):
        tree = tuple(None if node is None else (node[0], F(node[1])) for node in given.header["tree"])
        boxes = leaf_boxes(tree, question.contract.initial)
        for position, (leaf, box) in enumerate(zip(given.leaves, boxes, strict=True)):
            if problem := _false_start(question, leaf, box):
                return f"leaf {position}: {problem}"
            known = _claims(honest.leaves[position]) if honest and position < len(honest.leaves) else []
            tracked = unboxed(leaf.center, leaf.rows, leaf.radius)
            for number, claim in enumerate(_claims(leaf)):
                if claim not in known[number : number + 1] and (
                    problem := false_in_period(question, leaf, number, tracked)
                ):
                    return f"leaf {position}: {problem}"
                if number + 1 < len(leaf.periods):
                    tracked = next_tracked(question, tracked, leaf.periods[number])
        return false_header(question, given.header, None if honest is None else honest.header)


def _claims(leaf: Leaf) -> list[Any]:
    """Per period what is claimed about it, the set before it included; everything else is a hint."""
    found: list[Any] = []
    before: Any = (leaf.center, leaf.rows, leaf.radius)
    for period in leaf.periods:
        steps = tuple((step.kept, step.start_radius, step.end) for step in period.steps)
        forces = leaf.disturbance_center, leaf.disturbance_spread
        found.append((before, period.seen, period.action, steps, period.kept, period.radius, forces))
        last = period.steps[-1].end
        # what of the period before is left in its next set
        before = (before[0], before[1], last, period.kept, period.radius, period.action)
    return found


def _false_start(question: Question, leaf: Leaf, box: Any) -> str:
    """The start's hull, and the disturbances' ranges, in rationals."""
    contract, layout = question.contract, question.setting.layout
    held = [contract.disturbances[i].bounds for i in layout.constant]
    held += [(value, value) for _ in range(layout.delay) for value in contract.delayed_action]
    for i, (low, high) in enumerate([*box, *held]):
        reach = sum((abs(F(row[i])) for row in leaf.rows), F(leaf.radius[i]))
        if leaf.radius[i] < 0.0 or F(leaf.center[i]) - reach > low or F(leaf.center[i]) + reach < high:
            return "the start does not contain the initial box"
    for place, i in enumerate(layout.varying):
        low, high = contract.disturbances[i].bounds
        center, spread = F(leaf.disturbance_center[place]), F(leaf.disturbance_spread[place])
        if center - spread > low or center + spread < high:
            return "a disturbance is outside its claimed range"
    return ""


# Periods ----------------------------------------------------------------------------------------------------------


def false_in_period(question: Question, leaf: Leaf, number: int, tracked: Affine) -> str:
    """What is false about one period: its actions, the ends of its steps, its link."""
    layout, period = question.setting.layout, leaf.periods[number]
    generator = np.random.default_rng([question.seed, number])
    states = Affine(tracked.center[: layout.states], tracked.rows[:, : layout.states], tracked.own, tracked.box)
    with np.errstate(all="ignore"):
        if period.seen is not None and _false_observation(question, states, period.seen, generator):
            return f"period {number}: an observation is not in the claimed set"
        if _false_action(question, states, period, generator):
            return f"period {number}: an action is not in the claimed set"
        joint = _joint(question, leaf, period, tracked)
        begin, before = joint, None
        for position, step in enumerate(period.steps):
            if before is not None and step.start_radius is not None:
                rows = np.concatenate([before.rows, before.own])
                chosen = [*range(len(joint.rows)), *(len(joint.rows) + i for i in step.kept)]
                if _dropped_too_much(rows, chosen, before.box, step.start_radius):
                    return f"period {number}, step {position}: the start has no room for what was dropped"
                begin = _later_start(joint, before, rows[chosen], step.start_radius, layout.states)
            end = Affine.of(step.end.center, step.end.rows, step.end.fresh, step.end.radius)
            if (end.box < 0.0).any():
                return f"period {number}, step {position}: a half-width is negative"
            if _false_end(question, begin, end, len(period.steps), generator):
                return f"period {number}, step {position}: a state is not in the claimed end"
            before = end
    if period.kept is not None and period.radius is not None:
        _, rows, boxed = _linked(question, tracked, period)
        if _dropped_too_much(rows, period.kept, boxed, period.radius):
            return f"period {number}: the next set has no room for what was dropped"
    return ""


def _linked(question: Question, tracked: Affine, period: PeriodClaim) -> tuple[Array, Array, Array]:
    """Center, rows and box of the tracked coordinates at the end of a period, before anything is dropped."""
    layout, end, action = question.setting.layout, period.steps[-1].end, period.action
    states, inputs, count = layout.states, layout.inputs, len(tracked.rows)
    first, last = states + len(layout.constant), layout.tracked - inputs
    found = np.array([*end.rows, *end.fresh], float).reshape(-1, states)
    rows, center = np.zeros((len(found), layout.tracked)), tracked.center.copy()
    rows[:, :states], center[:states] = found, end.center
    rows[:count, states:first] = tracked.rows[:, states:first]
    if layout.delay:
        rows[:count, first:last], center[first:last] = tracked.rows[:, first + inputs :], center[first + inputs :]
        computed = np.concatenate([np.array(action.rows, float).reshape(-1, inputs), *_private(period, inputs)])
        rows[: len(computed), last:], center[last:] = computed, action.center
    return center, rows, np.array([*end.radius, *([0.0] * (layout.tracked - states))])


def next_tracked(question: Question, tracked: Affine, period: PeriodClaim) -> Affine:
    """The claimed tracked set of the next period."""
    center, rows, _ = _linked(question, tracked, period)
    return unboxed(center, rows[list(period.kept or ())], period.radius)


def _private(period: PeriodClaim, inputs: int) -> list[Array]:
    return [np.array(period.action.private, float).reshape(-1, inputs), np.diag(np.array(period.action.box, float))]


def _dropped_too_much(rows: Array, kept: Sequence[int], box: Array, room: Sequence[float]) -> bool:
    """Sums of the dropped rows and the box, in rationals."""
    dropped = [row.tolist() for i, row in enumerate(rows) if i not in set(kept)]
    return any(sum((abs(F(row[i])) for row in dropped), F(float(r))) > F(room[i]) for i, r in enumerate(box))


def _false_observation(question: Question, states: Affine, seen: SetClaim, generator: Any) -> bool:
    """What the policy sees without perturbation, against the claimed rows of the same factors."""
    claim = Affine.of(seen.center, seen.rows, seen.fresh, seen.radius)

    def prove(factors: list[F]) -> Any:
        return evaluate(question.observe, [ball(x) for x in exact_point(states, factors)])

    return judge(claim, states, lambda points: observe(question.loop, points), prove, generator, len(states.rows))


def _false_action(question: Question, states: Affine, period: PeriodClaim, generator: Any) -> bool:
    """The policy's action at exact states and perturbations, against the claimed rows of the same factors."""
    action = period.action
    claim = Affine.of(action.center, action.rows, action.private, action.box)
    if (claim.box < 0.0).any():
        return True
    radius = [F(r) for r in question.contract.radius]
    size = len(states.rows) + len(radius)
    lifted = Affine(
        np.concatenate([states.center, np.zeros(len(radius))]),
        np.zeros((size, states.center.size + len(radius))),
        states.own,
        states.box,
    )
    lifted.rows[: len(states.rows), : states.center.size] = states.rows
    lifted.rows[len(states.rows) :, states.center.size :] = np.diag([float(r) for r in radius])

    def image(points: Array) -> Array:
        seen = observe(question.loop, points[:, : states.center.size])
        return act(question.loop, seen + points[:, states.center.size :])

    def prove(factors: list[F]) -> Any:
        start = exact_point(states, factors[: len(states.rows)])
        noise = [f * r for f, r in zip(factors[len(states.rows) :], radius, strict=True)]
        return _action(question.contract, question.network, question.observe, [ball(x) for x in start], tuple(noise))

    return judge(claim, lifted, image, prove, generator, len(states.rows))


def _joint(question: Question, leaf: Leaf, period: PeriodClaim, tracked: Affine) -> Affine:
    """States, actions and disturbances: the tracked set's rows, the action's own ones, the disturbances'."""
    layout, contract = question.setting.layout, question.contract
    states, inputs, first = layout.states, layout.inputs, layout.states + len(layout.constant)
    forces, private = len(contract.disturbances), np.concatenate(_private(period, layout.inputs))
    size = states + inputs + forces
    rows = np.zeros((len(tracked.rows) + len(private) + len(layout.varying), size))
    center = np.zeros(size)
    rows[: len(tracked.rows), :states], center[:states] = tracked.rows[:, :states], tracked.center[:states]
    given = slice(states, states + inputs)
    if layout.delay:
        rows[: len(tracked.rows), given] = tracked.rows[:, first : first + inputs]
        center[given] = tracked.center[first : first + inputs]
    else:
        rows[: len(tracked.rows), given], center[given] = period.action.rows, period.action.center
        rows[len(tracked.rows) : len(tracked.rows) + len(private), given] = private
    for place, i in enumerate(layout.constant):
        rows[: len(tracked.rows), states + inputs + i] = tracked.rows[:, states + place]
        center[states + inputs + i] = tracked.center[states + place]
    for place, i in enumerate(layout.varying):
        rows[len(tracked.rows) + len(private) + place, states + inputs + i] = leaf.disturbance_spread[place]
        center[states + inputs + i] = leaf.disturbance_center[place]
    return Affine.of(center, rows, (), np.zeros(size))


def _later_start(joint: Affine, before: Affine, rows: Array, radius: Sequence[float], states: int) -> Affine:
    """The start of a later step: kept rows first, then its box."""
    count, held = len(joint.rows), joint.center.size - states
    tail = np.concatenate([joint.rows[:, states:], np.zeros((len(rows) - count, held))])
    whole = np.concatenate([rows, tail], 1)
    return unboxed([*before.center, *joint.center[states:]], whole, [*radius, *([0.0] * held)])


def _false_end(question: Question, start: Affine, end: Affine, steps: int, generator: Any) -> bool:
    """The plant's own solution from exact points, inputs and disturbances held."""
    layout, field = question.setting.layout, question.setting.field
    states, inputs = layout.states, layout.inputs
    duration = layout.period / steps

    def image(points: Array) -> Array:
        state, action, force = points[:, :states], points[:, states : states + inputs], points[:, states + inputs :]
        if layout.discrete:
            return derivative(question.loop, state, action, force)
        h = float(duration) / SUBSTEPS
        for _ in range(SUBSTEPS):
            k1 = derivative(question.loop, state, action, force)
            k2 = derivative(question.loop, state + h / 2 * k1, action, force)
            k3 = derivative(question.loop, state + h / 2 * k2, action, force)
            k4 = derivative(question.loop, state + h * k3, action, force)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        return state

    def prove(factors: list[F]) -> Any:
        point = [ball(x) for x in exact_point(start, factors)]
        if layout.discrete:
            return evaluate(field, point)
        solution = solve(field, point[:states], point[states:], duration)
        return None if solution is None else solution[1]

    return judge(end, start, image, prove, generator, len(end.rows))
