"""The drawing of a flowpipe contains what it draws, is small, and holds finite numbers only."""

from __future__ import annotations

import json
import math
import subprocess
import sys
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import report_cases as reports
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from setrl.verify.certification.reports.picture import picture_of
from setrl.verify.certification.reports.picture_boxes import Grid, boxes_in_plane, boxes_over_time, truncated_at
from setrl.verify.result import Flowpipe

ROOT = Path(__file__).resolve().parents[1]
Array = NDArray[np.float64]


def random_boxes(cells: int, parts: int, seed: int = 0) -> Array:
    generator = np.random.default_rng(seed)
    steps = generator.normal(0.0, 0.05, (cells, parts, 2)).cumsum(axis=1)
    size = generator.uniform(0.001, 0.05, (cells, parts, 2))
    return np.stack([steps - size, steps + size], axis=2)


def flowpipe_of(bounds: Array) -> Flowpipe:
    cells, parts = bounds.shape[:2]
    nothing = np.full((cells, 1, parts + 1), np.nan)
    return Flowpipe(0.1, ("x", "y"), np.concatenate([bounds[:, :1], bounds], axis=1), bounds, nothing)


@given(st.floats(-1e6, 1e6), st.floats(1e-3, 1e6), st.floats(-1.0, 2.0, allow_nan=False), st.floats(-1e300, 1e300))
def test_a_bound_is_rounded_outward(low: float, span: float, share: float, far: float) -> None:
    grid = Grid.of(low, low + span)
    value = min(max(low + share * span, grid.least), grid.most)
    unit = Fraction(10) ** -grid.digits
    assert Fraction(value) - 2 * unit <= Fraction(grid.low(value)) <= Fraction(value)
    assert Fraction(value) <= Fraction(grid.high(value)) <= Fraction(value) + 2 * unit
    assert span / 20_000 <= float(unit) <= span / 900
    assert grid.least - 2 * float(unit) <= grid.low(far) <= grid.high(far) <= grid.most + 2 * float(unit)


@pytest.mark.parametrize("digits", [-2, 0, 1, 3, 5])
def test_a_bound_just_beside_a_decimal_is_rounded_outward_too(digits: int) -> None:
    grid = Grid(digits, -1e6, 1e6)
    for units in range(-500, 500):
        decimal = float(Fraction(units) / Fraction(10) ** digits)
        for value in (decimal, math.nextafter(decimal, -math.inf), math.nextafter(decimal, math.inf)):
            assert grid.low(value) <= value <= grid.high(value)


@pytest.mark.parametrize(("cells", "parts"), [(1, 10), (1, 599), (1, 2000), (40, 40), (200, 60)])
def test_every_point_of_every_box_is_in_a_box_that_is_drawn(cells: int, parts: int) -> None:
    bounds = random_boxes(cells, parts)
    low, high = bounds[:, :, 0].min((0, 1)), bounds[:, :, 1].max((0, 1))
    grids = [Grid.of(a, b) for a, b in zip(low, high, strict=True)]
    drawn = np.array(boxes_in_plane(bounds, grids))
    assert len(drawn) <= 600
    generator = np.random.default_rng(1)
    flat = bounds.reshape(-1, 2, 2)[generator.integers(0, cells * parts, 500)]
    for share in (np.zeros((500, 2)), np.ones((500, 2)), generator.uniform(size=(500, 2))):
        points = flat[:, 0] + share * (flat[:, 1] - flat[:, 0])
        inside = (drawn[None, :, :2] <= points[:, None]) & (points[:, None] <= drawn[None, :, 2:])
        assert inside.all(axis=2).any(axis=1).all()


def test_strips_add_no_more_than_their_height() -> None:
    bounds = random_boxes(100, 60)
    low, high = bounds[:, :, 0].min((0, 1)), bounds[:, :, 1].max((0, 1))
    grids = [Grid.of(a, b) for a, b in zip(low, high, strict=True)]
    flat = bounds.reshape(-1, 2, 2)
    drawn = [box for box in boxes_in_plane(bounds, grids) if low[1] < (box[1] + box[3]) / 2 < high[1]]  # what is seen
    slack = max(top - bottom for _, bottom, _, top in drawn)
    assert slack < (high - low)[1] / 40
    for left, bottom, right, top in drawn:
        x, y = (left + right) / 2, (bottom + top) / 2
        near = (flat[:, 0] - slack <= (x, y)) & ((x, y) <= flat[:, 1] + slack)
        assert near.all(axis=1).any()


