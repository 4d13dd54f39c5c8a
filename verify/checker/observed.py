"""What the policy sees of a set of states, and what a claimed set of actions leaves of linear functions of it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .image import Start, image_of, require_image
from .layout import Layout
from .leaf import BOX, PERTURBATION, PRODUCT, ActionClaim, Products, SetClaim
from .program import Program
from .rejection import Rejected

Vector: TypeAlias = list[Any]
Column: TypeAlias = tuple[tuple[int, int], Vector]
"""Origin of a private factor, as in a claim, and what it adds to every action."""


@dataclass(frozen=True)
class Seen:
    """The set of observations ``center + rows b + box e + noise e'``.

    Attributes
    ----------
    center : list of balls, (o,)
    rows : arb_mat, (o, q)
        One column per factor, the tracked set's first.
    shared : int
        How many of them are the tracked set's; the others are products.
    box, noise : list of balls, (o,)
        Half-widths of rows of one component each: left over by the observation map, perturbation.
    """

    center: Vector
    rows: Any
    shared: int
    box: Vector
    noise: Vector

    def mapped(self, matrix: Any) -> tuple[list[Vector], list[Column]]:
        """The rows behind a linear map (m, o): per output those of the tracked set, and the private columns."""
        mapped, table = (matrix * self.rows).tolist(), matrix.tolist()
        columns: list[Column] = []
        for position in range(self.rows.ncols() - self.shared):
            columns.append(((PRODUCT, position), [row[self.shared + position] for row in mapped]))
        for kind, sizes in ((BOX, self.box), (PERTURBATION, self.noise)):
            for position, size in enumerate(sizes):
                if not size.is_zero():
                    columns.append(((kind, position), [row[position] * size for row in table]))
        return [row[: self.shared] for row in mapped], columns


def observe(
    layout: Layout, program: Program, radius: Vector, states: Start, products: Products | None, claim: SetClaim | None
) -> Seen:
    """What the policy sees of a set of states: plain states, or the claimed set once it contains their image.

    Parameters
    ----------
    layout : Layout
    program : Program
        The observation map.
    radius : list of balls
        Of the observation's perturbation.
    states : Start
        No boxed part.
    products : Products or None
        None where the policy sees plain states.
    claim : SetClaim or None
        The claimed set of observations, where it does not.

    Raises
    ------
    Rejected
        The claimed set is too small, or the observation map is not defined on all of the set.
    """
    count = len(states.rows)
    if layout.observed is not None:
        flat = [row[i] for i in layout.observed for row in states.rows]
        rows = arb_mat(layout.observations, count, flat)
        center = [arb(states.center[i]) for i in layout.observed]
        return Seen(center, rows, count, [arb(0)] * layout.observations, radius)
    assert products is not None and claim is not None
    image = image_of(program, states, products)
    if not all(bool(x.is_finite()) for x in (*image.center, *image.rest)):
        raise Rejected("what the policy sees is not defined on all of the set")
    require_image(image, states, claim, "the set of observations")
    columns = [*claim.rows, *claim.fresh]
    flat = [row[i] for i in range(layout.observations) for row in columns]
    rows = arb_mat(layout.observations, len(columns), flat)
    return Seen([arb(c) for c in claim.center], rows, count, [arb(r) for r in claim.radius], radius)


def left_over(shared: Sequence[Vector], columns: Sequence[Column], claim: ActionClaim, one_sided: bool) -> Vector:
    """What the claimed rows leave of computed ones, per action: differences, and whole columns that are not kept.

    A claimed row that is like no computed one only makes the claimed set larger.

    Parameters
    ----------
    shared : sequence of lists of balls
        Per action, one entry per row of the tracked set.
    columns : sequence of Column
    claim : ActionClaim
    one_sided : bool
        The functions are bounds of one side: then a claimed private row's factor is the computed one's, on both sides.
        Else it may be a share of it, whichever leaves least.

    Returns
    -------
    list of balls
    """
    kept = {origin: row for origin, row in zip(claim.origins, claim.private, strict=True)}
    needed = []
    for i, mapped in enumerate(shared):
        needed.append(sum((abs(x - row[i]) for x, row in zip(mapped, claim.rows, strict=True)), arb(0)))
    for origin, column in columns:
        row = kept.get(origin)
        if row is not None:
            share = arb(1.0 if one_sided else _share(column, row))
            column = [x - share * claimed for x, claimed in zip(column, row, strict=True)]
        needed = [need + abs(x) for need, x in zip(needed, column, strict=True)]
    return needed


def _share(column: Vector, row: Sequence[float]) -> float:
    """How much of a claimed row a column is, from -1 to 1; any such number is sound."""
    largest = max(range(len(row)), key=lambda i: abs(row[i]))
    if not row[largest]:
        return 0.0
    share = float(column[largest].mid()) / row[largest]
    return min(max(share, -1.0), 1.0)
