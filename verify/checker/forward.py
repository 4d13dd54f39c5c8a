"""The policy forward: one affine form of the observation for all neurons, with one slope per neuron.

    y = M (o - o_c) + c + sum_k P_k e_k,      e_k the residuals of the activations, each neuron's own factor,

with the slopes of the certificate, whoever chose them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .activation import clip_residual, residual
from .deployment import absolute_matrix
from .layers import Activation, Dense, Diagonal, Selection
from .leaf import CLIPPED, NEURON, ActionClaim, Floats, Lines
from .observed import Column, Seen, left_over
from .rejection import Rejected

Vector: TypeAlias = list[Any]


@dataclass(frozen=True)
class _Part:
    """Rows of one activation's residuals: ``matrix diag(size)``, None for the identity; `layer` has it as its own."""

    matrix: Any
    size: Vector
    layer: Dense | None = None


class Forward:
    """The affine form behind the layers so far.

    Parameters
    ----------
    seen : Seen
    lines : sequence of Lines
        Of the activations in their order.
    """

    def __init__(self, seen: Seen, lines: Sequence[Lines]) -> None:
        self.seen = seen
        self.lines = iter(lines)
        self.center = seen.center
        self.map: Any = None  # None is the identity
        self.parts: list[_Part] = []
        self.slopes: Vector | None = None
        """Of the last activation: still to be applied to `map` and to all parts but the last."""
        self.clipped = False
        """Whether the last part is the specification's clip."""

    def affine(self, layer: Dense | Diagonal | Selection) -> None:
        """Follow an affine layer."""
        match layer:
            case Dense():
                self._dense(layer)
            case Diagonal():
                self._diagonal(layer)
            case Selection():
                self._select(layer)

    def _dense(self, layer: Dense) -> None:
        matrix = product = layer.arb_matrix
        rows, size = len(layer.offset), len(self.center)
        moved = (matrix * arb_mat(size, 1, self.center)).entries()
        self.center = [y + b for y, b in zip(moved, layer.arb_offset, strict=True)]
        if self.slopes is not None:  # on the rows of what is there, or on the columns of the layer: what is less work
            waiting = self.map.ncols() + sum(part.matrix.ncols() for part in self.parts[:-1])
            if waiting < rows:
                self._apply_slopes()
            else:
                columns = [w * s for row in matrix.tolist() for w, s in zip(row, self.slopes, strict=True)]
                product, self.slopes = arb_mat(rows, size, columns), None
        self.map = product if self.map is None else product * self.map
        self.parts = [
            _Part(matrix, part.size, layer) if part.matrix is None else _Part(product * part.matrix, part.size)
            for part in self.parts
        ]

    def _apply_slopes(self) -> None:
        if self.slopes is not None:
            *earlier, last = self.parts
            self.map = _scaled(self.map, self.slopes)
            self.parts = [*(_Part(_scaled(part.matrix, self.slopes), part.size) for part in earlier), last]
            self.slopes = None

    def _settle(self) -> None:
        """Apply the slopes that wait, and give every matrix its entries."""
        self._apply_slopes()
        if self.map is None:
            self.map = _identity(len(self.center))
        self.parts = [
            replace(part, matrix=_identity(len(self.center))) if part.matrix is None else part for part in self.parts
        ]

    def _diagonal(self, layer: Diagonal) -> None:
        self._settle()
        self.center = [s * c + b for s, c, b in zip(layer.arb_scale, self.center, layer.arb_offset, strict=True)]
        if any(scale != 1 for scale in layer.scale):
            self.map = _scaled(self.map, layer.arb_scale)
            self.parts = [_Part(_scaled(part.matrix, layer.arb_scale), part.size) for part in self.parts]

    def _select(self, layer: Selection) -> None:
        self._settle()
        self.center = [self.center[i] for i in layer.index]
        self.map = _selected(self.map, layer.index)
        self.parts = [_Part(_selected(part.matrix, layer.index), part.size) for part in self.parts]

    def bounds(self) -> tuple[Vector, Vector]:
        """Ends of the enclosing interval of every component."""
        if self.slopes is not None:
            self._settle()
        seen, count = self.seen, len(self.center)
        if self.map is None:
            spread = [sum(map(abs, row), arb(0)) for row in seen.rows.tolist()]
            spread = [a + b + e for a, b, e in zip(spread, seen.box, seen.noise, strict=True)]
        else:
            width = seen.rows.ncols()
            entries = (self.map * seen.rows).entries() if width else []
            spread = [sum(map(abs, entries[i * width : (i + 1) * width]), arb(0)) for i in range(count)]
            own = [b + e for b, e in zip(seen.box, seen.noise, strict=True)]
            if any(not bool(x.is_zero()) for x in own):
                table = self.map.tolist()
                spread = [a + _weighted(row, own) for a, row in zip(spread, table, strict=True)]
        for part in self.parts:
            if part.matrix is None:
                spread = [a + e for a, e in zip(spread, part.size, strict=True)]
            elif part.layer is not None:
                more = (absolute_matrix(part.layer) * arb_mat(len(part.size), 1, part.size)).entries()
                spread = [a + b for a, b in zip(spread, more, strict=True)]
            else:
                spread = [a + _weighted(row, part.size) for a, row in zip(spread, part.matrix.tolist(), strict=True)]
        low = [c - s for c, s in zip(self.center, spread, strict=True)]
        return low, [c + s for c, s in zip(self.center, spread, strict=True)]

    def activate(self, activation: Activation, low: Vector, high: Vector) -> None:
        """Follow an activation of every component, within bounds; its residuals become a part of their own.

        Raises
        ------
        Rejected
            A claimed offset and error are not proved.
        """
        self._apply_slopes()
        lines = next(self.lines)
        center, size = [], []
        for i, (slope, c, a, b) in enumerate(zip(lines.slopes, self.center, low, high, strict=True)):
            # a range's ends are balls: thin ones around it lose nothing, wide ones lose the digits of f(x) - slope x
            least, most = residual(activation, slope, a.lower(), b.upper())
            if lines.offsets is not None and lines.errors is not None:
                offset, error = arb(lines.offsets[i]), arb(lines.errors[i])
                if not (bool(offset - error <= least) and bool(most <= offset + error)):
                    raise Rejected(f"the line of neuron {i} of a {activation.kind} is not proved")
                least, most = offset - error, offset + error
            center.append(slope * c + (least + most) / 2)
            size.append(arb(0) if bool(least == 0) and bool(most == 0) else (most - least) / 2)
        self.center = center
        if self.map is None:
            self._settle()
        self.slopes = [arb(slope) for slope in lines.slopes]
        self.parts = [*self.parts, _Part(None, size)]

    def clip(self, bounds: Sequence[tuple[Any, Any]], slopes: Floats, low: Vector, high: Vector) -> None:
        """Follow the specification's clip, of what is within [low, high]; nothing may follow it."""
        center, size = [], []
        for (least, most), slope, c, a, b in zip(bounds, slopes, self.center, low, high, strict=True):
            m = arb(slope)
            below, above = clip_residual(least, most, m, a.lower(), b.upper())
            center.append(m * c + (below + above) / 2)
            size.append((above - below) / 2)
        self._settle()
        self.center, self.clipped = center, True
        self.slopes = [arb(slope) for slope in slopes]
        self.parts = [*self.parts, _Part(None, size)]

    def left(self, claim: ActionClaim) -> tuple[Vector, ...]:
        """What a claimed set leaves of the form, per action; in both directions the same."""
        self._settle()
        shared, columns = self.seen.mapped(self.map)
        neurons = self.parts[:-1] if self.clipped else self.parts
        columns += _columns(NEURON, neurons)
        columns += _columns(CLIPPED, self.parts[len(neurons) :])
        middle = [abs(c - d) for c, d in zip(self.center, claim.center, strict=True)]
        return ([a + b for a, b in zip(middle, left_over(shared, columns, claim, one_sided=False), strict=True)],)


def _columns(kind: int, parts: Sequence[_Part]) -> list[Column]:
    """Columns of the residuals that are not zero, counted through all parts."""
    columns: list[Column] = []
    first = 0
    for part in parts:
        rows = part.matrix.tolist()
        for position, size in enumerate(part.size, first):
            if not size.is_zero():
                columns.append(((kind, position), [row[position - first] * size for row in rows]))
        first += len(part.size)
    return columns


def _identity(size: int) -> Any:
    return arb_mat(size, size, [arb(int(i == j)) for i in range(size) for j in range(size)])


def _weighted(row: Vector, size: Vector) -> Any:
    return sum((abs(x) * e for x, e in zip(row, size, strict=True) if not e.is_zero()), arb(0))


def _scaled(matrix: Any, factors: Vector) -> Any:
    entries = [x * s for row, s in zip(matrix.tolist(), factors, strict=True) for x in row]
    return arb_mat(matrix.nrows(), matrix.ncols(), entries)


def _selected(matrix: Any, index: tuple[int, ...]) -> Any:
    table = matrix.tolist()
    return arb_mat(len(index), matrix.ncols(), [x for i in index for x in table[i]])
