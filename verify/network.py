"""Enclosure of a policy network on a batch of zonotopes.

Generators keep their identity through the network, so the action set shares its factors with the state set. Each
relaxation error becomes a generator of its own at the next affine layer.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation, Affine, Layer
from . import rounding
from .balls import Ball, exact
from .relaxations import relax
from .zonotope import Zonotope, append_rows, diagonal_rows, linear_map, select_rows

Array = NDArray[np.float64]


@dataclass(frozen=True)
class LayerBounds:
    """What one layer saw: an enclosing interval of its input, lower and upper of shape (B, n)."""

    lower: Array
    upper: Array


@dataclass(frozen=True)
class NetworkEnclosure:
    """Result of `enclose_layers`.

    Attributes
    ----------
    output : Zonotope
        Rows 0 .. q - 1 belong to the input's generators in their order; later rows are private to the network.
    bounds : tuple of LayerBounds
        Input interval of every layer, for the deployed semantics.
    """

    output: Zonotope
    bounds: tuple[LayerBounds, ...]


@lru_cache(maxsize=256)
def affine_weights(layer: Affine) -> tuple[Ball, Ball]:
    """Weight and bias of a layer as balls (the radius is not zero where the file's number is not a float)."""
    weight = exact(layer.weight) if layer.weight_error is None else Ball(layer.weight, layer.weight_error)
    bias = exact(layer.bias) if layer.bias_error is None else Ball(layer.bias, layer.bias_error)
    return weight, bias


def enclose_layers(layers: Sequence[Layer], inputs: Zonotope) -> NetworkEnclosure:
    """Propagate zonotopes through affine layers and activations.

    Parameters
    ----------
    layers : sequence of Affine and Activation
    inputs : Zonotope, shape (B, n)

    Returns
    -------
    NetworkEnclosure
    """
    z = inputs
    errors: Array | None = None
    sums: Array | None = None  # |G| 1, known after an activation
    bounds = []
    for layer in layers:
        if sums is None:
            sums = rounding.absolute_sum(z.generators, -2)
        spread = z.radius + sums if errors is None else z.radius + sums + errors
        spread = rounding.enlarged(spread, 2)
        seen = LayerBounds(rounding.lower(z.center, spread), rounding.upper(z.center, spread))
        bounds.append(seen)
        if isinstance(layer, Affine):
            weight, bias = affine_weights(layer)
            if errors is not None:
                sums = rounding.enlarged(sums + errors, 1)
            z = linear_map(_with_error_rows(z, errors), weight, bias, sums)
            errors = sums = None
        else:
            z, sums, errors = _activate(z, sums, errors, layer, seen)
    return NetworkEnclosure(_with_error_rows(z, errors), tuple(bounds))


def _with_error_rows(z: Zonotope, errors: Array | None) -> Zonotope:
    """Append one generator per neuron whose relaxation is not exact in some cell of the batch."""
    if errors is None:
        return z
    active = np.flatnonzero((errors != 0.0).any(0))
    if active.size == 0:
        return z
    rows = np.zeros((z.batch, active.size, z.dimension))
    rows[:, np.arange(active.size), active] = errors[:, active]
    return append_rows(z, rows)


def _activate(
    z: Zonotope, sums: Array, errors: Array | None, activation: Activation, seen: LayerBounds
) -> tuple[Zonotope, Array, Array]:
    """Apply a relaxation: ``m z + offset`` with its rounding in the radius, and the relaxation errors apart.

    Returns the set, the new upper bound of |G| 1, and the errors; those of an activation directly before this one pass
    through the slope.
    """
    relaxation = relax(activation, seen.lower, seen.upper)
    slope, size = relaxation.slope, np.abs(relaxation.slope)
    scaled = slope * z.center
    center = scaled + relaxation.offset
    generators = z.generators * slope[:, None, :]
    sums = rounding.enlarged(size * sums, 2)
    # a product with 0 or 1 is exact, and then so is adding no offset: stable neurons leave no residue
    rounded = (slope != 0.0) & (slope != 1.0)
    products = rounding.relative_error(sums, 1) + rounding.relative_error(scaled, 1)
    radius = size * z.radius + np.where(rounded, products, 0.0)
    radius = radius + np.where(relaxation.offset == 0.0, 0.0, rounding.relative_error(center, 1))
    radius = np.where(slope == 0.0, np.where(relaxation.offset == 0.0, 0.0, radius), rounding.enlarged(radius, 4))
    new = relaxation.error
    if errors is not None:
        new = rounding.enlarged(new + errors * size, 2)
    return Zonotope(center, generators, radius), sums, new


def merge_rows(z: Zonotope, shared: int, rows: int) -> Zonotope:
    """Merge the private rows of an action set and its radius into few generators, in the low-dimensional action space.

    For one action all private rows are parallel and merge exactly into one. For more, the longest `rows` generators are
    kept and the rest is boxed: n more generators.

    Parameters
    ----------
    z : Zonotope, shape (B, m)
    shared : int
        Number of leading rows that keep their identity.
    rows : int

    Returns
    -------
    Zonotope
        Radius zero.
    """
    private = z.generators[:, shared:]
    if z.dimension > 1 and private.shape[1] > rows:
        scale = rounding.enlarged(np.abs(private).sum(1), private.shape[1])
        size = np.abs(private) / np.where(scale > 0.0, scale, 1.0)[:, None, :]
        kept, mask = select_rows(private, np.argpartition(-(size.sum(-1) - size.max(-1)), rows - 1, axis=1)[:, :rows])
    elif z.dimension > 1:
        kept, mask = private, np.zeros(private.shape[:2], dtype=bool)
    else:
        kept, mask = private[:, :0], np.ones(private.shape[:2], dtype=bool)
    boxed = (np.abs(private) * mask[:, :, None]).sum(1) + z.radius
    boxed = rounding.enlarged(boxed, private.shape[1] + 2)
    generators = np.concatenate([z.generators[:, :shared], kept, diagonal_rows(boxed)], 1)
    return Zonotope(z.center, generators, np.zeros_like(z.radius))
