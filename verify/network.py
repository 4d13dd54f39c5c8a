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

from ..models.policy import Affine, Layer
from . import rounding
from .balls import Ball, exact
from .relaxations import Relaxation, relax
from .zonotope import Zonotope, append_rows, diagonal_rows, linear_map, select_rows

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


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
    relaxations : tuple of Relaxation, shape (B, n) each
        Of every activation.
    origins : array of int, shape (k,)
        Whose relaxation error each row behind the input's is: neurons are counted through all activations in order.
    """

    output: Zonotope
    bounds: tuple[LayerBounds, ...]
    relaxations: tuple[Relaxation, ...]
    origins: Indices


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
    bounds, relaxations, origins = [], [], []
    neurons = 0  # of the activations so far
    for layer in layers:
        if sums is None:
            sums = rounding.absolute_sum(z.generators, -2)
        spread = z.radius + sums if errors is None else z.radius + sums + errors
        spread = rounding.enlarged(spread, 2)
        seen = LayerBounds(rounding.lower(z.center, spread), rounding.upper(z.center, spread))
        bounds.append(seen)
        if errors is not None:
            z, active = _with_error_rows(z, errors)
            origins.append(neurons - z.dimension + active)
            sums = rounding.enlarged(sums + errors, 1)
        if isinstance(layer, Affine):
            z = linear_map(z, *affine_weights(layer), sums)
            errors = sums = None
        else:
            relaxation = relax(layer, seen.lower, seen.upper)
            z, sums, errors = _activate(z, sums, relaxation)
            relaxations.append(relaxation)
            neurons += z.dimension
    if errors is not None:
        z, active = _with_error_rows(z, errors)
        origins.append(neurons - z.dimension + active)
    rows = np.concatenate([np.zeros(0, dtype=np.intp), *origins])
    return NetworkEnclosure(z, tuple(bounds), tuple(relaxations), rows)


def _with_error_rows(z: Zonotope, errors: Array) -> tuple[Zonotope, Indices]:
    """Append one generator per neuron whose relaxation is not exact in some cell of the batch; and which they are."""
    active = np.flatnonzero((errors != 0.0).any(0))
    if active.size == 0:
        return z, active
    rows = np.zeros((z.batch, active.size, z.dimension))
    rows[:, np.arange(active.size), active] = errors[:, active]
    return append_rows(z, rows), active


def _activate(z: Zonotope, sums: Array, relaxation: Relaxation) -> tuple[Zonotope, Array, Array]:
    """Apply a relaxation: ``m z + offset`` with its rounding in the radius, and the relaxation errors apart.

    Returns the set, the new upper bound of |G| 1, and the errors.
    """
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
    return Zonotope(center, generators, radius), sums, relaxation.error


def merge_rows(z: Zonotope, shared: int, rows: int) -> tuple[Zonotope, Indices]:
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
    array of int, shape (B, k)
        Which private rows were kept; n rows that box the others follow them.
    """
    private = z.generators[:, shared:]
    if z.dimension > 1 and private.shape[1] > rows:
        scale = rounding.enlarged(np.abs(private).sum(1), private.shape[1])
        size = np.abs(private) / np.where(scale > 0.0, scale, 1.0)[:, None, :]
        order = np.argpartition(-(size.sum(-1) - size.max(-1)), rows - 1, axis=1)
        chosen = np.sort(order[:, :rows], axis=1)
        kept, mask = select_rows(private, chosen)
    elif z.dimension > 1:
        kept, mask = private, np.zeros(private.shape[:2], dtype=bool)
        chosen = np.broadcast_to(np.arange(private.shape[1]), private.shape[:2])
    else:
        kept, mask = private[:, :0], np.ones(private.shape[:2], dtype=bool)
        chosen = np.zeros((z.batch, 0), dtype=np.intp)
    boxed = (np.abs(private) * mask[:, :, None]).sum(1) + z.radius
    boxed = rounding.enlarged(boxed, private.shape[1] + 2)
    generators = np.concatenate([z.generators[:, :shared], kept, diagonal_rows(boxed)], 1)
    return Zonotope(z.center, generators, np.zeros_like(z.radius)), chosen
