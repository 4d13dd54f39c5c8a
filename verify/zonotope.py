"""Batches of zonotopes with a boxed part, and the linear maps that enclose them.

A `Zonotope` of shape (B, n) is, for every cell, the set ``{ c + sum_j beta_j g_j + diag(r) e }``, beta in [-1, 1]^q,
e in [-1, 1]^n, r >= 0. Generators are rows, so one matrix product maps them all; r collects what is not worth a
generator, rounding included.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from . import rounding
from .balls import Ball

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class Zonotope:
    """A batch of zonotopes.

    Attributes
    ----------
    center : array, shape (B, n)
    generators : array, shape (B, q, n)
        Row j is generator j.
    radius : array, shape (B, n)
        Half-widths of the boxed part, >= 0.
    """

    center: Array
    generators: Array
    radius: Array

    @property
    def batch(self) -> int:
        """Number of cells B."""
        return int(self.center.shape[0])

    @property
    def dimension(self) -> int:
        """Dimension n."""
        return int(self.center.shape[-1])

    def __getitem__(self, index: Any) -> Zonotope:
        """Select cells."""
        return Zonotope(self.center[index], self.generators[index], self.radius[index])

    @property
    def spread(self) -> Array:
        """Upper bound of ``|G| 1 + r``, shape (B, n)."""
        total = np.abs(self.generators).sum(-2) + self.radius
        return rounding.enlarged(total, self.generators.shape[-2] + 1)  # type: ignore[no-any-return]

    @property
    def interval(self) -> Ball:
        """The enclosing interval, center the zonotope's center."""
        return Ball(self.center, self.spread)

    def coordinates(self, index: Any) -> Zonotope:
        """Projection onto some coordinates, exact."""
        return Zonotope(self.center[..., index], self.generators[..., index], self.radius[..., index])

    def support(self, directions: Array) -> Array:
        """Upper bound of ``max l.z`` over the set.

        Parameters
        ----------
        directions : array, shape (k, n) or (B, k, n)

        Returns
        -------
        array, shape (B, k)
        """
        transposed = np.swapaxes(directions, -1, -2)
        magnitude = np.abs(transposed)
        center = self.center[..., None, :] @ transposed
        mapped = np.abs(self.generators @ transposed).sum(-2)
        count, width = self.generators.shape[-2], self.dimension
        absolute = (self.spread + np.abs(self.center))[..., None, :] @ magnitude
        error = rounding.product_error(width, absolute, count + 1)[..., 0, :]
        boxed = (self.radius[..., None, :] @ magnitude)[..., 0, :]
        total = rounding.enlarged(mapped + boxed + error, count + width + 6)
        return rounding.upper(center[..., 0, :], total)  # type: ignore[no-any-return]


def from_box(low: Array, high: Array) -> Zonotope:
    """One generator per coordinate, for boxes ``[low, high]`` of shape (B, n)."""
    center, radius = rounding.center_radius(low, high)
    return Zonotope(center, radius[:, :, None] * np.eye(center.shape[-1]), np.zeros_like(center))


def linear_map(z: Zonotope, weight: Ball, bias: Ball, row_sums: Array | None = None) -> Zonotope:
    """Enclose ``W z + b``.

    Generators map as fl(G W'); the radius takes the boxed part, the rounding of center and generators by row sums
    (never a second matrix product), and the uncertainty of W and b:
    ``r' = |W| (r + g (s + |c|)) + g |b| + rad(W) (s + |c| + r) + rad(b)``, s = |G| 1, g the factor of k + 1 terms.

    Parameters
    ----------
    z : Zonotope, shape (B, n)
    weight : Ball, shape (m, n) or (B, m, n)
    bias : Ball, shape (m,) or (B, m)
    row_sums : array, shape (B, n), optional
        Upper bound of |G| 1 where the caller has it.

    Returns
    -------
    Zonotope, shape (B, m)
    """
    transposed = np.swapaxes(weight.mid, -1, -2)
    absolute = np.abs(transposed)
    generators = z.generators @ transposed
    center = (z.center[:, None, :] @ transposed)[:, 0] + bias.mid
    terms, count = z.dimension, z.generators.shape[-2]
    sums = np.abs(z.generators).sum(-2) if row_sums is None else row_sums
    size = rounding.enlarged(sums + np.abs(z.center), count + 1)
    inner = z.radius + rounding.sum_error(terms + 2, size)
    radius = (inner[:, None, :] @ absolute)[:, 0] + rounding.sum_error(terms + 2, np.abs(bias.mid)) + bias.rad
    if weight.rad.any():
        radius = radius + ((size + z.radius)[:, None, :] @ np.swapaxes(weight.rad, -1, -2))[:, 0]
    return Zonotope(center, generators, rounding.enlarged(radius, terms + 8))


