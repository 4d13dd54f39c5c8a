"""Training environments move as the closed loop does: against tight simulation and closed forms, one lane or many."""

from __future__ import annotations

import pickle
from copy import deepcopy
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from loops import affine_map, box_region, network, plant_of, specification_of

torch = pytest.importorskip("torch", reason="torch is part of the extra `train`")

from setrl.models.plant import compile_plant  # noqa: E402
from setrl.models.simulation import returns, simulate  # noqa: E402
from setrl.specs.errors import SpecificationError, UsageError  # noqa: E402
from setrl.specs.reader import SHIPPED, read_specification  # noqa: E402
from setrl.specs.specification import Bounds, Penalty, Reward  # noqa: E402
from setrl.train.dynamics import Discretisation  # noqa: E402
from setrl.train.environment import Environment, Lanes  # noqa: E402
from setrl.train.linear_dynamics import affine_map as exact_map  # noqa: E402
from setrl.train.streams import Streams  # noqa: E402
from setrl.train.task import Task, sample_forces, sample_starts, start_bounds, task_of  # noqa: E402

torch.set_num_threads(1)

F = Fraction
TIGHT = {"rtol": 1e-12, "atol": 1e-14}
STARTS: dict[str, Any] = {
    "quadrotor1d": {"z": [-4, 4], "zdot": 0},
    "pendulum": {"theta": [-3.141592653589793, 3.141592653589793], "thetadot": 0},
    "navigation": {"x": [2.9, 3.1], "y": [2.9, 3.1], "theta": [-0.1, 0.1], "v": [-0.1, 0.1]},
    "quadrotor2d": None,
}
REWARD = Reward({"p": F(1), "v": F(1, 4)}, {"p": F(1, 2)}, F(9, 10), Penalty(F(3), box_region(p=(0, 1), v=(-1, 1))))


def shipped(name: str) -> Task:
    start = STARTS[name]
    return task_of(read_specification(SHIPPED / f"{name}.yaml"), None if start is None else start_bounds(start))


def everything(delay: int = 2) -> Task:
    """Observation, maps, clipping, delay, disturbances and a penalty, around a nonlinear plant."""
    plant = plant_of({"p": "v + w", "v": "u1*cos(p) - sin(p)*u2 - v/5 + b", "q": "1/2"}, "u1 u2", "w b")
    specification = specification_of(
        plant,
        {"p": (-1, 1), "v": ("-0.5", "0.5"), "q": (0, 0)},
        periods=12,
        observation="0.1",
        disturbances={"w": ("-0.1", "0.3", False), "b": ("0.1", "0.2", True)},
        reward=REWARD,
        observe={"height": "sin(p) + v", "speed": "v", "free": "q"},
        before=affine_map([["2", "0", "0"], ["0", "0.5", "0"]], ["0.1", "-0.1"]),
        after=affine_map([["3", "0", "1"], ["0", "2", "0"]], ["0.2", "0"]),
        clip={"u1": Bounds(F(-2), F(1)), "u2": Bounds(F(-1), F(2))},
        delay=delay,
        delayed_action={"u1": F(1, 2)},
    )
    radii = {"height": F(1, 10), "speed": F(1, 20)}
    return task_of(replace(specification, perturbation=replace(specification.perturbation, observation=radii)))


def small(dynamics: dict[str, str], *, reward: Any = None, discrete: bool = False, **others: Any) -> Task:
    """A task about an inline plant that starts at 1 in every state."""
    plant = plant_of(dynamics, disturbances=others.pop("forces", ""), discrete=discrete)
    initial = others.pop("initial", {state: (1, 1) for state in dynamics})
    given = Reward({state: F(1) for state in dynamics}, {}, F(1)) if reward is None else reward
    return task_of(specification_of(plant, initial, reward=given, **others))


def chain() -> Task:
    """A linear plant with enough states for a matrix product to sum them in blocks."""
    names = [f"x{index}" for index in range(9)]
    dynamics = {name: f"u - {name}/3 + ({' + '.join(names)})/{17 + k}" for k, name in enumerate(names)}
    return small(dynamics, initial={name: (-1, 1) for name in names}, periods=9)


def tasks() -> dict[str, Task]:
    return {**{name: shipped(name) for name in STARTS}, "everything": everything(), "chain": chain()}


