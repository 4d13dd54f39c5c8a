"""Every law of the linear bounds fails on bounds that break its theorem: each mutation is a bug, planted on purpose."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
import test_backward as laws
from test_teeth import Tooth, method, wrapped

from setrl.verify import backward, backward_lines, relaxations

pytestmark = pytest.mark.slow
"""They are about the laws, which the default suite runs; `make test-slow` shows that the laws have teeth."""


def no_room(link: Any, layer: Any, size: Any, room: Any) -> Any:
    return link(layer, size, 0.0 * room)


def no_error(ball: Any, mid: Any, rad: Any) -> Any:
    return ball(mid, 0.0 * rad)


def narrower(bounds: Any, low: Any, high: Any) -> Any:
    return bounds(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)


def exactly(bounds: Any, low: Any, high: Any) -> Any:
    """Ranges without room, and a last digit too narrow."""
    return bounds(low + 4e-16 * np.abs(low), high - 4e-16 * np.abs(high))


def exchanged(lines_with: Any, *arguments: Any) -> Any:
    lines = lines_with(*arguments)
    return replace(
        lines,
        lower_slope=lines.upper_slope,
        lower_offset=lines.upper_offset,
        upper_slope=lines.lower_slope,
        upper_offset=lines.lower_offset,
    )


def turned(lines_with: Any, *arguments: Any) -> Any:
    lines = lines_with(*arguments)
    return replace(lines, lower_slope=-lines.lower_slope)


def through_zero(residual_bounds: Any, *arguments: Any) -> Any:
    """Both offsets as if every line met its function in the middle."""
    low, high = residual_bounds(*arguments)
    return 0.5 * (low + high), 0.5 * (low + high)


def without_box(unbox: Any, z: Any) -> Any:
    return replace(z, radius=0.0 * z.radius)


def of_the_first_cell(lower_functions: Any, chain: Any, *rest: Any) -> Any:
    matrix, offset = lower_functions(chain, *rest)
    return np.broadcast_to(matrix[:1], matrix.shape), offset


def finite(ball: Any, mid: Any, rad: Any) -> Any:
    return ball(np.nan_to_num(mid), np.nan_to_num(rad, posinf=0.0))


def wrong_image(image: Any, activation: Any, low: Any, high: Any) -> Any:
    return image(activation, 0.5 * low, 0.5 * high)


def no_residual_error(error: Any, *arguments: Any) -> Any:
    return 0.0 * error(*arguments)


def usual_of_relu(usual_slopes: Any, activation: Any, low: Any, high: Any) -> Any:
    return 0.0 * low, 0.0 * low


def enclose(kind: str = "relu", size: float = 0.5) -> Any:
    return lambda: laws.test_every_output_is_between_the_linear_bounds(kind, size)


def exact(kind: str = "relu") -> Any:
    return lambda: laws.test_exact_outputs_are_between_the_linear_bounds_without_any_tolerance(kind)


def checker(kind: str = "relu", size: float = 0.5) -> Any:
    return lambda: laws.test_the_checker_proves_the_lines_and_finds_its_ranges_within(kind, size)


TEETH = [
    Tooth("rounding of matrices dropped", wrapped(backward, "Link", no_room), exact()),
    Tooth("all rounding dropped", wrapped(backward, "Ball", no_error), exact()),
    Tooth("ranges too narrow", wrapped(backward, "LayerBounds", narrower), enclose("tanh")),
    Tooth("ranges without room", wrapped(backward, "LayerBounds", exactly), checker("mixed", 1e-6)),
    Tooth("lines exchanged", wrapped(backward_lines, "lines_with", exchanged), enclose("sigmoid")),
    Tooth("sign of lower slopes", wrapped(backward_lines, "lines_with", turned), enclose("leaky_relu")),
    Tooth("residuals forgotten", wrapped(backward_lines, "residual_bounds", through_zero), enclose("clip")),
    Tooth("box of the inputs dropped", wrapped(backward, "unbox", without_box), enclose("relu", 3.0)),
    Tooth(
        "every cell has the first one's functions",
        method(backward.Chain, "lower_functions", of_the_first_cell),
        lambda: laws.test_a_cell_has_the_same_bounds_in_every_batch("relu"),
    ),
    Tooth(
        "what is no number becomes one",
        wrapped(backward, "Ball", finite),
        lambda: laws.test_a_line_that_is_no_number_proves_nothing("relu"),
    ),
    Tooth("image of another range", wrapped(backward, "image", wrong_image), enclose("mixed")),
    Tooth(
        "rounding of residuals dropped",
        wrapped(relaxations.rounding, "relative_error", no_residual_error),
        lambda: laws.test_what_any_slope_leaves_is_bounded_from_outside_and_closely("leaky_relu"),
    ),
    Tooth(
        "flat lines",
        wrapped(backward_lines, "usual_slopes", usual_of_relu),
        lambda: laws.test_the_usual_lines_are_closer_than_flat_ones("relu"),
    ),
]


@pytest.mark.parametrize("tooth", TEETH, ids=str)
def test_the_law_notices(tooth: Tooth) -> None:
    tooth.law()
    with pytest.MonkeyPatch.context() as patch:
        tooth.mutate(patch)
        with pytest.raises(AssertionError):
            tooth.law()
