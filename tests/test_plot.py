"""Pictures show what the specification says and what was found; the same result gives the same file."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import EXAMPLE, HOPELESS, QUICK
from matplotlib.collections import LineCollection, PolyCollection
from matplotlib.figure import Figure

import setrl
from setrl.models.closed_loop import BoundPolytope
from setrl.models.rollouts import roll_out
from setrl.specs.errors import InputError, UsageError
from setrl.specs.reader import parse_specification
from setrl.verify.options import Options
from setrl.verify.plot import plot_result, plot_sweep, plot_trajectories
from setrl.verify.plot_regions import bounds_only, interval, polygon, view_of
from setrl.verify.result import Result

PLANE = (
    QUICK.split("requirements:")[0]
    + """\
requirements:
  - avoid: {z: [0.5, 0.6], zdot: [0.5, 0.6]}
    name: obstacle
  - stay: "z + zdot <= 3"
    name: fence
    during: [0.1, 0.3]
  - reach: {z: [-0.4, 0.4], zdot: [-1, 1]}
    name: goal
"""
)
VIEW = np.array([[0.0, 0.0], [4.0, 2.0]])


def verified(text: str, **options: Any) -> Result:
    result: Result = setrl.verify(EXAMPLE, parse_specification(text, "test.yaml"), options=Options(**options))
    return result


@pytest.fixture(scope="module")
def over_time() -> Result:
    return verified(QUICK)


@pytest.fixture(scope="module")
def in_plane() -> Result:
    return verified(PLANE)


def texts(figure: Figure) -> str:
    found = [text.get_text() for axes in figure.axes for text in axes.texts]
    return "\n".join([*found, figure.get_suptitle()])


def polytope(rows: list[list[int]], bounds: list[int]) -> BoundPolytope:
    normals = tuple(tuple(Fraction(entry) for entry in row) for row in rows)
    return BoundPolytope(normals, tuple(Fraction(bound) for bound in bounds), ("",) * len(bounds))


def test_two_named_states_are_drawn_as_a_plane(in_plane: Result) -> None:
    figure = plot_result(in_plane)
    (axes,) = figure.axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("z (m)", "zdot (m/s)")
    assert all(name in texts(figure) for name in ("obstacle", "fence 0.1-0.3 s", "goal at 0.5 s", "start"))
    assert in_plane.verdict.value in figure.get_suptitle()


def test_other_specifications_are_drawn_over_time(over_time: Result) -> None:
    figure = plot_result(over_time)
    assert [axes.get_ylabel() for axes in figure.axes] == ["z (m)", "zdot (m/s)"]
    assert figure.axes[-1].get_xlabel() == "time (s)"
    assert "altitude" in texts(figure)


def test_a_plane_can_be_chosen(over_time: Result) -> None:
    (axes,) = plot_result(over_time, states=("zdot", "z")).axes
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("zdot (m/s)", "z (m)")


@pytest.mark.parametrize("states", [("z", "z"), ("z", "w"), ("z",)])
def test_a_plane_of_other_than_two_states_is_an_error_that_lists_them(states: Any, over_time: Result) -> None:
    with pytest.raises(UsageError, match="z, zdot"):
        plot_result(over_time, states=states)


def test_every_box_of_the_flowpipe_is_drawn_where_it_is(in_plane: Result) -> None:
    (axes,) = plot_result(in_plane).axes
    drawn = [part for part in axes.collections if isinstance(part, PolyCollection)]
    corners = np.array([path.vertices[:4] for path in drawn[0].get_paths()])
    bounds = in_plane.flowpipe.intervals.reshape(-1, 2, 2)
    assert np.array_equal(corners.min(axis=1), bounds[:, 0]) and np.array_equal(corners.max(axis=1), bounds[:, 1])


def test_simulated_trajectories_lie_in_the_drawn_boxes(in_plane: Result) -> None:
    paths = roll_out(in_plane.loop, 24, "corner", np.random.default_rng(0)).period_ends
    lower, upper = in_plane.flowpipe.points[:, 1:, 0].min(axis=0), in_plane.flowpipe.points[:, 1:, 1].max(axis=0)
    assert (lower <= paths).all() and (paths <= upper).all()


def test_the_same_result_gives_the_same_bytes(in_plane: Result, tmp_path: Path) -> None:
    for suffix in ("png", "pdf", "svg"):
        plot_result(in_plane, str(tmp_path / f"a.{suffix}"))
        plot_result(in_plane, str(tmp_path / f"b.{suffix}"))
        assert (tmp_path / f"a.{suffix}").read_bytes() == (tmp_path / f"b.{suffix}").read_bytes()


@pytest.mark.parametrize("name", ["a.gif", "a", "a.PNG.txt"])
def test_a_format_that_cannot_be_written_is_an_error_that_names_those_that_can(
    name: str, over_time: Result, tmp_path: Path
) -> None:
    with pytest.raises(InputError, match=r"\.png, \.pdf, \.svg"):
        plot_result(over_time, str(tmp_path / name))
    assert list(tmp_path.iterdir()) == []


def test_a_flowpipe_that_explodes_does_not_hide_the_rest() -> None:
    result = verified(HOPELESS, splits=1)
    low, high = plot_result(result).axes[0].get_ylim()
    reached = np.nanmax(np.abs(result.flowpipe.points[..., 0]))
    assert -25 < low < -5 and 5 < high < 25
    assert reached > 0


def test_a_flowpipe_that_ended_early_is_drawn_as_far_as_it_goes(over_time: Result) -> None:
    from dataclasses import replace

    points, intervals = over_time.flowpipe.points.copy(), over_time.flowpipe.intervals.copy()
    points[:, 3:], intervals[:, 2:] = np.nan, np.inf
    figure = plot_result(replace(over_time, flowpipe=replace(over_time.flowpipe, points=points, intervals=intervals)))
    boxes = [part for part in figure.axes[0].collections if isinstance(part, PolyCollection)]
    assert len(boxes[0].get_paths()) == 2
    assert any(isinstance(part, LineCollection) for part in figure.axes[0].collections)


def test_a_candidate_is_drawn_where_it_violates() -> None:
    result = verified(QUICK.replace("[-1, 1]", "[-0.05, 0.05]"))
    assert result.candidate is not None
    figure = plot_result(result)
    marks = [line for line in figure.axes[0].lines if line.get_marker() == "X"]
    assert len(marks) == 1 and marks[0].get_xdata()[0] == pytest.approx(result.candidate.time)


def test_a_sweep_marks_what_is_verified(tmp_path: Path) -> None:
    specification = tmp_path / "test.yaml"
    specification.write_text(QUICK)
    results = setrl.verify_radii(EXAMPLE, specification, ["0", "5"], options=Options(splits=1))
    figure = plot_sweep([0.0, 5.0], results, str(tmp_path / "a.png"))
    assert "VERIFIED for 1 of 2 radii" in figure.get_suptitle()
    assert [axes.get_ylabel() for axes in figure.axes] == ["V(s0), lower bound", "margin"]


def test_trajectories_are_all_drawn(over_time: Result) -> None:
    run = roll_out(over_time.loop, 5, "uniform", np.random.default_rng(0))
    figure = plot_trajectories(over_time.loop, run)
    thin = [line for line in figure.axes[0].lines if len(line.get_xdata()) == len(run.times)]
    assert len(thin) == 5 and "5 trajectories" in figure.get_suptitle()


def test_pictures_need_no_display_and_no_global_state() -> None:
    import subprocess
    import sys

    code = "import sys, setrl.verify.plot; print('matplotlib.pyplot' in sys.modules, 'matplotlib' in sys.modules)"
    root = Path(__file__).resolve().parents[1]
    outcome = subprocess.run(
        [sys.executable, "-c", code], env={"PYTHONPATH": str(root / ".src")}, capture_output=True, text=True, check=True
    )
    assert outcome.stdout == "False False\n"


def test_a_polytope_in_a_plane_is_cut_at_the_view() -> None:
    corners = polygon(polytope([[1, 0], [-1, 0], [0, 1]], [3, -1, 1]), (0, 1), VIEW)
    assert (corners.min(axis=0) == [1, 0]).all() and (corners.max(axis=0) == [3, 1]).all()
    triangle = polygon(polytope([[1, 1]], [1]), (0, 1), VIEW)
    assert sorted(map(tuple, triangle.tolist())) == [(0, 0), (0, 1), (1, 0)]
    assert len(polygon(polytope([[1, 0]], [-1]), (0, 1), VIEW)) == 0


def test_a_facet_of_another_state_does_not_shape_the_picture() -> None:
    region = polytope([[1, 0, 0], [0, 0, 1]], [3, 7])
    assert not bounds_only(region, (0, 1)) and bounds_only(region, (0, 2))
    assert polygon(region, (0, 1), VIEW).max(axis=0).tolist() == [3, 2]
    assert interval(region, 2) == (-np.inf, 7.0) and interval(region, 1) == (-np.inf, np.inf)


def test_what_is_seen_contains_the_initial_set_and_every_bound(in_plane: Result) -> None:
    nothing = np.zeros((0, 2))
    low, high = view_of(in_plane.loop, nothing, nothing)
    assert (low <= [-0.4, -1]).all() and (high >= [0.6, 1]).all()
    far = view_of(in_plane.loop, np.array([[9.0, 0.0]]), np.array([[1e9, np.nan]]))
    assert 9 < far[1, 0] < 30
