"""Requirements as violations of an unrolled loop: which states it has to compute, and where they must not be."""

from __future__ import annotations

import itertools
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import prod

from ...specs.errors import InputError
from ...specs.queries import Case, LinearConstraint, Query
from ...specs.specification import Bounds
from ..checker.layout import Condition
from ..checker.regions import Facet, Region
from .loop_network import LoopNetwork, Output
from .sources import Source

MOST_CASES = 4096
WHOLE = Bounds(Fraction(0), Fraction(1))


@dataclass(frozen=True)
class Wanted:
    """One violation.

    Attributes
    ----------
    requirement : int
        Position in the specification.
    outputs : tuple of Output
        The states that it is about; one for `avoid` and `stay`, all instants of the window for `reach`.
    share : Bounds
        Of the period, where the state is one during it.
    """

    requirement: int
    outputs: tuple[Output, ...]
    share: Bounds = WHOLE


def wanted_queries(source: Source, periods: int) -> Iterator[Wanted]:
    """All violations that can be seen in the first periods of a run.

    `avoid` and `stay`: one per sampling instant, or one per period where all times of a window count. `reach`: one, if
    the window ends by then.
    """
    layout = source.layout
    length = layout.period
    for number, condition in enumerate(layout.conditions):
        start, end = condition.requirement.start, condition.requirement.end
        if condition.by_points:
            instants = [k for k in range(periods + 1) if start <= k * length <= end]
            outputs: list[Output] = [("at", k) for k in instants]
            if condition.requirement.kind == "reach":
                if outputs and end <= periods * length:
                    yield Wanted(number, tuple(outputs))
            else:
                yield from (Wanted(number, (output,)) for output in outputs)
            continue
        for k in range(periods):
            low, high = max(start / length - k, Fraction(0)), min(end / length - k, Fraction(1))
            # a window that only touches this period has that instant in the next one, or the one before
            if low < high or (low == high and start == end):
                yield Wanted(number, (("during", k),), Bounds(low, high))


def violation(source: Source, wanted: Wanted, network: LoopNetwork, comment: str = "") -> Query:
    """The query to a network that computes what is wanted, and perhaps other states too.

    Parameters
    ----------
    source : Source
    wanted : Wanted
    network : LoopNetwork
    comment : str

    Returns
    -------
    Query

    Raises
    ------
    InputError
        A union of regions needs more than `MOST_CASES` cases.
    """
    size = source.layout.states
    periods = {number for kind, number in wanted.outputs if kind == "during"}
    box = tuple(
        wanted.share if entry.kind == "share" and entry.period in periods else entry.bounds for entry in network.inputs
    )
    condition = source.layout.conditions[wanted.requirement]
    offsets = [size * network.outputs.index(output) for output in wanted.outputs]
    alternatives = _alternatives(condition, offsets)
    cases = tuple(Case(box, tuple(constraints)) for constraints in alternatives)
    return Query((1, len(box)), (1, size * len(network.outputs)), cases, comment)


def _alternatives(condition: Condition, offsets: Sequence[int]) -> list[list[LinearConstraint]]:
    """Conjunctions, one of which holds where the requirement does not."""
    requirement = condition.requirement
    region: Region = requirement.region
    if requirement.kind == "avoid":
        (offset,) = offsets
        return [[_holds(facet, offset) for facet in member] for member in region]
    # outside all members at all instants: one facet of each is violated
    choices = [[_fails(facet, offset) for facet in member] for offset in offsets for member in region]
    if prod(map(len, choices)) > MOST_CASES:
        raise InputError(
            f"the violation of {requirement.name} has more than {MOST_CASES} cases",
            remedy="ask for fewer regions or instants, or export the periods without --closed-loop",
        )
    return [list(chosen) for chosen in itertools.product(*choices)]


def _holds(facet: Facet, offset: int) -> LinearConstraint:
    terms = tuple((offset + i, c) for i, c in enumerate(facet.coefficients) if c)
    return LinearConstraint((), terms, facet.bound)


def _fails(facet: Facet, offset: int) -> LinearConstraint:
    """At or beyond the facet: touching it is counted as a violation too."""
    terms = tuple((offset + i, -c) for i, c in enumerate(facet.coefficients) if c)
    return LinearConstraint((), terms, -facet.bound)