def concatenate(first: Zonotope, second: Zonotope) -> Zonotope:
    """Joint set of two sets that share their generators' factors row by row; missing rows are padded with zero."""
    rows = max(first.generators.shape[-2], second.generators.shape[-2])
    return Zonotope(
        np.concatenate([first.center, second.center], -1),
        np.concatenate([pad_rows(first.generators, rows), pad_rows(second.generators, rows)], -1),
        np.concatenate([first.radius, second.radius], -1),
    )


def pad_rows(generators: Array, rows: int) -> Array:
    """Append zero generators up to a number of rows."""
    missing = rows - generators.shape[-2]
    if missing == 0:
        return generators
    shape = (*generators.shape[:-2], missing, generators.shape[-1])
    return np.concatenate([generators, np.zeros(shape)], -2)


def stack_cells(sets: Sequence[Zonotope]) -> Zonotope:
    """One batch of several: cells one after the other, rows padded to the same number."""
    if len(sets) == 1:
        return sets[0]
    rows = max(z.generators.shape[-2] for z in sets)
    return Zonotope(
        np.concatenate([z.center for z in sets]),
        np.concatenate([pad_rows(z.generators, rows) for z in sets]),
        np.concatenate([z.radius for z in sets]),
    )


def append_rows(z: Zonotope, rows: Array) -> Zonotope:
    """Append generators, shape (B, k, n)."""
    return replace(z, generators=np.concatenate([z.generators, rows], -2))


def diagonal_rows(radius: Array) -> Array:
    """Generators of the box with half-widths `radius`: (B, n) to (B, n, n)."""
    return radius[..., :, None] * np.eye(radius.shape[-1])


def unbox(z: Zonotope) -> Zonotope:
    """Turn the boxed part into generators."""
    return Zonotope(z.center, np.concatenate([z.generators, diagonal_rows(z.radius)], -2), np.zeros_like(z.radius))


def select_rows(rows: Array, chosen: NDArray[np.intp]) -> tuple[Array, NDArray[np.bool_]]:
    """Rows (B, k, n) at positions `chosen` (B, m), and a mask (B, k) of the others."""
    cells = np.arange(rows.shape[0])[:, None]
    mask = np.ones(rows.shape[:2], dtype=bool)
    mask[cells, chosen] = False
    return rows[cells, chosen], mask


def reduce_order(z: Zonotope, protected: int, rows: int, scale: Array) -> tuple[Zonotope, Array, NDArray[np.intp]]:
    """Order reduction: keep the generators that a box would represent worst, box the rest into the radius.

    The score of a generator is ``|g|_1 - |g|_inf`` after division by `scale` (the norms mix units) [1]_.

    Parameters
    ----------
    z : Zonotope, shape (B, n)
    protected : int
        The first rows, which keep their identity (factors of the initial set).
    rows : int
        Number of generators to keep in all; with fewer present, zero rows are appended.
    scale : array, shape (B, n) or (n,)
        Positive scale of each coordinate.

    Returns
    -------
    Zonotope
        With exactly `rows` generators.
    array, shape (B, n)
        What was boxed.
    array of int, shape (B, k), k <= rows
        Positions of the rows that were kept, in order.

    References
    ----------
    .. [1] A. Girard, "Reachability of uncertain linear systems using zonotopes", HSCC 2005, section 3.4.
    """
    generators = z.generators
    count = generators.shape[-2]
    if count <= rows:
        everything = np.broadcast_to(np.arange(count), (z.batch, count))
        return replace(z, generators=pad_rows(generators, rows)), np.zeros_like(z.radius), everything
    free = generators[:, protected:]
    size = np.abs(free)
    scaled = size / scale[..., None, :]
    score = scaled.sum(-1) - scaled.max(-1)
    keep = rows - protected
    order = np.argpartition(-score, keep - 1, axis=1) if keep > 0 else np.argsort(score, axis=1)
    chosen = np.sort(order[:, :keep], axis=1)
    kept, mask = select_rows(free, chosen)
    boxed = rounding.enlarged((size * mask[:, :, None]).sum(1), size.shape[1])
    radius = rounding.enlarged(z.radius + boxed, 1)
    leading = np.broadcast_to(np.arange(protected), (z.batch, protected))
    positions = np.concatenate([leading, protected + chosen], 1)
    return Zonotope(z.center, np.concatenate([generators[:, :protected], kept], 1), radius), boxed, positions
