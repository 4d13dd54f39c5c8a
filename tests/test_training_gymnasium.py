"""Gymnasium environments of the specifications are the specifications; lanes of Gymnasium environments are those."""

from __future__ import annotations

import re
import warnings
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import network

torch = pytest.importorskip("torch", reason="torch is part of the extra `train`")
gymnasium = pytest.importorskip("gymnasium", reason="gymnasium is part of the extra `train`")

from gymnasium import spaces  # noqa: E402
from gymnasium.utils.env_checker import check_env  # noqa: E402

import setrl.train.gymnasium_environments as ours  # noqa: E402
from setrl.models.simulation import returns, simulate  # noqa: E402
from setrl.specs.errors import InputError, SetrlError, UsageError  # noqa: E402
from setrl.train.environment import Lanes  # noqa: E402
from setrl.train.streams import Streams  # noqa: E402

torch.set_num_threads(1)

NAMES = ("quadrotor1d", "pendulum", "navigation", "quadrotor2d")
OWN = """
setrl: 1
plant:
  states: {x: m}
  inputs: {u: m/s}
  disturbances: {wind: m/s, drift: m/s}
  dynamics: {x: u + wind + drift}
controller: {period: 0.5}
horizon: 2
initial: {x: [-1, 1]}
perturbation: {disturbance: {wind: [-0.1, 0.1], drift: {range: [0.2, 0.4], varies: never}}}
requirements: [stay: {x: [-9, 9]}]
reward: {weights: {x: 1}}
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    path = tmp_path / "my.yaml"
    path.write_text(OWN)
    return path


@pytest.mark.parametrize("name", NAMES)
def test_gymnasium_accepts_a_shipped_specification(name: str) -> None:
    environment = gymnasium.make(f"setrl/{name}-v0")
    with warnings.catch_warnings():
        # states have no bounds of their own: the environment says so, and Gymnasium wonders
        warnings.filterwarnings("ignore", message=".*A Box observation space (minimum|maximum) value is .*infinity.*")
        check_env(environment.unwrapped)
    assert environment.unwrapped.task.loop.specification.source.endswith(f"{name}.yaml")


@pytest.mark.parametrize("name", NAMES)
def test_an_episode_is_the_simulated_one_and_is_truncated_at_the_horizon(name: str) -> None:
    environment = gymnasium.make(f"setrl/{name}-v0").unwrapped
    task = environment.task
    policy = network([task.inputs, 8, task.actions], ["tanh", "tanh"], seed=6)
    observation, info = environment.reset(seed=3)
    start, rewards, ends = info["state"], [], []
    for _ in range(task.horizon):
        observation, reward, terminated, truncated, info = environment.step(policy(info["state"]))
        assert environment.observation_space.contains(observation) and not terminated and not info["lost"]
        rewards.append(reward)
        ends.append(truncated)
    exact = simulate(task.bound(policy, 0.0), start, rtol=1e-12, atol=1e-14)
    np.testing.assert_allclose(info["state"], exact.states[0, -1], atol=2e-4 * np.abs(exact.states).max(), rtol=0)
    discounted = np.array(rewards) @ task.discount ** np.arange(task.horizon)
    np.testing.assert_allclose(discounted, returns(task.loop, exact)[0], rtol=1e-4)
    assert ends == [False] * (task.horizon - 1) + [True]


def test_resets_are_seeded_and_within_the_start_box() -> None:
    environment = gymnasium.make("setrl/quadrotor1d-v0", start={"z": [-4, 4], "zdot": 0}).unwrapped
    first, again = (environment.reset(seed=5)[1]["state"] for _ in range(2))
    others = np.array([environment.reset()[1]["state"] for _ in range(50)])
    assert np.array_equal(first, again)
    assert (np.abs(others[:, 0]) <= 4).all() and np.ptp(others[:, 0]) > 4 and not others[:, 1].any()
    chosen = environment.reset(options={"state": [-4.0, 0.5]})[0]
    assert chosen.tolist() == [-4.0, 0.5] and chosen.dtype == np.float32


def test_any_specification_file_is_an_environment(own: Path) -> None:
    environment = ours.make_environment(own)
    pushes = []
    for seed in range(20):
        states = [environment.reset(seed=seed)[1]["state"][0]]
        states += [environment.step([0.0])[4]["state"][0] for _ in range(4)]
        pushes.append(np.diff(states) / 0.5)
    assert (np.array(pushes) >= 0.1 - 1e-9).all() and (np.array(pushes) <= 0.5 + 1e-9).all()
    assert np.ptp(np.mean(pushes, axis=1)) > 0.1  # the constant disturbance differs between episodes
    assert (np.ptp(pushes, axis=1) <= 0.2 + 1e-9).all()  # and not within one
    step = ours.make_environment(own, start={"x": 0}, goal_stop=0.5)
    step.reset(seed=0)
    assert step.step([0.0])[2] is True


@pytest.mark.parametrize("wrong", [{"y": 0}, {"x": [1, 0]}, {}])
def test_a_wrong_start_box_is_an_error(own: Path, wrong: Any) -> None:
    with pytest.raises(UsageError):
        ours.make_environment(own, start=wrong)


def test_a_specification_that_is_not_there_is_an_error() -> None:
    with pytest.raises(InputError, match="shipped"):
        ours.make_environment("no-such-specification")


def test_a_lost_state_truncates_an_episode(own: Path, tmp_path: Path) -> None:
    path = tmp_path / "blows-up.yaml"
    path.write_text(OWN.replace("x: u + wind + drift", "x: x**3 + u + wind + drift"))
    environment = ours.make_environment(path, start={"x": 0})
    environment.reset(seed=0, options={"state": [99.0]})
    observation, reward, terminated, truncated, info = environment.step([0.0])
    assert (terminated, truncated, info["lost"]) == (False, True, True)
    assert observation.tolist() == [99.0] and reward == -99.0


def test_a_file_of_the_current_folder_does_not_replace_a_registered_specification(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "pendulum.yaml").write_text("not a specification")
    monkeypatch.chdir(tmp_path)
    assert gymnasium.make("setrl/pendulum-v0").unwrapped.task.horizon == 30


def test_the_page_about_environments_does_what_it_says(own: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(own.parent)
    page = (Path(__file__).resolve().parents[1] / "docs" / "environments.md").read_text(encoding="utf-8")
    blocks = re.findall(r"^```python[^\n]*\n(.*?)^```$", page, re.MULTILINE | re.DOTALL)
    names: dict[str, Any] = {}
    for block in blocks:
        exec(block, names)  # noqa: S102
    assert len(blocks) == 3
    rows = [line.split("|") for line in page.splitlines() if line.startswith("| `setrl/")]
    assert len(rows) == len([name for name in gymnasium.registry if name.startswith("setrl/")])
    for _, name, observed, actions, steps, _ in rows:
        task = gymnasium.make(name.strip(" `")).unwrapped.task
        assert observed.strip() == ", ".join(task.loop.observation_names)
        assert (int(actions), int(steps)) == (task.actions, task.horizon)


# Gymnasium's environments as lanes -------------------------------------------------------------------------


def test_lanes_of_a_gymnasium_environment_are_that_environment() -> None:
    lanes: Lanes = ours.GymnasiumLanes("Pendulum-v1", 3, dtype=torch.float64)
    assert (lanes.lanes, lanes.inputs, lanes.actions, lanes.horizon) == (3, 3, 1, 200)
    assert np.array_equal(lanes.perturbation, np.eye(3))
    seeds = lanes.sample_starts(Streams([4, 5, 6]))
    assert len({*seeds.ravel()}) == 3 and (seeds == np.floor(seeds)).all() and (0 <= seeds).all()
    forces = lanes.sample_forces(Streams([4, 5, 6]))
    actions = np.random.default_rng(7).uniform(-1.2, 1.2, (20, 3, 1))
    observations = [lanes.reset(seeds)]
    steps = [lanes.step(torch.from_numpy(action), forces[:, k]) for k, action in enumerate(actions)]
    observations += [step.observation for step in steps]
    for row in range(3):
        own = gymnasium.make("Pendulum-v1")
        seen, rewards = [own.reset(seed=int(seeds[row, 0]))[0]], []
        for action in actions[:, row]:
            outcome = own.step(np.clip(2.0 * action, -2.0, 2.0).astype(np.float32))
            seen.append(outcome[0])
            rewards.append(outcome[1])
        np.testing.assert_array_equal(np.array([entry[row].numpy() for entry in observations]), np.array(seen))
        np.testing.assert_array_equal([step.reward[row].item() for step in steps], rewards)
    assert not any(step.ended.any() for step in steps)
    assert np.array_equal(lanes.sample_starts(Streams([5]))[0], seeds[1])


class Countdown(gymnasium.Env):  # type: ignore[misc]
    """Terminates after a number of steps that the seed chooses; refuses to go on."""

    observation_space = spaces.Box(-10.0, 10.0, (1,), np.float32)
    action_space = spaces.Box(np.array([-1.0, 2.0], np.float32), np.array([3.0, 2.5], np.float32))

    def reset(self, *, seed: int | None = None, options: Any = None) -> Any:
        super().reset(seed=seed)
        self.left = 1 + (seed or 0) % 3
        return np.array([self.left], np.float32), {}

    def step(self, action: Any) -> Any:
        assert self.left > 0 and self.action_space.contains(action)
        self.left -= 1
        return np.array([self.left], np.float32), float(action[0] + 10 * action[1]), self.left == 0, False, {}


def test_a_lane_that_terminated_waits_with_reward_zero_for_the_others() -> None:
    lanes = ours.GymnasiumLanes(Countdown, 3, dtype=torch.float32, horizon=3)
    for _ in range(2):
        assert lanes.reset(np.array([[0.0], [1.0], [2.0]])).tolist() == [[1.0], [2.0], [3.0]]
        action = torch.tensor([[-1.0, 1.0], [0.0, 0.0], [1.5, -1.5]])  # beyond 1: clipped
        steps = [lanes.step(action, np.zeros((3, 0))) for _ in range(3)]
        assert [step.ended.tolist() for step in steps] == [[True, False, False], [True, True, False], [True] * 3]
        assert [step.reward.tolist() for step in steps] == [[24.0, 23.5, 23.0], [0.0, 23.5, 23.0], [0.0, 0.0, 23.0]]
        assert steps[0].observation.tolist() == [[0.0], [1.0], [2.0]]
    lanes.close()


def test_an_episode_that_its_time_limit_truncates_has_not_ended() -> None:
    lanes = ours.GymnasiumLanes("Pendulum-v1", 1, dtype=torch.float32, max_episode_steps=2)
    lanes.reset(np.array([[1.0]]))
    assert lanes.horizon == 2
    assert [bool(lanes.step(torch.zeros(1, 1), np.zeros((1, 0))).ended[0]) for _ in range(2)] == [False, False]


@pytest.mark.parametrize(
    ("environment", "message"),
    [
        ("No-Such-Environment-v0", "cannot be made"),
        ("CartPole-v1", "a bounded vector is required as the action"),
        (Countdown, "has no time limit"),
    ],
)
def test_an_environment_that_cannot_be_trained_in_says_why(environment: Any, message: str) -> None:
    with pytest.raises(SetrlError) as error:
        ours.GymnasiumLanes(environment, 1, dtype=torch.float32)
    assert message in str(error.value) and error.value.remedy


def test_seeds_have_the_shape_of_the_lanes() -> None:
    with pytest.raises(UsageError):
        ours.GymnasiumLanes("Pendulum-v1", 2, dtype=torch.float32).reset(np.zeros((3, 1)))


def test_hopper_falls_within_an_episode_of_random_actions() -> None:
    pytest.importorskip("mujoco", reason="MuJoCo is part of the extra `hopper`")
    lanes = ours.GymnasiumLanes("Hopper-v5", 2, dtype=torch.float32)
    assert (lanes.inputs, lanes.actions, lanes.horizon) == (11, 3, 1000)
    lanes.reset(lanes.sample_starts(Streams([0, 1])))
    actions = torch.from_numpy(np.random.default_rng(8).uniform(-1, 1, (300, 2, 3)))
    steps = [lanes.step(action, np.zeros((2, 0))) for action in actions]
    assert steps[-1].ended.all() and not steps[0].ended.any()
    assert all(torch.isfinite(step.observation).all() for step in steps)
