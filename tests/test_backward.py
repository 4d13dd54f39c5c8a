"""Linear bounds of networks: they enclose, others compute the same, and what is no number proves nothing."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from crown import Crown, Observed
from flint import arb, arb_mat, ctx
from laws import real_forward
from loops import activation_of, network

from setrl.models.policy import Activation, Affine, forward
from setrl.verify.backward import Choice, backward_bounds, usual
from setrl.verify.backward_lines import Lines, lines_with, usual_lines
from setrl.verify.checker import activation as exact_activation
from setrl.verify.checker.backward import Backward
from setrl.verify.checker.layers import Activation as CheckedActivation
from setrl.verify.checker.layers import Dense
from setrl.verify.checker.leaf import TwoLines
from setrl.verify.checker.observed import Seen
from setrl.verify.relaxations import residual_bounds
from setrl.verify.zonotope import Zonotope, from_box

Array = Any
KINDS = ("relu", "leaky_relu", "tanh", "sigmoid", "clip")
CASES = tuple(product((*KINDS, "mixed"), (1e-6, 0.05, 0.5, 3.0)))


def layers_of(kind: str, seed: int = 0, inputs: int = 3, outputs: int = 2, scale: float = 1.3) -> tuple[Any, ...]:
    """Two hidden layers; in the mixed one an activation follows another one, and an affine layer another one."""
    if kind != "mixed":
        return network([inputs, 8, 7, outputs], [kind, kind, "none"], seed, scale).layers
    layers = list(network([inputs, 8, 6, 7, outputs], ["tanh", "none", "relu", "sigmoid"], seed, scale).layers)
    return (*layers[:2], activation_of("clip"), *layers[2:])


def inputs_of(seed: int, size: float, batch: int = 4, inputs: int = 3, factors: int = 5) -> Zonotope:
    """Random sets of a size; the first is a box, the last a point."""
    generator = np.random.default_rng(seed)
    rows = size * generator.normal(size=(batch, factors, inputs)) / factors
    radius = 0.1 * size * generator.random((batch, inputs))
    rows[0], rows[-1], radius[-1] = 0.0, 0.0, 0.0
    return Zonotope(generator.normal(size=(batch, inputs)), rows, radius)


def points_of(z: Zonotope, count: int, seed: int = 0) -> Array:
    """Corners and points inside, shape (B, count, n)."""
    generator = np.random.default_rng(seed)
    factors = generator.uniform(-1, 1, size=(z.batch, count, z.generators.shape[1] + z.dimension))
    factors[:, ::2] = np.sign(factors[:, ::2])
    rows = np.concatenate([z.generators, z.radius[:, :, None] * np.eye(z.dimension)], 1)
    return z.center[:, None] + factors @ rows


def checked(layers: Any) -> tuple[Any, ...]:
    """The same layers in the checker's words."""
    found: list[Any] = []
    for layer in layers:
        if isinstance(layer, Affine):
            found.append(Dense(tuple(map(tuple, layer.weight.tolist())), tuple(layer.bias.tolist())))
        else:
            found.append(CheckedActivation(layer.kind, slope=layer.slope, low=layer.lower, high=layer.upper))
    return tuple(found)


def two_lines(lines: Lines, cell: int) -> TwoLines:
    fields = (lines.lower_slope, lines.lower_offset, lines.upper_slope, lines.upper_offset)
    return TwoLines(*(tuple(entry[cell].tolist()) for entry in fields))


def seen_of(z: Zonotope, cell: int) -> Seen:
    size, count = z.dimension, z.generators.shape[1]
    rows = arb_mat(size, count, z.generators[cell].T.ravel().tolist())
    return Seen([arb(x) for x in z.center[cell]], rows, count, [arb(r) for r in z.radius[cell]], [arb(0)] * size)