def drive(environment: Environment, policy: Any, starts: Any, forces: Any) -> tuple[Any, Any]:
    """States (L, T + 1, n) and rewards (L, T) of one episode."""
    observation = environment.reset(starts)
    states, rewards = [environment.state], []
    for k in range(environment.horizon):
        # row by row: a matrix product's sums depend on the number of rows
        actions = [policy(row) for row in observation.double().numpy()]
        step = environment.step(torch.from_numpy(np.stack(actions)), forces[:, k])
        observation = step.observation
        states.append(environment.state)
        rewards.append(step.reward.numpy())
    return np.stack(states, 1), np.stack(rewards, 1)


def episode(task: Task, lanes: int, rows: Any = slice(None), substeps: int | None = None) -> tuple[Any, ...]:
    """One episode of some of the lanes under a random policy, in float64."""
    policy = network([task.inputs, 8, task.actions], ["tanh", "tanh"], seed=4)
    streams = Streams(range(lanes))
    starts, forces = sample_starts(task, streams)[rows], sample_forces(task, streams)[rows]
    environment = Environment(task, len(starts), dtype=torch.float64)
    if substeps is not None:
        environment.discretisation = Discretisation(task.loop.plant, task.loop.period, substeps)
    return policy, starts, forces, *drive(environment, policy, starts, forces)


# One control period ----------------------------------------------------------------------------------


@pytest.mark.parametrize("name", STARTS)
def test_a_period_differs_from_tight_simulation_by_less_than_a_millionth(name: str) -> None:
    task, generator = shipped(name), np.random.default_rng(1)
    lower, upper = np.array(task.start, dtype=np.float64).T
    starts = generator.uniform(lower, upper, (16, len(lower)))
    actions = generator.choice([-1.0, -0.3, 0.0, 0.6, 1.0], (16, task.actions))
    moved = Discretisation(task.loop.plant, task.loop.period).advance(starts, actions, np.zeros((16, 0)))
    loop = replace(task.loop, periods=1)
    exact = np.concatenate(
        [simulate(loop, x, policy=lambda _, u=u: u[None], **TIGHT).states[:, 1] for x, u in zip(starts, actions)]  # noqa: B905
    )
    assert (np.abs(moved - exact).max(axis=1) < 1e-6 * np.abs(exact).max(axis=1)).all()


def test_a_linear_plant_moves_by_its_closed_form() -> None:
    plant = compile_plant(plant_of({"p": "v", "v": "u - 2*v + d"}, "u", "d"))
    step, h = Discretisation(plant, F(3, 10)), 0.3
    state, action, force = np.array([[1.0, 2.0], [-3.0, 0.5]]), np.array([[0.7], [-1.0]]), np.array([[0.1], [0.0]])
    moved = step.advance(state, action, force)
    pull, decay = (action + force)[:, 0] / 2, np.exp(-2 * h)
    speed = pull + (state[:, 1] - pull) * decay
    place = state[:, 0] + pull * h + (state[:, 1] - pull) * (1 - decay) / 2
    assert step.kind == "linear"
    np.testing.assert_allclose(moved, np.stack([place, speed], 1), rtol=1e-14)


@pytest.mark.parametrize(
    ("text", "row"),
    [
        ("2*x - x/4 + (1 + 3*u)/2 - d", [1.75, 1.5, -1.0, 0.5]),
        ("sqrt(2)*x + cos(0)*u", [2**0.5, 1.0, 0.0, 0.0]),
        ("x*(2 - 2) + (3*u - u - 2*u)*x", [0.0, 0.0, 0.0, 0.0]),
        ("-(x - u)**2/(-1)", None),
        ("x*u", None),
        ("sin(x)", None),
        ("u/(2 + x)", None),
        ("d + tanh(x)", None),
    ],
)
def test_what_is_affine_is_decided_exactly(text: str, row: Any) -> None:
    found = exact_map(compile_plant(plant_of({"x": text}, "u", "d")).tape)
    assert (found is None) == (row is None)
    if found is not None:
        np.testing.assert_allclose([*found[0][0], found[1][0]], row, rtol=1e-15)


def test_a_period_has_at_least_one_substep() -> None:
    with pytest.raises(UsageError):
        Discretisation(compile_plant(plant_of({"x": "u"})), F(1), 0)


