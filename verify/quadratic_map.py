"""Second-order enclosure of a function on a zonotope: value, Jacobian at the center, Hessian over the box.

With d = [G, diag(r)] b and f two times differentiable on the set's enclosing interval:
``f(c + d) in f(c) + Df(c) d + 1/2 d' H d`` for some H in the interval Hessian Hm +- Hr.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import lru_cache
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import rounding
from .balls import Ball
from .zonotope import Zonotope, linear_map, reduce_order

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@lru_cache(maxsize=64)
def _pairs(count: int) -> tuple[Indices, Indices]:
    """Pairs a <= b."""
    first, second = np.triu_indices(count)
    return first.astype(np.intp), second.astype(np.intp)


@lru_cache(maxsize=64)
def _full_index(dimension: int) -> NDArray[np.intp]:
    """Position of (i, j) in the packed upper triangle, shape (d, d)."""
    rows, columns = _pairs(dimension)
    index = np.zeros((dimension, dimension), dtype=np.intp)
    index[rows, columns] = index[columns, rows] = np.arange(rows.size)
    return index


@dataclass(frozen=True)
class Products:
    """Which products of factors were formed one by one, and which of those became generators.

    Attributes
    ----------
    factors : array of int, shape (B, k)
        Rows of the start set; the other rows entered through the boxed part.
    pairs : array of int, shape (B, p, 2)
        Positions in `factors`, one pair per new generator; where nothing is curved there are none.
    """

    factors: Indices
    pairs: Indices

    @classmethod
    def none(cls, batch: int) -> Products:
        """Nothing was formed."""
        return cls(np.zeros((batch, 0), dtype=np.intp), np.zeros((batch, 0, 2), dtype=np.intp))

    def __getitem__(self, cells: Any) -> Products:
        """Of some cells."""
        return Products(self.factors[cells], self.pairs[cells])


def enclose_map(
    value: Ball, jacobian: Ball, hessian: Ball, variables: Indices, z: Zonotope, rows: int
) -> tuple[Zonotope, Array, Products]:
    """Enclose the image of a zonotope under a function known by its second-order expansion.

    Parameters
    ----------
    value : Ball, shape (B, n)
        f at the center.
    jacobian : Ball, shape (B, n, d)
        Df at the center.
    hessian : Ball, shape (B, n, v (v + 1)/2)
        Upper triangle of the Hessian by the `variables`, over the enclosing interval of z.
    variables : array of int, shape (v,)
        Coordinates of z on which f does not depend linearly; the Hessian by the others is zero.
    z : Zonotope, shape (B, d)
    rows : int
        Products of two factors that become generators of the result; the other products are boxed.

    Returns
    -------
    Zonotope, shape (B, n)
        Generators: the q of z in their order, then `rows` new ones.
    array, shape (B, n)
        Half-width of what this map added to the radius.
    Products
        Whose products the new generators are.
    """
    image = linear_map(replace(z, center=np.zeros_like(z.center)), jacobian, value)
    added_rows = np.zeros((z.batch, rows, image.dimension))
    magnitude = hessian.magnitude
    # a structural zero carries rounding terms: too small to be worth products, it is bounded as a whole
    curved = np.asarray((magnitude > NEGLIGIBLE).any((0, 2)))
    added = rounding.checkable(half_quadratic(magnitude, z.spread[:, variables]))
    outputs = np.flatnonzero(curved)
    if not outputs.size:
        generators = np.concatenate([image.generators, added_rows], 1)
        radius = rounding.enlarged(image.radius + added, 1)
        return Zonotope(image.center, generators, radius), added, Products.none(z.batch)
    index = _full_index(variables.size)
    full = Ball(hessian.mid[:, outputs][:, :, index], hessian.rad[:, outputs][:, :, index])
    largest, factors = _largest_rows(z.coordinates(variables))
    shift, new, boxed, pairs = _quadratic_form(full, largest, rows)
    center = image.center.copy()
    center[:, outputs] += shift
    added_rows[:, :, outputs] = new
    boxed = rounding.checkable(boxed)
    added[:, outputs] = rounding.enlarged(boxed + rounding.relative_error(center[:, outputs], 1), 2)
    generators = np.concatenate([image.generators, added_rows], 1)
    radius = rounding.enlarged(image.radius + added, 1)
    return Zonotope(center, generators, radius), added, Products(factors, pairs)


NEGLIGIBLE = 2.0**-600
"""Hessians below this are bounded by 1/2 a' |H| a instead of product by product."""


