"""The exported file computes what the `predict` of Stable-Baselines3 computes, or it is not written."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is part of the extra `train`")
library = pytest.importorskip("stable_baselines3", reason="stable-baselines3 is part of the extra `dev`")

import gymnasium  # noqa: E402
from gymnasium import spaces  # noqa: E402
from stable_baselines3.common.torch_layers import FlattenExtractor  # noqa: E402
from stable_baselines3.common.vec_env import DummyVecEnv, VecNormalize  # noqa: E402

import setrl  # noqa: E402
from setrl.models.onnx_reader import read_policy  # noqa: E402
from setrl.models.policy import Activation, Affine, Policy  # noqa: E402
from setrl.specs.errors import InputError, PolicyError, UsageError  # noqa: E402
from setrl.train.stable_baselines3 import export_stable_baselines3  # noqa: E402

GAUSSIAN, SQUASHED = ("PPO", "A2C"), ("SAC", "TD3", "DDPG")
BOXES = {
    "unit": ([-1.0, -1.0], [1.0, 1.0]),
    "wide": ([-2.0, -2.0], [5.0, 5.0]),
    "one floor": ([-2.0, -2.0], [1.0, 3.0]),
    "uneven": ([-2.0, 0.5], [3.0, 0.75]),
}
FLAT = ([-1.0, 0.5], [1.0, 0.5])


class Still(gymnasium.Env):  # type: ignore[misc]
    """An environment in which nothing happens, with the spaces that are asked for."""

    def __init__(self, seen: spaces.Space, acting: spaces.Space) -> None:
        self.observation_space, self.action_space = seen, acting

    def reset(self, *, seed: int | None = None, options: dict[str, Any] | None = None) -> tuple[Any, dict[str, Any]]:
        super().reset(seed=seed)
        return self.observation_space.sample(), {}

    def step(self, action: Any) -> tuple[Any, float, bool, bool, dict[str, Any]]:
        return self.observation_space.sample(), 0.0, False, False, {}


def vector(size: int = 3) -> spaces.Box:
    return spaces.Box(-np.inf, np.inf, (size,), np.float32)


def box(name: str) -> spaces.Box:
    return span(*BOXES[name])


def span(low: list[float], high: list[float]) -> spaces.Box:
    return spaces.Box(np.array(low, np.float32), np.array(high, np.float32), dtype=np.float32)


def model_of(
    algorithm: str,
    acting: spaces.Space | None = None,
    seen: spaces.Space | None = None,
    *,
    normalized: bool = False,
    policy: str = "MlpPolicy",
    gain: float = 1.0,
    use_sde: bool = False,
    **network: Any,
) -> Any:
    """An untrained model with drawn weights, large enough that clips and squashings act."""
    environment: Any = DummyVecEnv([lambda: Still(seen or vector(), acting or box("unit"))])
    if normalized:
        environment = VecNormalize(environment, clip_obs=2.5, epsilon=0.03)
        generator = np.random.default_rng(7)
        environment.obs_rms.mean = generator.normal(size=3) * 4.0
        environment.obs_rms.var = generator.uniform(0.01, 4.0, size=3)
    memory = {} if algorithm in GAUSSIAN else {"buffer_size": 10}
    sde = {"use_sde": True} if use_sde else {}
    settings = {"net_arch": [8, 6], **network} if policy == "MlpPolicy" else {}
    made = getattr(library, algorithm)(
        policy, environment, policy_kwargs=settings, device="cpu", seed=3, **memory, **sde
    )
    torch.manual_seed(11)
    with torch.no_grad():
        for parameter in made.policy.parameters():
            parameter.copy_(torch.randn_like(parameter) * gain)
    return made


def observations(model: Any, statistics: VecNormalize | None) -> np.ndarray[Any, Any]:
    """Points of several sizes; normalised ones on both sides of the clip."""
    generator = np.random.default_rng(5)
    shape = model.policy.observation_space.shape
    points = generator.normal(size=(300, *shape)) * generator.choice([0.05, 0.5, 5.0], size=(300, *[1] * len(shape)))
    if statistics is not None:
        points = statistics.obs_rms.mean + points * np.sqrt(statistics.obs_rms.var)
    return np.asarray(points, dtype=np.float32)


def actions_of(model: Any, statistics: VecNormalize | None, points: Any) -> Any:
    """What the library does with the environment's own observations."""
    given = points if statistics is None else statistics.normalize_obs(points)
    return model.predict(given, deterministic=True)[0].reshape(len(points), -1)