@pytest.mark.parametrize("kind", KINDS)
def test_what_any_slope_leaves_is_bounded_from_outside_and_closely(kind: str) -> None:
    generator = np.random.default_rng(1)
    activation = activation_of(kind)
    judge = checked([activation])[0]
    ends = np.sort(generator.normal(size=(2, 300)) * np.exp2(generator.integers(-30, 6, 300)), axis=0)
    slopes = generator.uniform(-0.5, 1.5, size=(2, 300))
    slopes[:, ::7], slopes[0, ::5], slopes[1, ::5] = generator.choice([-1e9, 1e9, 1e-30]), 0.0, 1.0
    low, high = residual_bounds(activation, slopes, *ends)
    with ctx.workprec(300):
        for (row, column), slope in np.ndenumerate(slopes):
            least, most = exact_activation.residual(judge, float(slope), arb(ends[0, column]), arb(ends[1, column]))
            assert arb(low[row, column]) <= least and arb(high[row, column]) >= most
            room = 4e-14 * (1 + abs(slope)) * (1 + np.abs(ends[:, column]).max())
            assert float(least.mid()) - low[row, column] <= room and high[row, column] - float(most.mid()) <= room


@pytest.mark.parametrize(("kind", "size"), CASES, ids=str)
def test_every_output_is_between_the_linear_bounds(kind: str, size: float) -> None:
    for seed in range(3):
        layers, z = layers_of(kind, seed), inputs_of(seed, size)
        found = backward_bounds(layers, z)
        points = points_of(z, 1000, seed)
        values = forward(layers, points)
        room = 1e-13 * (1 + np.abs(values).max())
        below = points @ np.swapaxes(found.lower_matrix, 1, 2) + found.lower_offset[:, None]
        above = points @ np.swapaxes(found.upper_matrix, 1, 2) + found.upper_offset[:, None]
        assert (below <= values + room).all() and (values <= above + room).all()
        assert (found.output.lower[:, None] <= values).all() and (values <= found.output.upper[:, None]).all()
        for layer, seen in zip(layers, found.bounds, strict=True):
            room = 1e-13 * (1 + np.abs(points))
            assert (seen.lower[:, None] <= points + room).all() and (points <= seen.upper[:, None] + room).all()
            points = forward((layer,), points)


@pytest.mark.parametrize("kind", (*KINDS, "mixed"))
def test_exact_outputs_are_between_the_linear_bounds_without_any_tolerance(kind: str) -> None:
    """At points, where nothing but rounding is between the bounds, of networks that cancel."""
    for seed, scale in product(range(3), (1.0, 1e4)):
        layers = layers_of(kind, seed, scale=scale)
        z = from_box(*2 * [inputs_of(seed, 1.0, batch=5).center])
        found = backward_bounds(layers, z)
        for cell, point in enumerate(z.center):
            with ctx.workprec(200):
                exact = real_forward(layers, point)
                column = arb_mat(len(point), 1, point.tolist())
                for matrix, offset, side in (
                    (found.lower_matrix, found.lower_offset, 1),
                    (found.upper_matrix, found.upper_offset, -1),
                ):
                    moved = (arb_mat(matrix[cell].tolist()) * column).entries()
                    for a, b, value in zip(moved, offset[cell].tolist(), exact, strict=True):
                        assert side * (a + arb(b)) <= side * value


def test_products_of_layers_that_cancel_are_enclosed_without_any_tolerance() -> None:
    """What float64 leaves out of the product of two layers is all that there is."""
    generator, point = np.random.default_rng(8), np.array([[997.0]])
    relu, zero = Activation("relu"), np.zeros(60)
    for _ in range(20):
        inner, outer = generator.uniform(1, 2, size=(60, 1)), generator.normal(size=(1, 60))
        outer[0, -1] = -(outer[0, :-1] @ inner[:-1, 0]) / inner[-1, 0]
        layers = (Affine(np.eye(1), zero[:1]), relu, Affine(inner, zero), relu, Affine(outer, zero[:1]))
        found = backward_bounds(layers, from_box(point, point))
        with ctx.workprec(300):
            (exact,) = real_forward(layers, point[0])
            for matrix, offset, side in (
                (found.lower_matrix, found.lower_offset, 1),
                (found.upper_matrix, found.upper_offset, -1),
            ):
                bound = arb(float(matrix[0, 0, 0])) * arb(997) + arb(float(offset[0, 0]))
                assert side * bound <= side * exact


