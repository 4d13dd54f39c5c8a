"""Queries about small networks whose answers are known, from rationals or ball arithmetic that share no code."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from itertools import combinations, pairwise, product
from typing import Any

import numpy as np
from flint import arb, ctx

from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine, Layer
from setrl.specs.queries import Case, LinearConstraint, Query
from setrl.specs.specification import Bounds

F = Fraction
Box = tuple[Bounds, ...]


@dataclass(frozen=True)
class Known:
    """A query with its answer in exact arithmetic.

    `margin` is how far it is from the other answer, where that is known: small margins may stay undecided.
    """

    family: str
    content: bytes
    query: Query
    satisfiable: bool
    margin: Fraction


def weights(generator: np.random.Generator, *shape: int, positive: bool = False) -> Any:
    """Multiples of 1/64: exact in every precision."""
    drawn = generator.integers(1 if positive else -96, 97, size=shape)
    return drawn / 64.0


def box_of(generator: np.random.Generator, size: int) -> Box:
    """Ends with one decimal, most of which are no floats; sometimes a point."""
    ends = [sorted(generator.integers(-12, 13, size=2).tolist()) for _ in range(size)]
    return tuple(Bounds(F(low, 10), F(high, 10)) for low, high in ends)


def at_most(bound: Fraction, outputs: Sequence[Fraction], inputs: Sequence[Fraction] = ()) -> LinearConstraint:
    """``inputs . x + outputs . y <= bound``."""
    return LinearConstraint(
        tuple((i, c) for i, c in enumerate(inputs) if c), tuple((j, c) for j, c in enumerate(outputs) if c), bound
    )


def query_of(inputs: int, outputs: int, cases: Sequence[Case]) -> Query:
    return Query((1, inputs), (1, outputs), tuple(cases))


def affine(generator: np.random.Generator, rows: int, columns: int, positive: bool = False) -> Affine:
    return Affine(weights(generator, rows, columns, positive=positive), weights(generator, rows))


def rational_layer(layer: Layer, x: Sequence[Fraction]) -> list[Fraction]:
    if isinstance(layer, Affine):
        return [
            sum((F(float(w)) * v for w, v in zip(row, x, strict=True)), F(float(b)))
            for row, b in zip(layer.weight, layer.bias, strict=True)
        ]
    if layer.kind == "clip":
        return [min(max(v, F(layer.lower)), F(layer.upper)) for v in x]
    slope = F(layer.slope) if layer.kind == "leaky_relu" else F(0)
    return [v if v > 0 else slope * v for v in x]


def rational(layers: Sequence[Layer], x: Sequence[Fraction]) -> list[Fraction]:
    for layer in layers:
        x = rational_layer(layer, x)
    return list(x)


def dot(a: Sequence[Fraction], b: Sequence[Fraction]) -> Fraction:
    return sum((x * y for x, y in zip(a, b, strict=True)), F(0))


def lines_and_vertices(first: Affine, box: Box) -> list[tuple[Fraction, Fraction]]:
    """Vertices of the arrangement of a hidden layer's kinks and the faces of a box in the plane, inside the box."""
    lines = [(F(float(w[0])), F(float(w[1])), -F(float(b))) for w, b in zip(first.weight, first.bias, strict=True)]
    for axis, bounds in enumerate(box):
        lines += [(F(axis == 0), F(axis == 1), end) for end in (bounds.lower, bounds.upper)]
    points = []
    for (a, b, e), (c, d, f) in combinations(lines, 2):
        if determinant := a * d - b * c:
            points.append(((e * d - b * f) / determinant, (a * f - e * c) / determinant))
    return [p for p in points if all(s.lower <= v <= s.upper for v, s in zip(p, box, strict=True))]


def planar(seed: int, margin: Fraction) -> Known:
    """One hidden layer on the plane: a linear form's minimum is at a vertex of the arrangement of its kinks."""
    generator = np.random.default_rng([1, seed])
    kind = Activation("relu") if seed % 2 else Activation("leaky_relu", slope=0.25)
    layers = (affine(generator, 5, 2), kind, affine(generator, 2, 5))
    box = box_of(generator, 2)
    outputs = [F(int(n), 3) for n in generator.integers(-4, 5, size=2)]
    inputs = [F(int(n), 7) for n in generator.integers(-4, 5, size=2)]
    least = min(
        dot(outputs, rational(layers, p)) + dot(inputs, p)
        for p in lines_and_vertices(layers[0], box)  # type: ignore[arg-type]
    )
    case = Case(box, (at_most(least + margin, outputs, inputs),))
    return Known("planar", policy_bytes(layers), query_of(2, 2, [case]), margin >= 0, abs(margin))


