"""The claims of one leaf, followed from set to set: what each period starts from, is assembled from claims alone.

Where a step ends is proved by the first checker only. Here it is taken as claimed: a link is proved if the next set
contains the claimed end with everything that the tracked coordinates keep, a later step's start the one before's end.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from ..contract import Bounds, Contract
from ..layout import Layout
from ..leaf import PARALLEL, Leaf, PeriodClaim, Row
from ..rejection import Rejected
from .action import Policy, check_action
from .cover import require_inside
from .sets import Tracked, require_room, unit


@dataclass(frozen=True)
class Setting:
    """What all leaves share."""

    contract: Contract
    layout: Layout
    policy: Policy


def follow_leaf(setting: Setting, leaf: Leaf, cell: list[Bounds]) -> int:
    """Prove the start, the sets of actions and the links of one leaf.

    Parameters
    ----------
    setting : Setting
    leaf : Leaf
    cell : list of (lower, upper)
        Of initial states.

    Returns
    -------
    int
        Number of periods whose set of actions was proved: those in which the policy sees plain states and is followed
        with one slope per neuron.

    Raises
    ------
    Rejected
    """
    contract, layout = setting.contract, setting.layout
    held = [contract.disturbances[i].bounds for i in layout.constant]
    held += [(value, value) for _ in range(layout.delay) for value in contract.delayed_action]
    current = Tracked(leaf.center, leaf.rows, leaf.radius)
    require_inside([*cell, *held], current)
    _require_disturbances(setting, leaf)
    covered = 0
    for number, period in enumerate(leaf.periods):
        what = f"period {number}"
        current = current.in_rows()
        if period.form == PARALLEL:
            check_action(setting.policy, current, period, f"{what}: the set of actions")
            covered += 1
        _require_starts(layout, current, period, what)
        if number + 1 < len(leaf.periods):
            current = next_set(layout, current, period, what)
    return covered


def _require_disturbances(setting: Setting, leaf: Leaf) -> None:
    """Ranges of the disturbances that are free in every period."""
    claimed = zip(setting.layout.varying, leaf.disturbance_center, leaf.disturbance_spread, strict=True)
    for i, center, spread in claimed:
        low, high = setting.contract.disturbances[i].bounds
        least, most = Fraction(center) - Fraction(spread), Fraction(center) + Fraction(spread)
        if not (least <= low and high <= most):
            raise Rejected(f"the claimed range of disturbance {i} does not contain its bounds")


def _actions(layout: Layout, period: PeriodClaim) -> list[Row]:
    """Rows of the actions: the tracked set's factors, private ones, the box's."""
    action = period.action
    box = [unit(i, r, layout.inputs) for i, r in enumerate(action.box)]
    return [*action.rows, *action.private, *box]


def _require_starts(layout: Layout, current: Tracked, period: PeriodClaim, what: str) -> None:
    """Every later step keeps the joint set's rows, some of those behind them, and has room for the others."""
    joint = len(_actions(layout, period)) + len(layout.varying)
    assert len(period.action.rows) == len(current.rows)
    for position, step in enumerate(period.steps):
        if position == 0:
            continue
        before = period.steps[position - 1].end
        rows = [*before.rows, *before.fresh]
        kept = {joint + i for i in step.kept}
        dropped = [row for i, row in enumerate(rows) if i >= joint and i not in kept]
        if step.start_radius is None:
            raise Rejected(f"{what}: step {position} has no start")
        require_room(dropped, before.radius, step.start_radius, f"{what}: the start of step {position}")


def next_set(layout: Layout, current: Tracked, period: PeriodClaim, what: str) -> Tracked:
    """The next tracked set: end of the last step, constant disturbances, the queue of actions moved up by one.

    Parameters
    ----------
    layout : Layout
    current : Tracked
        The set at the start of the period, no boxed part.
    period : PeriodClaim
    what : str
        Where, for the message.

    Returns
    -------
    Tracked
        With the claimed box.

    Raises
    ------
    Rejected
        The box has no room for what is left out.
    """
    if period.kept is None or period.radius is None:
        raise Rejected(f"{what}: there is no link to the next set")
    end, inputs, delay = period.steps[-1].end, layout.inputs, layout.delay
    constant = slice(layout.states, layout.states + len(layout.constant))
    queue = slice(constant.stop + inputs, layout.tracked)
    actions = _actions(layout, period)
    nothing, none = (0.0,) * layout.tracked, (0.0,) * inputs
    rows: list[Row] = []
    for position, row in enumerate([*end.rows, *end.fresh]):
        old = current.rows[position] if position < len(current.rows) else nothing
        new = actions[position] if position < len(actions) else none
        rows.append((*row, *old[constant], *((*old[queue], *new) if delay else ())))
    center = (*end.center, *current.center[constant])
    center += (*current.center[queue], *period.action.center) if delay else ()
    kept = set(period.kept)
    dropped = [row for i, row in enumerate(rows) if i not in kept]
    radius = (*end.radius, *((0.0,) * (layout.tracked - layout.states)))
    require_room(dropped, radius, period.radius, f"{what}: the link to the next set")
    return Tracked(center, [row for i, row in enumerate(rows) if i in kept], period.radius)
