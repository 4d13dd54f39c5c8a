"""Linear bounds of a network by backward substitution, for a batch of cells, rounding included.

On its range every neuron has a line below its activation f and one above (`backward_lines`). A lower bound ``a y + b``
of something behind the activations, y = f(x), becomes one in front of them: positive entries of a take the line below,
negative ones the line above [1]_. Affine layers are put in. An upper bound is minus a lower bound of minus the same, so
there is only one direction, and one place where lines could be exchanged.

All matrices are floats that are meant exactly. What float64 leaves out when they are multiplied acts on a layer's
input x, |x| <= size; so it is a number, and joins the error of the offset.

References
----------
.. [1] Zhang et al., "Efficient neural network robustness certification with general activation functions", NeurIPS
   2018, Thm. 3.2.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation, Affine, Layer
from . import rounding
from .backward_lines import Lines, image, usual_lines
from .balls import Ball, exact
from .network import LayerBounds, affine_weights
from .zonotope import Zonotope, linear_map, unbox

Array = NDArray[np.float64]
Choice: TypeAlias = Callable[[int, Activation, Array, Array], Lines]
"""Lines of an activation, given its position among the activations and its range."""


@dataclass(frozen=True)
class BackwardBounds:
    """Result of `backward_bounds`: for every x of the inputs and y = network(x),

        lower_matrix x + lower_offset <= y <= upper_matrix x + upper_offset,

    where all four are floats that are meant exactly; rounding is in the offsets.

    Attributes
    ----------
    lower_matrix, upper_matrix : array, shape (B, m, n)
    lower_offset, upper_offset : array, shape (B, m)
        Not finite where nothing is known.
    lines : tuple of Lines, shape (B, k) each
        Of every activation.
    bounds : tuple of LayerBounds
        Input interval of every layer, a little wider than proved, so that whoever computes the same bounds with less
        care for rounding, or more, finds them within.
    output : LayerBounds
        Interval of the output, likewise.
    """

    lower_matrix: Array
    lower_offset: Array
    upper_matrix: Array
    upper_offset: Array
    lines: tuple[Lines, ...]
    bounds: tuple[LayerBounds, ...]
    output: LayerBounds


@dataclass(frozen=True)
class Link:
    """A layer of a `Chain`.

    Attributes
    ----------
    layer : Affine or Lines
    size : int
        Components behind it.
    room : array, shape (B, size)
        What float64 leaves out when a row with a 1 there is moved in front of the layer.
    """

    layer: Affine | Lines
    size: int
    room: Array


class Chain:
    """The layers so far, each affine or between lines.

    Parameters
    ----------
    inputs : Zonotope, shape (B, n)
    """

    def __init__(self, inputs: Zonotope) -> None:
        self.inputs = unbox(inputs) if inputs.radius.any() else inputs
        self.links: list[Link] = []
        self.size = inputs.dimension
        """Components behind the last layer."""
        self.magnitude = inputs.interval.magnitude
        """Upper bound of the magnitude of what is behind the last layer, and of what its lines say, shape (B, size)."""

    def affine(self, layer: Affine) -> LayerBounds:
        """Follow an affine layer; returns the range behind it."""
        weight, bias = affine_weights(layer)
        terms = weight.mid.shape[0]
        carried = self.magnitude @ rounding.sum_error(terms + 2, np.abs(weight.mid)).T
        carried = carried + rounding.sum_error(terms + 2, np.abs(bias.mid)) + bias.rad
        if weight.rad.any():
            carried = carried + self.magnitude @ weight.rad.T
        self.links.append(Link(layer, terms, rounding.enlarged(carried, self.size + 4)))
        self.size = terms
        seen = self.range()
        self.magnitude = np.maximum(np.abs(seen.lower), np.abs(seen.upper))
        return seen

    def between(self, lines: Lines) -> None:
        """Follow an activation between its lines, which hold on the range of what is there."""
        steep, high = lines.steepness * self.magnitude, lines.height
        carried = rounding.relative_error(steep, 2) + rounding.sum_error(self.size + 3, high)
        self.links.append(Link(lines, self.size, rounding.enlarged(carried, 3)))
        self.magnitude = rounding.enlarged(steep + high, 2)

    @property
    def linear(self) -> bool:
        """Whether no activation has been followed."""
        return not any(isinstance(link.layer, Lines) for link in self.links)

    def lower_functions(self, rows: Array, entries: list[Array] | None = None) -> tuple[Array, Ball]:
        """Lower bounds of linear functions of what is behind the last layer, as linear functions of the input.

        Parameters
        ----------
        rows : array, shape (k, size)
        entries : list, optional
            Receives the matrix behind every layer, the last layer's first.

        Returns
        -------
        matrix : array, shape (B, k, n)
        offset : Ball, shape (B, k)
            Every number in it is one of an exact bound, with the rounding of the matrix included.
        """
        batch, count = self.inputs.batch, len(rows)
        matrix: Array = rows[None]  # one for all cells, until lines make them differ
        offset, error = np.zeros((batch, count)), np.zeros((batch, count))
        for link in reversed(self.links):
            if entries is not None:
                entries.append(matrix)
            error = error + _weighted(np.abs(matrix), link.room)
            if isinstance(link.layer, Affine):
                weight, bias = affine_weights(link.layer)
                offset = offset + matrix @ bias.mid
                matrix = (matrix.reshape(-1, link.size) @ weight.mid).reshape(len(matrix), count, -1)
            else:
                lines = link.layer
                positive, negative = np.maximum(matrix, 0.0), np.minimum(matrix, 0.0)
                offset = offset + (_weighted(positive, lines.lower_offset) + _weighted(negative, lines.upper_offset))
                matrix = matrix * np.where(matrix >= 0.0, lines.lower_slope[:, None], lines.upper_slope[:, None])
            error = rounding.enlarged(error + rounding.relative_error(offset, 1), link.size + 4)
        return np.broadcast_to(matrix, (batch, *matrix.shape[1:])), Ball(offset, error)

    def sides(self) -> tuple[tuple[Array, Ball], tuple[Array, Ball]]:
        """Lower and upper bounds of every component: matrices (B, size, n) and offsets (B, size)."""
        rows = np.eye(self.size)
        if self.linear:
            both = self.lower_functions(rows)
            return both, both
        matrix, offset = self.lower_functions(np.concatenate([rows, -rows]))
        below, above = slice(None, self.size), slice(self.size, None)
        return (
            (matrix[:, below], offset[:, below]),
            (-matrix[:, above], Ball(-offset.mid[:, above], offset.rad[:, above])),
        )

    def range(self) -> LayerBounds:
        """An interval of every component behind the last layer, with room for another one's rounding."""
        if not self.links:
            interval = self.inputs.interval
            return LayerBounds(interval.lower, interval.upper)
        lower, upper = self.sides()
        low = linear_map(self.inputs, exact(lower[0]), lower[1])
        high = low if upper is lower else linear_map(self.inputs, exact(upper[0]), upper[1])
        # the inputs have no box: the radius of their image is rounding, and is granted twice more
        return LayerBounds(
            np.asarray(rounding.lower(low.center, rounding.enlarged(low.spread + 2.0 * low.radius, 2))),
            np.asarray(rounding.upper(high.center, rounding.enlarged(high.spread + 2.0 * high.radius, 2))),
        )