def linear(seed: int, margin: Fraction) -> Known:
    """An affine network: a linear form's minimum is at a corner."""
    generator = np.random.default_rng([2, seed])
    layers = (affine(generator, 4, 3), affine(generator, 3, 4))
    box = box_of(generator, 3)
    outputs = [F(int(n), 3) for n in generator.integers(-4, 5, size=3)]
    corners = product(*((bounds.lower, bounds.upper) for bounds in box))
    least = min(dot(outputs, rational(layers, corner)) for corner in corners)
    case = Case(box, (at_most(least + margin, outputs),))
    return Known("linear", policy_bytes(layers), query_of(3, 3, [case]), margin >= 0, abs(margin))


def pieces(layers: Sequence[Layer], low: Fraction, high: Fraction) -> list[Fraction]:
    """Ends and kinks of a piecewise linear network of one input, ascending."""
    places = [low, high]
    for depth, layer in enumerate(layers):
        if isinstance(layer, Affine):
            continue
        bends = [F(layer.lower), F(layer.upper)] if layer.kind == "clip" else [F(0)]
        found = []
        for a, b in pairwise(places):
            start, stop = rational(layers[:depth], [a]), rational(layers[:depth], [b])
            for u, v in zip(start, stop, strict=True):
                found += [
                    a + (b - a) * (bend - u) / (v - u) for bend in bends if u != v and min(u, v) < bend < max(u, v)
                ]
        places = sorted({*places, *found})
    return places


def on_a_line(seed: int) -> Known:
    """A deep network of one input: on each linear piece, every case is an intersection of intervals."""
    generator = np.random.default_rng([3, seed])
    kinds = [Activation("relu"), Activation("leaky_relu", slope=0.5), Activation("clip", lower=-0.5, upper=0.75)]
    layers: list[Layer] = [affine(generator, 4, 1)]
    for width in (4, 2):
        layers += [kinds[int(generator.integers(3))], affine(generator, width, 4)]
    cases, satisfiable, margin = [], False, None
    for _ in range(int(generator.integers(1, 4))):
        low, high = sorted(generator.choice(np.arange(-15, 16), 2, replace=False).tolist())
        box = (Bounds(F(low, 10), F(high, 10)),)
        middle = rational(layers, [F(low + high, 20)])
        constraints = []
        for _ in range(int(generator.integers(1, 4))):
            outputs = [F(int(n), 3) for n in generator.integers(-3, 4, size=2)]
            inputs = [F(int(generator.integers(-2, 3)))]
            shift = F(int(generator.integers(-40, 20)), 17)
            constraints.append(at_most(dot(outputs, middle) + inputs[0] * F(low + high, 20) + shift, outputs, inputs))
        constraints = [c for c in constraints if c.outputs or c.inputs]
        least = least_worst(layers, box[0], constraints)
        cases.append(Case(box, tuple(constraints)))
        satisfiable |= least <= 0
        margin = least if margin is None else min(margin, least)
    assert margin is not None
    return Known("line", policy_bytes(layers), query_of(1, 2, cases), satisfiable, abs(margin))


def least_worst(layers: Sequence[Layer], bounds: Bounds, constraints: Sequence[LinearConstraint]) -> Fraction:
    """Least over an interval of the largest ``v``: at an end, a kink, or where two forms cross on a linear piece."""
    if not constraints:
        return F(-1)

    def forms(x: Fraction) -> list[Fraction]:
        y = rational(layers, [x])
        return [
            sum((c * x for _, c in k.inputs), F(0)) + sum((c * y[j] for j, c in k.outputs), F(0)) - k.bound
            for k in constraints
        ]

    places = pieces(layers, bounds.lower, bounds.upper)
    candidates = set(places)
    for a, b in pairwise(places):
        start, stop = forms(a), forms(b)
        for i, j in combinations(range(len(constraints)), 2):
            before, after = start[i] - start[j], stop[i] - stop[j]
            if before != after and 0 <= (share := before / (before - after)) <= 1:
                candidates.add(a + (b - a) * share)
    return min(max(forms(x)) for x in candidates)


def ball(number: Fraction) -> arb:
    return arb(number.numerator) / arb(number.denominator)


