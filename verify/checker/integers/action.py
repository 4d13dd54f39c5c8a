"""The network obligation in integers: a claimed set of actions contains what the policy computes on a set of states.

Of a nonlinear observation it is the claimed set of observations that the policy is followed from; that this contains
the image of the states is a flow's kind of obligation, and not in here. The policy's affine form depends on the set's
own factors and on private ones: an observation's products, box and perturbation, what the slopes of the certificate
leave of every activation, of the clip. Every private factor may be chosen freely in the claimed set, so that one with a
claimed row of its own is matched with that row. What all matches leave, center by center and row by row, whole columns
that have no row, rounding, and the deployed runtime's error have to fit into the box.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ..contract import AffineMap, Contract
from ..layers import Activation, Dense, Diagonal, Selection
from ..layout import Layout
from ..leaf import BOX, CLIPPED, NEURON, PERTURBATION, PRODUCT, ActionClaim, Floats, Lines, PeriodClaim
from ..network import Network
from ..rejection import Rejected
from .fixed import Factor, Interval, Vector, ceil_at, enclosure, floor_at, product_up
from .forms import Form, Origin
from .residuals import clip_residual, residual
from .runtime import Runtime, Weights
from .sets import Tracked, unit

BITS, MOST_BITS = 160, 1024
"""Places behind the binary point: `BITS` below the smallest of the observations' sizes, within `MOST_BITS`."""
SHARED = -1
"""Kind of the factors of the tracked set."""


@dataclass(frozen=True)
class Policy:
    """Everything between the states and the action, prepared once per certificate.

    Attributes
    ----------
    layers : tuple
        The map before the network, the network, the map after it.
    radius : tuple of Fraction
        Of the observation's perturbation.
    clip : tuple of (low, high)
    runtime : Runtime or None
        None where only exact arithmetic is claimed.
    layout : Layout
    """

    layers: tuple[Weights | Diagonal | Selection | Activation, ...]
    radius: tuple[Fraction, ...]
    clip: tuple[tuple[Fraction, Fraction], ...]
    runtime: Runtime | None
    layout: Layout

    @classmethod
    def of(cls, contract: Contract, network: Network, layout: Layout, runtime: Runtime | None) -> Policy:
        """Prepare."""
        chain = [*_map(contract.before), *network.layers, *_map(contract.after)]
        layers = [Weights.of(layer, runtime) if isinstance(layer, Dense) else layer for layer in chain]
        clip = tuple(bounds for bounds in contract.clip if bounds is not None)
        return cls(tuple(layers), contract.radius, clip, runtime, layout)


def _map(affine: AffineMap | None) -> list[Dense]:
    return [] if affine is None else [Dense(affine.matrix, affine.offset)]


def check_action(policy: Policy, tracked: Tracked, claim: PeriodClaim, what: str) -> None:
    """Require that a period's claimed set of actions contains what the policy computes on the tracked set's states.

    Parameters
    ----------
    policy : Policy
    tracked : Tracked
    claim : PeriodClaim
    what : str
        Where, for the message.

    Raises
    ------
    Rejected
    """
    walk = _Walk(policy, tracked, claim)
    walk.follow(claim.lines)
    if claim.clip_slopes is not None:
        walk.clip(claim.clip_slopes)
    walk.form.settle()
    needed = _left(walk.form, walk.error, claim.action, walk.bits)
    for i, (need, room) in enumerate(zip(needed, claim.action.box, strict=True)):
        if not need <= floor_at(room, walk.bits):
            raise Rejected(f"{what}: what component {i} needs does not fit into {room:.6g}")


