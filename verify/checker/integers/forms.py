"""A vector as an affine form of named factors: center + columns e + error, every e in [-1, 1], all in fixed point.

Component i is ``center_i + sum_j column_ji e_j``, up to ``error_i``. Operations round centers and columns down; what a
component loses that way, and what its factors do not know about themselves, is added to its error.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from operator import mul
from typing import TypeAlias

from .fixed import Factor, Interval, Matrix, Vector, product_up, shifted_up

Origin: TypeAlias = tuple[int, int]
"""Which factor a column belongs to: a kind, and the position among its kind."""


@dataclass
class Form:
    """An affine form.

    Attributes
    ----------
    center, error : list of int
    columns : dict of Origin to list of int
    fresh : tuple of (kind, first position, list of int) or None
        One more factor per component, each in that component alone; half-widths. They become columns at the next
        operation.
    """

    center: Vector
    error: Vector
    columns: dict[Origin, Vector]
    fresh: tuple[int, int, Vector] | None = field(default=None)

    def spread(self) -> Vector:
        """How far every component can be from its center."""
        total = list(self.error)
        for column in self.columns.values():
            total = [t + abs(x) for t, x in zip(total, column, strict=True)]
        if self.fresh is not None:
            total = [t + x for t, x in zip(total, self.fresh[2], strict=True)]
        return total

    def bounds(self) -> list[Interval]:
        """The enclosing interval of every component."""
        return [(c - s, c + s) for c, s in zip(self.center, self.spread(), strict=True)]

    def settle(self) -> None:
        """Give the fresh factors their columns."""
        if self.fresh is not None:
            kind, first, sizes = self.fresh
            for i, size in enumerate(sizes):
                if size:
                    self.columns[kind, first + i] = [size if k == i else 0 for k in range(len(sizes))]
            self.fresh = None

    def select(self, index: Sequence[int]) -> None:
        """``y_i = x_(index_i)``."""
        self.settle()
        self.center = [self.center[i] for i in index]
        self.error = [self.error[i] for i in index]
        self.columns = {origin: [column[i] for i in index] for origin, column in self.columns.items()}

    def multiply(self, matrix: Matrix, offset: Sequence[Interval]) -> None:
        """``y = W x + b``."""
        rows, places = matrix.rows, matrix.scale
        error = matrix.absolute_times(self.error)
        if matrix.loose is not None:
            size = [abs(c) + s for c, s in zip(self.center, self.spread(), strict=True)]
            more = [shifted_up(sum(map(mul, row, size)), places) for row in matrix.loose]
            error = [e + m for e, m in zip(error, more, strict=True)]
        center = [sum(map(mul, row, self.center)) for row in rows]
        columns = {origin: [sum(map(mul, row, column)) for row in rows] for origin, column in self.columns.items()}
        if self.fresh is not None:
            kind, first, sizes = self.fresh
            for i, half in enumerate(sizes):
                if half:
                    columns[kind, first + i] = [row[i] * half for row in rows]
            self.fresh = None
        self._take(center, columns, [places] * len(rows), error)
        self._move(offset)

    def scale(self, factors: Sequence[Factor], offset: Sequence[Interval]) -> None:
        """``y_i = s_i x_i + b_i``."""
        self.settle()
        error = [product_up(s.absolute, e, s.scale) for s, e in zip(factors, self.error, strict=True)]
        if any(s.loose for s in factors):
            size = [abs(c) + r for c, r in zip(self.center, self.spread(), strict=True)]
            error = [e + shifted_up(s.loose * r, s.scale) for e, s, r in zip(error, factors, size, strict=True)]
        numbers = [s.n for s in factors]
        columns = {origin: list(map(mul, column, numbers)) for origin, column in self.columns.items()}
        self._take(list(map(mul, self.center, numbers)), columns, [s.scale for s in factors], error)
        self._move(offset)

    def _take(self, center: Vector, columns: dict[Origin, Vector], places: list[int], error: Vector) -> None:
        """Round numbers with so many bits too many, by component."""
        masks = [(1 << places_) - 1 for places_ in places]
        lost = [0] * len(center)
        for numbers in (center, *columns.values()):
            lost = [k + 1 if x & mask else k for k, x, mask in zip(lost, numbers, masks, strict=True)]
        self.center = [x >> k for x, k in zip(center, places, strict=True)]
        self.columns = {
            origin: [x >> k for x, k in zip(column, places, strict=True)] for origin, column in columns.items()
        }
        self.error = [e + k for e, k in zip(error, lost, strict=True)]

    def _move(self, offset: Sequence[Interval]) -> None:
        self.center = [c + low for c, (low, _) in zip(self.center, offset, strict=True)]
        self.error = [e + high - low for e, (low, high) in zip(self.error, offset, strict=True)]

    def follow(self, slopes: Sequence[Factor], left: Sequence[Interval], kind: int, first: int) -> None:
        """A function of every component: ``slope_i x_i`` and a fresh factor for what the line leaves."""
        middles = [low + high >> 1 for low, high in left]
        self.scale(slopes, [(middle, middle) for middle in middles])
        sizes = [max(high - m, m - low) for (low, high), m in zip(left, middles, strict=True)]
        self.fresh = kind, first, sizes
