"""Regions of a specification as they appear in a picture: polygons in a plane, intervals on an axis. For plots only."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundPolytope, ClosedLoop

Array = NDArray[np.float64]


def named_states(loop: ClosedLoop) -> list[int]:
    """Positions of the states that some requirement bounds."""
    used = {
        position
        for requirement in loop.requirements
        for member in requirement.region
        for normal in member.normals
        for position, entry in enumerate(normal)
        if entry
    }
    return sorted(used)


def shown_plane(loop: ClosedLoop) -> tuple[int, int] | None:
    """Positions of the two states that the requirements bound; None where they bound another number of states."""
    named = named_states(loop)
    return (named[0], named[1]) if len(named) == 2 else None


def bounds_only(polytope: BoundPolytope, states: Sequence[int]) -> bool:
    """Whether every facet bounds nothing but the given states: the picture is then the region, not its shadow."""
    return all(not entry or position in states for normal in polytope.normals for position, entry in enumerate(normal))


def polygon(polytope: BoundPolytope, plane: tuple[int, int], view: Array) -> Array:
    """The part of a polytope that is seen, by facets within the plane: corners (k, 2), k = 0 where there is none.

    Parameters
    ----------
    polytope : BoundPolytope
    plane : pair of int
        Positions of the two states.
    view : array, shape (2, 2)
        Lower and upper corner.
    """
    (left, bottom), (right, top) = view
    corners = np.array([[left, bottom], [right, bottom], [right, top], [left, top]])
    for normal, bound in zip(polytope.normals, polytope.bounds, strict=True):
        if bounds_only(BoundPolytope((normal,), (bound,), ("",)), plane):
            corners = _cut(corners, np.array([float(normal[position]) for position in plane]), float(bound))
    return corners


def _cut(corners: Array, normal: Array, bound: float) -> Array:
    """Corners of a convex polygon's part in a halfspace [1]_.

    References
    ----------
    .. [1] Sutherland and Hodgman, "Reentrant polygon clipping", Communications of the ACM 17(1), 1974.
    """
    kept: list[Array] = []
    for current, following in zip(corners, np.roll(corners, -1, axis=0), strict=True):
        here, there = bound - current @ normal, bound - following @ normal
        if here >= 0.0:
            kept.append(current)
        if here * there < 0.0:
            kept.append(current + (following - current) * (here / (here - there)))
    return np.array(kept).reshape(len(kept), 2)


def interval(polytope: BoundPolytope, state: int) -> tuple[float, float]:
    """Bounds of one state by the facets that bound it alone; infinite where there is none."""
    low, high = -np.inf, np.inf
    for normal, bound in zip(polytope.normals, polytope.bounds, strict=True):
        if [position for position, entry in enumerate(normal) if entry] == [state]:
            limit = float(bound / normal[state])
            low, high = (low, min(high, limit)) if normal[state] > 0 else (max(low, limit), high)
    return low, high


def view_of(loop: ClosedLoop, states: Array, flowpipe: Array) -> Array:
    """What to show of every state: the initial set, finite bounds of regions, trajectories, and the flowpipe unless it
    is so much larger that nothing else could be seen.

    Parameters
    ----------
    loop : ClosedLoop
    states : array, shape (..., n)
        Simulated.
    flowpipe : array, shape (..., n)
        Bounds of its boxes; NaN and infinities are ignored.

    Returns
    -------
    array, shape (2, n)
    """
    low = np.array([float(lower) for lower, _ in loop.initial])
    high = np.array([float(upper) for _, upper in loop.initial])
    regions = [member for requirement in loop.requirements for member in requirement.region]
    for position in range(low.size):
        limits = [limit for member in regions for limit in interval(member, position) if np.isfinite(limit)]
        low[position], high[position] = min([low[position], *limits]), max([high[position], *limits])
    low, high = _extended(low, high, states, np.inf)
    low, high = _extended(low, high, flowpipe, 1.0)
    pad = np.where(high > low, 0.06 * (high - low), 1.0)
    return np.stack([low - pad, high + pad])


def _extended(low: Array, high: Array, values: Array, most: float) -> tuple[Array, Array]:
    """Bounds that contain the values too, growing by `most` spans on either side."""
    flat = values.reshape(-1, low.size)
    if not flat.size:
        return low, high
    seen = np.isfinite(flat)
    below = np.where(seen, flat, np.inf).min(axis=0)
    above = np.where(seen, flat, -np.inf).max(axis=0)
    room = np.where(high > low, high - low, np.inf) * most
    return np.minimum(low, np.maximum(below, low - room)), np.maximum(high, np.minimum(above, high + room))
