"""Layers as they are written into a file, and how far the written network may be from the exact one.

A written layer has numbers W', b' of the file's precision. With ``|v' - v| <= e`` in front of it and ``|v| <= m``:

    |W' v' + b' - (W v + b)| <= |W| e + |W' - W| (m + e) + |b' - b|,

and an activation multiplies e by its largest slope. Both networks are meant in exact arithmetic: the difference is that
of their numbers, not of a runtime.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

import numpy as np
from flint import arb, arb_mat

from ...models import policy as network
from ...specs.errors import InputError
from ..checker import layers as exact
from ..checker.contract import AffineMap, Bounds, Contract
from ..checker.layers import Number
from .exact import rounded

Vector: TypeAlias = list[Any]


@dataclass(frozen=True, eq=False)
class Written:
    """One layer of a file.

    Attributes
    ----------
    exact : checker.layers.Layer
    layer : models.policy.Layer
        With the numbers of the file.
    absolute : arb_mat or None
        |W|; None for an activation, and so are the others.
    offset : list of balls, or None
        |b|.
    matrix_error, offset_error : or None
        |W' - W| and |b' - b|; None where all numbers are exact.
    """

    exact: exact.Layer
    layer: network.Layer
    absolute: Any = None
    offset: Any = None
    matrix_error: Any = None
    offset_error: Any = None

    def through(self, size: Vector, error: Vector) -> tuple[Vector, Vector]:
        """Bounds of ``|v|`` and of ``|v' - v|`` behind the layer from those in front of it."""
        if isinstance(self.layer, network.Activation):
            return _activated(self.layer, size, error)
        spread = _times(self.absolute, error)
        if self.matrix_error is not None:
            whole = [m + e for m, e in zip(size, error, strict=True)]
            spread = [a + b for a, b in zip(spread, _times(self.matrix_error, whole), strict=True)]
        if self.offset_error is not None:
            spread = [a + b for a, b in zip(spread, self.offset_error, strict=True)]
        return [a + b for a, b in zip(_times(self.absolute, size), self.offset, strict=True)], spread


def write_layers(layers: Iterable[exact.Layer], inputs: int, precision: str) -> list[Written]:
    """Layers with the numbers of a precision.

    Parameters
    ----------
    layers : iterable of checker.layers.Layer
    inputs : int
        What the first one takes.
    precision : {"float32", "float64"}

    Returns
    -------
    list of Written

    Raises
    ------
    InputError
        A number is not finite in the precision.
    """
    found, size = [], inputs
    for layer in layers:
        written = _written(layer, size, precision)
        if isinstance(written.layer, network.Affine):
            size = len(written.layer.bias)
        found.append(written)
    return found


def network_error(layers: Sequence[Written], size: Vector, error: Vector) -> Vector:
    """Bounds of the distance between the written chain and the exact one, per output.

    Parameters
    ----------
    layers : sequence of Written
    size, error : lists of balls
        Bounds of what enters, and of how much it differs already.
    """
    for layer in layers:
        size, error = layer.through(size, error)
    return error


def controller_layers(contract: Contract, layers: Sequence[exact.Layer]) -> list[exact.Layer]:
    """What makes actions of observations: the map before the network, the network, the map after it, the clip."""
    before, after = ([] if entry is None else [dense(entry)] for entry in (contract.before, contract.after))
    bounds = [pair for pair in contract.clip if pair is not None]
    return [*before, *layers, *after, *(_clip(bounds) if bounds else [])]


def dense(affine: AffineMap) -> exact.Dense:
    """An affine map of a specification as a layer."""
    return exact.Dense(affine.matrix, affine.offset)


def _clip(bounds: Sequence[Bounds]) -> list[exact.Layer]:
    """``min(max(x, low), high) = high - relu(high - low - relu(x - low))``, for tools that know ReLU only."""
    relu = exact.Activation("relu")
    identity = [[Fraction(int(i == j)) for j in range(len(bounds))] for i in range(len(bounds))]
    plus = tuple(tuple(row) for row in identity)
    minus = tuple(tuple(-entry for entry in row) for row in identity)
    return [
        exact.Dense(plus, tuple(-low for low, _ in bounds)),
        relu,
        exact.Dense(minus, tuple(high - low for low, high in bounds)),
        relu,
        exact.Dense(minus, tuple(high for _, high in bounds)),
    ]


def _written(layer: exact.Layer, size: int, precision: str) -> Written:
    if isinstance(layer, exact.Activation):
        slope, low, high = (rounded(x, precision) for x in (layer.slope, layer.low, layer.high))
        if (slope, low, high) != (layer.slope, layer.low, layer.high):
            raise InputError(f"a number of {layer.kind} is not one of {precision}", remedy="export the policy again")
        return Written(layer, network.Activation(layer.kind, slope, low, high))
    rows, offset = _matrix(layer, size)
    flat = [entry for row in rows for entry in row]
    numbers, constants = ([rounded(x, precision) for x in group] for group in (flat, offset))
    if not all(map(math.isfinite, (*numbers, *constants))):
        raise InputError(f"a number is not finite in {precision}")
    shape = len(rows), size
    return Written(
        layer,
        network.Affine(np.array(numbers).reshape(shape), np.array(constants)),
        arb_mat(*shape, [abs(x) for x in exact.enclosures(flat)]),
        [abs(x) for x in exact.enclosures(offset)],
        None if (moved := _distances(flat, numbers)) is None else arb_mat(*shape, moved),
        _distances(offset, constants),
    )


def _matrix(layer: exact.Layer, size: int) -> tuple[Sequence[Sequence[Number]], Sequence[Number]]:
    """Matrix and offset of a layer that is no activation."""
    match layer:
        case exact.Dense(matrix, offset):
            return matrix, offset
        case exact.Diagonal(scale, offset):
            return [[scale[i] if i == j else 0.0 for j in range(size)] for i in range(size)], offset
        case exact.Selection(index):
            return [[float(i == j) for j in range(size)] for i in index], [0.0] * len(index)
    raise AssertionError(f"unknown layer {layer!r}")


def _distances(numbers: Sequence[Number], written: Sequence[float]) -> Vector | None:
    """Distances between numbers and those that were written for them; None where all are 0."""
    distances = [
        abs(Fraction(a) - Fraction(b)) if a != b else Fraction(0) for a, b in zip(numbers, written, strict=True)
    ]
    return exact.enclosures(distances) if any(distances) else None


def _activated(layer: network.Activation, size: Vector, error: Vector) -> tuple[Vector, Vector]:
    slope = {"sigmoid": 0.25, "leaky_relu": max(1.0, layer.slope)}.get(layer.kind, 1.0)
    match layer.kind:
        case "tanh" | "sigmoid":
            size = [m.min(arb(1)) for m in size]
        case "clip":  # |clip(x)| is at most |x| or that of a bound
            for bound in (layer.lower, layer.upper):
                size = [m.max(arb(abs(bound))) for m in size] if math.isfinite(bound) else size
        case _:
            size = [arb(slope) * m for m in size]
    return size, [arb(slope) * e for e in error]


def _times(matrix: Any, vector: Vector) -> Vector:
    return list((matrix * arb_mat(len(vector), 1, vector)).entries())
