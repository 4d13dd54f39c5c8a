"""What the runtime computes is within e_L of exact arithmetic, and e_L is not much larger than it has to be."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import laws
import numpy as np
import pytest
from loops import activation_of, box_region, loop_of, network, plant_of, requirement, specification_of
from onnx import TensorProto
from onnx_models import bytes_of, random

from setrl.models import onnx_reader
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_runtime import deployed_runner
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine, Layer, Policy, activate, forward
from setrl.verify import deployed, verifier
from setrl.verify.network import enclose_layers
from setrl.verify.options import Options
from setrl.verify.result import Result, Verdict
from setrl.verify.runtime_error import runtime_error
from setrl.verify.zonotope import from_box

Array = Any


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


def test_a_product_of_normal_numbers_that_is_subnormal_is_within_its_bound() -> None:
    policy = stored([Affine(np.array([[2.0**-70 * (1.0 + 2.0**-20)]]), np.zeros(1))])
    point = np.array([2.0**-70 * (1.0 + 2.0**-19)])
    assert laws.law_deployed(policy, point, point, count=3) > 0.0


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
            assert most - runtime_error(precision) <= value <= least + runtime_error(precision)


# A hundred thousand inputs ------------------------------------------------------------------------------------------


def trained_like(sizes: Sequence[int], kinds: Sequence[str], seed: int, precision: str = "float32") -> Policy:
    """A few large weights among many small ones, as training leaves them; one unit in four is dead."""
    generator = np.random.default_rng(seed)
    layers: list[Layer] = []
    for rows, columns, kind in zip(sizes[1:], sizes[:-1], kinds, strict=True):
        weight = generator.standard_t(2.0, size=(rows, columns)) / np.sqrt(columns)
        bias = generator.normal(size=rows) - 4.0 * (generator.random(rows) < 0.25)
        layers.append(Affine(weight.astype(precision).astype(float), bias.astype(precision).astype(float)))
        layers += [activation_of(kind)] if kind != "none" else []
    return Policy(tuple(layers), sizes[0], sizes[-1], precision=precision)


def family() -> dict[str, Policy]:
    """Networks of every activation: random, trained-like, wide, deep, ending in an activation, cancelling."""
    found = {}
    for kind, precision in RUNS:
        found[f"random-{kind}-{precision}"] = network([4, 16, 16, 2], [kind, kind, "none"], 1, 1.5, precision)
        found[f"trained-{kind}-{precision}"] = trained_like([6, 24, 24, 2], [kind, kind, "none"], 2, precision)
    for kind in ("relu", "tanh", "sigmoid"):
        found[f"wide-{kind}"] = network([3, 256, 256, 1], [kind, kind, "none"], 3)
        found[f"deep-{kind}"] = network([4, *[12] * 9, 2], [kind] * 9 + ["none"], 4, 1.4)
    found["final-tanh"] = network([4, 16, 2], ["relu", "tanh"], 5, 3.0)
    for size in (1.0, 1e6):
        found[f"cancelling-{size:.0e}"] = Policy(tuple(cancelling(size)), 2, 2)
    return found


FAMILY = family()


def observed_and_claimed(policy: Policy, count: int, cells: int = 400) -> tuple[Array, Array, Array]:
    """Points in random boxes, every third of them a single point; the distance of what the runtime computes from
    exact arithmetic, rounded up, in batches of all, 1, 7 and 64; and e_L of the point's box. Shape (count, outputs).
    """
    generator = np.random.default_rng(11)
    center = generator.normal(size=(cells, policy.inputs)) * generator.choice([0.1, 1.0, 10.0], size=(cells, 1))
    radius = np.abs(center) * generator.choice([0.0, 1e-3, 0.1], size=(cells, 1))
    claimed, double = [], []
    for part in np.array_split(np.arange(cells), max(1, cells // 20)):
        bounds = enclose_layers(
            policy.layers, from_box(center[part] - radius[part], center[part] + radius[part])
        ).bounds
        claimed.append(deployed.deployed_error(policy.layers, bounds, policy.precision))
        double.append(deployed.deployed_error(policy.layers, bounds, "float64"))
    cell = np.arange(count) % cells
    points = center[cell] + radius[cell] * generator.uniform(-1.0, 1.0, size=(count, policy.inputs))
    points = np.clip(points, (center - radius)[cell], (center + radius)[cell])
    exact, precision = nearly_exact(policy, points)
    runner = deployed_runner(policy)
    distance = np.zeros((count, policy.outputs))
    for size in (count, 1, 7, 64):
        outputs = np.concatenate([runner(points[i : i + size]) for i in range(0, count, size)])
        distance = np.maximum(distance, np.abs(outputs - exact).astype(float))
    observed = (distance + precision * np.concatenate(double)[cell]) * (1.0 + 2.0**-50)
    return points, observed, np.concatenate(claimed)[cell]


def nearly_exact(policy: Policy, points: Array) -> tuple[Array, float]:
    """The network in a wider type than the runtime's, and a bound of that result's error in units of e_L for float64.

    float64 arithmetic is a runtime like any other, so that e_L for float64 bounds it. Of the 80-bit type only that it
    is 2^11 times as precise is used, 2 of the 11 bits are left to its tanh.
    """
    if policy.precision == "float32":
        return forward(policy.layers, points), 1.0
    if np.finfo(np.longdouble).nmant < 63:
        pytest.skip("this machine has no floating-point type wider than float64")
    values = points.astype(np.longdouble)
    for layer in policy.layers:
        if isinstance(layer, Affine):
            values = values @ layer.weight.T.astype(np.longdouble) + layer.bias
        else:
            values = activate(layer, values)
    return values, 2.0**-9


def require_bound(policy: Policy, count: int) -> float:
    """Observed <= claimed at every point, the worst ones in ball arithmetic; the largest share of the claim."""
    policy = stored(policy.layers, policy.precision)
    points, observed, claimed = observed_and_claimed(policy, count)
    share = observed / claimed
    assert (observed <= claimed).all(), f"{share.max():.3g} of the bound"
    for worst in points[np.argsort(-share.max(1))[:3]]:
        laws.law_deployed(policy, worst, worst, count=3)
    return float(share.max())


@pytest.mark.parametrize(
    "name", ["random-tanh-float32", "trained-relu-float32", "cancelling-1e+06", "random-relu-float64"]
)
def test_the_runtime_is_within_its_bound_on_many_inputs(name: str) -> None:
    assert require_bound(FAMILY[name], 4000) > 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("name", FAMILY)
def test_the_runtime_is_within_its_bound_on_a_hundred_thousand_inputs(name: str) -> None:
    assert require_bound(FAMILY[name], 100_000) > 0.0


# Networks on which the bound is nearly attained ---------------------------------------------------------------------

U = {"float32": 2.0**-24, "float64": 2.0**-53}


def just_above_one(generator: np.random.Generator, shape: Any, unit: float) -> Array:
    return 1.0 + generator.integers(1, 64, shape) * 2.0 * unit


def opposite_pair(generator: np.random.Generator, unit: float) -> list[Layer]:
    """``w x - w (1 + 2^-k) y``: both products are near 1, the result is not."""
    weight = just_above_one(generator, (), unit)
    other = weight * (1.0 + 2.0 ** -generator.integers(8, 20))
    return [Affine(np.array([[weight, -other]]), np.zeros(1))]


def bias_that_cancels(generator: np.random.Generator, unit: float) -> list[Layer]:
    return [Affine(1.0 + generator.integers(1, 2000, (1, 1)) * 2.0 * unit, -np.ones(1))]


def sum_that_loses_every_term(generator: np.random.Generator, unit: float, terms: int = 64) -> list[Layer]:
    """``1 + u + u + ... - 1``: every addition of u is a tie that rounds back to 1."""
    return [Affine(np.array([[1.0, *[unit] * (terms - 2), -1.0]]), np.zeros(1))]


def duplicated_units(generator: np.random.Generator, unit: float, terms: int = 64) -> list[Layer]:
    """A unit minus its duplicate: one of them was summed over many small terms, the other one was not."""
    row = np.array([1.0, *[unit] * (terms - 1)])
    first = Affine(np.stack([row, np.eye(terms)[0]]), np.zeros(2))
    return [first, Activation("relu"), Affine(np.array([[1.0, -1.0]]), np.zeros(1))]


def opposite_functions(generator: np.random.Generator, unit: float) -> list[Layer]:
    """``2^20 (tanh(x) - tanh(y))`` where the runtime's own tanh is worst."""
    return [Affine(np.eye(2), np.zeros(2)), Activation("tanh"), Affine(np.array([[2.0**20, -(2.0**20)]]), np.zeros(1))]


