"""The obligations of requirements: sets, known by their supports, are disjoint from a region or inside a member of it.

avoid: with l = C'y for y >= 0, y not 0, ``min_Z l.z > d.y`` proves that Z and {C x <= d} are disjoint. stay, reach:
``min_Z (-C_i).z > -d_i`` for every facet i of one member. Margins are in the unit of the facets: y is divided by its
sum.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .image import Start
from .leaf import Choice
from .program import ball
from .regions import Polytope, Region
from .rejection import Rejected

Least: TypeAlias = Callable[[Sequence[Any]], Any]
"""A set, as the function that bounds ``min direction . z`` over it from below."""


def support_of(start: Start) -> Least:
    """A zonotope with exact numbers as such a function."""

    def least(direction: Sequence[Any]) -> Any:
        middle = sum((a * c for a, c in zip(direction, start.center, strict=True)), arb(0))
        reach = sum((abs(a) * r for a, r in zip(direction, start.radius, strict=True)), arb(0))
        if start.rows:
            rows = arb_mat(len(start.rows), len(start.center), [x for row in start.rows for x in row])
            reach += sum(map(abs, (rows * arb_mat(len(direction), 1, list(direction))).entries()), arb(0))
        return middle - reach

    return least


def margin_of(kind: str, region: Region, choice: Choice | None, least: Least, what: str) -> Any:
    """Prove that a set meets a condition; its margin, a ball.

    Raises
    ------
    Rejected
        The choice proves nothing.
    """
    if kind == "avoid":
        if not isinstance(choice, tuple):
            raise Rejected(f"{what}: nothing separates the set from the region")
        margins = [separation(member, y, least, what) for member, y in zip(region, choice, strict=True)]
    else:
        if not isinstance(choice, int):
            raise Rejected(f"{what}: no member of the region is said to contain the set")
        member = region[choice]
        margins = [least([ball(-c) for c in facet.coefficients]) + ball(facet.bound) for facet in member]
    if not all(bool(margin > 0) for margin in margins):
        raise Rejected(f"{what}: the margin is not proved positive")
    margin = margins[0]
    for other in margins[1:]:
        margin = margin.min(other)
    return margin


def separation(member: Polytope, weights: Sequence[float], least: Least, what: str) -> Any:
    """``(min_Z l.z - d.y)/sum y``, l = C'y."""
    if not (all(weight >= 0.0 for weight in weights) and any(weight > 0.0 for weight in weights)):
        raise Rejected(f"{what}: separating weights are not negative, and not all zero")
    chosen = [(arb(weight), facet) for weight, facet in zip(weights, member, strict=True) if weight]
    scale = sum((weight for weight, _ in chosen), arb(0))
    direction = [arb(0)] * len(member[0].coefficients)
    level = arb(0)
    for weight, facet in chosen:
        share = weight / scale
        direction = [d + share * ball(c) if c else d for d, c in zip(direction, facet.coefficients, strict=True)]
        level += share * ball(facet.bound)
    return least(direction) - level
