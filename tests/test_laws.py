"""The laws of a sound engine on every set operation, activation, integrator step, plant and kind of closed loop."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import cases
import laws
import numpy as np
import pytest
from cases import F, flow_case, loop_cases, reward_of, shipped, small_policy, splitting_problem
from hypothesis import given, settings
from hypothesis import strategies as st
from laws import FlowCase, LoopCase, random_set
from loops import (
    box_region,
    gain,
    loop_of,
    network,
    plant_of,
    requirement,
    specification_of,
)

from setrl import verify
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import write_policy
from setrl.models.policy import Activation, Affine, Policy
from setrl.models.sampling import uniform_states
from setrl.specs.specification import Penalty
from setrl.verify.deadline import Deadline
from setrl.verify.options import Options
from setrl.verify.result import Verdict
from setrl.verify.splitting import CUT, PROVED, InitialSet, explore
from setrl.verify.zonotope import Zonotope

IMAGES = cases.images()
LOOPS = loop_cases() + cases.delayed_cases()
FLOWS = [case for method in cases.METHODS for case in cases.flow_cases(method)]
FIXED = settings(derandomize=True, deadline=None, max_examples=60, database=None)


# Sets ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("subject", IMAGES, ids=str)
def test_the_image_of_every_member_is_in_the_result(subject: laws.Image) -> None:
    laws.law_image(subject, sweeps=2)


@pytest.mark.parametrize("subject", IMAGES, ids=str)
def test_the_interval_hull_contains_the_set(subject: laws.Image) -> None:
    laws.law_hull(subject)


numbers = (
    st.floats(-1e6, 1e6) | st.floats(-1e-290, 1e-290) | st.sampled_from([0.0, 1.0, 2.0**-53, -(2.0**-53), 2.0**40])
)


def arrays(*shape: int, elements: Any = numbers) -> Any:
    size = int(np.prod(shape))
    return st.lists(elements, min_size=size, max_size=size).map(lambda xs: np.array(xs, dtype=float).reshape(shape))


@FIXED
@given(st.data())
def test_an_affine_map_encloses_the_exact_one(data: Any) -> None:
    n, m, q = (data.draw(st.integers(1, 4)) for _ in range(3))
    z = Zonotope(
        data.draw(arrays(1, n)), data.draw(arrays(1, q, n)), np.abs(data.draw(arrays(1, n, elements=st.floats(0, 1e3))))
    )
    error = data.draw(st.sampled_from([0.0, 2.0**-50])) * np.ones((m, n))
    signs = data.draw(arrays(q + n, elements=st.sampled_from([-1.0, 1.0])))
    laws.law_exact_affine(z, data.draw(arrays(m, n)), data.draw(arrays(m)), error, signs)


ADVERSARIAL_ROWS = {
    "absorbed": [1.0] + [2.0**-53] * 63,
    "cancelling": [1.0, -1.0] * 20 + [2.0**-53] * 24,
    "wide": [2.0**e for e in range(-30, 34)],
    "subnormal": [2.0**-1074] * 32 + [2.0**-1022] * 32,
    "thirds": [1.0 / 3.0] * 64,
}


def adversarial_map(name: str) -> tuple[Zonotope, Any, Any]:
    """A sum that rounds the same way in every term."""
    row = np.array(ADVERSARIAL_ROWS[name])
    weight = np.stack([row, row[::-1], -row])
    z = Zonotope(
        np.ones((1, 64)),
        np.concatenate([np.ones((1, 1, 64)), np.full((1, 1, 64), 1.0 + 2.0**-52)], 1),
        np.zeros((1, 64)),
    )
    return z, weight, np.array([1.0, 2.0**-53, 1.0 / 3.0])


@pytest.mark.parametrize("name", ADVERSARIAL_ROWS)
def test_an_affine_map_encloses_sums_that_round_the_same_way(name: str) -> None:
    z, weight, bias = adversarial_map(name)
    for signs in (np.ones(66), -np.ones(66)):
        laws.law_exact_affine(z, weight, bias, np.zeros_like(weight), signs)


@FIXED
@given(st.data())
def test_order_reduction_contains_the_set(data: Any) -> None:
    n, q = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 7))
    protected = data.draw(st.integers(0, min(q, 2)))
    rows = data.draw(st.integers(protected, q + 2))
    z = Zonotope(
        data.draw(arrays(1, n)), data.draw(arrays(1, q, n)), np.abs(data.draw(arrays(1, n, elements=st.floats(0, 1e3))))
    )
    laws.law_reduction(z, protected, rows)


@FIXED
@given(st.data())
def test_merging_private_rows_contains_the_set(data: Any) -> None:
    n, q = data.draw(st.integers(1, 3)), data.draw(st.integers(1, 9))
    shared, rows = data.draw(st.integers(0, q)), data.draw(st.integers(1, 4))
    z = Zonotope(
        data.draw(arrays(1, n)), data.draw(arrays(1, q, n)), np.abs(data.draw(arrays(1, n, elements=st.floats(0, 1e3))))
    )
    laws.law_merge(z, shared, rows)


# Activations --------------------------------------------------------------------------------------------------------

ADVERSARIAL_BOUNDS = [
    (0.0, 0.0),
    (0.3, 0.3),
    (-0.3, -0.3),
    (-1e-300, 1e-300),
    (-5e-324, 5e-324),
    (-1e-9, 1e-9),
    (-1.0, 2.0**-60),
    (-(2.0**-60), 1.0),
    (-1e6, 1e6),
    (-1e150, 1e150),
    (-1e3, 1e-3),
    (18.0, 400.0),
    (-400.0, -18.0),
    (19.0, 19.1),
    (-0.75, 1.0),
    (-0.75, 3.0),
    (0.999999, 1.000001),
    (1.0, 1.0 + 2.0**-52),
    (-2.0, -1.9999999),
    (-30.0, 0.5),
    (-0.5, 30.0),
    (-40.0, 40.0),
    (0.0, 1.0),
    (-1.0, 0.0),
    (-1e308, 1e308),
]


@pytest.mark.parametrize("bounds", ADVERSARIAL_BOUNDS, ids=str)
@pytest.mark.parametrize("activation", cases.ACTIVATIONS, ids=str)
def test_the_relaxation_encloses_every_sample_of_adversarial_intervals(
    activation: Activation, bounds: tuple[float, float]
) -> None:
    with np.errstate(over="ignore", invalid="ignore"):
        if max(abs(b) for b in bounds) < 1e300:
            laws.law_relaxation(activation, *bounds)
            return
        try:
            laws.law_relaxation(activation, *bounds)
        except AssertionError:  # an overflow may leave no relaxation, but never a wrong one
            laws.law_no_relaxation(activation, *bounds)


@pytest.mark.parametrize("activation", cases.ACTIVATIONS, ids=str)
def test_the_relaxation_encloses_every_sample_of_random_intervals(activation: Activation) -> None:
    generator = np.random.default_rng(4)
    for _ in range(60):
        scale = 10.0 ** generator.uniform(-6, 2)
        center, radius = generator.normal() * scale, scale * generator.random()
        laws.law_relaxation(activation, center - radius, center + radius, 15)


@pytest.mark.parametrize("activation", cases.ACTIVATIONS, ids=str)
def test_there_is_no_relaxation_without_bounds(activation: Activation) -> None:
    laws.law_relaxation_without_bounds(activation)


@pytest.mark.parametrize("kind", cases.KINDS)
def test_every_layer_sees_what_it_claims_to_see(kind: str) -> None:
    laws.law_network_bounds(network([3, 8, 6, 2], [kind, "relu", kind], 7, 1.5), random_set(3, 5, 8, 0.5))


# Flow ---------------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", FLOWS, ids=str)
def test_true_trajectories_end_in_the_end_set(case: FlowCase) -> None:
    laws.law_flow_end(case)


@pytest.mark.parametrize("case", FLOWS, ids=str)
def test_true_trajectories_are_in_the_time_interval_sets_all_the_time(case: FlowCase) -> None:
    laws.law_flow_between(case, 1)
    laws.law_flow_between(case, 4)


@pytest.mark.parametrize("name", cases.PLANTS)
@pytest.mark.parametrize("size", [0.0, 1e-3, 0.05])
def test_other_time_orders_and_product_rows_agree(name: str, size: float) -> None:
    first = flow_case(name, size, F(1, 10), 4)
    for order, rows in ((2, 8), (7, 8), (4, 0), (5, 40)):
        laws.law_steps_intersect(first, flow_case(name, size, F(1, 10), order, rows=rows))


@pytest.mark.skipif("linearization" not in cases.METHODS, reason="there is one flow method only")
@pytest.mark.parametrize("name", cases.PLANTS)
@pytest.mark.parametrize("size", [0.0, 1e-3, 0.05])
def test_two_flow_methods_agree(name: str, size: float) -> None:
    for order in (3, 6):
        one = flow_case(name, size, F(1, 10), order)
        laws.law_steps_intersect(one, replace(one, method="linearization"))


# Closed loops -------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("case", LOOPS, ids=str)
def test_the_flowpipe_contains_simulated_trajectories(case: LoopCase) -> None:
    laws.law_flowpipe(case)


@pytest.mark.parametrize("case", LOOPS, ids=str)
def test_one_true_period_from_any_claimed_set_ends_in_the_next(case: LoopCase) -> None:
    laws.law_one_period(case, every=2)


@pytest.mark.parametrize(
    "options",
    [
        Options(taylor_order=3),
        Options(taylor_order=8),
        Options(generators=4),
        Options(generators=60),
        Options(quadratic_rows=0),
    ]
    + [Options(action_rows=1), Options(remainder_share=1e-4), Options(enclosure="crown"), Options(enclosure="best")]
    + ([Options(method="linearization")] if "linearization" in cases.METHODS else []),
    ids=repr,
)
def test_other_options_enclose_the_same_trajectories(options: Options) -> None:
    for case in LOOPS:
        if case.name in ("everything", "quadrotor1d", "discrete", "everything-delay-1"):
            laws.law_final_sets_intersect(case, replace(case, options=options))


def rewritten(policy: Policy, seed: int, factors: bool) -> Policy:
    """The same function with its hidden neurons permuted and (ReLU only) scaled by powers of two."""
    generator = np.random.default_rng(seed)
    layers = list(policy.layers)
    for position, layer in enumerate(layers):
        following = [i for i in range(position + 1, len(layers)) if isinstance(layers[i], Affine)]
        if isinstance(layer, Affine) and following:
            order = generator.permutation(len(layer.weight))
            scale = 2.0 ** generator.integers(-3, 4, len(order)) if factors else np.ones(len(order))
            after = layers[following[0]]
            assert isinstance(after, Affine)
            layers[position] = Affine(layer.weight[order] * scale[:, None], layer.bias[order] * scale)
            layers[following[0]] = Affine(after.weight[:, order] / scale, after.bias)
    return replace(policy, layers=tuple(layers))


@pytest.mark.parametrize("kind", ["relu", "tanh"])
def test_a_rewritten_network_gives_a_similar_set(kind: str) -> None:
    policy = small_policy("quadrotor1d", 3, (kind, "tanh"))
    case = LoopCase("original", shipped("quadrotor1d", policy, "0.05"), Options(deployed=False))
    for seed in range(3):
        other = shipped("quadrotor1d", rewritten(policy, seed, kind == "relu"), "0.05")
        laws.law_final_sets_intersect(case, replace(case, loop=other), ratio=1.0001)


def box_case(width: Any, epsilon: Any = "0.02") -> LoopCase:
    """The pendulum from a box of a given half-width."""
    specification = specification_of(
        "pendulum",
        {"theta": (F("0.4") - F(width), F("0.4") + F(width)), "thetadot": (-F(width), F(width))},
        periods=8,
        observation=epsilon,
        requirements=[requirement("stay", box_region(theta=(-1, 1)), 0, F("0.8"))],
        reward=reward_of({"theta": "1"}),
    )
    return LoopCase(str(width), loop_of(gain([-0.9, -0.3], precision="float32"), specification))


def test_a_part_of_the_initial_set_stays_in_the_flowpipe_of_the_whole() -> None:
    laws.law_subset(box_case("0.02"), box_case("0.04"))
    laws.law_subset(box_case("0.04", "0.01"), box_case("0.04", "0.02"))


def test_a_part_of_the_initial_set_never_gets_a_worse_verdict() -> None:
    verdicts, values = [], []
    for width in ("0.3", "0.2", "0.1", "0.05", "0.02", "0.005"):
        loop = splitting_problem("0.8", width)
        result = verify(loop.policy, loop.specification, options=Options(splits=1))
        verdicts.append(result.verdict.positive)
        assert result.value is not None
        values.append(result.value.discounted)
    assert verdicts == sorted(verdicts) and len(set(verdicts)) == 2, verdicts
    assert values == sorted(values)


def test_cells_of_a_batch_do_not_disturb_each_other() -> None:
    # the first cell of the second batch escapes in finite time
    escape = specification_of(plant_of({"x": "x**2 + u", "y": "-y"}), {"x": (0, 8), "y": (0, 1)}, periods=5)
    loop = loop_of(gain([0.1, 0.1]), escape)
    low = np.array([[0.5, -1.0], [-1.0, -1.0], [-0.5, 0.5], [-1.0, 0.75], [0.9, 0.9]])
    high = np.array([[1.0, 1.0], [-0.9, -0.5], [-0.4, 0.6], [-0.75, 1.0], [1.0, 1.0]])
    survivors = laws.law_batch(loop, Options(), low, high)
    assert 1 <= survivors < len(low)
    case = box_case("0.05")
    edges = np.linspace(-1.0, 1.0, 9)
    low, high = np.stack([edges[:-1], -np.ones(8)], 1), np.stack([edges[1:], np.linspace(0.0, 1.0, 8)], 1)
    assert laws.law_batch(case.loop, Options(), low, high) == 8


# Splitting ----------------------------------------------------------------------------------------------------------

dyadic = st.integers(-(2**20), 2**20).map(lambda k: k * 2.0**-20)


@FIXED
@given(st.data())
def test_cells_contain_their_boxes_and_children_cover_their_parent(data: Any) -> None:
    sides = data.draw(st.lists(st.tuples(st.floats(-1e6, 1e6), st.floats(0, 1e3)), min_size=2, max_size=2))
    low, high = (np.array([s[0] - sign * s[1] for s in sides]) for sign in (1, -1))
    initial = InitialSet.of(low, high)
    ends = [sorted(data.draw(st.tuples(dyadic, dyadic))) for _ in initial.free]
    if initial.free.size:
        lower, upper = (np.array([e[side] for e in ends]) for side in (0, 1))
        laws.law_children_cover(initial, lower, upper, data.draw(st.integers(0, initial.free.size - 1)))
    exact = [F(float(c)) - F(float(r)) for c, r in zip(initial.center, initial.radius, strict=True)]
    assert all(e <= F(float(x)) for e, x in zip(exact, low, strict=True))


def test_the_leaves_of_a_proof_cover_the_initial_set() -> None:
    loop = splitting_problem()
    engine, initial = laws.engine_of(loop, Options(splits=400))
    radius = np.array([[float(r) for r in loop.observation_radius]])
    found = explore(engine, radius, Deadline.after(None))
    laws.law_tree_covers(found.tree, found.status, CUT)
    leaves = found.status != CUT
    assert (found.status == CUT).sum() >= 4, "the case needs no cut"
    assert (found.status[leaves] == PROVED).all()
    volume = (found.tree.upper[leaves] - found.tree.lower[leaves]).prod(1).sum()
    assert volume == 2.0**initial.free.size
    starts = uniform_states(loop, 500, np.random.default_rng(0))
    center, rows, _ = initial.cells(found.tree.lower[leaves], found.tree.upper[leaves])
    width = np.abs(rows).sum(1)
    within = (np.abs(starts[:, None] - center) <= width * (1 + 1e-15)).all(-1)
    assert within.any(1).all()


# Requirements -------------------------------------------------------------------------------------------------------


def nothing_case(discrete: bool) -> LoopCase:
    """Requirements of every kind, and a reward."""
    region = box_region(x=(-9, 9), y=(-9, 9))
    plant = plant_of({"x": "y", "y": "u - x"}, discrete=discrete)
    wanted = [
        requirement("stay", region, 0, 1, "stay"),
        requirement("reach", region, 1, 1, "reach"),
        requirement("reach", region, 0, 1, "some time"),
        requirement("avoid", box_region(x=(50, 60)), 0, 1, "avoid"),
        requirement("avoid", box_region(x=(50, 60), y=(50, 60)), 1, 1, "end"),
    ]
    specification = specification_of(
        plant,
        {"x": (0, 1), "y": (0, 1)},
        period="0.5",
        periods=2,
        requirements=wanted,
        reward=reward_of({"x": "1", "y": "1"}, penalty=Penalty(F(1), box_region(x=(50, 60)))),
    )
    return LoopCase("nothing", loop_of(gain([0.1, 0.1]), specification))


@pytest.mark.parametrize("discrete", [False, True])
def test_what_is_not_a_number_never_proves_anything(discrete: bool) -> None:
    laws.law_nan_never_proves(nothing_case(discrete))


def test_the_monitors_of_the_law_above_do_prove_ordinary_sets() -> None:
    case = nothing_case(False)
    result = verify(case.loop.policy, case.loop.specification)
    assert result.verdict is Verdict.CLAIMED
    found = laws.watched(case.loop, case.options, random_set(2, 4, 1, size=1e-3))
    assert [monitor.proved.all() for monitor in found.monitors] == [True] * 5
    assert (found.performance.value()[0] > -np.inf).all()


ESCAPES = ("x**2 + 1 + 0*u", "exp(3*x) + 0*u", "1/(2 - x) + 0*u", "log(2 - x) + x**2 + 0*u", "tan(x) + 0*u")


def escaping(text: str) -> Any:
    """A plant that leaves every bound, or its own domain, within the horizon."""
    specification = specification_of(
        plant_of({"x": text}),
        {"x": ("0.5", "1.5")},
        period="0.5",
        periods=8,
        requirements=[requirement("avoid", box_region(x=(-60, -50)), 0, 4)],
        reward=reward_of({"x": "1"}),
    )
    return loop_of(gain([0.0]), specification)


@pytest.mark.parametrize("text", ESCAPES)
def test_a_run_that_diverges_proves_nothing_and_is_worth_nothing(text: str) -> None:
    loop = escaping(text)
    engine, _ = laws.engine_of(loop, Options(splits=2))
    with np.errstate(all="ignore"):
        found = explore(engine, np.zeros((1, 1)), Deadline.after(None))
    leaves = found.status != CUT
    assert not (found.status[leaves] == PROVED).all()
    assert found.value[0] == -np.inf and found.undiscounted[0] == -np.inf
    assert found.value[leaves].min() == -np.inf


@FIXED
@given(st.data())
def test_a_separation_margin_is_below_the_true_distance(data: Any) -> None:
    z = random_set(2, 3, data.draw(st.integers(0, 10**6)), size=data.draw(st.sampled_from([0.05, 0.4, 1.0])))
    generator = np.random.default_rng(data.draw(st.integers(0, 10**6)))
    laws.law_separation(z, generator.normal(size=(4, 2)), generator.normal(size=4))


# Performance --------------------------------------------------------------------------------------------------------


@FIXED
@given(st.data())
def test_the_worst_cost_is_the_maximum_over_the_vertices(data: Any) -> None:
    n = data.draw(st.integers(1, 4))
    z = random_set(
        n, data.draw(st.integers(1, 5)), data.draw(st.integers(0, 10**6)), data.draw(st.sampled_from([1e-6, 1.0, 1e3]))
    )
    weights = data.draw(arrays(n, elements=st.sampled_from([0.0, 0.01, 1.0, 3.0])))
    laws.law_worst_cost(z, weights, data.draw(arrays(n, elements=st.floats(-2, 2))))


def test_the_worst_cost_of_many_states_is_never_too_small() -> None:
    generator = np.random.default_rng(3)
    for seed in range(5):
        z = Zonotope(generator.normal(size=(1, 14)), generator.normal(size=(1, 3, 14)), np.zeros((1, 14)))
        z = Zonotope(np.where(np.arange(14) < 2, 0.0, z.center), z.generators, z.radius)
        laws.law_worst_cost_sampled(z, generator.random(14), generator.normal(size=14), seed)


PAPER = {
    "quadrotor1d": [f"{k / 20:g}" for k in range(11)],
    "pendulum": [f"{k / 100:g}" for k in range(11)],
    "navigation": [f"{k / 100:g}" for k in range(11)],
    "quadrotor2d": [f"{k / 100:g}" for k in range(11)],
}
"""The four plants and the radii at which agents are evaluated."""


def paper_policy(name: str) -> Policy:
    """A policy under which V(s0) is finite for the radii of its table."""
    if name == "quadrotor1d":
        from setrl.models.example import example_policy_path

        return read_policy(example_policy_path())
    if name == "pendulum":
        return gain([-0.05, -0.2], precision="float32")
    if name == "navigation":
        return gain([0.02, -0.01, -0.3, 0.01], [-0.05, -0.05, 0.02, -0.4], precision="float32")
    return gain([0.01, 0.02, -0.2, -0.1, 0.05, 0.02], [0.01, 0.02, -0.2, -0.1, -0.05, -0.02], precision="float32")


def paper_case(name: str, epsilon: str, policy: Policy | None = None) -> LoopCase:
    return LoopCase(f"{name}-{epsilon}", shipped(name, policy or paper_policy(name), epsilon))


@pytest.mark.parametrize("name", PAPER)
def test_v_is_never_above_a_perturbed_rollout(name: str) -> None:
    for position in (1, 4):
        laws.law_value(paper_case(name, PAPER[name][position]), 100)


@pytest.mark.slow
@pytest.mark.parametrize(("name", "epsilon"), [(n, e) for n, radii in PAPER.items() for e in radii])
def test_v_is_never_above_ten_thousand_perturbed_rollouts(name: str, epsilon: str) -> None:
    laws.law_value(paper_case(name, epsilon), 10_000, 6)


def start_point(loop: Any, state: list[str]) -> Any:
    """The same loop from one exact start and with no reward region."""
    initial = tuple((F(x), F(x)) for x in state)
    return replace(loop, initial=initial)


POINTS = {
    "quadrotor1d": ["-4", "0"],
    "pendulum": ["3", "0"],
    "navigation": ["3", "3", "0", "0"],
    "quadrotor2d": ["0.0625", "0.03125", "-0.0625", "0.03125", "0.03125", "0"],
}


@pytest.mark.parametrize("name", PAPER)
def test_without_perturbation_v_is_the_return(name: str) -> None:
    loop = start_point(paper_case(name, "0").loop, POINTS[name])
    options = Options(deployed=False)
    laws.law_value_is_the_return(LoopCase(name, loop, options), 1e-9 if name == "quadrotor1d" else 1e-6)
    # covering float32 execution costs little
    laws.law_value_is_the_return(LoopCase(name, loop), 1e-3)


def test_the_discount_starts_at_one_and_the_penalty_is_charged(tmp_path: Any) -> None:
    case = penalty_case()
    value = laws.value_of(case.loop, case.options)
    # x = 1, 1/2, 1/4, 1/8 with costs 1/2, 1/4, 1/8, and a penalty of 2 for the period that ends at 1/4
    exact = -(F(1, 2) + F("0.99") * (F(1, 4) + 2) + F("0.99") ** 2 * F(1, 8))
    assert abs(value - float(exact)) <= 1e-12
    laws.law_value(case, 10)


def penalty_case() -> LoopCase:
    """x+ = x/2 from 1, a penalty of 2 in [0.2, 0.3]."""
    specification = specification_of(
        plant_of({"x": "x/2 + u"}, discrete=True),
        {"x": (1, 1)},
        period=1,
        periods=3,
        reward=reward_of({"x": "1"}, penalty=Penalty(F(2), box_region(x=("0.2", "0.3")))),
    )
    return LoopCase("penalty", loop_of(gain([0.0]), specification), Options(deployed=False))


GAIN = [F(-5, 32), F(-3, 32)]
"""Keeps the action of the 1D quadrotor far from any saturation."""


def linear_quadrotor(tmp_path: Any, epsilon: str, start: tuple[str, str] = ("-4", "0")) -> LoopCase:
    """The 1D quadrotor under a linear policy from an ONNX file, with unit discount-free states of full precision."""
    path = tmp_path / "linear.onnx"
    weight = np.array([[float(g) for g in GAIN]])
    write_policy(path, [Affine(weight, np.array([-0.25]))], precision="float64")
    loop = start_point(shipped("quadrotor1d", read_policy(path), epsilon), list(start))
    return LoopCase("linear", loop, Options(deployed=False, generators=400))


def closed_form(epsilon: Fraction, periods: int) -> float:
    """-sum_k discount^(k-1) max w'|s_k| in rationals, s_k in A^k s0 + sum_j A^(k-1-j) (b + B K [-eps, eps]^2)."""
    h, mass, gravity = F(1, 10), F("0.05"), F("9.81")
    force = 1 / (2 * mass)
    # s' = M s + N (force (a + 1) - gravity), a = K (s + e) - 1/4
    m, n = [[F(1), h], [F(0), F(1)]], [h * h / 2, h]
    a = [[m[i][j] + n[i] * force * GAIN[j] for j in range(2)] for i in range(2)]
    drift = [n[i] * (force * (1 - F(1, 4)) - gravity) for i in range(2)]
    columns = [[n[i] * force * GAIN[j] * epsilon for i in range(2)] for j in range(2)]
    center, generators = [F(-4), F(0)], []
    weights, total, factor = [F(1), F("0.01")], F(0), F(1)
    for _ in range(periods):
        center = [sum(a[i][j] * center[j] for j in range(2)) + drift[i] for i in range(2)]
        generators = [[sum(a[i][j] * g[j] for j in range(2)) for i in range(2)] for g in generators] + columns
        best = F(-(10**9))
        for signs in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            line = [s * w for s, w in zip(signs, weights, strict=True)]
            value = sum(x * y for x, y in zip(line, center, strict=True))
            value += sum(abs(sum(x * y for x, y in zip(line, g, strict=True))) for g in generators)
            best = max(best, value)
        total += factor * best
        factor *= F("0.99")
    return -float(total)