def clips(policy: Policy) -> list[tuple[float, float]]:
    return [
        (entry.lower, entry.upper) for entry in policy.layers if isinstance(entry, Activation) and entry.kind == "clip"
    ]


def require_same(model: Any, statistics: VecNormalize | None, path: Path) -> Policy:
    """Export, read the file, compare."""
    exported = export_stable_baselines3(model, path, normalize=statistics)
    policy = read_policy(path)
    points = observations(model, statistics)
    expected = actions_of(model, statistics, points)
    received = policy(points.reshape(len(points), -1))
    np.testing.assert_allclose(received, expected, rtol=0, atol=1e-4 * max(1.0, np.abs(expected).max()))
    assert exported.policy.digest == policy.digest and exported.policy.name == path.name and exported.path == path
    assert 0.0 <= exported.deviation <= exported.allowed < 0.01 * np.ptp(expected)
    return policy


@pytest.mark.parametrize("normalized", [False, True], ids=["plain", "normalised"])
@pytest.mark.parametrize("bounds", BOXES)
@pytest.mark.parametrize("algorithm", [*GAUSSIAN, *SQUASHED])
def test_the_file_computes_what_predict_computes(algorithm: str, bounds: str, normalized: bool, tmp_path: Path) -> None:
    model = model_of(algorithm, box(bounds), normalized=normalized)
    require_same(model, model.get_vec_normalize_env(), tmp_path / "policy.onnx")


@pytest.mark.parametrize(
    "activation",
    [torch.nn.ReLU, torch.nn.Tanh, torch.nn.LeakyReLU, torch.nn.Sigmoid, torch.nn.ReLU6, torch.nn.Identity],
)
@pytest.mark.parametrize("algorithm", ["PPO", "SAC", "TD3"])
def test_every_supported_activation_is_the_one_of_torch(algorithm: str, activation: Any, tmp_path: Path) -> None:
    require_same(model_of(algorithm, activation_fn=activation), None, tmp_path / "policy.onnx")


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_state_dependent_exploration_leaves_its_mean(algorithm: str, tmp_path: Path) -> None:
    policy = require_same(model_of(algorithm, use_sde=True), None, tmp_path / "policy.onnx")
    assert ((-2.0, 2.0) in clips(policy)) == (algorithm == "SAC")  # its `clip_mean`


def test_a_squashed_gaussian_of_ppo_is_squashed_and_scaled(tmp_path: Path) -> None:
    model = model_of("PPO", box("uneven"), use_sde=True, squash_output=True)
    policy = require_same(model, None, tmp_path / "policy.onnx")
    assert clips(policy) == []


def test_features_of_its_own_and_observations_of_two_dimensions_are_flattened(tmp_path: Path) -> None:
    seen = spaces.Box(-5.0, 5.0, (2, 3), np.float32)
    model = model_of("PPO", seen=seen, share_features_extractor=False)
    assert require_same(model, None, tmp_path / "policy.onnx").inputs == 6


@pytest.mark.parametrize("algorithm", ["PPO", "SAC"])
def test_a_network_without_hidden_layers_is_one_affine_map(algorithm: str, tmp_path: Path) -> None:
    policy = require_same(model_of(algorithm, net_arch=[]), None, tmp_path / "policy.onnx")
    assert isinstance(policy.layers[0], Affine) and policy.layers[0].weight.shape == (2, 3)


def test_actions_of_a_gaussian_end_at_the_edges_of_the_box(tmp_path: Path) -> None:
    """One pair of bounds is the file's last clip, as it is; several ones are met within a rounding of float32."""
    for bounds, slack in (("wide", 0.0), ("uneven", 1e-6)):
        model = model_of("PPO", box(bounds), gain=5.0)
        policy = require_same(model, None, tmp_path / f"{bounds}.onnx")
        actions = policy(observations(model, None))
        np.testing.assert_allclose(actions.min(axis=0), BOXES[bounds][0], rtol=0, atol=slack)
        np.testing.assert_allclose(actions.max(axis=0), BOXES[bounds][1], rtol=0, atol=slack)
        assert len(np.unique(actions[:, 0])) > 2  # between the edges too


