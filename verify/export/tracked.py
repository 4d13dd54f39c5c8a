"""The sets that a certificate follows, period by period: data that the checker has proved, put together again.

See "The sets" in docs/certificate.md; nothing is decided here.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence

from ..checker.image import Start
from ..checker.layout import Layout
from ..checker.leaf import ActionClaim, Leaf, PeriodClaim, Row


def tracked_sets(layout: Layout, leaf: Leaf) -> Iterator[tuple[Start, PeriodClaim]]:
    """The tracked set at the start of every period, its box turned into rows, and what the period claims.

    Parameters
    ----------
    layout : Layout
    leaf : Leaf

    Yields
    ------
    (Start, PeriodClaim)
        Rows of w numbers: states, constant disturbances, waiting actions.
    """
    current = Start(leaf.center, leaf.rows, leaf.radius)
    for period in leaf.periods:
        current = with_box_as_rows(current)
        yield current, period
        if period.kept is not None and period.radius is not None:
            current = _following(layout, current, period)


def with_box_as_rows(given: Start) -> Start:
    """The same set with one row more per half-width that is not 0."""
    size = len(given.center)
    boxed = [unit_row(i, r, size) for i, r in enumerate(given.radius) if r != 0.0]
    return Start(given.center, [*given.rows, *boxed], (0.0,) * size)


def unit_row(position: int, length: float, size: int) -> Row:
    """A row that moves one coordinate."""
    return tuple(length if i == position else 0.0 for i in range(size))


def private_rows(action: ActionClaim) -> list[Row]:
    """Rows of a set of actions that belong to no row of the tracked set; half-widths of the box, zeros included."""
    size = len(action.center)
    return [*action.private, *(unit_row(i, r, size) for i, r in enumerate(action.box))]


def _following(layout: Layout, current: Start, period: PeriodClaim) -> Start:
    """The next tracked set: kept rows of the last end, what does not move, the queue of actions moved up."""
    states, first = layout.states, layout.states + len(layout.constant)
    moved_up = first + layout.inputs
    action, end = period.action, period.steps[-1].end
    computed = [*action.rows, *private_rows(action)]
    rest: list[Row] = []
    for position in range(len(end.rows) + len(end.fresh)):
        old: Sequence[float] = current.rows[position] if position < len(current.rows) else (0.0,) * layout.tracked
        new = computed[position] if position < len(computed) else (0.0,) * layout.inputs
        rest.append((*old[states:first], *((*old[moved_up:], *new) if layout.delay else ())))
    queue = (*current.center[moved_up:], *action.center) if layout.delay else ()
    center = (*end.center, *current.center[states:first], *queue)
    rows = [(*row, *tail) for row, tail in zip((*end.rows, *end.fresh), rest, strict=True)]
    assert period.kept is not None and period.radius is not None
    return Start(center, [rows[i] for i in period.kept], period.radius)
