"""The policy backward: linear bounds of the action, with two lines per neuron; whoever chose the lines.

On its range [l, u] every neuron has a line below its activation f and one above,

    m x + c <= f(x) <= M x + C,

so that a linear function of the neurons is bounded by one of what they are functions of: with a+ = max(a, 0) and
a- = min(a, 0), row by row,

    a y + b >= (a+ m + a- M) x + b + a+ c + a- C      for y = f(x), and <= with the lines exchanged,

and so on, layer by layer, to the observation [1]_. The ranges come about in the same way, from the layers before, and a
layer's lines are used only after they were proved on its ranges.

References
----------
.. [1] Zhang et al., "Efficient neural network robustness certification with general activation functions", NeurIPS
   2018, Thm. 3.2.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, TypeAlias

from flint import arb, arb_mat, ctx

from .activation import clip_residual, residual
from .layers import Activation, Dense, Diagonal, Selection
from .leaf import ActionClaim, Floats, TwoLines
from .observed import Seen, left_over
from .rejection import Rejected

Vector: TypeAlias = list[Any]

EXTRA_BITS = 64
"""More than the precision in force, where lines are proved: a float times an end of a range, or times a bend, is exact
then, so that a line through one of them needs no room for rounding."""

ZERO = arb(0)


@dataclass(frozen=True)
class _Line:
    slope: Vector
    offset: Vector


@dataclass(frozen=True)
class _Between:
    """A function of every component, between two lines each."""

    below: _Line
    above: _Line


@dataclass(frozen=True)
class _Side:
    """Linear functions ``matrix x + offset``, all of them lower bounds or all of them upper bounds."""

    matrix: Any
    offset: Vector


_Affine: TypeAlias = Dense | Diagonal | Selection


@dataclass(frozen=True)
class _Link:
    """A layer, and how many components are in front of it."""

    layer: _Affine | _Between
    size: int


class Backward:
    """The layers so far, each affine or between proved lines.

    Parameters
    ----------
    seen : Seen
    lines : sequence of TwoLines
        Of the activations in their order.
    """

    def __init__(self, seen: Seen, lines: Sequence[TwoLines]) -> None:
        self.seen = seen
        self.lines = iter(lines)
        self.chain: list[_Link] = []
        self.size = len(seen.center)
        """Components behind the last layer."""

    def affine(self, layer: _Affine) -> None:
        """Follow an affine layer."""
        self.chain.append(_Link(layer, self.size))
        self.size = len(layer.index) if isinstance(layer, Selection) else len(layer.offset)

    def bounds(self) -> tuple[Vector, Vector]:
        """Ends of a range of every component."""
        lower, upper = self._sides()
        middle, reach = self._middle(lower), self._reach(lower)
        low = [m - s for m, s in zip(middle, reach, strict=True)]
        if upper is not lower:
            middle, reach = self._middle(upper), self._reach(upper)
        return low, [m + s for m, s in zip(middle, reach, strict=True)]

    def activate(self, activation: Activation, low: Vector, high: Vector) -> None:
        """Follow an activation of every component, within bounds, once its claimed lines are proved there.

        Raises
        ------
        Rejected
            A claimed line is not proved.
        """
        lines = next(self.lines)
        ranges = [(a.lower(), b.upper()) for a, b in zip(low, high, strict=True)]
        with ctx.workprec(ctx.prec + EXTRA_BITS):
            for i, ends in enumerate(ranges):
                least, _ = residual(activation, lines.lower_slopes[i], *ends)
                if not bool(arb(lines.lower_offsets[i]) <= least):
                    raise Rejected(f"the lower line of neuron {i} of a {activation.kind} is not proved")
                _, most = residual(activation, lines.upper_slopes[i], *ends)
                if not bool(arb(lines.upper_offsets[i]) >= most):
                    raise Rejected(f"the upper line of neuron {i} of a {activation.kind} is not proved")
        below = _Line(_balls(lines.lower_slopes), _balls(lines.lower_offsets))
        above = _Line(_balls(lines.upper_slopes), _balls(lines.upper_offsets))
        self.chain.append(_Link(_Between(below, above), self.size))

    def clip(self, bounds: Sequence[tuple[Any, Any]], slopes: Floats, low: Vector, high: Vector) -> None:
        """Follow the specification's clip, of what is within [low, high]: two parallel lines, as close as can be."""
        least, most = [], []
        for (bottom, top), slope, a, b in zip(bounds, slopes, low, high, strict=True):
            below, above = clip_residual(bottom, top, arb(slope), a.lower(), b.upper())
            least.append(below)
            most.append(above)
        between = _Between(_Line(_balls(slopes), least), _Line(_balls(slopes), most))
        self.chain.append(_Link(between, self.size))

    def left(self, claim: ActionClaim) -> tuple[Vector, ...]:
        """How far the bounds reach beyond a claimed set, per action: the upper ones above it, the lower ones below."""
        lower, upper = self._sides()
        above = [m - c for m, c in zip(self._middle(upper), claim.center, strict=True)]
        below = [c - m for m, c in zip(self._middle(lower), claim.center, strict=True)]
        return self._beyond(above, upper, claim), self._beyond(below, lower, claim)

    def _beyond(self, middle: Vector, side: _Side, claim: ActionClaim) -> Vector:
        left = left_over(*self.seen.mapped(side.matrix), claim, one_sided=True)
        return [a + b for a, b in zip(middle, left, strict=True)]

    def _sides(self) -> tuple[_Side, _Side]:
        """Lower and upper bounds of the components, as linear functions of the observation."""
        last = self.chain[-1].layer if self.chain else None
        if isinstance(last, Dense):
            lower = upper = _Side(last.arb_matrix, last.arb_offset)
        else:
            lower = upper = _identity(self.size)
        for link in reversed(self.chain[:-1] if isinstance(last, Dense) else self.chain):
            layer = link.layer
            if isinstance(layer, _Between):
                lower, upper = _split(lower, layer.below, layer.above), _split(upper, layer.above, layer.below)
            elif lower is upper:
                lower = upper = _composed(lower, layer, link.size)
            else:
                lower, upper = _composed(lower, layer, link.size), _composed(upper, layer, link.size)
        return lower, upper

    def _middle(self, side: _Side) -> Vector:
        """Values at the center of what is seen."""
        moved = (side.matrix * arb_mat(len(self.seen.center), 1, self.seen.center)).entries()
        return [a + b for a, b in zip(moved, side.offset, strict=True)]

    def _reach(self, side: _Side) -> Vector:
        """How far the values differ from those at the center."""
        seen = self.seen
        reach = [sum(map(abs, row), ZERO) for row in (side.matrix * seen.rows).tolist()]
        own = [b + e for b, e in zip(seen.box, seen.noise, strict=True)]
        if all(r.is_zero() for r in own):
            return reach
        sizes = [[abs(x) * r for x, r in zip(row, own, strict=True)] for row in side.matrix.tolist()]
        return [a + sum(row, ZERO) for a, row in zip(reach, sizes, strict=True)]


