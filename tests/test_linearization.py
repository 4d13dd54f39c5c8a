"""Conservative linearisation encloses every trajectory, and agrees with the jets method it is the test of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.integrate import solve_ivp
from scipy.linalg import expm
from scipy.optimize import linprog

from setrl.models.closed_loop import Plant
from setrl.models.example import EXAMPLE_SPECIFICATION, example_policy_path
from setrl.models.float_algebra import FloatAlgebra
from setrl.models.plant import compile_plant, load_plant, shipped_plants
from setrl.models.tape import run
from setrl.specs.expressions import parse_expression
from setrl.specs.specification import PlantDescription
from setrl.verify import balls, linearization
from setrl.verify.balls import Ball
from setrl.verify.flow import jet_step
from setrl.verify.integrator import integrate
from setrl.verify.linearization import LinearStep, linear_step
from setrl.verify.options import Options
from setrl.verify.series import map_jets
from setrl.verify.verifier import verify
from setrl.verify.zonotope import Zonotope

ORDER = 6
STEP = Fraction(1, 10)
ROUNDING = 1e-9
"""What DOP853 with rtol 1e-12 and float64 sums may be off by here."""
CENTERS = {
    "navigation": [3.0, 3.0, 0.7, 0.5, 0.3, -0.2],
    "pendulum": [2.0, 1.5, 0.1],
    "quadrotor1d": [-4.0, 0.5, 0.2],
    "quadrotor2d": [0.0, 0.1, 0.0, 0.2, 0.3, 0.8, 0.1, 0.12],
    "unicycle": [3.0, 3.0, 0.5, 0.7, 0.3, -0.2],
}


def custom_plant(**dynamics: str) -> Plant:
    """A plant without inputs, one equation per state."""
    return compile_plant(
        PlantDescription(
            name="custom",
            states=dict.fromkeys(dynamics, "1"),
            inputs={},
            disturbances={},
            parameters={},
            dynamics={state: parse_expression(text) for state, text in dynamics.items()},
            source="custom.yaml",
            lines=dict.fromkeys(dynamics, 1),
        )
    )


def example_set(name: str, size: float = 0.1, seed: int = 0) -> Zonotope:
    """A skewed set around a plant's center: as many generators as coordinates and two more."""
    generator = np.random.default_rng(seed)
    center = np.array([CENTERS[name]])
    dimension = center.shape[1]
    rows = np.concatenate([np.eye(dimension), 0.5 * generator.standard_normal((2, dimension))])
    return Zonotope(center, size * rows[None], np.full((1, dimension), 0.1 * size))


def box_set(center: list[float], radius: float) -> Zonotope:
    point = np.array([center])
    return Zonotope(point, radius * np.eye(point.shape[1])[None], np.zeros_like(point))


def directions(dimension: int, count: int = 70) -> Any:
    random = np.random.default_rng(7).standard_normal((count - 2 * dimension, dimension))
    return np.concatenate([np.eye(dimension), -np.eye(dimension), random])


def extremal_points(plant: Plant, z: Zonotope, duration: Fraction) -> Any:
    """Start points that are extremal in the directions that the linearised flow turns into `directions`."""
    states, dimension = len(plant.states), z.dimension
    rate = np.zeros((dimension, dimension))
    rate[:states] = map_jets(plant.tape, balls.exact(z.center), 1).mid[:, 0, 1:]
    points = []
    for time in (0.0, 0.5, 1.0):
        wanted = directions(states) @ expm(rate * time * float(duration))[:states]
        factors = np.sign(wanted @ z.generators[0].T)
        points.append(z.center[0] + factors @ z.generators[0] + np.sign(wanted) * z.radius[0])
    return np.concatenate(points)


def trajectories(plant: Plant, points: Any, times: Any) -> Any:
    """States (T, N, n) of DOP853 at rtol 1e-12, all start points as one system."""
    states = len(plant.states)
    constant = points[:, states:]

    def field(_: float, flat: Any) -> Any:
        x = np.concatenate([flat.reshape(-1, states), constant], 1)
        rates = run(plant.tape, FloatAlgebra(), list(x.T))
        return np.stack([np.broadcast_to(r, len(points)) for r in rates], 1).ravel()

    start, end = points[:, :states].ravel(), float(times[-1])
    solution = solve_ivp(field, (0.0, end), start, "DOP853", t_eval=times, rtol=1e-12, atol=1e-13)
    assert solution.success
    return solution.y.T.reshape(len(times), -1, states)


