"""The claims of a period as queries: is there an observation of the set whose action is outside the claimed set?

The claimed set of actions ``a_c + R b + private rows + box`` has two consequences that a query can ask for:

- *interval*: every action lies within ``a_c +- (sum |R| + sum |private| + box)``;
- *relative*: every action minus ``R b``, the same b, lies within ``a_c +- (sum |private| + box)``. This is what the
  certificate needs; the interval follows from it.

A bound is moved outward by what the written network may differ from the exact one, and a little beyond it to a decimal.
So a certificate that is right has queries that are unsatisfiable in exact arithmetic, and an unsatisfiable query proves
the claim to within twice that difference.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

from ...specs.queries import Case, LinearConstraint, Query
from ...specs.specification import Bounds
from .exact import decimal_above
from .period_network import TRACKED, PeriodNetwork

INTERVAL, RELATIVE = "interval", "relative"
SIDES = {"lower": -1, "upper": 1}


@dataclass(frozen=True)
class ActionQuery:
    """One bound of one action.

    Attributes
    ----------
    form : {"interval", "relative"}
    output : int
        Which action.
    side : {"lower", "upper"}
    claimed : Fraction
        The bound that the certificate claims of the exact network, exact.
    rounding : Fraction
        By how much the written network may differ; with `relative` also what is rounded in the rows.
    bound : Fraction
        The bound of the query: beyond ``claimed +- rounding``.
    query : Query
        The violation.
    """

    form: str
    output: int
    side: str
    claimed: Fraction
    rounding: Fraction
    bound: Fraction
    query: Query


def action_queries(network: PeriodNetwork, form: str = INTERVAL, what: str = "") -> Iterator[ActionQuery]:
    """Two queries per action.

    Parameters
    ----------
    network : PeriodNetwork
    form : {"interval", "relative"}
    what : str
        Where the period comes from, for the comment.

    Yields
    ------
    ActionQuery
        Actions in the plant's order; the lower bound first.
    """
    box = tuple(Bounds(Fraction(-1), Fraction(1)) for _ in network.factors)
    outputs = len(network.action.center)
    for output in range(outputs):
        rows, rest, moved = _parts(network, output, form)
        rounding = network.rounding[output] + moved
        for side, sign in SIDES.items():
            claimed = Fraction(network.action.center[output]) + sign * rest
            beyond = decimal_above(sign * claimed + rounding, strictly=True)
            # sign * (y - rows b) >= beyond
            terms = tuple((index, sign * row) for index, row in rows)
            violation = LinearConstraint(terms, ((output, Fraction(-sign)),), -beyond)
            comment = (
                f"{what}\n" if what else ""
            ) + f"action {output}, {side} bound, {form} form; unsat: no action is beyond it"
            query = Query((1, len(box)), (1, outputs), (Case(box, (violation,)),), comment)
            yield ActionQuery(form, output, side, claimed, rounding, sign * beyond, query)


def _parts(network: PeriodNetwork, output: int, form: str) -> tuple[list[tuple[int, Fraction]], Fraction, Fraction]:
    """Rows that stay in the query by input, the half-width of the rest, and what rounding the rows moves."""
    action = network.action
    rest = Fraction(action.box[output]) + sum((abs(Fraction(row[output])) for row in action.private), Fraction(0))
    if form == INTERVAL:
        return [], rest + sum((abs(Fraction(row[output])) for row in action.rows), Fraction(0)), Fraction(0)
    inputs = {factor.position: index for index, factor in enumerate(network.factors) if factor.kind == TRACKED}
    rows, moved = [], Fraction(0)
    for position, row in enumerate(action.rows):
        number = Fraction(row[output])
        if position not in inputs:  # the observation does not move with it
            rest += abs(number)
        elif number:
            written = decimal_above(number)
            moved += abs(written - number)
            rows.append((inputs[position], written))
    return sorted(rows), rest, moved
