"""Regions of the state space, exact: unions of polytopes, each a list of facets."""

from __future__ import annotations

import re
from dataclasses import dataclass
from fractions import Fraction
from itertools import pairwise
from typing import Any, TypeAlias

from ...specs.errors import SpecificationError
from .documents import mapping, number
from .expressions import affine, parse

_COMPARISON = re.compile(r"<=|>=|==|!=|<|>|=")


@dataclass(frozen=True)
class Facet:
    """The states with ``sum_i coefficients[i] * state_i <= bound``; coefficients in the plant's order."""

    coefficients: tuple[Fraction, ...]
    bound: Fraction


Polytope: TypeAlias = tuple[Facet, ...]
Region: TypeAlias = tuple[Polytope, ...]


def read_region(value: Any, states: tuple[str, ...]) -> Region:
    """A box, a comparison, a list of those (all hold), or ``{union: [...]}`` of any of them."""
    if isinstance(value, dict) and "union" in value:
        parts = mapping(value, ("union",), "region")["union"]
        if not isinstance(parts, list) or not parts:
            raise SpecificationError("a union is a list of parts")
        return tuple(_polytope(part, states) for part in parts)
    return (_polytope(value, states),)


def _polytope(value: Any, states: tuple[str, ...]) -> Polytope:
    facets: list[Facet] = []
    for part in value if isinstance(value, list) else [value]:
        if isinstance(part, dict):
            facets += _box(part, states)
        elif isinstance(part, str):
            facets += _comparisons(str(part), states)
        else:
            raise SpecificationError("a region is made of boxes and comparisons")
    if not facets:
        raise SpecificationError("a region without bounds")
    return tuple(facets)


def _box(value: dict[str, Any], states: tuple[str, ...]) -> list[Facet]:
    facets = []
    for state, pair in mapping(value, states, "box").items():
        if not isinstance(pair, list) or len(pair) != 2:
            raise SpecificationError("a side of a box is [lower, upper]")
        lower, upper = (None if side is None else number(side) for side in pair)
        if (lower is None and upper is None) or (lower is not None and upper is not None and lower > upper):
            raise SpecificationError(f"the side {state} of a box is empty or has no bound")
        if lower is not None:
            facets.append(_facet({state: Fraction(-1)}, -lower, states))
        if upper is not None:
            facets.append(_facet({state: Fraction(1)}, upper, states))
    return facets


def _comparisons(text: str, states: tuple[str, ...]) -> list[Facet]:
    """``x - 3*y <= 4`` or a chain that points one way; sets are closed, so ``<`` is ``<=``."""
    signs = [match.group() for match in _COMPARISON.finditer(text)]
    if not signs or any(sign in ("==", "=", "!=") for sign in signs) or len({sign[0] for sign in signs}) > 1:
        raise SpecificationError(f"a linear comparison is required, found {text[:60]!r}")
    facets = []
    for left, right in pairwise(affine(parse(side)) for side in _COMPARISON.split(text)):
        first, second = (left, right) if signs[0][0] == "<" else (right, left)
        names = {**first[0], **second[0]}
        row = {name: first[0].get(name, Fraction(0)) - second[0].get(name, Fraction(0)) for name in names}
        facets.append(_facet(row, second[1] - first[1], states))
    return facets


def _facet(row: dict[str, Fraction], bound: Fraction, states: tuple[str, ...]) -> Facet:
    row = {name: value for name, value in row.items() if value}
    if not row or not set(row) <= set(states):
        raise SpecificationError("a facet bounds at least one state, and nothing but states")
    return Facet(tuple(row.get(state, Fraction(0)) for state in states), bound)