def _balls(numbers: Floats) -> Vector:
    return [arb(x) for x in numbers]


def _identity(size: int) -> _Side:
    entries = [arb(int(i == j)) for i in range(size) for j in range(size)]
    return _Side(arb_mat(size, size, entries), [ZERO] * size)


def _composed(side: _Side, layer: _Affine, size: int) -> _Side:
    """Of the layer's output as a function of its input, which has `size` components."""
    rows = len(side.offset)
    if isinstance(layer, Selection):
        chosen = []
        for row in side.matrix.tolist():
            sums = [ZERO] * size
            for x, position in zip(row, layer.index, strict=True):
                sums[position] += x
            chosen += sums
        return _Side(arb_mat(rows, size, chosen), side.offset)
    moved = (side.matrix * arb_mat(len(layer.arb_offset), 1, layer.arb_offset)).entries()
    offset = [a + b for a, b in zip(side.offset, moved, strict=True)]
    if isinstance(layer, Dense):
        return _Side(side.matrix * layer.arb_matrix, offset)
    scaled = [x * s for row in side.matrix.tolist() for x, s in zip(row, layer.arb_scale, strict=True)]
    return _Side(arb_mat(rows, size, scaled), offset)


def _split(side: _Side, positive: _Line, negative: _Line) -> _Side:
    """Positive entries take one line of their component, negative ones the other; ``x = max(x, 0) + min(x, 0)``."""
    lines = []
    for m, c, n, d in zip(positive.slope, positive.offset, negative.slope, negative.offset, strict=True):
        # where both are one line no sign matters; an offset of None is 0
        lines.append((m == n and c == d, m, None if c.is_zero() else c, n, None if d.is_zero() else d))
    entries, offset = [], []
    for row, total in zip(side.matrix.tolist(), side.offset, strict=True):
        for x, (same, m, c, n, d) in zip(row, lines, strict=True):
            if same or x >= ZERO:
                entries.append(x * m)
                total = total if c is None else total + x * c
            elif x <= ZERO:
                entries.append(x * n)
                total = total if d is None else total + x * d
            else:  # a ball on both sides of 0
                up, down = x.max(ZERO), x.min(ZERO)
                entries.append(up * m + down * n)
                total = total if c is None else total + up * c
                total = total if d is None else total + down * d
        offset.append(total)
    return _Side(arb_mat(len(offset), len(lines), entries), offset)