def test_normalised_observations_are_clipped_where_the_library_clips_them(tmp_path: Path) -> None:
    model = model_of("TD3", normalized=True)
    statistics = model.get_vec_normalize_env()
    policy = require_same(model, statistics, tmp_path / "policy.onnx")
    assert clips(policy) == [(-2.5, 2.5)]
    far, farther = (statistics.obs_rms.mean + reach * np.sqrt(statistics.obs_rms.var) for reach in (30.0, 3000.0))
    assert np.array_equal(policy(far), policy(farther))
    statistics.clip_obs = np.inf
    assert clips(require_same(model, statistics, tmp_path / "unclipped.onnx")) == []


def test_only_rewards_normalised_is_not_normalised(tmp_path: Path) -> None:
    model = model_of("PPO", normalized=True)
    model.get_vec_normalize_env().norm_obs = False
    policy = require_same(model, None, tmp_path / "policy.onnx")
    statistics = model.get_vec_normalize_env()
    assert export_stable_baselines3(model, tmp_path / "given.onnx", normalize=statistics).policy.digest == policy.digest


def test_an_exported_policy_is_verified_with_its_clips(tmp_path: Path) -> None:
    """Both clips act within the initial set, and the checker accepts the certificate."""
    model = model_of("PPO", spaces.Box(-0.5, 0.5, (1,), np.float32), normalized=True)
    statistics = model.get_vec_normalize_env()
    statistics.obs_rms.mean, statistics.obs_rms.var = np.zeros(3), np.full(3, 0.01)
    export_stable_baselines3(model, tmp_path / "policy.onnx", normalize=statistics)
    (tmp_path / "drift.yaml").write_text(
        "setrl: 1\n"
        "plant:\n  states: {x: m}\n  inputs: {u: m/s}\n  dynamics: {x: u}\n"
        "controller: {period: 0.1, observe: [x, sin(x), 2*x]}\n"
        "horizon: 1\ninitial: {x: [-0.4, 0.4]}\n"
        "requirements:\n  - stay: {x: [-0.95, 0.95]}\n"
    )
    result = setrl.verify(tmp_path / "policy.onnx", tmp_path / "drift.yaml")
    assert result.verdict == "VERIFIED", result.reason  # |u| <= 0.5 for 1 s


class Doubled(FlattenExtractor):
    def forward(self, given: Any) -> Any:
        return 2.0 * super().forward(given)


def refusals() -> dict[str, Any]:
    """Models that no file of affine maps and activations can hold, and what the error names."""
    image = spaces.Box(0, 255, (3, 36, 36), np.uint8)
    several = spaces.Dict({"position": vector(2), "speed": vector(1)})
    return {
        "images": (lambda: model_of("PPO", seen=image, policy="CnnPolicy"), "vector of numbers", "FlattenObservation"),
        "dictionary": (
            lambda: model_of("PPO", seen=several, policy="MultiInputPolicy"),
            "vector of numbers",
            "FlattenObservation",
        ),
        "discrete": (lambda: model_of("PPO", spaces.Discrete(3)), "continuous actions", "Box"),
        "extractor": (
            lambda: model_of("SAC", features_extractor_class=Doubled),
            "features extractor Doubled",
            "net_arch",
        ),
        "activation": (lambda: model_of("TD3", activation_fn=torch.nn.ELU), "with ELU", "LeakyReLU"),
        "one value": (lambda: model_of("PPO", span(*FLAT)), "one possible value", "leave that action out"),
    }


@pytest.mark.parametrize("case", refusals())
def test_what_the_file_cannot_hold_is_refused_with_a_remedy(case: str, tmp_path: Path) -> None:
    make, message, remedy = refusals()[case]
    with pytest.raises(PolicyError, match=message) as caught:
        export_stable_baselines3(make(), tmp_path / "policy.onnx")
    assert remedy in str(caught.value.remedy)
    assert list(tmp_path.iterdir()) == []


