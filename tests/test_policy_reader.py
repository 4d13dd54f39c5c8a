"""What an ONNX file means is what setrl reads, and what it does not understand it refuses by name."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from onnx import TensorProto, helper
from onnx_models import bytes_of, model_of, random

from setrl.models.example import EXAMPLE_SPECIFICATION, example_policy_path
from setrl.models.onnx_operators import supported_operators
from setrl.models.onnx_reader import describe_policy, read_policy
from setrl.models.onnx_runtime import deployed_runner, require_agreement
from setrl.models.onnx_writer import write_policy
from setrl.models.policy import Activation, Affine, Policy
from setrl.specs.errors import PolicyError

F32 = np.float32
W, B, V = random(4, 3), random(3, seed=2), random(4, seed=3)
POINTS = np.random.default_rng(4).uniform(-3, 3, size=(50, 4))
DOUBLE = {"dtype": TensorProto.DOUBLE}


def plain(operator: str, **attributes: Any) -> list[Any]:
    return [(operator, ["x"], "y", attributes)]


def with_constant(operator: str, first: bool = True) -> list[Any]:
    return [(operator, ["x", "c"] if first else ["c", "x"], "y", {})]


# name: (nodes, constants, options, the same in numpy)
READABLE: dict[str, Any] = {
    "Gemm": ([("Gemm", ["x", "w", "b"], "y", {})], {"w": W, "b": B}, {}, lambda x: x @ W + B),
    "Gemm transB": ([("Gemm", ["x", "w", "b"], "y", {"transB": 1})], {"w": W.T, "b": B}, {}, lambda x: x @ W + B),
    "Gemm without bias": ([("Gemm", ["x", "w"], "y", {})], {"w": W}, {}, lambda x: x @ W),
    "Gemm with factors": (
        [("Gemm", ["x", "w", "b"], "y", {"alpha": 0.3, "beta": 1.7})],
        {"w": W, "b": B},
        {},
        lambda x: float(F32(0.3)) * (x @ W) + float(F32(1.7)) * B.astype(np.float64),
    ),
    "Gemm with powers of two": (
        [("Gemm", ["x", "w", "b"], "y", {"alpha": 0.5, "beta": 4.0})],
        {"w": W, "b": B},
        {},
        lambda x: 0.5 * (x @ W) + 4 * B,
    ),
    "Gemm with a scalar bias": ([("Gemm", ["x", "w", "b"], "y", {})], {"w": W, "b": F32(2)}, {}, lambda x: x @ W + 2),
    "MatMul": ([("MatMul", ["x", "w"], "y", {})], {"w": W}, {}, lambda x: x @ W),
    "MatMul and Add": (
        [("MatMul", ["x", "w"], "h", {}), ("Add", ["b", "h"], "y", {})],
        {"w": W, "b": B},
        {},
        lambda x: x @ W + B,
    ),
    "MatMul of a transposed constant": (
        [("Transpose", ["w"], "t", {}), ("MatMul", ["x", "t"], "y", {})],
        {"w": np.ascontiguousarray(W.T)},
        {},
        lambda x: x @ W,
    ),
    "MatMul on the last of three axes": (
        [("MatMul", ["x", "w"], "h", {}), ("Flatten", ["h"], "y", {})],
        {"w": random(2, 3)},
        {"shape": ("batch", 2, 2)},
        lambda x: (x.reshape(-1, 2, 2) @ random(2, 3)).reshape(len(x), 6),
    ),
    "Add": (with_constant("Add"), {"c": V}, {}, lambda x: x + V),
    "Sub": (with_constant("Sub"), {"c": V}, {}, lambda x: x - V),
    "Sub from a constant": (with_constant("Sub", first=False), {"c": V}, {}, lambda x: V - x),
    "Mul": (with_constant("Mul"), {"c": V}, {}, lambda x: x * V),
    "Mul by a scalar": (with_constant("Mul", first=False), {"c": F32(-2.5)}, {}, lambda x: -2.5 * x),
    "Div": (with_constant("Div"), {"c": V}, {}, lambda x: x / V),
    "Neg": (plain("Neg"), {}, {}, lambda x: -x),
    "Relu": (plain("Relu"), {}, {}, lambda x: np.maximum(x, 0)),
    "LeakyRelu": (plain("LeakyRelu", alpha=0.1), {}, {}, lambda x: np.where(x > 0, x, float(F32(0.1)) * x)),
    "LeakyRelu by default": (plain("LeakyRelu"), {}, {}, lambda x: np.where(x > 0, x, float(F32(0.01)) * x)),
    "Tanh": (plain("Tanh"), {}, {}, np.tanh),
    "Sigmoid": (plain("Sigmoid"), {}, {}, lambda x: 1 / (1 + np.exp(-x))),
    "Clip by attributes": (plain("Clip", min=-1.0, max=0.5), {}, {"opset": 8}, lambda x: np.clip(x, -1, 0.5)),
    "Clip by inputs": (
        [("Clip", ["x", "l", "u"], "y", {})],
        {"l": F32(-1), "u": F32(0.5)},
        {},
        lambda x: np.clip(x, -1, 0.5),
    ),
    "Clip above": ([("Clip", ["x", "", "u"], "y", {})], {"u": F32(0.5)}, {}, lambda x: np.minimum(x, 0.5)),
    "Clip at infinity": (
        [("Clip", ["x", "l", "u"], "y", {})],
        {"l": F32(-np.inf), "u": F32(0.5)},
        {},
        lambda x: np.minimum(x, 0.5),
    ),
    "Max and Min": (
        [("Max", ["x", "l"], "h", {}), ("Min", ["u", "h"], "y", {})],
        {"l": np.full(4, -1, F32), "u": F32(1)},
        {},
        lambda x: np.clip(x, -1, 1),
    ),
    "Flatten": (plain("Flatten"), {}, {"shape": ("batch", 2, 2)}, lambda x: x),
    "Reshape": ([("Reshape", ["x", "s"], "y", {})], {"s": [-1, 4]}, {"shape": ("batch", 2, 1, 2)}, lambda x: x),
    "Reshape that copies the batch": (
        [("Reshape", ["x", "s"], "h", {}), ("Squeeze", ["h", "a"], "y", {})],
        {"s": [0, 4, 1], "a": [2]},
        {},
        lambda x: x,
    ),
    "Squeeze and Unsqueeze": (
        [("Unsqueeze", ["x", "a"], "h", {}), ("Squeeze", ["h", "a"], "y", {})],
        {"a": [1]},
        {},
        lambda x: x,
    ),
    "Squeeze by attribute": (plain("Squeeze", axes=[1]), {}, {"shape": ("batch", 1, 4), "opset": 11}, lambda x: x),
    "Transpose of activations": (
        [("Transpose", ["x"], "h", {"perm": [0, 2, 1]}), ("Flatten", ["h"], "f", {}), ("Tanh", ["f"], "y", {})],
        {},
        {"shape": ("batch", 2, 2)},
        lambda x: np.tanh(x[:, [0, 2, 1, 3]]),
    ),
    "Slice": (
        [("Slice", ["x", "s", "e", "a", "t"], "y", {})],
        {"s": [-1], "e": [-(2**63)], "a": [1], "t": [-2]},
        {},
        lambda x: x[:, ::-2],
    ),
    "Slice by attributes": (plain("Slice", starts=[1], ends=[3], axes=[1]), {}, {"opset": 8}, lambda x: x[:, 1:3]),
    "Gather": ([("Gather", ["x", "i"], "y", {"axis": 1})], {"i": [3, 0, -1]}, {}, lambda x: x[:, [3, 0, 3]]),
    "Concat of slices": (
        [
            ("Slice", ["x", "s2", "s4", "one"], "a", {}),
            ("Slice", ["x", "s0", "s2", "one"], "b", {}),
            ("Concat", ["a", "b"], "c", {"axis": 1}),
            ("MatMul", ["c", "w"], "y", {}),
        ],
        {"s0": [0], "s2": [2], "s4": [4], "one": [1], "w": W},
        {},
        lambda x: x[:, [2, 3, 0, 1]] @ W,
    ),
    "Concat of constants": (
        [("Concat", ["c", "d"], "w", {"axis": 0}), ("MatMul", ["x", "w"], "y", {})],
        {"c": W[:1], "d": W[1:]},
        {},
        lambda x: x @ W,
    ),
    "Identity": (plain("Identity"), {}, {}, lambda x: x),
    "Dropout": (plain("Dropout"), {}, {}, lambda x: x),
    "Constant": (
        [("Constant", [], "c", {"value_floats": [1.0, 2.0, 3.0, 4.0]}), ("Add", ["x", "c"], "y", {})],
        {},
        {},
        lambda x: x + [1, 2, 3, 4],
    ),
    "Cast to float": (
        [("Cast", ["x"], "h", {"to": TensorProto.FLOAT}), ("MatMul", ["h", "w"], "y", {})],
        {"w": W},
        DOUBLE,
        lambda x: x @ W,
    ),
    "Cast to double": (
        [("Cast", ["x"], "h", {"to": TensorProto.DOUBLE}), ("MatMul", ["h", "w"], "y", {})],
        {"w": W.astype(np.float64)},
        {},
        lambda x: x @ W,
    ),
    "float64": (
        [("Gemm", ["x", "w", "b"], "h", {"alpha": 0.3, "beta": 0.7}), ("Tanh", ["h"], "y", {})],
        {"w": W.astype(np.float64) / 3, "b": B.astype(np.float64) / 7},
        DOUBLE,
        lambda x: np.tanh(
            float(F32(0.3)) * (x @ (W.astype(np.float64) / 3)) + float(F32(0.7)) * B.astype(np.float64) / 7
        ),
    ),
    "Conv over the whole width": (
        [("Conv", ["x", "k", "b"], "h", {}), ("Flatten", ["h"], "y", {})],
        {"k": random(3, 1, 4), "b": B},
        {"shape": ("batch", 1, 4)},
        lambda x: x @ random(3, 1, 4)[:, 0].T + B,
    ),
    "Conv with padding, stride and groups": (
        [("Conv", ["x", "k"], "h", {"group": 2, "pads": [1, 1], "strides": [2]}), ("Flatten", ["h"], "y", {})],
        {"k": random(4, 1, 2)},
        {"shape": ("batch", 2, 2)},
        None,
    ),
    "Conv in two dimensions with dilation": (
        [("Conv", ["x", "k"], "h", {"dilations": [1, 2]}), ("Flatten", ["h"], "y", {})],
        {"k": random(2, 1, 1, 2)},
        {"shape": ("batch", 1, 1, 4)},
        None,
    ),
    "Shape of a fixed batch": (
        [("Shape", ["c"], "s", {}), ("Reshape", ["x", "s"], "y", {})],
        {"c": np.zeros((1, 4), F32)},
        {"shape": (1, 2, 2)},
        lambda x: x,
    ),
    "a vector without a batch": ([("MatMul", ["x", "w"], "y", {})], {"w": W}, {"shape": (4,)}, lambda x: x @ W),
}


@pytest.mark.parametrize("name", READABLE)
def test_each_operator_means_what_numpy_and_onnxruntime_compute(name: str) -> None:
    nodes, constants, options, expected = READABLE[name]
    policy = read_policy(bytes_of(nodes, constants, **options))
    scale = 1e-12 if policy.precision == "float64" else 1e-6
    ours = policy(POINTS)
    np.testing.assert_allclose(deployed_runner(policy)(POINTS), ours, rtol=20 * scale, atol=20 * scale)
    if expected is not None:
        np.testing.assert_allclose(ours, expected(POINTS), rtol=1e-12, atol=1e-12)
    assert policy.outputs == ours.shape[1]


def test_every_supported_operator_has_a_row_in_the_table_above() -> None:
    covered = {operator for nodes, *_ in READABLE.values() for operator, *_ in nodes}
    assert covered == set(supported_operators())


def test_weights_are_the_stored_numbers_exactly() -> None:
    nodes = [("Gemm", ["x", "w", "b"], "h", {}), ("Relu", ["h"], "y", {})]
    policy = read_policy(bytes_of(nodes, {"w": W, "b": B}))
    first, second = policy.layers
    assert isinstance(first, Affine) and second == Activation("relu")
    assert (first.weight == W.T.astype(np.float64)).all() and (first.bias == B.astype(np.float64)).all()
    assert first.weight_error is None and first.bias_error is None


def test_a_bias_that_is_added_joins_its_matrix_and_a_later_one_does_not() -> None:
    nodes = [("MatMul", ["x", "w"], "h", {}), ("Add", ["h", "b"], "i", {}), ("Add", ["i", "b"], "y", {})]
    policy = read_policy(bytes_of(nodes, {"w": W, "b": B}))
    assert [layer.weight.shape for layer in policy.layers if isinstance(layer, Affine)] == [(3, 4), (3, 3)]
    assert (policy.layers[1].bias == B).all()  # type: ignore[union-attr]


@pytest.mark.parametrize("divisor", [3.0, 0.1, -7.3e20, 1e-30, 0.25])
def test_the_rounding_of_a_reciprocal_is_bounded(divisor: float) -> None:
    constant = np.full(4, divisor, F32)
    (layer,) = read_policy(bytes_of(with_constant("Div"), {"c": constant})).layers
    assert isinstance(layer, Affine)
    true = 1 / Fraction(float(constant[0]))
    bound = Fraction(0) if layer.weight_error is None else Fraction(float(layer.weight_error[0, 0]))
    assert abs(true - Fraction(float(layer.weight[0, 0]))) <= bound <= abs(true) * Fraction(2) ** -52


def test_the_rounding_of_a_scaled_bias_is_bounded() -> None:
    bias = np.array([0.1, 1e-300, -3.3])
    nodes = [("Gemm", ["x", "w", "b"], "y", {"beta": 0.7})]
    layers = read_policy(bytes_of(nodes, {"w": W.astype(np.float64), "b": bias}, **DOUBLE)).layers
    (last,) = layers[1:]
    assert isinstance(last, Affine) and last.bias_error is not None
    for stored, error, exact in zip(last.bias, last.bias_error, bias, strict=True):
        true = Fraction(float(F32(0.7))) * Fraction(float(exact))
        assert abs(true - Fraction(float(stored))) <= Fraction(float(error)) <= abs(true) * Fraction(2) ** -51


REFUSED: dict[str, tuple[Any, str]] = {
    "a skip connection": (([("Tanh", ["x"], "h", {}), ("Add", ["x", "h"], "y", {})], {}), "skip connection"),
    "a product of activations": (([("Mul", ["x", "x"], "y", {})], {}), "skip connection"),
    "a division by an activation": ((with_constant("Div", first=False), {"c": V}), "divides by an activation"),
    "a division by zero": ((with_constant("Div"), {"c": np.zeros(4, F32)}), "divides by zero"),
    "weights on the left": (([("MatMul", ["w", "x"], "y", {})], {"w": W}), "weights on the left"),
    "transA": (([("Gemm", ["x", "w"], "y", {"transA": 1})], {"w": W}), "transA"),
    "different bounds": (
        ([("Min", ["x", "c"], "y", {})], {"c": V}),
        "one constant bound for all neurons",
    ),
    "an empty clip": (([("Clip", ["x", "l", "u"], "y", {})], {"l": F32(1), "u": F32(0)}), "empty"),
    "a constant that enlarges": (([("Add", ["x", "c"], "y", {})], {"c": np.zeros((2, 1, 4), F32)}), "does not fit"),
    "a constant per batch row": (([("Add", ["x", "c"], "y", {})], {"c": np.zeros((3, 4), F32)}), "does not fit"),
    "a reshape into the batch": (([("Reshape", ["x", "s"], "y", {})], {"s": [-1, 2]}), "mixes the dynamic batch"),
    "a transposed batch": (([("Transpose", ["x"], "y", {})], {}), "mixes the dynamic batch"),
    "a slice of the batch": (
        ([("Slice", ["x", "s", "e", "a"], "y", {})], {"s": [0], "e": [1], "a": [0]}),
        "mixes the dynamic batch",
    ),
    "different activations joined": (
        ([("Tanh", ["x"], "h", {}), ("Concat", ["x", "h"], "y", {"axis": 1})], {}),
        "different activations",
    ),
    "narrowing in the middle": (
        (
            [
                ("Cast", ["x"], "d", {"to": TensorProto.DOUBLE}),
                ("Tanh", ["d"], "h", {}),
                ("Cast", ["h"], "y", {"to": 1}),
            ],
            {},
        ),
        "at the input only",
    ),
    "arithmetic on constants": (([("Add", ["c", "c"], "h", {}), ("Add", ["x", "h"], "y", {})], {"c": V}), "simplify"),
    "integer weights": (([("Add", ["x", "c"], "y", {})], {"c": np.ones(4, np.int64)}), "int64"),
    "Dropout in training mode": (
        ([("Dropout", ["x", "r", "t"], "y", {})], {"r": F32(0.5), "t": np.array(True)}),
        "training mode",
    ),
    "automatic padding": (
        ([("Conv", ["x", "k"], "y", {"auto_pad": "SAME_UPPER"})], {"k": random(1, 1, 3)}, {"shape": ("batch", 1, 4)}),
        "explicit pads",
    ),
}


@pytest.mark.parametrize("name", REFUSED)
def test_what_is_not_supported_is_named(name: str) -> None:
    (nodes, constants, *options), message = REFUSED[name]
    with pytest.raises(PolicyError, match=message):
        read_policy(bytes_of(nodes, constants, **(options[0] if options else {})))


def test_all_unsupported_operators_are_listed_at_once() -> None:
    nodes = [
        ("Softmax", ["x"], "a", {}),
        ("Tanh", ["a"], "b", {}),
        ("Erf", ["b"], "c", {}),
        ("Mul", ["x", "x"], "d", {}),
        ("Add", ["c", "d"], "y", {}),
    ]
    content = bytes_of(nodes)
    with pytest.raises(PolicyError) as caught:
        read_policy(content)
    assert all(operator in caught.value.message for operator in ("Softmax", "Erf", "Mul"))
    facts = describe_policy(content)
    assert not facts["supported"] and len(facts["problems"]) == 3 and facts["operators"]["Softmax"] == 1


@pytest.mark.parametrize("value", [np.nan, np.inf, -np.inf])
def test_weights_that_are_not_finite_are_refused(value: float) -> None:
    weights = W.copy()
    weights[1, 2] = value
    with pytest.raises(PolicyError, match=r"finite.*: w"):
        read_policy(bytes_of([("MatMul", ["x", "w"], "y", {})], {"w": weights}))
    nodes = [("Constant", [], "c", {"value_float": value}), ("Add", ["x", "c"], "y", {})]
    with pytest.raises(PolicyError, match=r"finite.*: c"):
        read_policy(bytes_of(nodes))


def test_external_data_is_refused_before_any_file_is_opened(tmp_path: Path) -> None:
    model = model_of([("MatMul", ["x", "w"], "y", {})], {"w": W})
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", str(tmp_path / "missing.bin")
    with pytest.raises(PolicyError, match="external data: w"):
        read_policy(model.SerializeToString())


def test_functions_subgraphs_and_foreign_domains_are_refused_together() -> None:
    model = model_of([("Tanh", ["x"], "y", {})])
    branch = model_of([("Tanh", ["x"], "y", {})]).graph
    model.graph.node.extend(
        [
            helper.make_node("If", ["c"], ["a"], then_branch=branch, else_branch=branch),
            helper.make_node("Gelu", ["x"], ["b"], domain="com.microsoft"),
        ]
    )
    body = [helper.make_node("Tanh", ["p"], ["q"])]
    model.functions.append(helper.make_function("local", "twice", ["p"], ["q"], body, [helper.make_opsetid("", 13)]))
    with pytest.raises(PolicyError) as caught:
        read_policy(model.SerializeToString())
    assert all(word in caught.value.message for word in ("functions: twice", "subgraph", "com.microsoft"))


@pytest.mark.parametrize("shape", [("batch", "n"), (2, 4), ("batch",), ("batch", 0), None, ("batch", 2, "k")])
def test_only_the_batch_may_be_dynamic(shape: Any) -> None:
    with pytest.raises(PolicyError, match=r"shape"):
        read_policy(bytes_of(plain("Tanh"), shape=shape))


@pytest.mark.parametrize("opset", [5, 26])
def test_operator_sets_outside_the_known_versions_are_refused(opset: int) -> None:
    with pytest.raises(PolicyError, match=f"6 to 25 is required, received {opset}"):
        read_policy(bytes_of(plain("Tanh"), opset=opset))


def test_several_inputs_or_outputs_are_refused_and_default_inputs_are_not() -> None:
    model = model_of([("MatMul", ["x", "w"], "y", {})], {"w": W}, ir_version=3)
    model.graph.input.append(helper.make_tensor_value_info("w", TensorProto.FLOAT, (4, 3)))
    assert read_policy(model.SerializeToString()).outputs == 3
    model.graph.input.append(helper.make_tensor_value_info("z", TensorProto.FLOAT, (4, 3)))
    with pytest.raises(PolicyError, match="one input is required, received 2: x, z"):
        read_policy(model.SerializeToString())
    model = model_of([("Tanh", ["x"], "y", {}), ("Relu", ["x"], "z", {})])
    model.graph.output.append(helper.make_tensor_value_info("z", TensorProto.FLOAT, ("batch", 4)))
    with pytest.raises(PolicyError, match="one output is required, received 2: y, z"):
        read_policy(model.SerializeToString())


@pytest.mark.parametrize("content", [b"", b"not a model", b"\x08\x07", bytes(range(256)), b"PK\x03\x04"])
def test_bytes_that_are_no_model_are_refused(content: bytes) -> None:
    with pytest.raises(PolicyError, match="not an ONNX model"):
        read_policy(content)


def test_truncated_models_are_refused() -> None:
    content = bytes_of([("Gemm", ["x", "w", "b"], "y", {})], {"w": W, "b": B})
    for length in range(0, len(content), 7):
        with pytest.raises(PolicyError):
            read_policy(content[:length])


@pytest.mark.filterwarnings("error")
def test_damaged_models_end_in_a_message_and_never_in_a_crash() -> None:
    generator = np.random.default_rng(5)
    models = [bytes_of(nodes, constants, **options) for nodes, constants, options, _ in READABLE.values()]
    outcomes = {"read": 0, "refused": 0}
    for _ in range(4000):
        content = bytearray(models[generator.integers(len(models))])
        for _ in range(generator.integers(1, 4)):
            place = generator.integers(len(content))
            stop = place + generator.integers(0, 3)
            content[place:stop] = generator.integers(0, 256, size=generator.integers(0, 3), dtype=np.uint8).tobytes()
        try:
            read_policy(bytes(content))
            outcomes["read"] += 1
        except PolicyError as error:
            assert error.message
            outcomes["refused"] += 1
    assert min(outcomes.values()) > 50, outcomes


def test_half_precision_and_quantized_networks_are_refused() -> None:
    with pytest.raises(PolicyError, match="FLOAT16"):
        read_policy(bytes_of([("MatMul", ["x", "w"], "y", {})], {"w": W.astype(np.float16)}))
    with pytest.raises(PolicyError, match="float32 or float64"):
        read_policy(bytes_of(plain("Relu"), dtype=TensorProto.FLOAT16))


def test_files_that_cannot_be_read_say_where(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match=r"missing\.onnx.*No such file"):
        read_policy(tmp_path / "missing.onnx")
    large = tmp_path / "large.onnx"
    with large.open("wb") as file:
        file.truncate(64 * 2**20 + 1)
    with pytest.raises(PolicyError, match="larger than 64 MiB"):
        read_policy(large)


def test_a_reader_that_misunderstood_the_file_is_caught_by_onnxruntime() -> None:
    policy = read_policy(bytes_of([("MatMul", ["x", "w"], "y", {})], {"w": W}))
    (layer,) = policy.layers
    assert isinstance(layer, Affine)
    wrong = Affine(layer.weight * (1 + 1e-4), layer.bias)
    misread = Policy((wrong,), policy.inputs, policy.outputs, content=policy.content)
    with pytest.raises(PolicyError, match="disagree"):
        require_agreement(misread)


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_a_written_policy_is_read_back_number_by_number(tmp_path: Path, precision: str) -> None:
    dtype = np.dtype(precision)
    layers = [
        Affine(random(5, 4, dtype=dtype).astype(np.float64), random(5, dtype=dtype).astype(np.float64)),
        Activation("leaky_relu", slope=0.125) if precision == "float32" else Activation("relu"),
        Affine(random(3, 5, seed=8, dtype=dtype).astype(np.float64), random(3, seed=9, dtype=dtype).astype(np.float64)),
        Activation("sigmoid"),
        Activation("clip", lower=0.25, upper=0.75),
    ]
    path = tmp_path / "written.onnx"
    digest = write_policy(path, layers, precision=precision)
    policy = read_policy(path)
    assert (policy.digest, policy.precision, policy.name) == (digest, precision, "written.onnx")
    for written, read in zip(layers, policy.layers, strict=True):
        if isinstance(written, Affine):
            assert isinstance(read, Affine)
            assert (written.weight == read.weight).all() and (written.bias == read.bias).all()
        else:
            assert written == read
    assert [file.name for file in tmp_path.iterdir()] == ["written.onnx"]


def test_a_policy_that_does_not_fit_together_is_not_written(tmp_path: Path) -> None:
    with pytest.raises(PolicyError, match="takes 4"):
        write_policy(tmp_path / "p.onnx", [Affine(np.ones((2, 3)), np.zeros(2)), Affine(np.ones((2, 4)), np.zeros(2))])
    with pytest.raises(PolicyError, match="finite"):
        write_policy(tmp_path / "p.onnx", [Affine(np.full((1, 1), 1e300), np.zeros(1))])
    assert not list(tmp_path.iterdir())


def test_competition_networks_are_read(nav_folder: Path) -> None:
    for name in ("nn-nav-point.onnx", "nn-nav-set.onnx"):
        policy = read_policy(nav_folder / name)
        assert (policy.inputs, policy.outputs, policy.precision, len(policy.layers)) == (4, 2, "float32", 6)
        facts = describe_policy(nav_folder / name)
        assert facts["layers"] == ["affine 4 -> 64", "relu", "affine 64 -> 32", "relu", "affine 32 -> 2", "tanh"]
        assert facts["parameters"] == 2466


def test_the_shipped_example_is_read_and_hovers() -> None:
    policy = read_policy(example_policy_path())
    assert (policy.inputs, policy.outputs) == (2, 1) and EXAMPLE_SPECIFICATION == "quadrotor1d"
    assert abs(policy([0.0, 0.0])[0] + 0.019) < 0.1