def halfway(generator: np.random.Generator, count: int, inputs: int, unit: float) -> Array:
    """Numbers that the cast of the observation rounds by nearly a unit; one of three rows is exact."""
    numbers = 1.0 + (2 * generator.integers(0, 1000, (count, inputs)) + 1) * unit
    numbers[::3] = 1.0
    return numbers


def saturating(generator: np.random.Generator, count: int, inputs: int, unit: float) -> Array:
    return generator.uniform(5.0, 9.0, (count, inputs)).astype(np.float32).astype(float)


Make = Callable[[np.random.Generator, float], list[Layer]]
Draw = Callable[[np.random.Generator, int, int, float], Array]


def worst_case(make: Make, draw: Draw, rounds: int = 40) -> tuple[Policy, Array, float]:
    """Random search for the network and the input at which the runtime uses most of e_L.

    Inputs and weights have so few bits, or rounding errors so small, that float64 tells well enough; what it finds is
    judged in ball arithmetic.
    """
    generator = np.random.default_rng(3)
    best: tuple[float, Any, Any] = (0.0, None, None)
    unit = U["float32"]
    for _ in range(rounds):
        layers = make(generator, unit)
        inputs = layers[0].weight.shape[1]  # type: ignore[union-attr]
        policy = Policy(tuple(layers), inputs, 1, content=policy_bytes(layers))
        points = draw(generator, 512 // inputs, inputs, unit)
        bounds = enclose_layers(policy.layers, from_box(points, points)).bounds
        distance = np.abs(deployed_runner(policy)(points) - forward(policy.layers, points))
        share = (distance / deployed.deployed_error(policy.layers, bounds, "float32"))[:, 0]
        if share.max() > best[0]:
            best = (float(share.max()), layers, points[share.argmax()])
    _, layers, point = best
    policy = stored(layers)
    return policy, point, laws.law_deployed(policy, point, point, count=3)


HARD: list[tuple[Make, Draw]] = [
    (opposite_pair, halfway),
    (bias_that_cancels, halfway),
    (sum_that_loses_every_term, halfway),
    (duplicated_units, halfway),
    (opposite_functions, saturating),
]


@pytest.mark.parametrize(("make", "draw"), HARD, ids=[make.__name__ for make, _ in HARD])
def test_networks_built_to_cancel_use_a_fifth_of_the_bound_and_a_tenth_of_it_fails(
    make: Make, draw: Draw, monkeypatch: pytest.MonkeyPatch
) -> None:
    policy, point, share = worst_case(make, draw)
    assert 0.2 <= share <= 1.0
    claimed = deployed.deployed_error
    monkeypatch.setattr(deployed, "deployed_error", lambda *arguments: 0.1 * claimed(*arguments))
    with pytest.raises(AssertionError, match="claimed"):
        laws.law_deployed(policy, point, point, count=3)


@pytest.mark.parametrize("precision", U)
def test_a_long_sum_nearly_attains_the_bound(precision: str) -> None:
    row = np.array([[1.0] + [U[precision]] * 255])
    share = laws.law_deployed(stored([Affine(row, np.zeros(1))], precision), np.ones(256), np.ones(256), count=3)
    assert 0.98 <= share <= 1.0


@pytest.mark.parametrize("make", [sum_that_loses_every_term, duplicated_units])
def test_in_float64_they_use_a_fifth_of_the_bound_too(make: Make) -> None:
    unit = U["float64"]
    policy = stored(make(np.random.default_rng(0), unit), "float64")
    point = np.ones(policy.inputs)
    assert 0.2 <= laws.law_deployed(policy, point, point, count=3) <= 1.0


# Networks whose bound is too large for a claim ----------------------------------------------------------------------


def steered(layers: Sequence[Layer], bound: str, initial: tuple[str, str], **options: Any) -> Result:
    """An integrator, x' = u, that has to stay in [-bound, bound]."""
    policy = stored(layers)
    stay = requirement("stay", box_region(x=(f"-{bound}", bound)), "0", "0.3")
    loop = loop_of(policy, specification_of(plant_of({"x": "u"}), {"x": initial}, requirements=[stay]))
    return verifier.verify(loop.policy, loop.specification, options=Options(**options))


def difference_of(size: float) -> list[Layer]:
    """``-x`` as ``relu(size x + 4 size) - relu((size + 1) x + 4 size)``, positive for |x| < 3."""
    first = Affine(np.array([[size], [size + 1.0]]), np.full(2, 4.0 * size))
    return [first, Activation("relu"), Affine(np.array([[1.0, -1.0]]), np.zeros(1))]


def test_a_well_conditioned_network_is_covered_in_float32() -> None:
    result = steered(difference_of(4.0), "2", ("-1", "1"))
    assert result.verdict is Verdict.CLAIMED and result.semantics == ("real", "float32")
    assert all(note.startswith("not checked") for note in result.notes)


@pytest.mark.parametrize(
    "bound",
    [
        pytest.param("100", id="proved with e_L all the same"),
        pytest.param("2", id="not proved with e_L"),
    ],
)
def test_an_ill_conditioned_network_is_refused_for_float32_and_decided_for_real(bound: str) -> None:
    result = steered(difference_of(2.0**22), bound, ("-1", "1"), splits=8)
    assert result.verdict is Verdict.CLAIMED and result.semantics == ("real",)
    assert "float32" not in result.claim and "exact real arithmetic" in result.claim
    note, _ = result.notes
    assert "float32 execution is not covered" in note and "of the action range" in note and "rescale" in note


@pytest.mark.parametrize("nodes", [("MatMul", "Mul"), ("Mul", "MatMul"), ("MatMul", "Div"), ("Div", "MatMul")])
def test_a_factor_that_the_runtime_moves_into_a_product_is_within_its_bound(
    nodes: tuple[str, str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """onnxruntime keeps such a factor as a float32 number, also where everything else is float64.

    Such a file is refused when it is read, because runtime and reader disagree; e_L does not rely on that.
    """
    monkeypatch.setattr(onnx_reader, "require_agreement", lambda policy: None)
    operands = {"MatMul": "w", "Mul": "c", "Div": "c"}
    chain = [
        (nodes[0], ["x", operands[nodes[0]]], "h", {}),
        (nodes[1], ["h", operands[nodes[1]]], "y", {}),
    ]
    constants = {"w": random(4, 3, dtype=np.float64), "c": np.array(0.1)}
    content = bytes_of(chain, constants, dtype=TensorProto.DOUBLE)
    policy = read_policy(content)
    points = np.random.default_rng(2).normal(size=(200, 4))
    exact = nearly_exact(policy, points)[0].astype(np.float64)
    distance = np.abs(deployed_runner(policy)(points) - exact)
    bounds = enclose_layers(policy.layers, from_box(points, points)).bounds
    claimed = deployed.deployed_error(policy.layers, bounds, "float64")
    assert (distance <= claimed).all() and claimed.max() < 1e-5