def violation(plant: Plant, step: LinearStep, slabs: int) -> float:
    """By how much trajectories leave the set at the end or the sets of time intervals, in any of 70 directions."""
    states = len(plant.states)
    parts = 8
    times = np.linspace(0.0, float(step.duration), slabs * parts + 1)
    paths = trajectories(plant, extremal_points(plant, step.start, step.duration), times)
    normals = directions(states)
    reached = (paths @ normals.T).max(1)
    worst = [float((reached[-1] - step.end.coordinates(slice(0, states)).support(normals)[0]).max())]
    for part, z in enumerate(step.time_intervals(slabs)):
        inside = reached[part * parts : (part + 1) * parts + 1].max(0)
        worst.append(float((inside - z.support(normals)[0]).max()))
    return max(worst)


def intersects(first: Zonotope, second: Zonotope) -> bool:
    """Whether two zonotopes (one cell each) have a common point, by a linear program in their factors."""
    columns = [np.concatenate([z.generators[0].T, np.diag(z.radius[0])], 1) for z in (first, second)]
    system = np.concatenate([columns[0], -columns[1]], 1)
    gap = second.center[0] - first.center[0]
    found = linprog(np.zeros(system.shape[1]), A_eq=system, b_eq=gap, bounds=(-1.0, 1.0), method="highs")
    return bool(found.status == 0)


def test_every_shipped_plant_is_tested() -> None:
    assert set(CENTERS) == set(shipped_plants())


@pytest.mark.parametrize("slabs", [1, 4])
@pytest.mark.parametrize("size", [0.0, 0.02, 0.2])
@pytest.mark.parametrize("name", sorted(CENTERS))
def test_every_trajectory_stays_in_the_step(name: str, size: float, slabs: int) -> None:
    plant = load_plant(name)
    step = linear_step(plant.tape, example_set(name, size), STEP, ORDER)
    assert step.sound.all()
    assert violation(plant, step, slabs) <= ROUNDING


@pytest.mark.parametrize("order", [2, 3, 12])
@pytest.mark.parametrize(
    ("plant", "z"),
    [
        (custom_plant(x="-5*x"), box_set([1.0], 0.3)),
        (custom_plant(x="y - x", y="-4*x - 2*y"), box_set([1.0, -1.0], 0.3)),
        (custom_plant(x="x**3"), box_set([0.0], 0.8)),
        (custom_plant(x="exp(y)/(1 + x**2)", y="tanh(x) - sqrt(y + 4)"), box_set([0.5, 0.2], 0.3)),
    ],
    ids=["decay", "oscillator", "cubic", "functions"],
)
def test_every_trajectory_stays_in_the_step_at_every_order(plant: Plant, z: Zonotope, order: int) -> None:
    step = linear_step(plant.tape, z, STEP, order)
    assert step.sound.all()
    assert violation(plant, step, 2) <= ROUNDING


@pytest.mark.parametrize("name", sorted(CENTERS))
def test_the_start_set_s_factors_keep_their_meaning(name: str) -> None:
    plant = load_plant(name)
    states = len(plant.states)
    start = replace(example_set(name), radius=np.zeros((1, len(CENTERS[name]))))
    step = linear_step(plant.tape, start, STEP, ORDER)
    count = start.generators.shape[1]
    np.testing.assert_array_equal(step.end.center[:, states:], start.center[:, states:])
    np.testing.assert_array_equal(step.end.generators[:, :count, states:], start.generators[:, :, states:])
    assert not step.end.generators[:, count:, states:].any()
    factors = np.random.default_rng(3).choice([-1.0, 1.0], (50, count))
    reached = trajectories(plant, start.center[0] + factors @ start.generators[0], [0.0, float(STEP)])[-1]
    predicted = step.end.center[0] + factors @ step.end.generators[0, :count]
    rest = np.abs(step.end.generators[0, count:]).sum(0) + step.end.radius[0]
    assert (np.abs(reached - predicted[:, :states]) <= rest[:states] + ROUNDING).all()


