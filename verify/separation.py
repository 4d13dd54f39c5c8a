"""Proofs that a batch of zonotopes is disjoint from a polytope, or contained in it.

Disjoint: with l = C'y for some y >= 0, ``min_Z l.z > d.y`` proves Z and {C x <= d} disjoint, for any y whatever its
origin. Contained: ``max_Z C_i.z <= d_i`` for every facet i. Margins are in the unit of the facets (y sums to 1).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundPolytope
from . import rounding
from .balls import Ball, rational_matrix, rationals
from .zonotope import Zonotope

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Facets:
    """A polytope ``{x : C x <= d}`` in floats with the distance from the exact numbers.

    Attributes
    ----------
    normals : Ball, shape (f, n)
    bounds : Ball, shape (f,)
    weights : array, shape (k, f)
        Nonnegative weights of the facets that are tried as separating directions: first the facets themselves, then
        mixtures of two. Rows sum to 1.
    texts : tuple of str
    program_range : float
        A linear program is worth its time only where the best of these directions misses by less than this share of the
        set's spread: in one or two dimensions the mixtures leave at most about a hundredth of it.
    """

    normals: Ball
    bounds: Ball
    weights: Array
    texts: tuple[str, ...]
    program_range: float


MIXTURE_STEPS = 8
"""Directions between two neighbouring facets that are tried before a linear program."""
MIXTURE_FACETS = 12
"""Polytopes with more facets go to the linear program at once."""


def prepare_polytope(polytope: BoundPolytope) -> Facets:
    """Exact polytope to floats, with directions to try."""
    normals, bounds = rational_matrix(polytope.normals), rationals(polytope.bounds)
    count = bounds.mid.size
    rows = []
    if count <= MIXTURE_FACETS:
        for i in range(count):
            for j in range(i + 1, count):
                if not np.allclose(normals.mid[i], -normals.mid[j]):
                    for step in range(1, MIXTURE_STEPS):
                        row = np.zeros(count)
                        row[i], row[j] = step / MIXTURE_STEPS, 1.0 - step / MIXTURE_STEPS
                        rows.append(row)
    weights = np.concatenate([np.eye(count), np.reshape(rows, (-1, count))])
    plane = count <= MIXTURE_FACETS and np.linalg.matrix_rank(normals.mid) <= 2
    return Facets(normals, bounds, weights, polytope.facets, 0.01 if plane else 0.25)


def separation_margins(z: Zonotope, facets: Facets, weights: Array) -> Array:
    """Lower bounds of ``min_Z (C'y).z - d.y`` for given y >= 0; a positive value proves disjointness.

    Parameters
    ----------
    z : Zonotope, shape (B, n)
    facets : Facets
    weights : array, shape (k, f) or (B, k, f)
        Rows y >= 0.

    Returns
    -------
    array, shape (B, k)
    """
    if not (weights >= 0.0).all():
        raise AssertionError("separating weights are not negative")
    count = facets.bounds.mid.size
    direction = weights @ facets.normals.mid
    # the float direction differs from C'y: rounding of this product and of the facets' coefficients
    blur = rounding.enlarged(
        weights @ (facets.normals.rad + rounding.sum_error(count, np.abs(facets.normals.mid))), count + 2
    )
    size = z.interval.magnitude
    slack = (blur @ size[:, :, None])[..., 0] if blur.ndim == 3 else size @ blur.T
    level = weights @ facets.bounds.mid
    level_error = weights @ (facets.bounds.rad + rounding.sum_error(count, np.abs(facets.bounds.mid)))
    above = rounding.upper(level, rounding.enlarged(level_error, count + 2))
    least = -z.support(-direction)
    width = z.dimension + 2
    return rounding.down(rounding.down(least - rounding.enlarged(slack, width)) - above)  # type: ignore[no-any-return]


def containment_margins(z: Zonotope, facets: Facets) -> Array:
    """Lower bounds of ``d_i - max_Z C_i.z`` per facet, shape (B, f); all positive proves containment."""
    size = z.interval.magnitude
    slack = rounding.enlarged(size @ facets.normals.rad.T, z.dimension + 2)
    most = z.support(facets.normals.mid)
    least_bound = rounding.lower(facets.bounds.mid, facets.bounds.rad)
    return rounding.down(rounding.down(least_bound - most) - slack)  # type: ignore[no-any-return]


def facet_separation(z: Zonotope, facets: Facets) -> tuple[Array, NDArray[np.intp]]:
    """Best margin over the facets as directions, and which; shapes (B,)."""
    return _best_separation(z, facets, facets.weights[: facets.bounds.mid.size])


def mixed_separation(z: Zonotope, facets: Facets) -> tuple[Array, NDArray[np.intp]]:
    """Best margin over the facets and their mixtures, and which of ``facets.weights``; shapes (B,)."""
    return _best_separation(z, facets, facets.weights)


def _best_separation(z: Zonotope, facets: Facets, weights: Array) -> tuple[Array, NDArray[np.intp]]:
    margins = separation_margins(z, facets, weights)
    best = margins.argmax(1)
    return np.take_along_axis(margins, best[:, None], 1)[:, 0], best


def program_separation(z: Zonotope, facets: Facets) -> tuple[float, Array]:
    """Best separating direction of one zonotope by linear programming.

    Maximises ``l.c - |G l|_1 - r.|l| - d.y`` over l = C'y, y >= 0, 1.y = 1 (cvxpy, HiGHS). The solver only proposes y;
    the margin is evaluated with rounding bounds afterwards.

    Parameters
    ----------
    z : Zonotope, shape (1, n)
    facets : Facets

    Returns
    -------
    float
        Margin, -inf where the solver failed.
    array, shape (f,)
        y, the evidence.
    """
    count = facets.bounds.mid.size
    problem, parameters, weights = _program(facets.bounds.mid.size, *z.generators.shape[1:])
    parameters["bounds"].value = facets.bounds.mid
    parameters["center"].value = facets.normals.mid @ z.center[0]
    # mapped by the facets' normals beforehand, so that the problem stays linear in its parameters
    parameters["generators"].value = z.generators[0] @ facets.normals.mid.T
    parameters["radius"].value = z.radius[0][:, None] * facets.normals.mid.T
    import cvxpy

    try:
        problem.solve(solver=cvxpy.HIGHS)
    except cvxpy.error.SolverError:
        return -np.inf, np.zeros(count)
    if weights.value is None or not np.isfinite(weights.value).all():
        return -np.inf, np.zeros(count)
    y = np.maximum(np.asarray(weights.value, dtype=np.float64), 0.0)
    return float(separation_margins(z, facets, y[None])[0, 0]), y


@lru_cache(maxsize=32)
def _program(facets: int, generators: int, states: int) -> tuple[Any, dict[str, Any], Any]:
    """The linear program of `program_separation` for given sizes; parameters are filled in before each solve."""
    import cvxpy

    parameters = {
        "bounds": cvxpy.Parameter(facets),
        "center": cvxpy.Parameter(facets),
        "generators": cvxpy.Parameter((generators, facets)),
        "radius": cvxpy.Parameter((states, facets)),
    }
    y = cvxpy.Variable(facets, nonneg=True)
    spread = cvxpy.norm1(parameters["generators"] @ y) + cvxpy.norm1(parameters["radius"] @ y)
    value = parameters["center"] @ y - spread - parameters["bounds"] @ y
    return cvxpy.Problem(cvxpy.Maximize(value), [cvxpy.sum(y) == 1]), parameters, y
