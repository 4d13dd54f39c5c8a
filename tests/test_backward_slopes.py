"""The search for slopes: it never ends with more than it began with, and follows the true gradient."""

from __future__ import annotations

from itertools import product
from typing import Any

import numpy as np
import pytest
from loops import network
from test_backward import KINDS, inputs_of, layers_of

from setrl.models.policy import forward
from setrl.verify import backward_slopes
from setrl.verify.backward import BackwardBounds, backward_bounds, usual
from setrl.verify.backward_lines import Lines, lines_with, sensible_slopes
from setrl.verify.backward_slopes import chosen, searched_slopes
from setrl.verify.network import enclose_layers
from setrl.verify.zonotope import Zonotope, unbox

Array = Any
ACTIVATIONS = (*KINDS, "mixed")
OBJECTIVES = ("width", "gap")


def left(found: BackwardBounds, z: Zonotope, objective: str) -> Array:
    """Per cell and output."""
    if objective == "width":
        return found.output.upper - found.output.lower
    between = found.upper_matrix - found.lower_matrix
    middle = (between @ z.center[:, :, None])[:, :, 0] + found.upper_offset - found.lower_offset
    reach = np.abs(between @ np.swapaxes(z.generators, 1, 2)).sum(2)
    return middle + reach + (np.abs(between) @ z.radius[:, :, None])[:, :, 0]


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("kind", ACTIVATIONS)
def test_the_search_never_ends_with_more_than_it_began_with(kind: str, objective: Any) -> None:
    for seed, size in enumerate((1e-6, 0.05, 0.5, 3.0)):
        layers, z = layers_of(kind, seed), inputs_of(seed, size)
        first = left(backward_bounds(layers, z), z, objective)
        other = left(backward_bounds(layers, z, backward_slopes._parallel), z, objective)
        found = left(backward_bounds(layers, z, chosen(searched_slopes(layers, z, objective))), z, objective)
        unit = np.where(first > 1e-11, first, np.inf)
        for beginning in (first, other):
            assert ((found / unit).sum(1) <= (beginning / unit).sum(1) * (1 + 1e-6) + 1e-6).all()


@pytest.mark.parametrize("kind", ACTIVATIONS)
def test_bounds_with_searched_slopes_enclose(kind: str) -> None:
    for seed, objective in enumerate(OBJECTIVES):
        layers, z = layers_of(kind, seed), inputs_of(seed, 1.0)
        found = backward_bounds(layers, z, chosen(searched_slopes(layers, z, objective)))
        generator = np.random.default_rng(seed)
        factors = np.sign(generator.normal(size=(z.batch, 2000, z.generators.shape[1])))
        points = z.center[:, None] + factors @ z.generators
        points = points + z.radius[:, None] * generator.uniform(-1, 1, size=points.shape)
        values = forward(layers, points)
        below = points @ np.swapaxes(found.lower_matrix, 1, 2) + found.lower_offset[:, None]
        above = points @ np.swapaxes(found.upper_matrix, 1, 2) + found.upper_offset[:, None]
        assert (below <= values + 1e-12).all() and (values <= above + 1e-12).all()


@pytest.mark.parametrize("objective", OBJECTIVES)
@pytest.mark.parametrize("kind", KINDS)
@pytest.mark.parametrize("hidden", [[], [7]], ids=str)
def test_the_smallest_move_of_any_one_slope_does_what_the_gradient_says(
    hidden: list[int], kind: str, objective: Any
) -> None:
    """Of the last hidden layer, on whose slopes no range depends; from slopes where the score has no bend."""
    layers = network([3, *hidden, 8, 2], [kind] * len(hidden) + [kind, "none"], 5, 1.3).layers
    z, generator = inputs_of(5, 1.0)[:3], np.random.default_rng(6)
    parts = [generator.uniform(0.1, 0.9, size=(2, z.batch, size)) for size in (*hidden, 8)]

    def anywhere(position: int, activation: Any, low: Array, high: Array) -> Lines:
        ends = sensible_slopes(activation, low, high)
        slopes = [a + part * (b - a) for (a, b), part in zip(ends, parts[position], strict=True)]
        return lines_with(activation, *slopes, low, high)

    trial = backward_slopes._trial(layers, z, anywhere, objective, None)
    count = 0
    for side, neuron in product((0, 1), range(8)):
        slopes = [array.copy() for array in trial.slopes[-1]]
        slopes[side][:, neuron] += 1e-5 * trial.moves[-1][side][:, neuron]
        after = backward_slopes._trial(
            layers, z, chosen([*trial.slopes[:-1], (slopes[0], slopes[1])]), objective, trial.unit
        )
        changed = np.abs(slopes[side] - trial.slopes[-1][side])[:, neuron] > 0.0
        count += changed.sum()
        assert not (changed & (after.score > trial.score + 1e-12)).any()
    assert count >= 4


@pytest.mark.parametrize("kind", ["relu", "leaky_relu", "tanh"])
def test_on_wide_sets_a_search_leaves_clearly_less_than_zonotopes_and_usual_lines(kind: str) -> None:
    layers, z = layers_of(kind, 1), inputs_of(1, 1.5, batch=30)
    zonotope = 2.0 * enclose_layers(layers, z).output.spread
    usual_ = left(backward_bounds(layers, z, usual), z, "width")
    found = left(backward_bounds(layers, z, chosen(searched_slopes(layers, z, "width"))), z, "width")
    assert found.sum() < 0.95 * min(zonotope.sum(), usual_.sum())


def test_parallel_lines_of_the_chord_are_the_zonotope_of_a_relu_network() -> None:
    layers, z = layers_of("relu", 2), unbox(inputs_of(2, 0.5, batch=10))
    found = backward_bounds(layers, z, backward_slopes._parallel).output
    interval = enclose_layers(layers, z).output.interval
    assert np.allclose(found.lower, interval.lower, rtol=1e-9, atol=1e-9)
    assert np.allclose(found.upper, interval.upper, rtol=1e-9, atol=1e-9)


def test_a_cell_that_is_no_number_does_not_change_the_others() -> None:
    layers, z = layers_of("relu"), inputs_of(0, 0.5)
    alone = searched_slopes(layers, z, "gap")
    z.center[1, 0] = np.nan
    with np.errstate(all="ignore"):
        beside = searched_slopes(layers, z, "gap")
    for one, two in zip(alone, beside, strict=True):
        for a, b in zip(one, two, strict=True):
            assert np.allclose(np.delete(a, 1, 0), np.delete(b, 1, 0), rtol=1e-9, atol=1e-9)
