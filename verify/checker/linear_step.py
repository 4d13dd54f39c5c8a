"""The flow obligation of one integrator step by conservative linearisation.

With e = z - p, p any point, and B a box that contains p and every solution on [0, h], Taylor's theorem on the segments
from p to the solutions gives ``f(z) = f(p) + J e + l`` with ``l in L = 1/2 e' H e``, J the Jacobian at p, e in B - p
and H the Hessian over B. J is the real matrix within its balls, A its part by the states. With g the center of L and
rho its half-widths, the solutions are linear in the start's deviation d from its center c:

    x(t) in P(t) + DP(t) d +- sum_(k=1..K) t^k |A^(k-1)|/k! rho +- tail,
    P = c + sum_(k=1..K) t^k A^(k-1)/k! (J (c - p) + f(p) + g),
    DP = [I, 0] + sum_(k=1..K) t^k A^(k-1)/k! J.

The tail bounds the terms above K of all three sums. With N = |A| h and q_0 a bound of the terms K together, it is

    sum_(j>=1) q_j,     q_j = N q_(j-1) / (K + j).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import reduce
from typing import Any, TypeAlias

from flint import arb, arb_mat

from . import ranges
from .between import Between, Motion
from .image import Image, Start, box_of, require_image, spread_columns
from .jets import map_jets
from .leaf import Floats, Row, SetClaim, StepClaim
from .polynomials import combine, powers_of
from .program import Program, ball, used_inputs
from .rejection import Rejected
from .step import a_priori
from .taylor import evaluate

Vector: TypeAlias = list[Any]

TAIL_TERMS = 16
"""Terms of a tail that are summed one by one; it decides how tight the bound is, nothing else."""
SHAPE_ITERATIONS = 16
"""Of the vector that bounds the others. Any positive vector that passes the comparison will do."""


@dataclass(frozen=True)
class LinearMotion:
    """A step that was followed: what the sets between its ends need.

    Attributes
    ----------
    motion : Motion
        The linearised solutions up to the power K of time.
    driven : list of lists of balls, (K + 1, n)
        Time coefficients of the half-widths that the linearisation's remainder causes.
    tail : list of balls, (n,)
        Upper bounds of what is above the power K, at every time of the step.
    """

    motion: Motion
    driven: list[Vector]
    tail: Vector

    @property
    def start(self) -> Start:
        """The set at the begin of the step."""
        return self.motion.start

    @property
    def duration(self) -> Fraction:
        """Length of the step."""
        return self.motion.duration

    def between(self, part: int, count: int) -> Between:
        """The set of one of `count` equal parts of the step."""
        linear = self.motion.between(part, count)
        end = powers_of(ball(self.duration * Fraction(part + 1, count)), len(self.driven))
        driven = combine(end, self.driven)
        extra = [a + b + c for a, b, c in zip(linear.extra, driven, self.tail, strict=True)]
        return replace(linear, extra=extra)


def follow_linear(field: Program, start: Start, duration: Fraction, order: int, claim: StepClaim) -> LinearMotion:
    """Follow one step and require that the claimed end contains what came out.

    Parameters
    ----------
    field : Program
        The vector field of the first n coordinates; the others are constant.
    start : Start
        All d coordinates.
    duration : Fraction
    order : int
        K.
    claim : StepClaim
        The rows of ``claim.end.fresh`` are those of a box: one per state, along it.

    Raises
    ------
    Rejected
        No a-priori enclosure was proved, the tail has no bound, or the claimed end is too small.
    """
    assert claim.prior is not None
    box = box_of(start)
    reached = [*a_priori(field, box, duration, claim.prior), *box[len(field.outputs) :]]
    motion = _linearised(field, start, duration, order, reached)
    _require_end(motion, claim.end)
    return motion


def _linearised(field: Program, start: Start, duration: Fraction, order: int, reached: Vector) -> LinearMotion:
    """All solutions of a step, `reached` being a box that contains them; see the module's formula."""
    states, dimension = len(field.outputs), len(start.center)
    spread, longest = start.spread, ball(duration)
    point = _expansion_point(field, start.center, longest)
    domain = [x.union(arb(p)) for x, p in zip(reached, point, strict=True)]
    used = used_inputs(field)
    jets = map_jets(field, [arb(p) for p in point], 1, used)
    hessians = [jet[1 + len(used) :] for jet in map_jets(field, domain, 2, used)]
    rest = _remainder(hessians, [domain[i] - point[i] for i in used])
    jacobian = arb_mat(states, dimension, [x for jet in jets for x in spread_columns(jet[1:], used, dimension)])
    offset = arb_mat(dimension, 1, [arb(c) - p for c, p in zip(start.center, point, strict=True)])
    rate = [j + jet[0] + x.mid() for j, jet, x in zip((jacobian * offset).entries(), jets, rest, strict=True)]
    half = arb_mat(states, 1, [x.rad() for x in rest])
    value = [[arb(c) for c in start.center[:states]]]
    slopes = [[[arb(int(i == j)) for j in range(dimension)] for i in range(states)]]
    driven = [[arb(0)] * states]
    matrix = arb_mat([row[:states] for row in jacobian.tolist()])
    power = arb_mat([row[:states] for row in slopes[0]])
    for k in range(1, order + 1):
        if k > 1:
            power = matrix * power / k
        value.append((power * arb_mat(states, 1, rate)).entries())
        slopes.append((power * jacobian).tolist())
        driven.append((_absolute(power) * half).entries())
    last = [
        (abs(v) + d + sum((abs(x) * a for x, a in zip(row, spread, strict=True)), arb(0))) * longest**order
        for v, d, row in zip(value[order], driven[order], slopes[order], strict=True)
    ]
    tail = _tail(_absolute(matrix) * longest, last, order)
    nothing: list[list[Vector]] = [[[] for _ in range(states)] for _ in value]
    return LinearMotion(
        Motion(start, duration, (), value, slopes, nothing, [arb(0)] * states),
        driven,
        tail,
    )