def test_a_policy_class_of_ones_own_is_refused(tmp_path: Path) -> None:
    from stable_baselines3.common.policies import ActorCriticPolicy

    class Own(ActorCriticPolicy):  # type: ignore[misc]
        pass

    with pytest.raises(PolicyError, match="type Own"):
        export_stable_baselines3(model_of("PPO", policy=Own), tmp_path / "policy.onnx")  # type: ignore[arg-type]


def test_discrete_q_networks_are_refused(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="continuous actions"):
        export_stable_baselines3(model_of("DQN", spaces.Discrete(2)), tmp_path / "policy.onnx")


@pytest.mark.parametrize("factor", [1.01, np.nan])
def test_a_file_that_disagrees_with_predict_is_not_written(factor: float, tmp_path: Path) -> None:
    model = model_of("TD3")
    model.policy.actor.mu.register_forward_hook(lambda module, given, returned: factor * returned)
    with pytest.raises(PolicyError, match="do not compute the same actions"):
        export_stable_baselines3(model, tmp_path / "policy.onnx")
    assert list(tmp_path.iterdir()) == []


def test_weights_that_are_not_numbers_are_refused(tmp_path: Path) -> None:
    model = model_of("SAC")
    with torch.no_grad():
        model.policy.actor.mu.bias[0] = np.nan
    with pytest.raises(PolicyError, match="finite"):
        export_stable_baselines3(model, tmp_path / "policy.onnx")


def test_a_normalisation_is_not_forgotten(tmp_path: Path) -> None:
    model = model_of("PPO", normalized=True)
    with pytest.raises(UsageError, match="normalised observations") as caught:
        export_stable_baselines3(model, tmp_path / "policy.onnx")
    assert caught.value.remedy == "normalize=model.get_vec_normalize_env()"


def test_a_normalisation_that_does_not_fit_is_refused(tmp_path: Path) -> None:
    statistics = model_of("PPO", normalized=True).get_vec_normalize_env()
    wide = model_of("PPO", seen=vector(4))
    with pytest.raises(UsageError, match="of 3 numbers, the policy observes 4"):
        export_stable_baselines3(wide, tmp_path / "policy.onnx", normalize=statistics)
    with pytest.raises(UsageError, match="must be a VecNormalize, received str"):
        export_stable_baselines3(wide, tmp_path / "policy.onnx", normalize="statistics.pkl")
    several = spaces.Dict({"position": vector(2), "speed": vector(1)})
    apart = VecNormalize(DummyVecEnv([lambda: Still(several, box("unit"))]))
    with pytest.raises(UsageError, match="dictionary"):
        export_stable_baselines3(wide, tmp_path / "policy.onnx", normalize=apart)


@pytest.mark.parametrize("given", ["model.zip", None, torch.nn.Linear(2, 1)])
def test_what_is_no_model_is_a_usage_error(given: Any, tmp_path: Path) -> None:
    with pytest.raises(UsageError, match="a model of Stable-Baselines3 is required") as caught:
        export_stable_baselines3(given, tmp_path / "policy.onnx")
    assert "PPO.load" in str(caught.value.remedy)


def test_without_the_library_the_error_says_what_to_install(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "stable_baselines3.common.base_class", None)
    with pytest.raises(UsageError, match="cannot be imported") as caught:
        export_stable_baselines3(object(), tmp_path / "policy.onnx")
    assert caught.value.remedy == "pip install stable-baselines3"


def test_a_folder_that_is_missing_is_an_input_error(tmp_path: Path) -> None:
    with pytest.raises(InputError):
        export_stable_baselines3(model_of("PPO"), tmp_path / "missing" / "policy.onnx")


def test_a_model_that_was_saved_and_loaded_is_the_same_file(tmp_path: Path) -> None:
    model = model_of("SAC")
    first = export_stable_baselines3(model, tmp_path / "policy.onnx")
    model.save(tmp_path / "model.zip")
    loaded = library.SAC.load(tmp_path / "model.zip", device="cpu")
    assert export_stable_baselines3(loaded, tmp_path / "again.onnx").policy.digest == first.policy.digest