def test_a_discrete_plant_moves_by_its_map() -> None:
    plant = compile_plant(plant_of({"x": "y*u + 1", "y": "x", "n": "3"}, "u", discrete=True))
    step = Discretisation(plant, F(1))
    moved = step.advance(np.array([[2.0, 3.0, 0.0], [1.0, -1.0, 9.0]]), np.array([[0.5], [2.0]]), np.zeros((2, 0)))
    assert step.kind == "map"
    assert moved.tolist() == [[2.5, 2.0, 3.0], [-1.0, 1.0, 3.0]]


@pytest.mark.parametrize("discrete", [False, True])
@pytest.mark.parametrize("text", ["exp(-x**2)*cos(y) + sqrt(3 + x)/(2 + y**2) - d", "2", "u", "log(2 + u)*y - 1"])
def test_tensors_move_as_arrays_do(text: str, discrete: bool) -> None:
    plant = compile_plant(plant_of({"x": text, "y": "tan(x/4)*u - tanh(y)"}, "u", "d", discrete))
    step, generator = Discretisation(plant, F(1, 5)), np.random.default_rng(2)
    values = [generator.uniform(-1, 1, (6, size)) for size in (2, 1, 1)]
    moved = step.advance(*values)
    tensors = [torch.from_numpy(value).reshape(2, 3, -1) for value in values]
    np.testing.assert_allclose(step.advance(*tensors).reshape(6, 2).numpy(), moved, rtol=1e-13)


def test_tensors_move_as_arrays_do_where_the_plant_is_linear() -> None:
    step = Discretisation(compile_plant(plant_of({"x": "2*u - d + e", "y": "x - y - 1"}, "u", "d e")), F(1, 5))
    values = [np.random.default_rng(2).uniform(-1, 1, (6, size)) for size in (2, 1, 2)]
    assert step.kind == "linear"
    np.testing.assert_allclose(step.advance(*map(torch.from_numpy, values)), step.advance(*values), rtol=1e-13)


@pytest.mark.parametrize("name", ["quadrotor1d", "quadrotor2d"])
def test_tensors_broadcast_and_carry_gradients(name: str) -> None:
    task, generator = shipped(name), torch.Generator().manual_seed(3)
    step, size = Discretisation(task.loop.plant, task.loop.period), len(task.start)
    state = torch.rand(2, 1, size, dtype=torch.float64, generator=generator, requires_grad=True)
    action = torch.rand(3, task.actions, dtype=torch.float64, generator=generator, requires_grad=True)
    force = torch.zeros(0, dtype=torch.float64)
    assert step.advance(state, action, force).shape == (2, 3, size)
    assert torch.autograd.gradcheck(lambda x, u: step.advance(x, u, force), (state, action))


# Episodes ----------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*STARTS, "everything"])
def test_an_episode_is_the_simulated_trajectory_and_its_return(name: str) -> None:
    task = tasks()[name]
    policy, starts, forces, states, rewards = episode(task, 3)
    loop = task.bound(policy, 0.0)
    exact = simulate(loop, starts, disturbances=forces, **TIGHT)
    scale = np.abs(exact.states).max()
    discounted = rewards @ task.discount ** np.arange(task.horizon)
    np.testing.assert_allclose(states, exact.states, atol=2e-4 * scale, rtol=0)
    np.testing.assert_allclose(discounted, returns(loop, exact), rtol=1e-4)
    finer = episode(task, 3, substeps=100)
    np.testing.assert_allclose(finer[3], exact.states, atol=1e-8 * scale, rtol=0)
    np.testing.assert_allclose(finer[4] @ task.discount ** np.arange(task.horizon), returns(loop, exact), rtol=1e-8)


@pytest.mark.parametrize("delay", [0, 1, 3])
def test_a_delayed_action_acts_that_many_periods_later(delay: int) -> None:
    task = everything(delay)
    policy, starts, forces, states, _ = episode(task, 2, substeps=50)
    exact = simulate(task.bound(policy, 0.0), starts, disturbances=forces, **TIGHT)
    np.testing.assert_allclose(states, exact.states, atol=1e-8, rtol=0)


@pytest.mark.parametrize("name", [*STARTS, "everything", "chain"])
def test_a_lane_is_the_same_bit_for_bit_whatever_runs_beside_it(name: str) -> None:
    task = tasks()[name]
    *_, states, rewards = episode(task, 5)
    *_, alone, rewards_alone = episode(task, 5, slice(3, 4))
    assert np.array_equal(states[3:4], alone) and np.array_equal(rewards[3:4], rewards_alone)