def _require_end(linear: LinearMotion, end: SetClaim) -> None:
    """Require that a claimed set contains the states at the end of a step."""
    motion, start = linear.motion, linear.start
    powers = powers_of(ball(linear.duration), len(motion.value))
    jacobian = [combine(powers, [row[i] for row in motion.jacobian]) for i in range(len(linear.tail))]
    needed = []
    for row, driven, tail in zip(jacobian, combine(powers, linear.driven), linear.tail, strict=True):
        boxed = sum((abs(x) * r for x, r in zip(row, start.radius, strict=True) if r), arb(0))
        needed.append(boxed + driven + tail)
    # the claimed rows of the remainder are one part of the box that is needed, the claimed half-widths the other
    rest = [need - arb(width) for need, width in zip(needed, _widths(end.fresh), strict=True)]
    fresh = [[arb(x) for x in row] for row in end.fresh]
    image = Image(combine(powers, motion.value), arb_mat(jacobian), fresh, rest)
    require_image(image, start, end, "the end of a step")


def _expansion_point(field: Program, center: Sequence[float], duration: Any) -> Floats:
    """``c + h/2 f(c)`` in the states, c in the rest, near the middle of the step. Any point will do."""
    slope = evaluate(field, [arb(c) for c in center])
    moved = [float((c + duration / 2 * v).mid()) for c, v in zip(center, slope, strict=False)]
    return (*moved, *center[len(moved) :])


def _remainder(hessians: list[Vector], deviation: Vector) -> Vector:
    """``1/2 e' H e`` for every output; upper triangles of H row by row."""
    products = []
    for i, first in enumerate(deviation):
        products.append(ranges.square(first) / 2)
        products += [first * second for second in deviation[i + 1 :]]
    # structural zeros cost nothing
    return [sum((h * e for h, e in zip(row, products, strict=True) if not h.is_zero()), arb(0)) for row in hessians]


def _absolute(matrix: Any) -> Any:
    return arb_mat(matrix.nrows(), matrix.ncols(), [abs(x) for x in matrix.entries()])


def _widths(rows: Sequence[Row]) -> list[float]:
    """Half-widths of a box whose rows were claimed one by one."""
    for i, row in enumerate(rows):
        if any(x != 0.0 for j, x in enumerate(row) if j != i):
            raise Rejected("the rows of a linearisation's remainder are not those of a box")
    return [abs(row[i]) for i, row in enumerate(rows)]


def _tail(rate: Any, last: Vector, order: int) -> Vector:
    """Upper bounds of ``sum_(j>=1) q_j`` with ``q_0 = last`` and ``q_j = N q_(j-1)/(K + j)``, N >= 0.

    m terms are summed. With M = K + m + 1 the rest y is at most ``N (q_m + y)/M``; for s > 0 with
    ``N s <= sigma M s``, sigma < 1, therefore ``y <= max_i (u_i/s_i) / (1 - sigma) s``, u = N q_m/M. Every upper bound
    of y put into the right-hand side is one again: so the bound is 0 where N leads to nothing.

    Parameters
    ----------
    rate : arb_mat, (n, n)
        N.
    last : list of balls, (n,)
    order : int
        K.

    Raises
    ------
    Rejected
        No sigma < 1 was found.
    """
    count = len(last)
    term, total = arb_mat(count, 1, last), arb_mat(count, 1)
    for j in range(1, TAIL_TERMS + 1):
        term = rate * term / (order + j)
        total += term
    following = rate / (order + TAIL_TERMS + 1)
    ones = arb_mat(count, 1, [1] * count)
    shape = ones
    for _ in range(SHAPE_ITERATIONS):
        shape = ones + following * shape * 2
    sigma = reduce(arb.max, (a / s for a, s in zip((following * shape).entries(), shape.entries(), strict=True)))
    if not bool(sigma < 1):
        raise Rejected("the exponential's tail has no bound: the step is too long")
    first = (following * term).entries()
    height = reduce(arb.max, (u / s for u, s in zip(first, shape.entries(), strict=True)))
    rest = shape * (height / (1 - sigma))
    for _ in range(count):
        rest = following * (term + rest)
    return list((total + rest).entries())