@pytest.mark.parametrize("epsilon", ["0", "0.05", "0.1", "0.3", "0.5"])
def test_v_of_a_linear_loop_is_the_closed_form(epsilon: str, tmp_path: Any) -> None:
    case = linear_quadrotor(tmp_path, epsilon)
    value, truth = laws.value_of(case.loop, case.options), closed_form(F(epsilon), case.loop.periods)
    laws.law_close_below(value, truth, 1e-9)


# Deadlines ----------------------------------------------------------------------------------------------------------


def test_a_time_limit_is_honoured_within_a_tenth_or_one_batch() -> None:
    laws.law_deadline(splitting_problem("0.8"), 0.5)


class ExpiresInTheFirstBatch(Deadline):
    """Not expired when it is asked for the first time, expired from then on."""

    questions = 0

    @property
    def expired(self) -> bool:
        self.questions += 1
        return self.questions > 1


def test_a_run_that_was_cut_short_says_so() -> None:
    loop = splitting_problem("0.8")
    deadline = ExpiresInTheFirstBatch(None)
    result = verify(loop.policy, loop.specification, deadline=deadline)
    assert result.reason is not None and "time limit" in result.reason.sentence, result.reason


def test_an_interrupted_run_is_unknown() -> None:
    loop = splitting_problem("0.8")
    interrupted = Deadline.after(None)
    interrupted.interrupted = True
    result = verify(loop.policy, loop.specification, deadline=interrupted)
    assert result.verdict is Verdict.UNKNOWN and result.value is not None and result.value.discounted == -np.inf


@pytest.mark.timeout(4)
def test_a_time_limit_is_honoured_while_the_falsifier_simulates_an_escape() -> None:
    loop = escaping("1/(2 - x) + 0*u")
    with np.errstate(all="ignore"):
        verify(loop.policy, loop.specification, options=Options(splits=8), deadline=Deadline.after(1.0))