def test_an_episode_does_not_remember_the_one_before() -> None:
    task, streams = everything(), Streams([0, 1])
    environment = Environment(task, 2, dtype=torch.float32, goal_stop=0.1)
    policy = network([task.inputs, 8, task.actions], ["tanh", "tanh"], seed=4)
    starts, forces = sample_starts(task, streams), sample_forces(task, streams)
    first = drive(environment, policy, starts, forces)
    drive(environment, policy, -starts, forces)
    again = drive(environment, policy, starts, forces)
    assert all(np.array_equal(a, b) for a, b in zip(first, again, strict=True))


@pytest.mark.parametrize("name", ["quadrotor2d", "everything"])
def test_a_copy_of_an_environment_goes_on_alone(name: str) -> None:
    task, streams = tasks()[name], Streams([0, 1])
    environment = Environment(task, 2, dtype=torch.float64)
    environment.reset(sample_starts(task, streams))
    forces, action = sample_forces(task, streams), torch.full((2, task.actions), 0.5, dtype=torch.float64)
    environment.step(action, forces[:, 0])
    copies = [deepcopy(environment), pickle.loads(pickle.dumps(environment))]  # noqa: S301
    ends = []
    for each in (*copies, environment):
        each.step(action, forces[:, 1])
        ends.append(each.step(-action, forces[:, 2]).observation)
    assert torch.equal(ends[0], ends[2]) and torch.equal(ends[1], ends[2])


def test_observations_are_those_of_the_controller_in_network_coordinates() -> None:
    task = everything()
    starts = np.array([[0.5, -0.25, 0.0], [-1.0, 0.5, 2.0]])
    observation = Environment(task, 2, dtype=torch.float64).reset(starts).numpy()
    place, speed = starts[:, 0], starts[:, 1]
    np.testing.assert_allclose(observation, np.stack([2 * (np.sin(place) + speed) + 0.1, speed / 2 - 0.1], 1))


def test_a_lane_ends_where_every_weighted_state_is_near_its_target() -> None:
    reward = Reward({"x": F(1), "y": F(1), "z": F(0)}, {"x": F(2)}, F(1))
    task = small({"x": "u", "y": "0", "z": "0"}, reward=reward, periods=2, period=1)
    environment = Environment(task, 4, dtype=torch.float32, goal_stop=0.25)
    environment.reset(np.array([[1.0, 0.2, 9.0], [1.0, 0.3, 0.0], [1.5, 0.0, 0.0], [2.0, 0.0, 0.0]]))
    step = environment.step(torch.ones(4, 1), np.zeros((4, 0)))
    assert step.ended.tolist() == [True, False, False, False]  # the last one begins at the goal and leaves it
    never = Environment(task, 1, dtype=torch.float32)
    never.reset(np.array([[2.0, 0.0, 0.0]]))
    assert never.step(torch.zeros(1, 1), np.zeros((1, 0))).ended.tolist() == [False]


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
def test_a_lane_that_leaves_the_finite_numbers_keeps_its_last_state_and_disturbs_nobody(dtype: Any) -> None:
    task = small({"x": "x**3 + u/9", "y": "-y"}, periods=8, period=1, initial={"x": ("0.1", "0.1"), "y": (1, 1)})
    starts, force = np.array([[0.1, 1.0], [50.0, 1.0], [-0.2, 1.0]]), np.zeros((3, 0))
    environment, alone = (Environment(task, lanes, dtype=dtype, goal_stop=1e9) for lanes in (3, 2))
    environment.reset(starts)
    alone.reset(starts[[0, 2]])
    for _ in range(8):
        before = environment.state[1].copy()
        step, other = environment.step(torch.zeros(3, 1), force), alone.step(torch.zeros(2, 1), force[:2])
        assert environment.lost.tolist() == [False, True, False] and np.array_equal(environment.state[1], before)
        assert np.array_equal(environment.state[[0, 2]], alone.state)
        assert torch.equal(step.reward[[0, 2]], other.reward)
        assert torch.isfinite(step.observation).all() and torch.isfinite(step.reward).all()
        assert step.ended.tolist() == [True, False, True] and step.observation[1].tolist() == [50.0, 1.0]
        assert step.reward[1].item() == -51.0
    environment.reset(starts[[0, 0, 0]])
    assert not environment.lost.any()