def half_quadratic(curvature: Array, spread: Array) -> Array:
    """1/2 a' |H| a for packed |H| of shape (..., B, n, d (d + 1)/2): off-diagonal entries count twice."""
    rows, columns = _pairs(spread.shape[1])
    weight = spread[:, rows] * spread[:, columns] * np.where(rows == columns, 0.5, 1.0)
    return rounding.enlarged((curvature @ weight[:, :, None])[..., 0], rows.size + 6)  # type: ignore[no-any-return]


MOST_FACTORS = 24
"""Factors whose products are formed one by one; the others enter the quadratic form through the boxed part."""


def _largest_rows(z: Zonotope) -> tuple[Zonotope, Indices]:
    """The same set with only its largest generators kept, the rest boxed; and which were kept."""
    if z.generators.shape[1] <= MOST_FACTORS:
        return z, np.tile(np.arange(z.generators.shape[1]), (z.batch, 1))
    scale = z.spread
    reduced, _, kept = reduce_order(z, 0, MOST_FACTORS, np.where(scale > 0.0, scale, 1.0))
    return reduced, kept


def _quadratic_form(hessian: Ball, z: Zonotope, rows: int) -> tuple[Array, Array, Array, Indices]:
    """Enclose 1/2 d' H d, d the deviation of z from its center, H of shape (B, m, d, d).

    With M = G Hm G' (rows of G are generators): ``1/2 b' M b in tr M / 4 +- (sum_a |M_aa| / 4 + sum_(a<b) |M_ab|)``.
    The largest products keep a factor of their own; the boxed part e of z adds |e|' |Hm| |G b| + 1/2 |e|' |Hm| |e|,
    and Hr, together with the rounding of M, adds 1/2 a' Hr a.

    Returns
    -------
    tuple of arrays
        Shift of the center (B, m), new generators (B, rows, m), half-width of the rest (B, m), and the pairs of factors
        that the new generators belong to, (B, p, 2).
    """
    generators = z.generators
    count, dimension = generators.shape[1:]
    mapped = generators[:, None] @ hessian.mid @ np.swapaxes(generators, 1, 2)[:, None]
    first, second = _pairs(count)
    products = mapped[:, :, first, second]
    diagonal = first == second
    products[:, :, diagonal] *= 0.25
    size = np.abs(products)
    trace = products[:, :, diagonal]
    shift = trace.sum(-1)
    new = np.zeros((z.batch, rows, products.shape[1]))
    kept = min(rows, size.shape[-1])
    pairs = np.zeros((z.batch, 0, 2), dtype=np.intp)
    total = size.sum(-1)
    if kept:
        score = (size / np.where(total > 0.0, total, 1.0)[:, :, None]).sum(1)
        chosen = np.argpartition(-score, kept - 1, axis=1)[:, :kept]
        cells = np.arange(z.batch)[:, None]
        new[:, :kept] = products[cells, :, chosen]
        size[cells, :, chosen] = 0.0
        total = size.sum(-1)
        pairs = np.stack([first[chosen], second[chosen]], -1)
    boxed = rounding.enlarged(total, size.shape[-1])
    boxed = boxed + rounding.relative_error(np.abs(trace).sum(-1), count + 2)
    # Hessian radius and the rounding of the two products that made M, as one interval matrix
    magnitude = np.abs(hessian.mid)
    uncertain = hessian.rad + rounding.sum_error(2 * dimension + 6, magnitude)
    inner = rounding.enlarged(np.abs(generators).sum(1), count)[:, None, :, None]
    outer = z.radius[:, None, :, None]
    whole = rounding.enlarged(inner + outer, 1)
    row = np.swapaxes
    rest = 0.5 * (row(whole, 2, 3) @ uncertain @ whole)
    if z.radius.any():
        rest = rest + row(outer, 2, 3) @ magnitude @ inner + 0.5 * (row(outer, 2, 3) @ magnitude @ outer)
    rest = rounding.enlarged(rest[:, :, 0, 0], 4 * dimension + 12)
    return shift, new, rounding.enlarged(boxed + rest, 2), pairs