@pytest.mark.parametrize("duration", [Fraction(1, 10), Fraction(1, 3)])
def test_a_linear_plant_is_enclosed_exactly_up_to_rounding(duration: Fraction) -> None:
    plant = load_plant("quadrotor1d")
    z = example_set("quadrotor1d")
    step, jets = linear_step(plant.tape, z, duration, ORDER), jet_step(plant.tape, z, duration, ORDER, 4)
    count = z.generators.shape[1]
    np.testing.assert_allclose(step.end.center, jets.end.center, rtol=0, atol=1e-10)
    np.testing.assert_allclose(step.end.generators[:, :count], jets.end.generators[:, :count], rtol=0, atol=1e-10)
    np.testing.assert_allclose(step.end.spread, jets.end.spread, rtol=0, atol=1e-10)
    assert step.added.max() < 1e-10


def test_a_linear_plant_moves_by_the_matrix_exponential() -> None:
    plant = custom_plant(x="y - x/2", y="-4*x - 2*y + 1")
    z = box_set([1.0, -1.0], 0.3)
    step = linear_step(plant.tape, z, STEP, 14)
    rate = np.array([[-0.5, 1.0, 0.0], [-4.0, -2.0, 1.0], [0.0, 0.0, 0.0]])
    solution = expm(rate * float(STEP))[:2]
    np.testing.assert_allclose(step.end.center[0], solution @ [1.0, -1.0, 1.0], atol=1e-13)
    np.testing.assert_allclose(step.end.generators[0, :2], 0.3 * solution[:, :2].T, atol=1e-13)
    assert step.added.max() < 1e-12


@pytest.mark.parametrize("duration", [Fraction(1, 5), Fraction(1, 10), Fraction(1, 40)])
@pytest.mark.parametrize("name", sorted(CENTERS))
def test_it_intersects_the_jets_enclosure(name: str, duration: Fraction) -> None:
    plant = load_plant(name)
    z = example_set(name)
    step, jets = linear_step(plant.tape, z, duration, ORDER), jet_step(plant.tape, z, duration, ORDER, 4)
    assert step.sound.all() and jets.sound.all()
    assert intersects(step.end, jets.end)
    for one, other in zip(step.time_intervals(2), jets.time_intervals(2), strict=True):
        assert intersects(one, other)


@pytest.mark.parametrize("name", sorted(CENTERS))
def test_it_agrees_with_the_jets_enclosure_at_short_steps(name: str) -> None:
    plant = load_plant(name)
    z = example_set(name, 0.02)
    step, jets = (take(plant.tape, z, Fraction(1, 80)) for take in (_linear, _jets))
    states = len(plant.states)
    normals = directions(states)
    supports = [s.end.coordinates(slice(0, states)).support(normals) for s in (step, jets)]
    assert (np.abs(supports[0] - supports[1]) <= 0.01 * step.end.spread[:, :states].max()).all()


def _linear(tape: Any, z: Zonotope, duration: Fraction) -> Any:
    return linear_step(tape, z, duration, ORDER)


def _jets(tape: Any, z: Zonotope, duration: Fraction) -> Any:
    return jet_step(tape, z, duration, ORDER, 4)


def order_of(sizes: list[Fraction], errors: list[float]) -> float:
    """Slope of a regression of log error by log step."""
    return float(np.polyfit(np.log([float(h) for h in sizes]), np.log(errors), 1)[0])


@pytest.mark.parametrize("name", ["pendulum", "quadrotor2d", "unicycle"])
def test_what_a_step_adds_to_a_point_is_of_third_order(name: str) -> None:
    plant = load_plant(name)
    sizes = [Fraction(1, 40 * 2**i) for i in range(5)]
    added = [float(linear_step(plant.tape, example_set(name, 0.0), h, ORDER).added.max()) for h in sizes]
    assert 2.8 <= order_of(sizes, added) <= 3.4


