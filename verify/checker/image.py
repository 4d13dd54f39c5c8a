"""Images of zonotopes under functions known to second order, in ball arithmetic.

The start is ``c + sum_j b_j g_j + diag(r) e`` with |b_j|, |e_i| <= 1, d its deviation from c, and some H in the Hessian
over the start's enclosing box:

    f(c + d) in f(c) + Df(c) d + 1/2 d' H d.

Products b_a b_b of a few chosen rows are formed one by one: with M = G H_m G', H_m the Hessian's midpoints,

    1/2 b' M b in tr M/4 +- (sum_a |M_aa|/4 + sum_(a<b) |M_ab|),

and the pairs that the certificate names keep a row of their own.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from flint import arb, arb_mat

from .jets import map_jets
from .leaf import Products, Row, SetClaim
from .program import Program, used_inputs
from .rejection import require_within

Vector: TypeAlias = list[Any]


@dataclass(frozen=True)
class Start:
    """A set with exact numbers: center, rows, half-widths of the boxed part."""

    center: Sequence[float]
    rows: Sequence[Row]
    radius: Sequence[float]

    @property
    def spread(self) -> list[float]:
        """Upper bounds of ``|G| 1 + r``."""
        columns: Iterable[Any] = zip(*self.rows, strict=True) if self.rows else ((),) * len(self.center)
        return [sum_above([*column, r]) for column, r in zip(columns, self.radius, strict=True)]


@dataclass(frozen=True)
class Image:
    """``center + jacobian d + sum of fresh rows +- rest``.

    Attributes
    ----------
    center : list of balls, (m,)
    jacobian : arb_mat, (m, d)
    fresh : list of lists of balls, one row (m,) per pair
    rest : list of balls, (m,)
        Upper bounds of half-widths.
    """

    center: Vector
    jacobian: Any
    fresh: list[Vector]
    rest: Vector


def sum_above(numbers: Sequence[float]) -> float:
    """A float that is not below the sum of absolute values: `math.fsum` rounds once. Infinite where no float is."""
    try:
        total = math.fsum(map(abs, numbers))
    except OverflowError:
        return math.inf
    return math.nextafter(total, math.inf) if total else 0.0


def box_of(start: Start) -> Vector:
    """The enclosing box, a ball per coordinate."""
    return [arb(c, a) for c, a in zip(start.center, start.spread, strict=True)]


def image_of(program: Program, start: Start, products: Products) -> Image:
    """The image under a program: observation maps, discrete-time plants."""
    used = used_inputs(program)
    center = map_jets(program, [arb(c) for c in start.center], 1, used)
    over_box = map_jets(program, box_of(start), 2, used)
    size = len(used)
    jacobian = [spread_columns(jet[1:], used, len(start.center)) for jet in center]
    hessian = [jet[1 + size :] for jet in over_box]
    return second_order([jet[0] for jet in center], jacobian, hessian, used, start, products)


def spread_columns(row: Vector, used: Sequence[int], dimension: int) -> Vector:
    """A row of a Jacobian by some coordinates as one by all of them."""
    result = [arb(0)] * dimension
    for entry, position in zip(row, used, strict=True):
        result[position] = entry
    return result


def second_order(
    value: Vector, jacobian: list[Vector], hessian: list[Vector], used: Sequence[int], start: Start, products: Products
) -> Image:
    """The image of a set from value and Jacobian at its center and the Hessian over its box.

    Parameters
    ----------
    value : list of balls, (m,)
    jacobian : list of lists of balls, (m, d)
    hessian : list of lists of balls, (m, v (v + 1)/2)
        Upper triangles by the coordinates `used`, row by row.
    used : sequence of int, (v,)
    start : Start
    products : Products
    """
    spread = start.spread
    factors = [[start.rows[j][i] for i in used] for j in products.factors]
    chosen = set(products.factors)
    boxed = [
        sum_above([*(row[i] for j, row in enumerate(start.rows) if j not in chosen), start.radius[i]]) for i in used
    ]
    center, rest = list(value), []
    fresh = [[arb(0)] * len(value) for _ in products.pairs]
    for output, row in enumerate(hessian):
        wide = sum((abs(a) * r for a, r in zip(jacobian[output], start.radius, strict=True) if r), arb(0))
        if not all(entry.is_zero() for entry in row):
            form = _quadratic(row, factors, boxed, [spread[i] for i in used], products)
            center[output] += form.shift
            wide += form.rest
            for position, entry in enumerate(form.kept):
                fresh[position][output] = entry
        rest.append(wide)
    flat = [entry for row in jacobian for entry in row]
    return Image(center, arb_mat(len(value), len(start.center), flat), fresh, rest)


@dataclass(frozen=True)
class _Form:
    shift: Any
    kept: Vector
    rest: Any


def _quadratic(
    packed: Vector, factors: list[list[float]], boxed: list[float], spread: list[float], products: Products
) -> _Form:
    """``1/2 d' H d`` for one output, H packed by the variables of `factors`' columns."""
    size = len(boxed)
    middle = [[arb(0)] * size for _ in range(size)]
    uncertain = arb(0)
    entries = iter(packed)
    for i in range(size):
        for j in range(i, size):
            entry = next(entries)
            middle[i][j] = middle[j][i] = entry.mid()
            uncertain += entry.rad() * spread[i] * spread[j] * (arb(1) / 2 if i == j else 1)
    count = len(factors)
    total, shift, kept = arb(0), arb(0), []
    if count:
        rows = arb_mat(count, size, [x for row in factors for x in row])
        products_of = (rows * arb_mat(size, size, [x for row in middle for x in row]) * rows.transpose()).entries()
        quarter = [products_of[a * count + a] / 4 for a in range(count)]
        shift = sum(quarter, arb(0))
        total = sum(map(abs, quarter), arb(0))
        for a in range(count):
            total += sum(map(abs, products_of[a * count + a + 1 : (a + 1) * count]), arb(0))
        for a, b in products.pairs:
            kept.append(quarter[a] if a == b else products_of[a * count + b])
            total -= abs(kept[-1])
    inner = [sum_above([row[i] for row in factors]) for i in range(size)]
    for i, rho in enumerate(boxed):
        if rho:
            for j in range(size):
                total += rho * abs(middle[i][j]) * (inner[j] + arb(boxed[j]) / 2)
    return _Form(shift, kept, total + uncertain)


def require_image(image: Image, start: Start, claim: SetClaim, what: str) -> None:
    """Require that a claimed set contains an image, row by row.

    ``|center - c'| + sum_j |row_j - g'_j| + rest <= r'``.
    """
    size = len(image.center)
    needed = [abs(c - d) + r for c, d, r in zip(image.center, claim.center, image.rest, strict=True)]
    if start.rows:
        rows = arb_mat(len(start.rows), len(start.center), [x for row in start.rows for x in row])
        mapped = (rows * image.jacobian.transpose()).entries()
        for position, row in enumerate(claim.rows):
            for i, x in enumerate(row):
                needed[i] += abs(mapped[position * size + i] - x)
    for computed, row in zip(image.fresh, claim.fresh, strict=True):
        for i, x in enumerate(row):
            needed[i] += abs(computed[i] - x)
    require_within(needed, claim.radius, what)