@pytest.mark.parametrize(("cells", "parts", "most"), [(1, 50, 600), (30, 200, 100), (3, 1000, 300)])
def test_every_bound_over_time_is_in_a_box_that_is_drawn(cells: int, parts: int, most: int) -> None:
    bounds = random_boxes(cells, parts)
    grid = Grid.of(bounds[..., 0].min(), bounds[..., 0].max())
    drawn = np.array(boxes_over_time(flowpipe_of(bounds), 0, grid, False, most))
    width = 0.1
    for cell in range(cells):
        for part in range(0, parts, 7):
            middle = (part + 0.5) * width
            there = drawn[(drawn[:, 0] <= middle) & (middle <= drawn[:, 2])]
            low, high = bounds[cell, part, :, 0]
            assert ((there[:, 1] <= low) & (high <= there[:, 3])).any()


def test_what_is_not_finite_is_left_out_and_the_time_is_said() -> None:
    bounds = random_boxes(3, 20)
    bounds[1, 12:] = np.nan
    bounds[2, 15:, 1] = np.inf
    flowpipe = flowpipe_of(bounds)
    assert truncated_at(flowpipe, False) == pytest.approx(1.2)
    assert truncated_at(flowpipe_of(bounds[:1]), False) is None
    grids = [Grid.of(-1.0, 1.0)] * 2
    for found in (boxes_in_plane(bounds, grids), boxes_over_time(flowpipe, 0, grids[0], False, 600)):
        assert found and all(math.isfinite(number) for box in found for number in box)


def test_a_flowpipe_without_a_cell_has_no_boxes() -> None:
    empty = np.zeros((0, 10, 2, 2))
    assert boxes_in_plane(empty, [Grid.of(0.0, 1.0)] * 2) == []
    assert boxes_over_time(flowpipe_of(empty), 0, Grid.of(0.0, 1.0), False, 600) == []
    assert truncated_at(flowpipe_of(empty), False) is None


CASES = [
    ("quadrotor1d-set", "quadrotor1d", "times"),
    ("navigation-set", "navigation", "plane"),
    ("quadrotor2d-set", "quadrotor2d", "times"),
]


def numbers(data: Any) -> list[float]:
    if isinstance(data, dict):
        return [number for entry in data.values() for number in numbers(entry)]
    if isinstance(data, list):
        return [number for entry in data for number in numbers(entry)]
    return [data] if isinstance(data, float) else []


@pytest.mark.parametrize(("policy", "specification", "kind"), CASES)
def test_a_picture_of_a_real_result_is_small_finite_and_contains_the_flowpipe(
    policy: str, specification: str, kind: str
) -> None:
    result = reports.real(policy, specification)
    picture = picture_of(result)
    assert picture["kind"] == kind
    assert len(json.dumps(picture, allow_nan=False)) < 25_000
    assert all(math.isfinite(number) for number in numbers(picture))
    assert (picture["witness"] is not None) == (result.witness is not None)
    if kind == "times":
        for state, panel in enumerate(picture["panels"]):
            low, high = panel["view"]
            bounds = np.clip(result.flowpipe.intervals[0, :, :, state], low, high)
            width = 3.0 / len(bounds)
            for part, (lower, upper) in enumerate(bounds.tolist()):
                middle = (part + 0.5) * width
                (box,) = [box for box in panel["boxes"] if box[0] < middle < box[2]]
                assert box[1] <= lower and upper <= box[3]


def test_a_witness_is_marked_where_it_violates_the_requirement() -> None:
    result = reports.real("quadrotor2d-set", "quadrotor2d")
    picture = picture_of(result)
    assert result.candidate is not None
    witness = picture["witness"]
    assert witness["time"] == pytest.approx(result.candidate.time, abs=0.02)
    assert len(witness["times"]) <= 200
    at = witness["mark"]
    outside = [abs(panel["path"][at]) > 1.0 for panel in picture["panels"] if panel["name"] in ("x", "z")]
    assert any(outside)


def test_drawing_needs_no_matplotlib() -> None:
    code = (
        "import sys, setrl.verify.certification.reports.files, setrl.verify.certification.reports.picture; "
        "assert not {'matplotlib', 'torch', 'ray'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, env={"PYTHONPATH": str(ROOT / ".src")})