class _Walk:
    """The form behind the layers so far, and the runtime's error of it (zeros without one)."""

    def __init__(self, policy: Policy, tracked: Tracked, claim: PeriodClaim) -> None:
        self.policy = policy
        center, rows = _observed(policy.layout, tracked, claim)
        if len(claim.action.rows) != len(tracked.rows):
            raise Rejected("the set of actions has not one row for every row of the tracked set")
        self.bits = _places(center, list(rows.values()), policy.radius)
        self.form = self._seen(center, rows)
        self.error = [0] * len(center)
        self.size: Vector = []
        if policy.runtime is not None:
            self.size = self._size()
            self.error = policy.runtime.cast(self.size, self.bits)

    def _seen(self, center: Sequence[float], rows: dict[Origin, Sequence[float]]) -> Form:
        table = [[floor_at(x, self.bits) for x in numbers] for numbers in (center, *rows.values())]
        exact = [[ceil_at(x, self.bits) for x in numbers] for numbers in (center, *rows.values())]
        error = [0] * len(center)
        for low, high in zip(table, exact, strict=True):
            error = [e + b - a for e, a, b in zip(error, low, high, strict=True)]
        columns: dict[Origin, Vector] = dict(zip(rows, table[1:], strict=True))
        noise = [ceil_at(radius, self.bits) for radius in self.policy.radius]
        return Form(table[0], error, columns, (PERTURBATION, 0, noise))

    def _size(self) -> Vector:
        return [max(abs(low), abs(high)) for low, high in self.form.bounds()]

    def follow(self, lines: Sequence[Lines]) -> None:
        """Through all layers; one of `lines` for every activation."""
        if len(lines) != len(self.policy.layout.neurons):
            raise Rejected("the claim has not one slope for every neuron")
        waiting, neurons = iter(lines), 0
        for layer in self.policy.layers:
            bounds = self.form.bounds() if isinstance(layer, Activation) else []
            if self.policy.runtime is not None:
                self._err(self.policy.runtime, layer, bounds)
            match layer:
                case Activation():
                    self._activate(layer, next(waiting), bounds, neurons)
                    neurons += len(bounds)
                case Selection():
                    self.form.select(layer.index)
                case Diagonal():
                    self.form.scale([Factor.of(w) for w in layer.scale], self._offset(layer.offset))
                case Weights():
                    self.form.multiply(layer.matrix, self._offset(layer.offset))
            if self.policy.runtime is not None and isinstance(layer, Diagonal | Weights):
                self.size = self._size()
        if self.policy.runtime is None:
            self.error = [0] * len(self.form.center)

    def _err(self, runtime: Runtime, layer: Any, bounds: Sequence[Interval]) -> None:
        """The runtime's error behind a layer; the size behind it too, where the layer knows it best."""
        match layer:
            case Activation():
                self.error = runtime.activated(layer, bounds, self.error, self.bits)
                ranges = [residual(layer, Factor(0, 0), *ends, self.bits) for ends in bounds]
                self.size = [max(abs(low), abs(high)) for low, high in ranges]
            case Selection():
                self.error = [self.error[i] for i in layer.index]
                self.size = [self.size[i] for i in layer.index]
            case Diagonal():
                self.error = runtime.diagonal(layer, self.size, self.error, self.bits)
            case Weights():
                self.error = runtime.dense(layer, self.size, self.error, self.bits)

    def _offset(self, numbers: Sequence[float | Fraction]) -> list[Interval]:
        return [enclosure(number, self.bits) for number in numbers]

    def _activate(self, activation: Activation, lines: Lines, bounds: Sequence[Interval], first: int) -> None:
        slopes = [Factor.of(slope) for slope in lines.slopes]
        left = [residual(activation, slope, *ends, self.bits) for slope, ends in zip(slopes, bounds, strict=True)]
        if lines.offsets is not None and lines.errors is not None:
            for i, (offset, error) in enumerate(zip(lines.offsets, lines.errors, strict=True)):
                least, most = Fraction(offset) - Fraction(error), Fraction(offset) + Fraction(error)
                if not (ceil_at(least, self.bits) <= left[i][0] and left[i][1] <= floor_at(most, self.bits)):
                    raise Rejected(f"the line of neuron {i} of a {activation.kind} is not proved")
                left[i] = floor_at(least, self.bits), ceil_at(most, self.bits)
        self.form.follow(slopes, left, NEURON, first)

    def clip(self, slopes: Floats) -> None:
        """The specification's clip, on what the runtime computes too."""
        factors, bits, clip = [Factor.of(slope) for slope in slopes], self.bits, self.policy.clip
        wide = [(low - e, high + e) for (low, high), e in zip(self.form.bounds(), self.error, strict=True)]
        left = [
            clip_residual(bound, factor, *ends, bits) for bound, factor, ends in zip(clip, factors, wide, strict=True)
        ]
        self.form.follow(factors, left, CLIPPED, 0)
        self.error = [product_up(f.absolute, e, f.scale) for f, e in zip(factors, self.error, strict=True)]
        runtime = self.policy.runtime
        if runtime is not None:
            moved = [max(map(runtime.conversion, bound)) for bound in clip]
            self.error = [e + ceil_at(move, bits) for e, move in zip(self.error, moved, strict=True)]


