"""Sets of a certificate as its own floats, and whether what is left out of one fits into a box: in exact integers."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass

from ..leaf import Floats, Row
from ..rejection import Rejected
from .fixed import whole


@dataclass(frozen=True)
class Tracked:
    """center + rows + box."""

    center: Floats
    rows: Sequence[Row]
    radius: Floats

    def in_rows(self) -> Tracked:
        """The same set, each side of the box that has a length as one more row."""
        size = len(self.center)
        sides = [unit(i, r, size) for i, r in enumerate(self.radius) if r != 0.0]
        return Tracked(self.center, [*self.rows, *sides], (0.0,) * size)


def unit(position: int, length: float, size: int) -> Row:
    """A row that moves one coordinate."""
    return (0.0,) * position + (length,) + (0.0,) * (size - position - 1)


def require_room(dropped: Collection[Row], radius: Floats, room: Floats, what: str) -> None:
    """Require ``r_i + sum_dropped |g_i| <= room_i`` in every coordinate, and that no r_i is negative."""
    for i, (r, most) in enumerate(zip(radius, room, strict=True)):
        needed = whole(r) + sum(abs(whole(row[i])) for row in dropped)
        if not (r >= 0.0 and needed <= whole(most)):
            raise Rejected(f"{what}: the rows that are dropped do not fit into the box in coordinate {i}")
