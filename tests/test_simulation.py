"""Simulated trajectories are those of the closed loop: against closed forms, not against another simulator."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from setrl.models.binding import bind
from setrl.models.closed_loop import ClosedLoop
from setrl.models.example import example_policy_path
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_runtime import deployed_runner
from setrl.models.policy import Affine, Policy
from setrl.models.sampling import (
    center_state,
    corner_states,
    inner_bounds,
    sample_disturbances,
    sample_noise,
    uniform_states,
)
from setrl.models.simulation import returns, simulate
from setrl.specs.errors import UsageError
from setrl.specs.expressions import parse_expression
from setrl.specs.reader import read_specification
from setrl.specs.specification import (
    AffineMap,
    Bounds,
    Controller,
    Disturbance,
    Halfspace,
    Penalty,
    Perturbation,
    PlantDescription,
    Polytope,
    Region,
    Requirement,
    Reward,
    Specification,
)

F = Fraction
GAIN = np.array([[-0.6, -0.4]])
STARTS = np.array([[-4.0, 0.0], [1.0, 0.5], [0.0, 0.0]])
WALL = Requirement("avoid", "wall", Region((Polytope((Halfspace({"z": F(-1)}, F(-9), "z >= 9"),)),)), F(0), F(1))


def gain_policy(weight: Any = GAIN) -> Policy:
    matrix = np.atleast_2d(np.asarray(weight, dtype=np.float64))
    return Policy((Affine(matrix, np.zeros(len(matrix))),), matrix.shape[1], matrix.shape[0])


def loop_of(plant: Any = "quadrotor1d", policy: Policy | None = None, **changes: Any) -> ClosedLoop:
    states = {"z": Bounds(F(-4), F(4)), "zdot": Bounds(F(0), F(1))} if plant == "quadrotor1d" else changes.pop("states")
    controller = Controller(**{"period": F(1, 10), **changes.pop("controller", {})})
    requirement = replace(WALL, region=changes.pop("region", WALL.region))
    given: dict[str, Any] = {
        "plant": plant,
        "controller": controller,
        "horizon": F(1),
        "initial": states,
        "perturbation": Perturbation(),
        "requirements": (requirement,) if plant == "quadrotor1d" else (),
    }
    return bind(Specification(**{**given, **changes}), policy or gain_policy())


def closed_form(states: Any, period: float, periods: int, hold: Any = None) -> Any:
    """The 1D quadrotor under ``a = GAIN s``: constant acceleration within each period, (N, periods + 1, 2)."""
    path = [states]
    for _ in range(periods):
        z, zdot = path[-1].T
        acceleration = (path[-1] @ GAIN[0] + 1) / 0.1 - 9.81
        path.append(np.stack([z + zdot * period + acceleration * period**2 / 2, zdot + acceleration * period], 1))
    return np.stack(path, 1)


def test_the_quadrotor_follows_its_closed_form() -> None:
    result = simulate(loop_of(), STARTS)
    np.testing.assert_allclose(result.states, closed_form(STARTS, 0.1, 10), atol=1e-11)
    np.testing.assert_allclose(result.actions[..., 0], result.states[:, :-1] @ GAIN[0], atol=1e-12)
    assert result.times.tolist() == pytest.approx([k / 10 for k in range(11)])
    assert (result.period_ends == result.states[:, 1:]).all()


def test_samples_between_the_periods_lie_on_the_same_trajectory() -> None:
    coarse, fine = simulate(loop_of(), STARTS), simulate(loop_of(), STARTS, samples_per_period=4)
    assert fine.states.shape == (3, 41, 2) and fine.times[2] == pytest.approx(0.05)
    np.testing.assert_allclose(fine.states[:, ::4], coarse.states, atol=1e-10)
    np.testing.assert_allclose(fine.period_ends, coarse.period_ends, atol=1e-10)


def test_trajectories_of_a_batch_are_those_of_single_runs() -> None:
    given = read_specification(Path(__file__).resolve().parents[1] / "specs" / "pendulum.yaml")
    loop = bind(given, gain_policy())
    starts = np.array([[3.0, 0.0], [0.1, 0.2], [-1.0, 1.0]])
    together = simulate(loop, starts)
    for row, start in enumerate(starts):
        np.testing.assert_allclose(simulate(loop, start).states[0], together.states[row], atol=1e-6)


def test_onnxruntime_can_drive_the_simulation() -> None:
    given = read_specification(Path(__file__).resolve().parents[1] / "specs" / "quadrotor1d.yaml")
    loop = bind(given, read_policy(example_policy_path()))
    start = center_state(loop)
    ours, deployed = simulate(loop, start), simulate(loop, start, policy=deployed_runner(loop.policy))
    assert 0 < np.abs(ours.states - deployed.states).max() < 1e-4
    assert (np.abs(ours.states[0, -1]) < [0.1, 0.5]).all(), "the shipped example hovers at the origin"
    assert -35 < returns(loop, ours)[0] < -20


def test_noise_changes_what_is_observed_and_not_the_state() -> None:
    noise = np.random.default_rng(1).uniform(-0.1, 0.1, size=(3, 10, 2))
    result = simulate(loop_of(), STARTS, noise)
    np.testing.assert_allclose(result.observations, result.states[:, :-1] + noise)
    np.testing.assert_allclose(result.actions, result.observations @ GAIN.T)
    asked = simulate(loop_of(), STARTS, lambda period, clean: np.full_like(clean, period / 10))
    assert (asked.noise == np.arange(10)[None, :, None] / 10).all()


def test_maps_clipping_and_delay_act_in_this_order() -> None:
    controller = {
        "observe": {"zdot": parse_expression("zdot"), "sum": parse_expression("z + zdot")},
        "before": AffineMap(None, F(2), F(1)),
        "after": AffineMap(None, F(3), F(-1)),
        "clip": Bounds(F(-1), F(1, 2)),
        "delay": 2,
        "delayed_action": {"a": F(1, 4)},
    }
    result = simulate(loop_of(controller=controller), STARTS)
    z, zdot = np.moveaxis(result.states[:, :-1], 2, 0)
    observation = np.stack([zdot, z + zdot], 2)
    expected = np.clip(3 * ((2 * observation + 1) @ GAIN.T) - 1, -1, 0.5)
    np.testing.assert_allclose(result.observations, observation)
    np.testing.assert_allclose(result.actions[:, :2], 0.25)
    np.testing.assert_allclose(result.actions[:, 2:], expected[:, :-2])


def discrete(**changes: Any) -> PlantDescription:
    given: dict[str, Any] = {
        "name": "counter",
        "states": {"x": ""},
        "inputs": {"u": ""},
        "disturbances": {"w": ""},
        "parameters": {},
        "dynamics": {"x": parse_expression("x/2 + u + w")},
        "discrete": True,
    }
    return PlantDescription(**{**given, **changes})


def test_discrete_plants_are_iterated() -> None:
    states = {"x": Bounds(F(0), F(1))}
    reward = Reward({"x": F(1)}, {})
    loop = loop_of(discrete(), gain_policy([[0.25]]), states=states, reward=reward)
    forces = np.random.default_rng(1).normal(size=(1, 10, 1))
    result = simulate(loop, [[1.0]], disturbances=forces)
    x = 1.0
    for k in range(10):
        x = 0.75 * x + forces[0, k, 0]
        assert result.states[0, k + 1, 0] == pytest.approx(x)
    with pytest.raises(UsageError, match="one sample per period"):
        simulate(loop, [[1.0]], samples_per_period=2)


def test_returns_are_the_discounted_sums_with_the_state_at_the_end_of_the_period() -> None:
    above = Region((Polytope((Halfspace({"z": F(-1)}, F(1, 2), "z >= -0.5"),)),))
    reward = Reward({"z": F(1), "zdot": F(1, 100)}, {"z": F(-1)}, F(9, 10), Penalty(F(3), above))
    loop = loop_of(reward=reward)
    result = simulate(loop, STARTS)
    expected = np.zeros(3)
    for k in range(1, 11):
        z, zdot = result.states[:, k].T
        expected -= 0.9 ** (k - 1) * (np.abs(z + 1) + 0.01 * np.abs(zdot) + 3 * (z >= -0.5))
    np.testing.assert_allclose(returns(loop, result), expected, rtol=1e-12)
    with pytest.raises(UsageError, match="no reward"):
        returns(loop_of(), result)


def test_a_trajectory_that_explodes_does_not_take_the_others_with_it() -> None:
    plant = discrete(dynamics={"x": parse_expression("x**3 + u + w")}, discrete=False)
    states = {"x": Bounds(F(-9), F(9))}
    loop = loop_of(plant, gain_policy([[0.0]]), states=states, reward=Reward({"x": F(1)}, {}))
    result = simulate(loop, [[9.0], [0.5]])
    assert np.isnan(result.states[0, -1]).all()
    assert result.states[1, -1, 0] == pytest.approx(0.5 / np.sqrt(1 - 2 * 0.25), rel=1e-8)
    assert returns(loop, result)[0] == -np.inf


def test_samples_and_corners_are_in_the_exact_box() -> None:
    loop = loop_of(initial={"z": Bounds(F(1, 10), F(3, 10)), "zdot": Bounds(F(1, 3), F(1, 3))})
    points = np.vstack([corner_states(loop), uniform_states(loop, 100, np.random.default_rng(1))])
    assert len(corner_states(loop)) == 2
    assert all(F(1, 10) <= F(float(z)) <= F(3, 10) for z in points[:, 0])
    assert (points[:, 1] == 1 / 3).all()
    assert inner_bounds(F(1, 10), F(1, 5)) >= (0.1, 0.0) and F(inner_bounds(F(1, 10), F(1, 5))[1]) <= F(1, 5)


@pytest.mark.parametrize("attack", ["none", "uniform", "corner"])
def test_perturbations_stay_in_their_bounds_and_repeat_with_their_generator(attack: Any) -> None:
    perturbation = Perturbation(F(1, 10), {"w": Disturbance(Bounds(F(-1), F(3)), constant=True)})
    states = {"x": Bounds(F(0), F(1))}
    loop = loop_of(
        discrete(), gain_policy([[1.0]]), states=states, perturbation=perturbation, reward=Reward({"x": F(1)}, {})
    )
    noise = sample_noise(loop, attack, 5, np.random.default_rng(7))
    forces = sample_disturbances(loop, attack, 5, np.random.default_rng(7))
    assert noise.shape == forces.shape == (5, 10, 1)
    assert (np.abs(noise) <= 0.1).all() and (forces >= -1).all() and (forces <= 3).all()
    assert (forces == forces[:, :1]).all(), "a constant disturbance does not change"
    assert (noise == sample_noise(loop, attack, 5, np.random.default_rng(7))).all()
    if attack == "corner":
        assert set(np.abs(noise).ravel()) == {inner_bounds(F(-1, 10), F(1, 10))[1]}


def test_an_unknown_attack_is_an_error() -> None:
    with pytest.raises(UsageError, match="attacks: none, uniform, corner"):
        sample_noise(loop_of(), "gaussian", 1, np.random.default_rng(1))  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("initial", "noise"), [(np.zeros((2, 3)), None), (np.zeros((2, 2)), np.zeros((2, 9, 2)))], ids=["initial", "noise"]
)
def test_wrong_shapes_are_usage_errors(initial: Any, noise: Any) -> None:
    with pytest.raises(UsageError, match="shape"):
        simulate(loop_of(), initial, noise)


def test_the_competition_loop_reaches_its_goal(nav_folder: Path) -> None:
    given = read_specification(Path(__file__).resolve().parents[1] / "specs" / "nav.yaml")
    loop = bind(given, read_policy(nav_folder / "nn-nav-set.onnx"))
    result = simulate(loop, corner_states(loop), samples_per_period=2)
    assert (np.abs(result.states[:, -1, :2]) < 0.5).all()
