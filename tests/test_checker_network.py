"""The checker's network encloses what the file's numbers mean, and refuses what it does not know."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx
from loops import network
from onnx import TensorProto
from onnx_models import bytes_of, random

from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import policy_bytes
from setrl.specs.errors import PolicyError
from setrl.verify.checker.network import read_network
from setrl.verify.checker.taylor import ball

W, V = random(4, 6, seed=1), random(6, 2, seed=2)
B, C = random(6, seed=3), random(2, seed=4)


def balls(x: Any) -> list[Any]:
    return [arb(float(value)) for value in x]


def agrees(content: bytes, count: int = 20, tolerance: float = 1e-12) -> None:
    ours, theirs = read_network(content), read_policy(content)
    assert (ours.inputs, ours.outputs, ours.digest) == (theirs.inputs, theirs.outputs, theirs.digest)
    points = np.random.default_rng(0).normal(size=(count, ours.inputs))
    with ctx.workprec(160):
        for point in points:
            found = ours(balls(point))
            assert max(float(value.rad()) for value in found) < 1e-40
            assert [float(value) for value in found] == pytest.approx(theirs(point).tolist(), rel=1e-10, abs=tolerance)


@pytest.mark.parametrize(
    ("kind", "precision"),
    [(kind, "float32") for kind in ("relu", "leaky_relu", "tanh", "sigmoid", "clip")]
    + [("relu", "float64"), ("tanh", "float64"), ("sigmoid", "float64")],
)
def test_random_networks_agree_with_the_float_forward_pass(kind: str, precision: str) -> None:
    for seed in range(2):
        policy = network([3, 8, 5, 2], [kind, kind, "tanh"], seed, 1.5, precision)
        agrees(policy_bytes(policy.layers, precision=precision))


CHAINS: dict[str, tuple[list[Any], dict[str, Any], dict[str, Any]]] = {
    "matmul add": ([("MatMul", "xW", "h", {}), ("Add", "hB", "y", {})], {"W": W, "B": B}, {}),
    "bias first": ([("MatMul", "xW", "h", {}), ("Add", "Bh", "y", {})], {"W": W, "B": B[None]}, {}),
    "gemm": ([("Gemm", "xWB", "y", {"transB": 1})], {"W": W.T.copy(), "B": B}, {}),
    "scaled gemm": ([("Gemm", "xWB", "y", {"alpha": 0.3, "beta": -1.7})], {"W": W, "B": B}, {}),
    "without bias": ([("Gemm", "xW", "y", {})], {"W": W}, {}),
    "sub mul div": (
        [("Sub", "xa", "h", {}), ("Mul", "hb", "i", {}), ("Div", "ib", "j", {}), ("Sub", "aj", "y", {})],
        {"a": random(4), "b": random(1, 4, seed=5)},
        {},
    ),
    "numbers": ([("Mul", "xa", "h", {}), ("Div", "hb", "y", {})], {"a": np.float32(3), "b": random(1)}, {}),
    "flatten": ([("Flatten", "x", "h", {}), ("MatMul", "hW", "y", {})], {"W": W}, {"shape": ("batch", 2, 2)}),
    "reshape": (
        [("Reshape", "xs", "h", {}), ("MatMul", "hW", "y", {})],
        {"s": np.array([-1, 4]), "W": W},
        {"shape": ("batch", 2, 2)},
    ),
    "activations": (
        [("Relu", "x", "a", {}), ("LeakyRelu", "a", "b", {}), ("Tanh", "b", "c", {}), ("Sigmoid", "c", "d", {})]
        + [("Neg", "d", "e", {}), ("LeakyRelu", "e", "f", {"alpha": 0.3}), ("Identity", "f", "y", {})],
        {},
        {},
    ),
    "clip": ([("Clip", "xlh", "y", {})], {"l": np.float32(-0.5), "h": np.float32(0.25)}, {}),
    "clip above": ([("Clip", ["x", "", "h"], "y", {})], {"h": np.float32(0.25)}, {}),
    "clip by attributes": ([("Clip", "x", "y", {"min": -0.5, "max": 0.25})], {}, {"opset": 10}),
    "widening cast": (
        [("Cast", "x", "h", {"to": TensorProto.DOUBLE}), ("MatMul", "hW", "y", {})],
        {"W": W.astype(np.float64)},
        {},
    ),
}


@pytest.mark.parametrize("name", CHAINS)
def test_operators_agree_with_the_other_reader(name: str) -> None:
    nodes, constants, options = CHAINS[name]
    agrees(bytes_of(nodes, constants, **options))


REFUSED: dict[str, tuple[list[Any], dict[str, Any], dict[str, Any]]] = {
    "unknown operator": ([("Sin", "x", "y", {})], {}, {}),
    "skip connection": ([("Relu", "x", "h", {}), ("Add", "xh", "y", {})], {}, {}),
    "weights on the left": ([("MatMul", "Wx", "y", {})], {"W": W}, {}),
    "column of constants": ([("Add", "xa", "y", {})], {"a": random(4, 1)}, {}),
    "wrong matrix": ([("MatMul", "xV", "y", {})], {"V": V}, {}),
    "transposed input": ([("Gemm", "xW", "y", {"transA": 1})], {"W": W}, {}),
    "narrowing cast": (
        [("Relu", "x", "h", {}), ("Cast", "h", "y", {"to": TensorProto.FLOAT})],
        {},
        {"dtype": TensorProto.DOUBLE},
    ),
    "several rows": ([("Relu", "x", "y", {})], {}, {"shape": (2, 4)}),
    "division by the input": ([("Div", "ax", "y", {})], {"a": random(4)}, {}),
    "infinite weight": ([("Add", "xa", "y", {})], {"a": np.array([np.inf] * 4, dtype=np.float32)}, {}),
    "nan": ([("Clip", "xa", "y", {})], {"a": np.float32(np.nan)}, {}),
    "constant output": ([("Identity", "a", "y", {})], {"a": random(4)}, {}),
    "unknown attribute": ([("Flatten", "x", "y", {"axis": 0})], {}, {}),
    "new operator set": ([("Relu", "x", "y", {})], {}, {"opset": 3}),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_understood_is_not_checkable(name: str) -> None:
    nodes, constants, options = REFUSED[name]
    with pytest.raises(PolicyError):
        read_network(bytes_of(nodes, constants, **options))


@pytest.mark.parametrize("content", [b"", b"no model", b"\x00" * 100])
def test_bytes_that_are_no_model_are_refused(content: bytes) -> None:
    with pytest.raises(PolicyError):
        read_network(content)


def test_division_by_a_constant_is_exact() -> None:
    content = bytes_of([("Div", "xa", "y", {})], {"a": np.float32([3, 7, 10, 0.1])})
    with ctx.workprec(160):
        found = read_network(content)(balls([1, 1, 1, 1]))
        for value, divisor in zip(found, (3, 7, 10, Fraction(float(np.float32(0.1)))), strict=True):
            assert value.contains(ball(1 / Fraction(divisor))) and float(value.rad()) < 1e-45


def test_a_box_of_inputs_is_enclosed() -> None:
    policy = network([2, 6, 2], ["leaky_relu", "tanh"], 5)
    ours = read_network(policy_bytes(policy.layers))
    generator = np.random.default_rng(1)
    with ctx.workprec(128):
        box = ours([arb(0.1, 0.2), arb(-0.3, 0.5)])
        for _ in range(50):
            point = [0.1 + 0.2 * generator.uniform(-1, 1), -0.3 + 0.5 * generator.uniform(-1, 1)]
            assert all(wide.contains(thin) for wide, thin in zip(box, ours(balls(point)), strict=True))
