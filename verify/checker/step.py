"""The flow obligation of one integrator step by 2-jets: a-priori enclosure, Taylor expansion, everything left over.

With the time-Taylor coefficients phi_k of the flow as functions of the start point, P = sum_(k<K) phi_k(c) t^k:

    z(t) in P(c) + DP(c) d + 1/2 d' H d + z_[K](B) t^K,    H the Hessian of P over the start's box,

for every start c + d of the set, where B contains every solution on [0, h]: ``box + [0, h] f(B) within B``.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from typing import Any, TypeAlias

from flint import arb

from .between import Motion
from .image import Image, Start, box_of, require_image, second_order, spread_columns
from .jets import flow_jets
from .leaf import StepClaim
from .polynomials import combine, powers_of
from .program import Program, ball, used_inputs
from .rejection import Rejected
from .taylor import evaluate

Vector: TypeAlias = list[Any]


def follow(field: Program, start: Start, duration: Fraction, order: int, claim: StepClaim) -> Motion:
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

    Raises
    ------
    Rejected
        No a-priori enclosure was proved, or the claimed end is too small.
    """
    states, dimension = len(field.outputs), len(start.center)
    box = box_of(start)
    assert claim.prior is not None and claim.products is not None
    prior = a_priori(field, box, duration, claim.prior)
    used = used_inputs(field)
    size = len(used)
    center = flow_jets(field, [arb(c) for c in start.center], 1, order, used)
    over_box = flow_jets(field, box, 2, order, used)
    remainder = [jets[0] for jets in flow_jets(field, [*prior, *box[states:]], 0, order + 1, used)[order]]
    value = [[jet[0] for jet in row] for row in center]
    jacobian = [[spread_columns(jet[1 : 1 + size], used, dimension) for jet in row] for row in center]
    for state in range(states):
        if state not in used:  # the flow is the identity in what the field does not read
            jacobian[0][state][state] = arb(1)
    hessian = [[jet[1 + size :] for jet in row] for row in over_box]
    motion = Motion(start, duration, used, value, jacobian, hessian, remainder)
    powers = powers_of(ball(duration), order + 1)
    image = second_order(
        combine(powers, value),
        [combine(powers, [row[i] for row in jacobian]) for i in range(states)],
        [combine(powers, [row[i] for row in hessian]) for i in range(states)],
        used,
        start,
        claim.products,
    )
    moved = [c + r * powers[order] for c, r in zip(image.center, remainder, strict=True)]
    require_image(Image(moved, image.jacobian, image.fresh, image.rest), start, claim.end, "the end of a step")
    return motion


def a_priori(field: Program, box: Vector, duration: Fraction, guess: tuple[Sequence[float], Sequence[float]]) -> Vector:
    """A box that provably contains every solution that starts in `box` over a duration; states only.

    Any guess will do: it is widened a little, and once more where a coordinate does not fit; only the inclusion counts.
    """
    states, longest = len(field.outputs), ball(duration)
    wide = []
    for low, high in zip(*guess, strict=True):
        if not low <= high:
            raise Rejected("an a-priori enclosure is empty")
        wide.append(_widened(arb(low).union(arb(high))))
    for _ in range(states + 2):
        slope = evaluate(field, [*wide, *box[states:]])
        # [0, h] v is the hull of 0 and h v, and less than the product of two balls
        image = [x + arb(0).union(longest * v) for x, v in zip(box, slope, strict=False)]
        if not all(bool(x.is_finite()) for x in image):
            break
        fits = [bool(b.contains(x)) for b, x in zip(wide, image, strict=True)]
        if all(fits):
            return image
        wide = [b if fit else _widened(b.union(x)) for b, x, fit in zip(wide, image, fits, strict=True)]
    raise Rejected("an a-priori enclosure is not proved")


def _widened(guess: Any) -> Any:
    return arb(guess.mid(), guess.rad() * (1 + arb(2) ** -20) + abs(guess.mid()) * arb(2) ** -40 + arb(2) ** -900)
