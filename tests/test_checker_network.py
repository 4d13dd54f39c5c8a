"""The checker's network encloses what the file's numbers mean, and refuses what it does not know."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx
from loops import network
from onnx import TensorProto
from onnx_chains import random_chain
from onnx_models import bytes_of, model_of, random
from test_policy_reader import READABLE

from setrl.models import policy as engine
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import policy_bytes
from setrl.specs.errors import PolicyError
from setrl.verify.checker.layers import Activation, Dense, Diagonal, Selection, enclosures
from setrl.verify.checker.network import Network, read_network
from setrl.verify.checker.taylor import ball

W, V = random(4, 6, seed=1), random(6, 2, seed=2)
B, C = random(6, seed=3), random(2, seed=4)

CHAINS_DRAWN = 60


def balls(x: Any) -> list[Any]:
    return [arb(float(value)) for value in x]


def agrees(content: bytes, count: int = 20, tolerance: float = 1e-12) -> None:
    ours, theirs = read_network(content), read_policy(content)
    assert (ours.inputs, ours.outputs, ours.digest) == (theirs.inputs, theirs.outputs, theirs.digest)
    assert ours.precision == theirs.precision
    assert activations(ours) == activations_of_the_engine(theirs)
    points = np.random.default_rng(0).normal(size=(count, ours.inputs))
    with ctx.workprec(160):
        for point in points:
            found = ours(balls(point))
            assert max(float(value.rad()) for value in found) < 1e-40
            assert [float(value) for value in found] == pytest.approx(theirs(point).tolist(), rel=1e-10, abs=tolerance)


def activations(ours: Network) -> list[Any]:
    """Every activation with its number of neurons."""
    size, found = ours.inputs, []
    for layer in ours.layers:
        if isinstance(layer, Activation):
            found.append((layer.kind, layer.slope, layer.low, layer.high, size))
        else:
            size = len(layer.index if isinstance(layer, Selection) else layer.offset)
    assert size == ours.outputs
    return found


def activations_of_the_engine(theirs: engine.Policy) -> list[Any]:
    size, found = theirs.inputs, []
    for layer in theirs.layers:
        if isinstance(layer, engine.Activation):
            found.append((layer.kind, layer.slope, layer.lower, layer.upper, size))
        else:
            size = len(layer.bias)
    return found


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


@pytest.mark.parametrize("name", READABLE)
def test_every_operator_of_the_other_reader_means_the_same_here(name: str) -> None:
    nodes, constants, options, _ = READABLE[name]
    agrees(bytes_of(nodes, constants, **options))


@pytest.mark.parametrize("seed", range(CHAINS_DRAWN))
def test_random_chains_of_operators_mean_the_same_to_both_readers(seed: int) -> None:
    agrees(random_chain(seed).content(), count=3, tolerance=1e-9)


def test_the_random_chains_contain_every_operator_that_computes_or_moves() -> None:
    drawn = {operator for seed in range(CHAINS_DRAWN) for operator, *_ in random_chain(seed).nodes}
    assert drawn >= {operator for nodes, *_ in READABLE.values() for operator, *_ in nodes} - {
        "Cast",
        "Constant",
        "Shape",
    }


# what has a meaning for one observation, although it would mix a batch of several; the outputs are places of the input
ONE_ROW: dict[str, tuple[list[Any], dict[str, Any], list[int]]] = {
    "a reshape into the batch": ([("Reshape", "xs", "y", {})], {"s": [-1, 2]}, [0, 1, 2, 3]),
    "a transposed batch": ([("Transpose", "x", "y", {})], {}, [0, 1, 2, 3]),
    "a slice of the batch": ([("Slice", "xsea", "y", {})], {"s": [0], "e": [1], "a": [0]}, [0, 1, 2, 3]),
    # where a walk backwards starts in front of the array, ONNX lets it start at the first place
    "a slice from far outside": (
        [("Slice", "xseat", "y", {})],
        {"s": [-9], "e": [-(2**63)], "a": [1], "t": [-1]},
        [0],
    ),
}


@pytest.mark.parametrize("name", ONE_ROW)
def test_a_network_is_read_for_a_batch_of_one(name: str) -> None:
    nodes, constants, places = ONE_ROW[name]
    ours = read_network(bytes_of(nodes, constants))
    assert [float(value) for value in ours(balls(range(4)))] == places


def test_layers_hold_exactly_the_numbers_of_the_file() -> None:
    double = {"dtype": TensorProto.DOUBLE}
    (product,) = read_network(bytes_of([("Gemm", "xWB", "y", {})], {"W": W, "B": B})).layers
    assert isinstance(product, Dense)
    assert product.matrix == tuple(map(tuple, W.T.tolist())) and product.offset == tuple(B.tolist())
    divisor = np.array([3, 0.5, 1e-310, -0.1])
    (division,) = read_network(bytes_of([("Div", "xd", "y", {})], {"d": divisor}, **double)).layers
    assert isinstance(division, Diagonal) and division.scale == tuple(1 / Fraction(d) for d in divisor.tolist())
    assert [type(scale) for scale in division.scale] == [Fraction, float, Fraction, Fraction]
    scaled = [("Gemm", "xWB", "y", {"alpha": 0.5, "beta": 0.7})]
    weights = {"W": W.astype(np.float64) / 3, "B": B.astype(np.float64) / 7}
    bare, factor = read_network(bytes_of(scaled, weights, **double)).layers
    assert isinstance(bare, Dense) and isinstance(factor, Diagonal)
    assert bare.matrix == tuple(map(tuple, weights["W"].T.tolist())) and not any(bare.offset)
    beta = Fraction(float(np.float32(0.7)))
    assert factor.scale == (0.5,) * 6 and factor.offset == tuple(beta * Fraction(b) for b in weights["B"].tolist())


def test_a_bias_that_is_added_is_the_offset_of_its_product_and_a_later_one_is_not() -> None:
    nodes = [("MatMul", "xW", "h", {}), ("Add", "hB", "i", {}), ("Add", "Bi", "y", {})]
    first, second = read_network(bytes_of(nodes, {"W": W, "B": B})).layers
    assert isinstance(first, Dense) and first.offset == tuple(B.tolist())
    assert isinstance(second, Diagonal) and second.offset == tuple(B.tolist())


def test_stored_balls_enclose_their_numbers_whatever_the_precision_at_first_use() -> None:
    third = Fraction(1, 3)
    with ctx.workprec(10):
        layer = Dense(((third, 0.1),), (Fraction(1, 7),))
        assert layer.arb_matrix[0, 1].is_exact() and not layer.arb_matrix[0, 0].is_exact() and layer.arb_offset
    with ctx.workprec(3000):
        assert (3 * layer.arb_matrix[0, 0]).contains(1) and (7 * layer.arb_offset[0]).contains(1)
        assert float(layer.arb_matrix[0, 0].rad()) == 0.0 != layer.arb_matrix[0, 0].rad()
        assert all(value.is_exact() for value in enclosures([0.1, 5e-324, -1.7976931348623157e308]))


PRECISIONS: dict[str, tuple[list[Any], int, str]] = {
    "float32": ([("Relu", "x", "y", {})], TensorProto.FLOAT, "float32"),
    "float64": ([("Relu", "x", "y", {})], TensorProto.DOUBLE, "float64"),
    "widened": ([("Cast", "x", "y", {"to": TensorProto.DOUBLE})], TensorProto.FLOAT, "float32"),
    "narrowed": ([("Cast", "x", "y", {"to": TensorProto.FLOAT})], TensorProto.DOUBLE, "float32"),
    "narrowed and widened again": (
        [("Cast", "x", "h", {"to": TensorProto.FLOAT}), ("Cast", "h", "y", {"to": TensorProto.DOUBLE})],
        TensorProto.DOUBLE,
        "float32",
    ),
    "narrowed beside the way": (
        [("Cast", "x", "unused", {"to": TensorProto.FLOAT}), ("Cast", "x", "y", {"to": TensorProto.DOUBLE})],
        TensorProto.DOUBLE,
        "float32",
    ),
}


@pytest.mark.parametrize("name", PRECISIONS)
def test_a_network_is_float32_where_anything_in_it_is(name: str) -> None:
    nodes, dtype, precision = PRECISIONS[name]
    content = bytes_of(nodes, dtype=dtype)
    assert read_network(content).precision == precision
    agrees(content)


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


def test_numbers_that_are_not_stored_as_raw_bytes_are_the_same_numbers() -> None:
    nodes = [("Gather", "xi", "g", {"axis": 1}), ("Reshape", "gs", "h", {}), ("Add", "ha", "y", {})]
    model = model_of(nodes, {"i": np.array([3, -4], np.int32), "s": np.array([-1, 2]), "a": V[0]})
    agrees(model.SerializeToString())
    for tensor, field, numbers in zip(
        model.graph.initializer,
        ("int32_data", "int64_data", "float_data"),
        ([3, -4], [-1, 2], V[0].tolist()),
        strict=True,
    ):
        tensor.ClearField("raw_data")
        getattr(tensor, field).extend(numbers)
    agrees(model.SerializeToString())
    moved, added = read_network(model.SerializeToString()).layers
    assert isinstance(moved, Selection) and moved.index == (3, 0)
    assert isinstance(added, Diagonal) and added.offset == tuple(V[0].tolist())


def test_damaged_models_are_refused_or_mean_the_same_to_both_readers() -> None:
    generator = np.random.default_rng(6)
    models = [bytes_of(nodes, constants, **options) for nodes, constants, options, _ in READABLE.values()]
    both = 0
    for _ in range(2500):
        content = bytearray(models[generator.integers(len(models))])
        for _ in range(generator.integers(1, 4)):
            place = generator.integers(len(content))
            stop = place + generator.integers(0, 3)
            content[place:stop] = generator.integers(0, 256, size=generator.integers(0, 3), dtype=np.uint8).tobytes()
        try:
            ours, theirs = read_network(bytes(content)), read_policy(bytes(content))
        except PolicyError:
            continue
        both += 1
        assert (ours.precision, activations(ours)) == (theirs.precision, activations_of_the_engine(theirs))
        point = generator.normal(size=ours.inputs)
        with ctx.workprec(160):
            found = [float(value) for value in ours(balls(point))]
        assert found == pytest.approx(theirs(point).tolist(), rel=1e-9, abs=1e-9)
    assert both > 100
