"""Linear bounds of networks by backward substitution, in numpy: claims with two lines per neuron. Not rigorous.

Written apart from the checker, for comparison and to have claims of another origin than the engine's.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from flint import arb

from setrl.verify.checker.action import Policy
from setrl.verify.checker.deployment import Deployment
from setrl.verify.checker.layers import Activation, Dense, Diagonal, Layer, Selection
from setrl.verify.checker.leaf import BOX, PERTURBATION, PRODUCT, ActionClaim, TwoLines
from setrl.verify.checker.observed import Seen

Array = Any
ROOM = 1e-14
"""Relative room that a range gets before lines are chosen on it."""


def point(activation: Activation, x: Array) -> Array:
    """The activation."""
    match activation.kind:
        case "relu":
            return np.maximum(x, 0.0)
        case "leaky_relu":
            return np.maximum(x, 0.0) + activation.slope * np.minimum(x, 0.0)
        case "clip":
            return np.clip(x, activation.low, activation.high)
        case "tanh":
            return np.tanh(x)
    return 0.5 + 0.5 * np.tanh(0.5 * x)


def derivative(activation: Activation, x: float) -> float:
    """The derivative of a smooth activation."""
    value = math.tanh(x if activation.kind == "tanh" else x / 2)
    return (1.0 - value * value) / (1 if activation.kind == "tanh" else 4)


def residual(activation: Activation, slope: float, low: float, high: float) -> tuple[float, float]:
    """Least and largest ``f(x) - slope x``."""
    places = [low, high]
    match activation.kind:
        case "relu" | "leaky_relu":
            places.append(0.0)
        case "clip":
            places += [activation.low, activation.high]
        case kind:
            scale = 1 if kind == "tanh" else 2
            steepness = slope * scale * scale
            if 0.0 < steepness < 1.0:
                place = scale * math.atanh(math.sqrt(1.0 - steepness))
                places += [place, -place]
    values = [float(point(activation, x)) - slope * x for x in places if low <= x <= high]
    return min(values), max(values)


def lines_of(activation: Activation, low: Array, high: Array) -> TwoLines:
    """Two lines per neuron on [low, high], of the usual slopes."""
    slopes = [_slopes(activation, a, b) for a, b in zip(low.tolist(), high.tolist(), strict=True)]
    return with_slopes(activation, *np.array(slopes).T, low, high)


def with_slopes(activation: Activation, lower: Array, upper: Array, low: Array, high: Array) -> TwoLines:
    """Two lines per neuron on [low, high], as close as the slopes allow; room for rounding only where one rounds."""
    offsets = []
    for m, n, a, b in zip(lower.tolist(), upper.tolist(), low.tolist(), high.tolist(), strict=True):
        least, most = residual(activation, m, a, b)[0], residual(activation, n, a, b)[1]
        room = 4e-15 * (1.0 + abs(a) + abs(b))
        offsets.append((least and least - room, most and most + room))
    below, above = zip(*offsets, strict=True)
    return TwoLines(tuple(lower.tolist()), below, tuple(upper.tolist()), above)


def _slopes(activation: Activation, low: float, high: float) -> tuple[float, float]:
    ends = point(activation, np.array([low, high]))
    chord = float(ends[1] - ends[0]) / (high - low)
    match activation.kind:
        case "relu" | "leaky_relu":
            least = activation.slope if activation.kind == "leaky_relu" else 0.0
            if low >= 0.0 or high <= 0.0:
                return (1.0, 1.0) if low >= 0.0 else (least, least)
            return 1.0 if high > -low else least, chord
        case "clip":
            return chord, chord
    tangent = derivative(activation, 0.5 * (low + high))
    if low >= 0.0:
        return chord, tangent
    return (tangent, chord) if high <= 0.0 else (min(derivative(activation, low), derivative(activation, high)),) * 2


@dataclass(frozen=True)
class Observed:
    """`Seen` in float64."""

    center: Array
    rows: Array
    shared: int
    box: Array
    noise: Array

    @classmethod
    def of(cls, seen: Seen) -> Observed:
        rows = np.array([[float(x) for x in row] for row in seen.rows.tolist()]).reshape(len(seen.center), -1)
        center, box, noise = (np.array([float(x) for x in entry]) for entry in (seen.center, seen.box, seen.noise))
        return cls(center, rows, seen.shared, box, noise)


@dataclass
class Crown:
    """A policy between linear bounds.

    `lower` and `upper` are pairs (matrix, offset); `lines` and `ranges` are those of the activations; `error` is the
    deployed runtime's.
    """

    policy: Policy
    seen: Observed
    clip_slopes: tuple[float, ...] | None = None
    choose: Callable[[Activation, Array, Array], TwoLines] = lines_of
    """Lines of an activation on its range."""
    lines: list[TwoLines] = field(default_factory=list)
    ranges: list[tuple[Array, Array]] = field(default_factory=list)

    def __post_init__(self) -> None:
        self.chain: list[tuple[Array, ...]] = []
        self.size = len(self.seen.center)
        deployment = self.policy.deployment
        self.error = np.zeros(1)
        magnitude = np.abs(self.range()).max(0)
        if deployment is not None:
            self.error = _floats(deployment.start(_balls(magnitude)))
        for layer in self.policy.layers:
            magnitude = self._follow(layer, deployment, magnitude)
        if self.clip_slopes is not None:
            self._clip(self.clip_slopes, deployment)
        self.lower, self.upper = self.sides()

    def _follow(self, layer: Layer, deployment: Deployment | None, magnitude: Array) -> Array:
        low, high = self.range()
        if isinstance(layer, Activation):
            self.ranges.append((low, high))
            wide = ROOM * (1.0 + np.abs(low) + np.abs(high))
            lines = self.choose(layer, low - wide, high + wide)
            self.lines.append(lines)
            if deployment is not None:
                self.error = _floats(deployment.activated(layer, _balls(low), _balls(high), _balls(self.error)))
            self.chain.append(tuple(map(np.array, (*_four(lines),))))
            return np.abs(point(layer, np.array([low, high]))).max(0)
        if deployment is not None:
            self.error = _floats(deployment.through(layer, _balls(magnitude), _balls(self.error)))
        self.chain.append(_matrix(layer, self.size))
        self.size = len(self.chain[-1][1])
        return np.abs(self.range()).max(0)

    def _clip(self, slopes: Sequence[float], deployment: Deployment | None) -> None:
        low, high = self.range()
        offsets = []
        for (least, most), m, a, b in zip(self.policy.bounds, slopes, low - self.error, high + self.error, strict=True):
            clip = Activation("clip", low=float(least), high=float(most))
            offsets.append(residual(clip, m, a, b))
        below, above = np.array(offsets).T
        self.chain.append((np.array(slopes), below, np.array(slopes), above))
        self.error = np.abs(slopes) * self.error
        if deployment is not None:
            self.error = self.error + _floats(deployment.clip_error())

    def sides(self) -> tuple[tuple[Array, Array], tuple[Array, Array]]:
        found = []
        for sign in (-1.0, 1.0):
            matrix, offset = np.eye(self.size), np.zeros(self.size)
            for link in reversed(self.chain):
                if len(link) == 2:
                    offset, matrix = offset + matrix @ link[1], matrix @ link[0]
                    continue
                near, far = (link[2:], link[:2]) if sign > 0 else (link[:2], link[2:])
                up, down = np.maximum(matrix, 0.0), np.minimum(matrix, 0.0)
                offset = offset + up @ near[1] + down @ far[1]
                matrix = up * near[0] + down * far[0]
            found.append((matrix, offset))
        return found[0], found[1]

    def range(self) -> tuple[Array, Array]:
        """Of every component behind the layers so far."""
        ends = []
        for sign, (matrix, offset) in zip((-1.0, 1.0), self.sides(), strict=True):
            reach = np.abs(matrix @ self.seen.rows).sum(1) + np.abs(matrix) @ (self.seen.box + self.seen.noise)
            ends.append(matrix @ self.seen.center + offset + sign * reach)
        return ends[0], ends[1]

    def columns(self, matrix: Array) -> dict[tuple[int, int], Array]:
        """Private columns by their origins."""
        mapped = matrix @ self.seen.rows
        columns = {(PRODUCT, j): mapped[:, self.seen.shared + j] for j in range(mapped.shape[1] - self.seen.shared)}
        for kind, sizes in ((BOX, self.seen.box), (PERTURBATION, self.seen.noise)):
            columns |= {(kind, j): matrix[:, j] * size for j, size in enumerate(sizes) if size}
        return columns

    def needed(self, claim: ActionClaim) -> Array:
        """The smallest box that makes a claim true as far as the linear bounds know."""
        kept = dict(zip(claim.origins, claim.private, strict=True))
        sides = []
        for sign, (matrix, offset) in zip((-1.0, 1.0), (self.lower, self.upper), strict=True):
            total = sign * (matrix @ self.seen.center + offset - np.array(claim.center)) + self.error
            shared = (matrix @ self.seen.rows)[:, : self.seen.shared]
            total += np.abs(shared - np.array(claim.rows).reshape(-1, self.size).T).sum(1)
            for origin, column in self.columns(matrix).items():
                total += np.abs(column - np.array(kept.get(origin, np.zeros(self.size))))
            sides.append(total)
        return np.maximum(*sides)

    def claim(self, kept: Sequence[tuple[int, int]] = (), extra: Sequence[tuple[int, int]] = ()) -> ActionClaim:
        """A set of actions between both bounds, its box the smallest; `extra` rows are like nothing."""
        (a, b), (c, d) = self.lower, self.upper
        middle, offset = (a + c) / 2, (b + d) / 2
        columns = self.columns(middle)
        rows = (middle @ self.seen.rows)[:, : self.seen.shared].T
        private = [*(columns[origin] for origin in kept), *(np.full(self.size, 0.01) for _ in extra)]
        claim = ActionClaim(
            tuple((middle @ self.seen.center + offset).tolist()),
            tuple(tuple(row) for row in rows.tolist()),
            (*kept, *extra),
            tuple(tuple(row.tolist()) for row in private),
            (0.0,) * self.size,
        )
        return boxed(claim, self.needed(claim))


def boxed(claim: ActionClaim, box: Array) -> ActionClaim:
    """A claim with another box."""
    return ActionClaim(claim.center, claim.rows, claim.origins, claim.private, tuple(np.array(box).tolist()))


def _four(lines: TwoLines) -> tuple[tuple[float, ...], ...]:
    return lines.lower_slopes, lines.lower_offsets, lines.upper_slopes, lines.upper_offsets


def _matrix(layer: Dense | Diagonal | Selection, size: int) -> tuple[Array, Array]:
    match layer:
        case Dense():
            return np.array([[float(x) for x in row] for row in layer.matrix]), np.array([*map(float, layer.offset)])
        case Diagonal():
            return np.diag([*map(float, layer.scale)]), np.array([*map(float, layer.offset)])
    return np.eye(size)[list(layer.index)], np.zeros(len(layer.index))


def _balls(numbers: Array) -> list[Any]:
    return [arb(float(x)) for x in numbers]


def _floats(balls: Sequence[Any]) -> Array:
    return np.array([float(x) for x in balls])