@pytest.mark.parametrize(("kind", "size"), CASES, ids=str)
def test_the_checker_proves_the_lines_and_finds_its_ranges_within(kind: str, size: float) -> None:
    for seed, scale in product(range(3), (1.3, 1e3)):
        layers, z = layers_of(kind, seed, scale=scale), inputs_of(seed, size)
        found = backward_bounds(layers, z)
        for cell in range(z.batch):
            with ctx.workprec(64):
                form = Backward(seen_of(z, cell), [two_lines(lines, cell) for lines in found.lines])
                follows = False
                for layer, seen in zip(checked(layers), found.bounds, strict=True):
                    low, high = form.bounds()
                    if isinstance(layer, CheckedActivation) or not follows:
                        assert all(map(arb.__le__, map(arb, seen.lower[cell].tolist()), low))
                        assert all(map(arb.__ge__, map(arb, seen.upper[cell].tolist()), high))
                    if follows := isinstance(layer, CheckedActivation):
                        form.activate(layer, low, high)
                    else:
                        form.affine(layer)
                low, high = form.bounds()
                assert all(map(arb.__le__, map(arb, found.output.lower[cell].tolist()), low))
                assert all(map(arb.__ge__, map(arb, found.output.upper[cell].tolist()), high))


@pytest.mark.parametrize(("kind", "size"), CASES, ids=str)
def test_another_program_computes_the_same_bounds_from_the_same_lines(kind: str, size: float) -> None:
    layers, z = layers_of(kind), inputs_of(0, size)
    found = backward_bounds(layers, z)
    for cell in range(z.batch):
        waiting = iter(found.lines)
        seen = Observed(z.center[cell], z.generators[cell].T, z.generators.shape[1], z.radius[cell], 0 * z.radius[cell])
        policy: Any = SimpleNamespace(layers=checked(layers), deployment=None, bounds=())
        other = Crown(policy, seen, None, lambda *_, w=waiting, c=cell: two_lines(next(w), c))
        for side, ours in (
            (other.lower, (found.lower_matrix, found.lower_offset)),
            (other.upper, (found.upper_matrix, found.upper_offset)),
        ):
            for theirs, mine in zip(side, ours, strict=True):
                assert np.allclose(theirs, mine[cell], rtol=1e-9, atol=1e-9)
        assert np.allclose(other.range(), (found.output.lower[cell], found.output.upper[cell]), rtol=1e-9, atol=1e-9)
        kinds = [i for i, layer in enumerate(layers) if isinstance(layer, Activation)]
        for (low, high), place in zip(other.ranges, kinds, strict=True):
            assert np.allclose(low, found.bounds[place].lower[cell], rtol=1e-9, atol=1e-9)
            assert np.allclose(high, found.bounds[place].upper[cell], rtol=1e-9, atol=1e-9)


@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("part", ["weight", "bias"])
def test_layers_whose_numbers_are_known_up_to_an_error_are_enclosed_for_all_of_them(kind: str, part: str) -> None:
    generator = np.random.default_rng(7)
    z = inputs_of(7, 1e-6)
    known = layers_of(kind, 7)
    errors = [{f"{part}_error": 0.01 * np.ones_like(getattr(x, part))} if isinstance(x, Affine) else {} for x in known]
    layers = [replace(layer, **error) for layer, error in zip(known, errors, strict=True)]
    found = backward_bounds(layers, z).output
    for _ in range(50):
        member = []
        for layer in known:
            if isinstance(layer, Affine):
                moved = getattr(layer, part) + 0.01 * np.sign(generator.normal(size=getattr(layer, part).shape))
                layer = replace(layer, **{part: moved})
            member.append(layer)
        values = forward(tuple(member), points_of(z, 20))
        assert (found.lower[:, None] <= values).all() and (values <= found.upper[:, None]).all()


def remembered(lines: tuple[Lines, ...]) -> Choice:
    return lambda position, *_: lines[position]


