"""A policy that Stable-Baselines3 trained, as the ONNX file of exactly what its `predict` computes.

What is between the environment's observation and its action is part of the file, in this order: `VecNormalize`'s
statistics and clip, the hidden layers, the mean of the action, the squashing, and the scaling or clipping to the
action space. Stable-Baselines3 is no dependency of setrl: who has such a policy has the library.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import torch

from ..models.onnx_reader import read_policy
from ..models.onnx_runtime import SLACK, deployed_runner, rounding_budget
from ..models.onnx_writer import policy_bytes
from ..models.policy import Activation, Affine, FloatArray, Layer, Policy
from ..specs.errors import PolicyError, UsageError
from ..specs.files import write_atomically

SAMPLES = 256
"""Random observations on which the file is compared with `predict`."""

_SUPPORTED = "PPO, A2C, SAC, TD3 and DDPG with MlpPolicy are"


@dataclass(frozen=True)
class ExportedPolicy:
    """A policy that was exported, and how it compares with the library's own.

    Attributes
    ----------
    policy : Policy
        As the verifier reads it.
    path : Path
    deviation : float
        Largest ``|onnxruntime(x) - predict(x)|`` over the random observations, in units of the action.
    allowed : float
        What rounding in float32 explains at that observation; the deviation is not larger.
    """

    policy: Policy = field(repr=False)
    path: Path
    deviation: float
    allowed: float


def export_stable_baselines3(
    model: Any, path: str | Path, *, normalize: Any = None, description: str = ""
) -> ExportedPolicy:
    """Write the deterministic policy of a Stable-Baselines3 model as ONNX, and compare the file with ``model.predict``.

    The file computes ``a = out(mu(net(norm(o))))`` from the environment's own observation o, where ``norm(o) =
    clip((o - mean) / sqrt(var + eps), -c, c)`` with `VecNormalize`'s statistics, and ``out`` is ``clip(m, low, high)``
    for a Gaussian policy (PPO, A2C) and ``low + (tanh(m) + 1) (high - low) / 2`` for a squashed one (SAC, TD3, DDPG).

    Parameters
    ----------
    model : BaseAlgorithm
        PPO, A2C, SAC, TD3 or DDPG with an ``MlpPolicy``; of a zip file, what ``PPO.load(...)`` returns.
    path : str or path
        Written whole or not at all.
    normalize : VecNormalize, optional
        The wrapper that the policy was trained behind. Required where the model still has one.
    description : str
        Goes into the file.

    Returns
    -------
    ExportedPolicy

    Raises
    ------
    UsageError
        Stable-Baselines3 cannot be imported, `model` is none of its models, or `normalize` does not fit the model.
    PolicyError
        The policy has a part that a file of affine maps and activations cannot hold, a weight is not finite, or the
        file and ``predict`` do not compute the same actions.
    InputError
        The file cannot be written.
    """
    _require_model(model)
    policy = model.policy
    statistics = _statistics(model, normalize)
    size = _observed(policy)
    layers = [*_normalisation(statistics, size), *_network(policy), *_output(policy)]
    read = read_policy(policy_bytes(layers, description=description))
    deviation, allowed = _compare(read, model, statistics)
    write_atomically(path, read.content)
    return ExportedPolicy(replace(read, name=Path(path).name), Path(path), deviation, allowed)


def _require_model(model: Any) -> None:
    try:
        from stable_baselines3.common.base_class import BaseAlgorithm
    except ImportError as error:
        raise UsageError(
            f"Stable-Baselines3 cannot be imported: {error}", remedy="pip install stable-baselines3"
        ) from error
    if not isinstance(model, BaseAlgorithm):
        raise UsageError(
            f"a model of Stable-Baselines3 is required, received {type(model).__name__}",
            remedy="load it first, for example PPO.load('model.zip')",
        )


def _statistics(model: Any, normalize: Any) -> Any:
    """The wrapper whose observation statistics are part of the policy, or None where observations stay as they are."""
    from stable_baselines3.common.vec_env import VecNormalize

    if normalize is None:
        # a policy without its normalisation is another policy, and `predict` alone does not tell
        attached = model.get_vec_normalize_env()
        if attached is not None and attached.norm_obs:
            raise UsageError(
                "the model was trained on normalised observations, and no normalisation is given",
                remedy="normalize=model.get_vec_normalize_env()",
            )
        return None
    if not isinstance(normalize, VecNormalize):
        raise UsageError(
            f"normalize must be a VecNormalize, received {type(normalize).__name__}",
            remedy="VecNormalize.load('statistics.pkl', environment) reads a saved one",
        )
    return normalize if normalize.norm_obs else None


def _observed(policy: Any) -> int:
    """Numbers of an observation."""
    from gymnasium import spaces
    from stable_baselines3.common.preprocessing import is_image_space
    from stable_baselines3.common.torch_layers import FlattenExtractor

    seen, acting = policy.observation_space, policy.action_space
    if not isinstance(seen, spaces.Box) or is_image_space(seen):
        raise PolicyError(
            f"a vector of numbers is required as the observation, received {seen}",
            remedy="train on a flat Box of numbers, for example with gymnasium.wrappers.FlattenObservation",
        )
    if not isinstance(acting, spaces.Box):
        raise PolicyError(
            f"continuous actions are required, received {acting}", remedy="train with an action space that is a Box"
        )
    extractor = getattr(policy, "actor", policy).features_extractor
    # of the exact type: a subclass may compute anything
    if type(extractor) is not FlattenExtractor:
        raise PolicyError(
            f"the features extractor {type(extractor).__name__} is not supported",
            remedy="use MlpPolicy, whose FlattenExtractor hands the observation on, and put layers into net_arch",
        )
    return int(np.prod(seen.shape))


def _normalisation(statistics: Any, size: int) -> Iterator[Layer]:
    """``clip((o - mean) / sqrt(var + eps), -c, c)`` as an affine map and a clip."""
    if statistics is None:
        return
    mean, var = (np.asarray(part, dtype=np.float64).reshape(-1) for part in _moments(statistics))
    if len(mean) != size:
        raise UsageError(
            f"the normalisation is of {len(mean)} numbers, the policy observes {size}",
            remedy="give the VecNormalize that the policy was trained behind",
        )
    scale = 1.0 / np.sqrt(var + statistics.epsilon)
    yield Affine(np.diag(scale), -mean * scale)
    if np.isfinite(statistics.clip_obs):
        yield Activation("clip", lower=-float(statistics.clip_obs), upper=float(statistics.clip_obs))


def _moments(statistics: Any) -> tuple[Any, Any]:
    if isinstance(statistics.obs_rms, dict):
        raise UsageError(
            "the normalisation is of a dictionary of observations",
            remedy="give the VecNormalize that the policy was trained behind",
        )
    return statistics.obs_rms.mean, statistics.obs_rms.var


def _network(policy: Any) -> Iterator[Layer]:
    """Hidden layers and the mean of the action; the tanh that TD3 keeps inside its network included."""
    from stable_baselines3.common.policies import ActorCriticPolicy
    from stable_baselines3.sac.policies import Actor as SquashedActor
    from stable_baselines3.td3.policies import Actor as DeterministicActor

    actor = getattr(policy, "actor", None)
    if type(policy) is ActorCriticPolicy:
        modules = [policy.mlp_extractor.policy_net, policy.action_net]
    elif type(actor) is SquashedActor:
        modules = [actor.latent_pi, actor.mu]
    elif type(actor) is DeterministicActor:
        modules = [actor.mu]
    else:
        raise PolicyError(f"a policy of type {type(policy).__name__} is not supported", remedy=_SUPPORTED)
    for module in modules:
        yield from _layers(module)


def _layers(module: Any) -> Iterator[Layer]:
    """A module of torch; of the exact type, because a subclass may compute anything."""
    nn = torch.nn
    kind = type(module)
    if kind is nn.Sequential:
        for part in module:
            yield from _layers(part)
    elif kind is nn.Linear:
        weight = module.weight.detach().cpu().double().numpy()
        bias = np.zeros(len(weight)) if module.bias is None else module.bias.detach().cpu().double().numpy()
        yield Affine(weight, bias)
    elif kind is nn.LeakyReLU:
        yield Activation("leaky_relu", slope=float(module.negative_slope))
    elif kind in (nn.Hardtanh, nn.ReLU6):
        yield Activation("clip", lower=float(module.min_val), upper=float(module.max_val))
    elif kind in _ACTIVATIONS:
        yield Activation(_ACTIVATIONS[kind])
    elif kind is not nn.Identity:
        raise PolicyError(
            f"a network with {kind.__name__} is not supported",
            remedy="supported are Linear, ReLU, LeakyReLU, Tanh, Sigmoid and Hardtanh",
        )


_ACTIVATIONS: dict[type, str] = {torch.nn.ReLU: "relu", torch.nn.Tanh: "tanh", torch.nn.Sigmoid: "sigmoid"}


def _output(policy: Any) -> Iterator[Layer]:
    """From the mean to an action of the action space."""
    from stable_baselines3.td3.policies import Actor as DeterministicActor

    space = policy.action_space
    low, high = (np.asarray(bound, dtype=np.float64).reshape(-1) for bound in (space.low, space.high))
    if policy.squash_output:
        if type(getattr(policy, "actor", None)) is not DeterministicActor:
            yield Activation("tanh")
        yield from _scaled(low, high)
    elif (low == low[0]).all() and (high == high[0]).all():
        yield Activation("clip", lower=float(low[0]), upper=float(high[0]))
    else:
        if not (low < high).all():
            raise PolicyError(
                f"an action with one possible value cannot be clipped, received {space}",
                remedy="leave that action out of the environment's action space",
            )
        # the clip of a file has one pair of bounds for all components: there and back in units of the box
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        yield Affine(np.diag(1.0 / half), -middle / half)
        yield Activation("clip", lower=-1.0, upper=1.0)
        yield Affine(np.diag(half), middle)


def _scaled(low: FloatArray, high: FloatArray) -> Iterator[Layer]:
    """From [-1, 1] to [low, high]."""
    if not ((low == -1.0).all() and (high == 1.0).all()):
        yield Affine(np.diag((high - low) / 2.0), (low + high) / 2.0)


def _compare(read: Policy, model: Any, statistics: Any) -> tuple[float, float]:
    """Largest difference between the file and `predict`, and what rounding explains there.

    Both compute in float32, and each stays within `SLACK` times the first-order estimate of
    `models.onnx_runtime.rounding_budget`.
    """
    generator = np.random.default_rng(20250821)
    scales = generator.choice([0.1, 1.0, 10.0], size=(SAMPLES, 1))
    points = generator.uniform(-1.0, 1.0, size=(SAMPLES, read.inputs)) * scales
    if statistics is not None:
        # where the normalised observations are of those sizes; some are beyond the clip
        mean, var = (np.asarray(part).reshape(-1) for part in _moments(statistics))
        points = mean + 2.0 * points * np.sqrt(var + statistics.epsilon)
    points = points.astype(np.float32).astype(np.float64)
    shaped = points.astype(np.float32).reshape(SAMPLES, *model.policy.observation_space.shape)
    given = shaped if statistics is None else statistics.normalize_obs(shaped)
    expected = np.asarray(model.predict(given, deterministic=True)[0], dtype=np.float64).reshape(SAMPLES, -1)
    received = deployed_runner(read)(points)
    _, budget = rounding_budget(read, points)
    allowed = 2.0 * SLACK * budget
    # stated as what has to hold: NaN is no agreement
    if not (received.shape == expected.shape and (np.abs(received - expected) <= allowed).all()):
        raise PolicyError(
            "the exported network and the model's predict do not compute the same actions",
            remedy="a policy with its own forward pass cannot be exported: export it with torch.onnx.export",
        )
    deviations = np.abs(received - expected)
    worst = np.unravel_index(int(np.argmax(deviations)), deviations.shape)
    return float(deviations[worst]), float(allowed[worst])