def test_a_lost_lane_does_not_come_back_before_the_next_episode() -> None:
    task = small({"x": "x*exp(400*u)", "n": "n + 1"}, discrete=True)
    environment = Environment(task, 2, dtype=torch.float64)
    environment.reset(np.zeros((2, 2)) + [1.0, 0.0])
    for k, action in enumerate((0.0, 2.0, 0.0)):
        environment.step(torch.tensor([[action], [0.0]]), np.zeros((2, 0)))
        assert environment.state.tolist() == [[1.0, 1.0], [1.0, k + 1.0]]
        assert environment.lost.tolist() == [k >= 1, False]


def test_a_state_beyond_float32_is_lost_there_and_not_in_float64() -> None:
    task = small({"x": "x*200"}, periods=3, period="0.5")
    lost = {}
    for dtype in (torch.float32, torch.float64):
        environment = Environment(task, 1, dtype=dtype)
        environment.reset(np.array([[1.0]]))
        step = environment.step(torch.zeros(1, 1), np.zeros((1, 0)))
        lost[dtype] = bool(environment.lost[0])
        assert torch.isfinite(step.reward).all()
    assert lost == {torch.float32: True, torch.float64: False}


def test_a_reward_beyond_float32_is_lost_though_the_state_is_not() -> None:
    task = small({"x": "u"}, reward=Reward({"x": F(10) ** 35}, {}, F(1)))
    environment = Environment(task, 2, dtype=torch.float32)
    environment.reset(np.array([[1.0], [3402.7]]))
    step = environment.step(torch.ones(2, 1), np.zeros((2, 0)))
    assert environment.lost.tolist() == [False, False] and torch.isfinite(step.reward).all()
    environment.reset(np.array([[1.0], [3402.8]]))
    step = environment.step(torch.ones(2, 1), np.zeros((2, 0)))
    assert environment.lost.tolist() == [False, True] and torch.isfinite(step.reward).all()


def test_actions_carry_no_gradient_into_the_environment_and_are_copied_into_its_queue() -> None:
    task = small({"x": "u"}, periods=4, period=1, delay=1)
    environment = Environment(task, 1, dtype=torch.float64)
    environment.reset(np.zeros((1, 1)))
    action, states = torch.full((1, 1), 0.25, dtype=torch.float64, requires_grad=True), []
    for _ in range(4):
        step = environment.step(action, np.zeros((1, 0)))
        states.append(step.observation.item())
        with torch.no_grad():
            action *= 2.0
    assert states == [0.0, 0.25, 0.75, 1.75] and not step.observation.requires_grad


@pytest.mark.parametrize("starts", [np.zeros((1, 3)), np.zeros((2, 2)), np.full((2, 3), np.nan)])
def test_episodes_begin_at_finite_states_of_the_right_shape(starts: Any) -> None:
    with pytest.raises(UsageError):
        Environment(everything(), 2, dtype=torch.float64).reset(starts)


# The task ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", [*STARTS, "everything"])
def test_perturbed_inputs_are_those_of_perturbed_observations(name: str) -> None:
    task = tasks()[name]
    loop, generator = task.loop, np.random.default_rng(5)
    observation, eps = generator.normal(size=len(loop.observation_names)), 0.3
    radii = np.array(loop.observation_radius, dtype=np.float64)
    beta = generator.uniform(-1, 1, len(radii))
    matrix = np.eye(len(radii)) if loop.before is None else np.array(loop.before.matrix, dtype=np.float64)
    moved = matrix @ (observation + eps * radii / radii.max() * beta) - matrix @ observation
    np.testing.assert_allclose(moved, eps * beta[radii > 0] @ task.perturbation, rtol=1e-12, atol=1e-15)
    assert task.perturbation.any(axis=1).all() and task.epsilon == radii.max()


def test_a_radius_of_a_bound_policy_is_a_decimal_in_the_specifications_proportions() -> None:
    task = everything()
    policy = network([2, 3], ["tanh"], seed=1)
    assert task.bound(policy, 0.3).observation_radius == (F(3, 10), F(3, 20), F(0))
    assert task.bound(policy).observation_radius == (F(1, 10), F(1, 20), F(0))
    quiet = small({"x": "u"})
    assert quiet.bound(network([1, 1], ["tanh"], 1), 0.1).observation_radius == (F(1, 10),)
    assert quiet.epsilon == 0.0 and quiet.perturbation.tolist() == [[1.0]]
    for radius in (-0.1, float("nan"), float("inf")):
        with pytest.raises(UsageError):
            task.bound(policy, radius)