@pytest.mark.parametrize("kind", (*KINDS, "mixed"))
def test_with_the_same_lines_smaller_inputs_have_smaller_bounds(kind: str) -> None:
    layers, z = layers_of(kind), inputs_of(0, 0.5)
    whole = backward_bounds(layers, z)
    smaller = Zonotope(z.center, 0.5 * z.generators, 0.25 * z.radius)
    part = backward_bounds(layers, smaller, remembered(whole.lines))
    for outer, inner in zip((*whole.bounds, whole.output), (*part.bounds, part.output), strict=True):
        assert (outer.lower <= inner.lower).all() and (inner.upper <= outer.upper).all()
    assert (part.output.upper - part.output.lower < whole.output.upper - whole.output.lower)[:-1].all()


@pytest.mark.parametrize("kind", (*KINDS, "mixed"))
def test_a_cell_has_the_same_bounds_in_every_batch(kind: str) -> None:
    layers, z = layers_of(kind), inputs_of(2, 0.5, batch=6)
    together = backward_bounds(layers, z)
    for cell in range(6):
        alone = backward_bounds(layers, z[cell : cell + 1])
        for name in ("lower_matrix", "lower_offset", "upper_matrix", "upper_offset"):
            assert np.allclose(getattr(together, name)[cell], getattr(alone, name)[0], rtol=1e-12, atol=1e-13)


@pytest.mark.parametrize("kind", (*KINDS, "mixed"))
@pytest.mark.parametrize("field", ["center", "generators", "radius"])
@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_inputs_that_are_no_numbers_prove_nothing_and_harm_no_other_cell(kind: str, field: str, value: float) -> None:
    layers, z = layers_of(kind), inputs_of(0, 0.5)
    getattr(z, field)[1].flat[0] = value
    found = backward_bounds(layers, z)
    for proved in (found.lower_offset, found.upper_offset, found.output.lower, found.output.upper):
        assert not np.isfinite(proved[1]).any() and np.isfinite(np.delete(proved, 1, 0)).all()


@pytest.mark.parametrize("kind", (*KINDS, "mixed"))
def test_a_line_that_is_no_number_proves_nothing(kind: str) -> None:
    layers, z = layers_of(kind), inputs_of(0, 0.5)

    def broken(position: int, activation: Activation, low: Array, high: Array) -> Lines:
        lines = usual(position, activation, low, high)
        lines.lower_offset[1], lines.upper_offset[1] = np.nan, np.nan
        return lines

    found = backward_bounds(layers, z, broken)
    assert not np.isfinite(np.stack([found.lower_offset[1], found.upper_offset[1]])).any()


@pytest.mark.parametrize("kind", KINDS)
def test_the_usual_lines_are_closer_than_flat_ones(kind: str) -> None:
    generator = np.random.default_rng(3)
    low, high = np.sort(2 * generator.normal(size=(2, 1, 500)), axis=0)
    activation = activation_of(kind)
    usual_, flat = usual_lines(activation, low, high), lines_with(activation, 0 * low, 0 * low, low, high)

    def area(lines: Lines) -> Array:
        slope, offset = lines.upper_slope - lines.lower_slope, lines.upper_offset - lines.lower_offset
        return (high - low) * (0.5 * slope * (low + high) + offset)

    assert (area(usual_) <= area(flat) * (1 + 1e-9) + 1e-12).all()
    assert area(usual_).sum() < 0.5 * area(flat).sum()


@pytest.mark.parametrize("kind", ["tanh", "sigmoid"])
def test_no_line_leaves_less_in_the_middle_of_the_range_of_a_smooth_activation(kind: str) -> None:
    activation = activation_of(kind)
    low, high = np.sort(3 * np.random.default_rng(4).normal(size=(2, 1, 200)), axis=0)
    slopes = np.linspace(0.0, 1.0, 801)[:, None] * np.ones_like(low)
    lines, others = usual_lines(activation, low, high), lines_with(activation, slopes, slopes, low, high)
    middle = 0.5 * (low + high)
    below = others.lower_slope * middle + others.lower_offset
    above = others.upper_slope * middle + others.upper_offset
    assert (lines.lower_slope * middle + lines.lower_offset >= below - 1e-12).all()
    assert (lines.upper_slope * middle + lines.upper_offset <= above + 1e-12).all()
