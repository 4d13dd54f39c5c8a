"""What the runtime computes is within e_L of exact arithmetic."""

from __future__ import annotations

from typing import Any

import laws
import numpy as np
import pytest
from loops import activation_of, network

from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_runtime import deployed_runner
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine, Layer, Policy
from setrl.verify import deployed


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


def test_a_number_that_float32_cannot_hold_is_off_by_its_conversion() -> None:
    held, lost = np.array([1.0, -0.5, 3.0, 2.0**24]), np.array([1.0 + 2.0**-40, 0.1, 2.0**24 + 1.0, 1e-40])
    assert (deployed.conversion_error(held, None, "float32") == 0.0).all()
    distance = np.abs(lost.astype(np.float32).astype(np.float64) - lost)
    assert (distance > 0.0).all() and (deployed.conversion_error(lost, None, "float32") >= distance).all()
    assert (deployed.conversion_error(lost, None, "float64") == 0.0).all()
    # a denormal number that is held may be flushed to zero all the same
    denormal = np.array([2.0**-140])
    assert (deployed.conversion_error(denormal, None, "float32") >= denormal).all()
    # a stored number that only bounds the exact one is off by both
    inexact = np.full(4, 2.0**-30)
    assert (deployed.conversion_error(held, inexact, "float32") >= inexact).all()


@pytest.mark.parametrize(("kind", "precision"), [(k, p) for k in ("tanh", "sigmoid") for p in ("float32", "float64")])
def test_the_runtimes_own_functions_are_within_their_constant(kind: str, precision: str) -> None:
    # around 16 onnxruntime 1.31 is furthest off in float64; batches of several sizes take different code paths
    points = np.concatenate([np.linspace(-20.0, 20.0, 4001), np.linspace(-19.0, -15.0, 3000), [-17.711515293817616]])
    runner = deployed_runner(stored([Affine(np.eye(1), np.zeros(1)), Activation(kind)], precision))
    points = points.astype(precision).astype(np.float64)
    exact = [laws.exact_activation(Activation(kind), float(x)) for x in points]
    for size in (1, 7, 64, points.size):
        shown = points[:: max(1, points.size // 500)] if size == 1 else points
        values = np.concatenate([runner(shown[i : i + size, None])[:, 0] for i in range(0, shown.size, size)])
        bounds = exact[:: max(1, points.size // 500)] if size == 1 else exact
        for value, (least, most) in zip(values, bounds, strict=True):
            assert most - deployed.RUNTIME_ERROR[precision] <= value <= least + deployed.RUNTIME_ERROR[precision]