@pytest.mark.parametrize("name", ["pendulum", "quadrotor2d", "unicycle"])
def test_the_radius_over_a_fixed_time_converges_with_second_order(name: str) -> None:
    plant = load_plant(name)
    states = len(plant.states)
    counts = [8, 16, 32, 64]
    errors = []
    for count in counts:
        z = example_set(name, 0.0)
        for _ in range(count):
            step = linear_step(plant.tape, z, Fraction(1, 5) / count, ORDER)
            assert step.sound.all()
            z = step.end
        errors.append(float(z.spread[0, :states].max()))
    assert 1.8 <= order_of([Fraction(1, n) for n in counts], errors) <= 2.4


def test_slabs_shrink_to_the_time_point_sets() -> None:
    plant = load_plant("pendulum")
    step = linear_step(plant.tape, example_set("pendulum", 0.02), STEP, ORDER)
    last = [float((step.time_intervals(n)[-1].spread - step.end.spread[:, :2]).max()) for n in (1, 4, 16)]
    assert last[0] > 3.0 * last[1] > 9.0 * last[2] > 0.0


def test_a_step_beyond_a_blow_up_is_not_sound_and_says_so() -> None:
    plant = custom_plant(x="x**2")
    z = Zonotope(np.array([[1.0], [0.01]]), np.full((2, 1, 1), 0.001), np.zeros((2, 1)))
    step = linear_step(plant.tape, z, Fraction(2), ORDER)
    np.testing.assert_array_equal(step.sound, [False, True])


def test_a_pole_in_the_a_priori_box_is_not_sound() -> None:
    plant = custom_plant(x="1/x")
    assert not linear_step(plant.tape, box_set([0.1], 0.2), STEP, ORDER).sound.any()


def test_an_infinite_set_is_not_sound() -> None:
    plant = load_plant("pendulum")
    z = example_set("pendulum")
    for broken in (replace(z, radius=z.radius + np.inf), replace(z, center=z.center * np.nan)):
        assert not linear_step(plant.tape, broken, STEP, ORDER).sound.any()


def test_the_integrator_halves_steps_until_the_linearisation_is_sound() -> None:
    plant = custom_plant(x="-30*x")
    flow = integrate(
        plant, box_set([1.0], 0.1), Fraction(1, 5), Options(method="linearization"), np.zeros(1, dtype=np.intp)
    )
    assert flow.sound.all()
    assert len(flow.groups[0].steps) >= 8
    assert 1.1 * np.exp(-6.0) <= flow.end.support(np.ones((1, 1)))[0, 0] <= 1.2 * np.exp(-6.0)


def batch_of(name: str, count: int) -> Zonotope:
    parts = [example_set(name, 0.02 * (i + 1), seed=i) for i in range(count)]
    return Zonotope(*(np.concatenate([getattr(p, f) for p in parts]) for f in ("center", "generators", "radius")))


def assert_same(one: Zonotope, other: Zonotope) -> None:
    for attribute in ("center", "generators", "radius"):
        np.testing.assert_allclose(getattr(one, attribute), getattr(other, attribute), rtol=1e-13, atol=1e-14)


@pytest.mark.parametrize("name", sorted(CENTERS))
def test_a_batch_is_its_cells(name: str) -> None:
    plant = load_plant(name)
    z = batch_of(name, 5)
    whole = linear_step(plant.tape, z, STEP, ORDER)
    for cell in range(5):
        single = linear_step(plant.tape, z[cell : cell + 1], STEP, ORDER)
        assert_same(whole.end[cell : cell + 1], single.end)
        assert whole.sound[cell] == single.sound[0]
        np.testing.assert_allclose(whole.added[cell], single.added[0], rtol=1e-12, atol=1e-15)
        np.testing.assert_allclose(whole.truncation[cell], single.truncation[0], rtol=1e-12, atol=1e-15)
        for one, other in zip(whole.time_intervals(3), single.time_intervals(3), strict=True):
            assert_same(one[cell : cell + 1], other)


def test_selected_cells_have_the_same_time_intervals() -> None:
    plant = load_plant("unicycle")
    whole = linear_step(plant.tape, batch_of("unicycle", 5), STEP, ORDER)
    chosen = np.array([1, 3])
    for one, other in zip(whole.time_intervals(4), whole.select(chosen).time_intervals(4), strict=True):
        assert_same(one[chosen], other)


def no_remainder(hessian: Ball, deviation: Ball) -> Ball:
    return balls.exact(np.zeros(hessian.mid.shape[:2]))


