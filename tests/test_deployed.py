"""What the runtime computes is within e_L of exact arithmetic."""

from __future__ import annotations

from typing import Any

import laws
import numpy as np
import pytest
from loops import activation_of, network

from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine, Layer, Policy


def stored(layers: Any, precision: str = "float32") -> Policy:
    """The policy as its ONNX file says."""
    return read_policy(policy_bytes(layers, precision=precision))


RUNS = [(kind, "float32") for kind in ("relu", "leaky_relu", "tanh", "sigmoid", "clip")]
RUNS += [(kind, "float64") for kind in ("relu", "tanh", "sigmoid", "clip")]  # onnxruntime has no LeakyRelu for double


@pytest.mark.parametrize(("kind", "precision"), RUNS)
def test_the_runtime_is_within_its_bound(kind: str, precision: str) -> None:
    for seed, scale in enumerate((0.5, 3.0)):
        policy = stored(network([3, 9, 7, 2], [kind, kind, "none"], seed, scale).layers, precision)
        share = laws.law_deployed(policy, np.array([-1.0, 0.3, 2.0]), np.array([1.0, 0.31, 9.0]), seed=seed)
        assert share > 0.0 or precision == "float64"


@pytest.mark.parametrize("kind", ["relu", "tanh", "sigmoid"])
def test_a_final_activation_is_within_its_bound(kind: str) -> None:
    policy = stored(network([2, 6, 2], ["relu", kind], 4, 2.0).layers)
    laws.law_deployed(policy, np.array([-1.0, -1.0]), np.array([1.0, 1.0]))


def cancelling(size: float, width: int = 64) -> list[Layer]:
    """Large terms that cancel exactly in real arithmetic and leave a small one."""
    generator = np.random.default_rng(2)
    large = (size * generator.random(width)).astype(np.float32).astype(float)
    first = Affine(np.stack([large, np.ones(width)], 1), np.zeros(width))
    row = np.concatenate([np.ones(width // 2), -np.ones(width // 2)])
    return [first, Activation("relu"), Affine(np.stack([row, row[::-1]]), np.array([1e-3, 0.0]).astype(np.float32))]


@pytest.mark.parametrize("size", [1.0, 1e4, 1e12])
def test_networks_that_cancel_are_within_their_bound(size: float) -> None:
    policy = stored(cancelling(size))
    assert laws.law_deployed(policy, np.array([0.1, -1.0]), np.array([1.3, 1.0])) > 0.0


def test_sums_that_round_the_same_way_are_within_their_bound() -> None:
    row = np.array([1.0] + [2.0**-24] * 63)
    policy = stored([Affine(np.stack([row, -row]), np.zeros(2)), activation_of("relu"), Affine(np.eye(2), np.zeros(2))])
    laws.law_deployed(policy, np.full(64, 0.99), np.full(64, 1.01))


def test_subnormal_numbers_are_within_their_bound() -> None:
    tiny = Affine(np.full((2, 2), 2.0**-140), np.full(2, 2.0**-140))
    layers = (tiny, activation_of("relu"), Affine(np.full((1, 2), 2.0**60), np.zeros(1)))
    policy = Policy(layers, 2, 1, content=policy_bytes(layers))
    laws.law_deployed(policy, np.array([0.1, 0.1]), np.array([1.0, 1.0]))