def _observed(layout: Layout, tracked: Tracked, claim: PeriodClaim) -> tuple[Floats, dict[Origin, Sequence[float]]]:
    """Center and rows of what the policy sees: plain states, or the claimed image of another observation map."""
    if layout.observed is not None:
        rows = {(SHARED, j): [row[i] for i in layout.observed] for j, row in enumerate(tracked.rows)}
        return tuple(tracked.center[i] for i in layout.observed), dict(rows)
    seen = claim.seen
    if seen is None or len(seen.rows) != len(tracked.rows):
        raise Rejected("the set of observations has not one row for every row of the tracked set")
    found: dict[Origin, Sequence[float]] = {(SHARED, j): row for j, row in enumerate(seen.rows)}
    found.update({(PRODUCT, j): row for j, row in enumerate(seen.fresh)})
    size = len(seen.center)
    found.update({(BOX, i): unit(i, r, size) for i, r in enumerate(seen.radius) if r})
    return seen.center, found


def _places(center: Sequence[float], rows: Sequence[Sequence[float]], radius: Sequence[Fraction]) -> int:
    """Places behind the binary point that resolve the smallest observation; a choice of precision, not a bound."""
    exponents = []
    for i, noise in enumerate(radius):
        numbers = [math.frexp(x)[1] for x in (center[i], *(row[i] for row in rows)) if x]
        numbers += [noise.numerator.bit_length() - noise.denominator.bit_length()] if noise else []
        exponents += [max(numbers)] if numbers else []
    return min(BITS + max(0, -min(exponents, default=0)), MOST_BITS)


def _left(form: Form, error: Vector, claim: ActionClaim, bits: int) -> Vector:
    """Half-widths of the box that a claimed set needs around a form, upper bounds."""
    needed = [e + own for e, own in zip(error, form.error, strict=True)]
    rows: dict[Origin, Floats] = {(SHARED, j): row for j, row in enumerate(claim.rows)}
    rows.update(zip(claim.origins, claim.private, strict=True))
    nothing = (0.0,) * len(needed)
    needed = [n + _distance(x, y, bits) for n, x, y in zip(needed, form.center, claim.center, strict=True)]
    for origin, column in form.columns.items():
        row = rows.get(origin, nothing)
        part = [_distance(x, y, bits) for x, y in zip(column, row, strict=True)]
        unmatched = list(map(abs, column))
        if origin[0] != SHARED and all(a <= b for a, b in zip(unmatched, part, strict=True)):
            part = unmatched  # a private factor of the claimed set may also stay at 0
        needed = [n + x for n, x in zip(needed, part, strict=True)]
    return needed


def _distance(x: int, y: float, bits: int) -> int:
    """``|x - y|``, rounded up; x at `bits`."""
    low, high = enclosure(y, bits)
    return max(high - x, x - low)