def hessian_at_the_center(tape: Any, box: Ball) -> Ball:
    return _bounds(tape, balls.exact(box.mid))


def deviation_of_the_start_set_only(prior: Ball, point: Any) -> Ball:
    return Ball(point, 0.1 * np.ones_like(point))


def start_box_only(tape: Any, box: Ball, prior: Ball, duration: Fraction) -> Ball:
    return box


def no_tail(rate: Any, last: Any, order: int) -> Any:
    return np.zeros_like(last)


def no_bend(times: tuple[Fraction, ...], order: int, derivative: int) -> Ball:
    weights = _weights(times, order, derivative)
    return balls.exact(np.zeros_like(weights.mid)) if derivative == 2 else weights


def no_motion(times: tuple[Fraction, ...], order: int, derivative: int) -> Ball:
    weights = _weights(times, order, derivative)
    return balls.exact(np.zeros_like(weights.mid)) if derivative == 1 else weights


_bounds, _weights = linearization.hessian_bounds, linearization.time_weights


@pytest.mark.parametrize(
    ("name", "planted", "plant", "z", "order"),
    [
        ("lagrange_remainder", no_remainder, load_plant("unicycle"), example_set("unicycle", 0.2), ORDER),
        ("lagrange_remainder", no_remainder, load_plant("pendulum"), example_set("pendulum", 0.2), ORDER),
        ("hessian_bounds", hessian_at_the_center, custom_plant(x="x**3"), box_set([0.0], 0.8), ORDER),
        ("hessian_domain", deviation_of_the_start_set_only, custom_plant(x="x**2"), box_set([1.5], 0.1), ORDER),
        ("tightened", start_box_only, custom_plant(x="x**2"), box_set([0.0], 0.8), ORDER),
        ("exponential_tail", no_tail, custom_plant(x="-5*x"), box_set([1.0], 0.1), 2),
        ("exponential_tail", no_tail, custom_plant(x="y", y="-25*x"), box_set([1.0, 0.0], 0.1), 3),
        ("time_weights", no_bend, load_plant("quadrotor1d"), example_set("quadrotor1d", 0.02), ORDER),
        ("time_weights", no_motion, load_plant("unicycle"), example_set("unicycle", 0.02), ORDER),
    ],
    ids=lambda value: getattr(value, "__name__", ""),
)
def test_the_containment_law_sees_a_term_that_is_missing(
    name: str, planted: Callable[..., Any], plant: Plant, z: Zonotope, order: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    intact = linear_step(plant.tape, z, STEP, order)
    assert intact.sound.all()
    assert violation(plant, intact, 2) <= ROUNDING
    monkeypatch.setattr(linearization, name, planted)
    spoilt = linear_step(plant.tape, z, STEP, order)
    assert violation(plant, spoilt, 2) > 1e-5


def test_the_shipped_example_verifies() -> None:
    results = [
        verify(str(example_policy_path()), EXAMPLE_SPECIFICATION, options=Options(method=method))
        for method in ("linearization", "jets")
    ]
    assert [result.verdict.name for result in results] == ["VERIFIED", "VERIFIED"]
    assert results[0].value is not None and results[1].value is not None
    assert results[0].value.discounted == pytest.approx(results[1].value.discounted, rel=1e-6)


def test_the_enclosure_of_nav_intersects_the_jets_enclosure(nav_folder: Path) -> None:
    policy = str(nav_folder / "nn-nav-set.onnx")
    linear, jets = (
        verify(policy, "nav", options=Options(method=method, splits=1)) for method in ("linearization", "jets")
    )
    assert linear.verdict.name == jets.verdict.name == "VERIFIED"
    for one, other in (
        (linear.flowpipe.points, jets.flowpipe.points),
        (linear.flowpipe.intervals, jets.flowpipe.intervals),
    ):
        assert (one[:, :, 0] <= other[:, :, 1]).all() and (other[:, :, 0] <= one[:, :, 1]).all()
    widths = [r.flowpipe.points[0, -1, 1] - r.flowpipe.points[0, -1, 0] for r in (linear, jets)]
    assert (widths[0] <= 2.0 * widths[1]).all()