def test_starts_and_disturbances_are_within_bounds_and_a_seed_draws_its_own() -> None:
    task = everything()
    streams, alone = Streams(range(50)), Streams([7])
    starts, forces = sample_starts(task, streams), sample_forces(task, streams)
    assert (np.abs(starts) <= [1.0, 0.5, 0.0]).all() and np.ptp(starts[:, 0]) > 1.5
    assert forces.shape == (50, 12, 2)
    assert (forces >= [-0.1, 0.1]).all() and (forces <= [0.3, 0.2]).all()
    assert (forces[:, :, 1] == forces[:, :1, 1]).all() and np.ptp(forces[0, :, 0]) > 0.1
    assert np.array_equal(sample_starts(task, alone)[0], starts[7])
    assert np.array_equal(sample_forces(task, alone)[0], forces[7])
    assert sample_forces(shipped("pendulum"), alone).shape == (1, 30, 0)


def test_an_environment_has_what_a_trainer_asks_for() -> None:
    task = shipped("pendulum")
    lanes: Lanes = Environment(task, 2, dtype=torch.float32)
    streams, other = Streams([1, 2]), Streams([1, 2])
    assert (lanes.lanes, lanes.inputs, lanes.actions, lanes.horizon) == (2, 2, 1, 30)
    assert (lanes.discount, lanes.epsilon) == (0.99, 0.01)
    assert np.array_equal(lanes.perturbation, np.eye(2))
    assert np.array_equal(lanes.sample_starts(streams), sample_starts(task, other))
    assert lanes.reset(lanes.sample_starts(streams)).dtype == torch.float32
    step = lanes.step(torch.zeros(2, 1), lanes.sample_forces(streams)[:, 0])
    assert (step.reward.dtype, step.ended.dtype, step.observation.shape) == (torch.float32, torch.bool, (2, 2))


@pytest.mark.parametrize(
    ("start", "message"),
    [
        ({"z": [-4, 4]}, "missing: zdot"),
        ({"z": 0, "zdto": 0}, "did you mean zdot"),
        ({"z": [1, -1], "zdot": 0}, "is empty"),
        ({"z": "low", "zdot": 0}, "expected a number or [lower, upper]"),
        ({"z": [0, float("nan")], "zdot": 0}, "start.z"),
        ({"z": [0, 1, 2], "zdot": 0}, "start.z"),
        ({"z": True, "zdot": 0}, "start.z"),
    ],
)
def test_a_wrong_start_box_is_named(start: Any, message: str) -> None:
    specification = read_specification(SHIPPED / "quadrotor1d.yaml")
    with pytest.raises(UsageError) as error:
        task_of(specification, start_bounds(start))
    assert message in str(error.value) and error.value.remedy


def test_a_start_box_is_exact() -> None:
    task = task_of(read_specification(SHIPPED / "quadrotor1d.yaml"), start_bounds({"z": [-0.1, F(1, 3)], "zdot": 2}))
    assert task.start == ((F(-1, 10), F(1, 3)), (F(2), F(2)))
    assert task.loop.initial == ((F(-4), F(-4)), (F(0), F(0)))


@pytest.mark.parametrize(
    ("others", "message"),
    [
        ({"reward": None}, "no reward"),
        ({"reward": Reward({"x": F(0)}, {}, F(1))}, "every weight of the reward is zero"),
        ({"initial": {"x": (-1, 1)}, "text": "log(x)"}, "vector field has no finite value at x = 0"),
        ({"initial": {"x": (0, 1)}, "text": "1/x"}, "vector field has no finite value at x = 0"),
        ({"observe": {"o": "sqrt(x)"}, "initial": {"x": (-1, 3)}}, "observation has no finite value at x = -1"),
        ({"text": "x**3", "initial": {"x": (0, 1)}}, "do not resolve its motion at x = 1"),
        ({"text": "1000*(sin(u) - x)*(2 + cos(x))"}, "do not resolve its motion at x = 1"),
        ({"inputs": "", "text": "-x"}, "no inputs"),
    ],
)
def test_what_cannot_be_trained_says_why(others: dict[str, Any], message: str) -> None:
    others = {"reward": Reward({"x": F(1)}, {}, F(1)), "initial": {"x": (1, 1)}, "period": 1, **others}
    plant = plant_of({"x": others.pop("text", "u")}, others.pop("inputs", "u"))
    with pytest.raises(SpecificationError) as error:
        task_of(specification_of(plant, others.pop("initial"), **others))
    assert message in str(error.value) and error.value.remedy