def smooth(layers: Sequence[Layer], x: Sequence[Fraction]) -> list[arb]:
    """A network with tanh and sigmoid in 200-bit balls."""
    ctx.prec = 200
    values = [ball(v) for v in x]
    for layer in layers:
        if isinstance(layer, Affine):
            values = [
                sum((arb(float(w)) * v for w, v in zip(row, values, strict=True)), arb(float(b)))
                for row, b in zip(layer.weight, layer.bias, strict=True)
            ]
        elif layer.kind == "tanh":
            values = [v.tanh() for v in values]
        elif layer.kind == "sigmoid":
            values = [1 / (1 + (-v).exp()) for v in values]
        else:
            values = [v.max(arb(0)) for v in values]
    ctx.prec = 53
    return values


def below(value: arb) -> Fraction:
    """A rational just below a ball (and 2^-80 apart)."""
    mantissa, exponent = value.mid().man_exp()
    middle = F(int(mantissa)) * F(2) ** int(exponent)
    return middle - F(1, 2**80)


def monotone(seed: int, margin: Fraction) -> Known:
    """Positive weights: every output is largest at the upper corner."""
    generator = np.random.default_rng([4, seed])
    kinds = ["tanh", "sigmoid", "relu"]
    layers: list[Layer] = [affine(generator, 5, 3, positive=True)]
    for width in (4, 1):
        layers += [
            Activation(kinds[int(generator.integers(3))]),
            affine(generator, width, len(layers[-1].weight), True),
        ]  # type: ignore[union-attr]
    box = box_of(generator, 3)
    most = below(smooth(layers, [bounds.upper for bounds in box])[0])
    case = Case(box, (at_most(-most + margin, [F(-1)]),))
    return Known("monotone", policy_bytes(layers), query_of(3, 1, [case]), margin > 0, abs(margin))


def deep(seed: int, planted: bool) -> Known:
    """A random network of mixed activations: a planted witness, or a margin above interval arithmetic."""
    generator = np.random.default_rng([5, seed])
    kinds = ["tanh", "sigmoid", "relu"]
    layers: list[Layer] = [affine(generator, 8, 3)]
    for width in (8, 2):
        layers += [Activation(kinds[int(generator.integers(3))]), affine(generator, width, 8)]
    box = box_of(generator, 3)
    if planted:
        share = [F(int(n), 100) for n in generator.integers(0, 101, size=3)]
        x = [b.lower + s * (b.upper - b.lower) for b, s in zip(box, share, strict=True)]
        values = [below(v) for v in smooth(layers, x)]
        constraints = (at_most(values[0] + F(1, 500), [F(1), F(0)]), at_most(F(1, 500) - values[1], [F(0), F(-1)]))
        return Known("witness", policy_bytes(layers), query_of(3, 2, [Case(box, constraints)]), True, F(1, 500))
    low, high = intervals(layers, box)
    outside = [at_most(low[0] - F(1, 100), [F(1), F(0)]), at_most(-high[1] - F(1, 100), [F(0), F(-1)])]
    cases = [Case(box, (constraint,)) for constraint in outside]
    return Known("margin", policy_bytes(layers), query_of(3, 2, cases), False, F(1, 100))


def intervals(layers: Sequence[Layer], box: Box) -> tuple[list[Fraction], list[Fraction]]:
    """Interval arithmetic: rationals for affine layers, balls for activations."""
    low, high = [b.lower for b in box], [b.upper for b in box]
    for layer in layers:
        if isinstance(layer, Affine):
            ends = [
                [
                    F(float(b))
                    + sum(
                        (F(float(w)) * (p if (w > 0) == top else q) for w, p, q in zip(row, high, low, strict=True)),
                        F(0),
                    )
                    for row, b in zip(layer.weight, layer.bias, strict=True)
                ]
                for top in (False, True)
            ]
            low, high = ends
        else:
            low = [below(v) for v in smooth([layer], low)]
            high = [below(v) + F(1, 2**70) for v in smooth([layer], high)]
    return low, high


MARGINS = (F(0), F(1, 10**12), F(-1, 10**12), F(1, 1000), F(-1, 1000))


def known_queries() -> list[Known]:
    """More than 200 of them."""
    found = [planar(seed, margin) for seed in range(10) for margin in MARGINS]
    found += [linear(seed, margin) for seed in range(10) for margin in MARGINS]
    found += [on_a_line(seed) for seed in range(45)]
    found += [monotone(seed, margin) for seed in range(9) for margin in MARGINS[1:]]
    found += [deep(seed, planted) for seed in range(12) for planted in (True, False)]
    return found