def _weighted(rows: Array, column: Array) -> Array:
    """Rows (B, k, n) times one column (B, n) per cell."""
    return (rows @ column[:, :, None])[:, :, 0]


def follow(layers: Sequence[Layer], inputs: Zonotope, choose: Choice) -> tuple[Chain, list[LayerBounds], list[Lines]]:
    """The chain of all layers, the input interval of every layer, and the lines of every activation."""
    chain = Chain(inputs)
    seen, behind = chain.range(), None
    bounds: list[LayerBounds] = []
    lines: list[Lines] = []
    for layer in layers:
        if isinstance(layer, Affine):
            bounds.append(seen if behind is None else LayerBounds(*image(behind, seen.lower, seen.upper)))
            seen, behind = chain.affine(layer), None
            continue
        if behind is not None:
            seen = chain.range()  # of what the lines say: wider than the image, and all that others may know
        bounds.append(seen)
        lines.append(choose(len(lines), layer, seen.lower, seen.upper))
        chain.between(lines[-1])
        behind = layer
    return chain, bounds, lines


def usual(position: int, activation: Activation, low: Array, high: Array) -> Lines:
    """The choice of `usual_lines`, whatever the position."""
    return usual_lines(activation, low, high)


def backward_bounds(layers: Sequence[Layer], inputs: Zonotope, choose: Choice = usual) -> BackwardBounds:
    """Linear bounds of a network on a batch of sets.

    Parameters
    ----------
    layers : sequence of Affine and Activation
    inputs : Zonotope, shape (B, n)
    choose : callable, optional
        ``choose(position, activation, low, high)`` returns the lines of an activation on its range.

    Returns
    -------
    BackwardBounds
        Not finite where the inputs or the lines are not.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        chain, bounds, lines = follow(layers, inputs, choose)
        lower, upper = chain.sides()
        return BackwardBounds(
            lower[0],
            lower[1].lower,
            upper[0],
            upper[1].upper,
            tuple(lines),
            tuple(bounds),
            chain.range(),
        )
