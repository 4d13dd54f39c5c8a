"""What one step of an unrolled loop leaves out, as boxes.

Over a period of length h, with the time-Taylor coefficients phi_j of the plant and phi_K over a box B that contains
every trajectory during the period:

    x(t) in sum_(j<K) phi_j(x, u, d) t^j + phi_K(B) t^K,    0 <= t <= h.

B comes from the certificate: its tracked sets contain the states at the start of every period, its claimed sets of
actions what acts. The sum is written with rounded constants and a rounded controller; what that changes is added.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from flint import arb, ctx

from ...specs.errors import InputError
from ...specs.specification import Bounds
from ..checker.image import Start, box_of
from ..checker.jets import flow_jets
from ..checker.layout import observation_program
from ..checker.leaf import ActionClaim, PeriodClaim
from ..checker.program import Program, ball
from ..checker.rejection import Rejected
from ..checker.step import a_priori
from ..checker.taylor import between
from .exact import at_least, at_most, decimal_above, decimal_below
from .period_network import PRECISION, Controller
from .rounding_bounds import Known, RoundingBounds
from .series import Term, Terms, flow_series, map_values
from .sources import Source
from .tracked import tracked_sets
from .written import network_error


@dataclass(frozen=True)
class Remainder:
    """Boxes of one period, one entry per state; None where nothing is left out.

    Attributes
    ----------
    end : tuple of Bounds or None
        What is added to the polynomial at the end of the period.
    during : tuple of Bounds or None
        At any time of the period.
    """

    end: tuple[Bounds | None, ...]
    during: tuple[Bounds | None, ...]


def step_values(
    program: Program, terms: Terms[Any], point: Sequence[Term], source: Source, order: int, share: Term
) -> list[Term]:
    """The polynomial of one period at a share of it: ``sum_(j<=order) phi_j (h share)^j``; discrete plants: the map.

    Parameters
    ----------
    program : Program
        The plant's dynamics.
    terms : Terms
    point : sequence of Term
        States, inputs, disturbances.
    source : Source
    order : int
    share : Term
        From 0 to 1.

    Returns
    -------
    list of Term
        One per state.
    """
    if source.layout.discrete:
        return map_values(program, terms, point)
    rows = flow_series(program, terms, point, order + 1)
    scaled = [[terms.multiply(source.layout.period**j, value) for value in row] for j, row in enumerate(rows)]
    return [terms.polynomial(column, share) for column in zip(*scaled, strict=True)]


def held_terms(source: Source) -> list[Term]:
    """Disturbances that have one value only, as that value; None where they are free."""
    return [low if low == high else None for low, high in (d.bounds for d in source.contract.disturbances)]


def remainders(source: Source, leaf: int, periods: int, order: int) -> Iterator[Remainder]:
    """What the polynomial of degree `order` leaves out, period by period.

    Parameters
    ----------
    source : Source
    leaf : int
    periods : int
        How many, from the first.
    order : int

    Raises
    ------
    InputError
        The remainder has no bound.
    """
    layout, controller = source.layout, Controller.of(source)
    error: Any = [arb(0)] * layout.inputs
    waiting: list[list[Term]] = [list(source.contract.delayed_action) for _ in range(layout.delay)]
    for number, (tracked, claim) in zip(range(periods), tracked_sets(layout, source.leaf(leaf)), strict=False):
        with ctx.workprec(PRECISION):
            states = box_of(Start(tracked.center, tracked.rows, tracked.radius))[: layout.states]
            error = _action_error(source, controller, states)
            actions = [Known(value, e) for value, e in zip(_action_box(claim.action), error, strict=True)]
            waiting.append(list(actions))
            try:
                found = _remainder(source, states, waiting.pop(0), claim, order)
            except Rejected as rejected:
                raise InputError(
                    f"period {number}: what a polynomial of order {order} in time leaves out has no bound: {rejected}",
                    remedy="choose another --map-order, or export the periods without --closed-loop",
                ) from None
        yield found


def _action_box(action: ActionClaim) -> list[Any]:
    """The interval around a claimed set of actions, as balls."""
    rows = [*action.rows, *action.private]
    return box_of(Start(action.center, rows, action.box))


def _action_error(source: Source, controller: Controller, states: Sequence[Any]) -> list[Any]:
    """By how much the written controller's action differs from the exact one's, for one and the same state."""
    program = observation_program(source.contract)
    terms = Terms(RoundingBounds(controller.precision))
    seen = [terms.value(term) for term in map_values(program, terms, [Known(x, arb(0)) for x in states])]
    size = [abs(known.value) + ball(radius) for known, radius in zip(seen, source.radius, strict=True)]
    return network_error(controller.layers, size, [known.error for known in seen])


def _remainder(source: Source, states: list[Any], actions: list[Term], claim: PeriodClaim, order: int) -> Remainder:
    layout, field = source.layout, source.setting.field
    terms = Terms(RoundingBounds(source.network.precision))
    free = [between(*entry.bounds) for entry in source.contract.disturbances]
    fixed = held_terms(source)
    held = [Known(value, arb(0)) if known is None else known for value, known in zip(free, fixed, strict=True)]
    point = [*(Known(x, arb(0)) for x in states), *actions, *held]
    share = Known(between(Fraction(0), Fraction(1)), arb(0))
    moved = [
        [terms.value(term).error.upper() for term in step_values(field, terms, point, source, order, time)]
        for time in (Fraction(1), share)
    ]
    rest = [arb(0)] * layout.states
    if not layout.discrete:
        applied = [known.value if isinstance(known, Known) else ball(known) for known in actions]
        prior = _during(source, states, [*applied, *free], claim)
        last = flow_jets(field, [*prior, *applied, *free], 0, order + 2, ())[order + 1]
        rest = [value * ball(layout.period) ** (order + 1) for (value,) in last]
    end = [_bounds(value + arb(0, error)) for value, error in zip(rest, moved[0], strict=True)]
    during = [_bounds(value.union(arb(0)) + arb(0, error)) for value, error in zip(rest, moved[1], strict=True)]
    return Remainder(tuple(end), tuple(during))


def _during(source: Source, states: list[Any], held: list[Any], claim: PeriodClaim) -> list[Any]:
    """A box that contains the states at every time of a period: the hull of the boxes of its steps."""
    duration = source.layout.period / len(claim.steps)
    start, found = states, None
    for step in claim.steps:
        assert step.prior is not None
        box = a_priori(source.setting.field, [*start, *held], duration, step.prior)
        found = box if found is None else [a.union(b) for a, b in zip(found, box, strict=True)]
        start = box_of(Start(step.end.center, [*step.end.rows, *step.end.fresh], step.end.radius))
    assert found is not None
    return found


def _bounds(value: Any) -> Bounds | None:
    """An interval of decimals around a ball; None for exactly 0."""
    if not bool(value.is_finite()):
        raise Rejected("it is not finite")
    if bool(value.is_zero()):
        return None
    return Bounds(decimal_below(at_least(value)), decimal_above(at_most(value)))
