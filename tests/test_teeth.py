"""Every law fails on an engine that breaks its theorem: each mutation is one bug, planted on purpose."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Any

import cases
import laws
import numpy as np
import pytest
import test_deployed
import test_laws
import test_planted_violations
from cases import F, flow_case, splitting_problem
from laws import LoopCase, random_set

from setrl.models.policy import Activation
from setrl.verify import (
    balls,
    closed_loop,
    deployed,
    flow,
    network,
    performance,
    relaxations,
    requirements,
    splitting,
    zonotope,
)
from setrl.verify.balls import Ball
from setrl.verify.deadline import Deadline
from setrl.verify.options import Options
from setrl.verify.zonotope import Zonotope

pytestmark = pytest.mark.slow
"""They are about the laws, which the default suite runs; `make test-slow` shows that the laws have teeth."""

Patch = pytest.MonkeyPatch


@dataclass(frozen=True)
class Tooth:
    """A mutation of the engine, and the law that must notice it."""

    name: str
    mutate: Callable[[Patch], None]
    law: Callable[[], Any]

    def __str__(self) -> str:
        return self.name


def wrapped(module: Any, name: str, change: Callable[..., Any]) -> Callable[[Patch], None]:
    """Replace a function by ``change(original, *arguments)``."""

    def mutate(patch: Patch) -> None:
        original = getattr(module, name)
        patch.setattr(module, name, lambda *arguments, **options: change(original, *arguments, **options))

    return mutate


def image(name: str) -> laws.Image:
    return next(case for case in test_laws.IMAGES if case.name == name)


def loop(name: str) -> LoopCase:
    return next(case for case in test_laws.LOOPS if case.name == name)


# Mutations ----------------------------------------------------------------------------------------------------------


def shrunk_error(relax: Any, *arguments: Any) -> Any:
    relaxation = relax(*arguments)
    return replace(relaxation, error=0.95 * relaxation.error)


def swapped_bounds(relax: Any, activation: Any, lower: Any, upper: Any) -> Any:
    return relax(activation, upper, lower)


def midpoint_only(relax: Any, activation: Any, lower: Any, upper: Any) -> Any:
    """The error as if the residual were largest at the ends and in the middle."""
    from setrl.models.policy import activate

    relaxation = relax(activation, lower, upper)
    places = np.stack([lower, upper, 0.5 * (lower + upper)])
    residual = activate(activation, places) - relaxation.slope * places
    low, high = residual.min(0), residual.max(0)
    return replace(relaxation, offset=0.5 * (low + high), error=0.5 * (high - low) + 1e-12)


def not_a_number_is_zero(relax: Any, *arguments: Any) -> Any:
    found = relax(*arguments)
    parts = (np.nan_to_num(x, posinf=0, neginf=0) for x in (found.slope, found.offset, found.error))
    return relaxations.Relaxation(*parts)


def without_radius(linear_map: Any, *arguments: Any) -> Any:
    result = linear_map(*arguments)
    return replace(result, radius=0.0 * result.radius)


def without_rounding(linear_map: Any, z: Any, weight: Any, bias: Any, *rest: Any) -> Any:
    result = linear_map(z, weight, bias, *rest)
    return replace(result, radius=z.radius @ np.abs(weight.mid).T + 2.0**-960)


def without_uncertainty(linear_map: Any, z: Any, weight: Any, bias: Any, *rest: Any) -> Any:
    return linear_map(z, balls.exact(weight.mid), balls.exact(bias.mid), *rest)


def without_box(reduce_order: Any, z: Any, *rest: Any) -> Any:
    result, boxed, kept = reduce_order(z, *rest)
    return replace(result, radius=z.radius), boxed, kept


def without_last_row(function: Any, z: Any, *rest: Any) -> Any:
    result = function(z, *rest)
    rows = result.generators.copy()
    rows[:, -1] = 0.0
    return replace(result, generators=rows)


def without_remainder(flow_jets: Any, tape: Any, point: Any, order: int, terms: int, *rest: Any) -> Any:
    """The last time coefficient of a small batch, which only the remainder uses."""
    jets = flow_jets(tape, point, order, terms, *rest)
    for part in (jets.mid, jets.rad):
        part[terms - 1] = 0.0
    return jets


def hessian_at_center(enclose_map: Any, value: Any, jacobian: Any, hessian: Any, *rest: Any) -> Any:
    return enclose_map(value, jacobian, Ball(hessian.mid, 0.0 * hessian.rad), *rest)


def without_hessian(enclose_map: Any, value: Any, jacobian: Any, hessian: Any, *rest: Any) -> Any:
    return enclose_map(value, jacobian, Ball(0.0 * hessian.mid, 0.0 * hessian.rad), *rest)


def jacobian_at_center(combine: Any, *arguments: Any) -> Any:
    result = combine(*arguments)
    return Ball(0.999 * result.mid, 0.0 * result.rad)


def start_as_prior(a_priori: Any, tape: Any, box: Any, *rest: Any) -> Any:
    return Ball(box.mid, 0.0 * box.rad), np.ones(len(box.mid), dtype=bool)


def without_quadratic_drift(half_quadratic: Any, *arguments: Any) -> Any:
    return 0.0 * half_quadratic(*arguments)


def one_period_late(advance: Any, engine: Any, number: int, cells: Any) -> Any:
    period, after = advance(engine, number, cells)
    return replace(period, end=period.start), after


def without_noise(act: Any, engine: Any, state: Any, radius: Any, *rest: Any) -> Any:
    return act(engine, state, 0.0 * radius, *rest)


def without_disturbance(attach: Any, engine: Any, *rest: Any) -> Any:
    middle = 0.5 * (engine.model.disturbance_lower + engine.model.disturbance_upper)
    model = replace(engine.model, disturbance_lower=middle, disturbance_upper=middle)
    return attach(replace(engine, model=model), *rest)


def without_clip(clip: Any, engine: Any, action: Any) -> Any:
    low, high, _ = engine.model.clip
    return Zonotope(np.clip(action.center, low, high), action.generators, action.radius), clip(engine, action)[1]


def everyone_or_no_one(run: Any, engine: Any, cells: Any, observer: Any) -> Any:
    """All cells leave when one of them does."""

    def strict(period: Any) -> Any:
        keep = observer(period) & period.sound
        return keep & keep.all()

    return run(engine, cells, strict)


def too_cheap(worst_cost: Any, *arguments: Any) -> Any:
    return 0.95 * worst_cost(*arguments)


def printed_formula(worst_cost: Any, z: Any, weights: Any, target: Any) -> Any:
    """Eq. (28) of the paper: ``w'|c - s*| + dia(w'Z)/2``."""
    center = np.abs(z.center - target.mid) @ weights.mid
    return center + np.abs(z.generators @ weights.mid).sum(1) + z.radius @ weights.mid


def number_anyway(function: Any, *arguments: Any) -> Any:
    return np.nan_to_num(function(*arguments), nan=1.0, posinf=1.0, neginf=1.0)


def pair_anyway(function: Any, *arguments: Any) -> Any:
    margin, which = function(*arguments)
    return np.nan_to_num(margin, nan=1.0, posinf=1.0, neginf=1.0), which


def no_penalty(prepare: Any, *arguments: Any) -> Any:
    return replace(prepare(*arguments), penalty=balls.exact(0.0))


def no_discount(prepare: Any, *arguments: Any) -> Any:
    found = prepare(*arguments)
    return replace(found, discount=balls.multiply(found.discount, found.discount))


def narrow_cells(cells: Any, initial: Any, *rest: Any) -> Any:
    center, rows, radius = cells(initial, *rest)
    return center, 0.999 * rows, radius


def support_without_last(support: Any, z: Any, lines: Any) -> Any:
    return 0.95 * support(z, lines)


def no_error(deployed_error: Any, *arguments: Any) -> Any:
    return 0.0 * deployed_error(*arguments)


def cast_only(affine: Any, layer: Any, size: Any, error: Any, *rest: Any) -> Any:
    return error @ np.abs(layer.weight).T


def method(owner: Any, name: str, change: Callable[..., Any]) -> Callable[[Patch], None]:
    """`wrapped` for a method, whose first argument is the object."""

    def mutate(patch: Patch) -> None:
        original = getattr(owner, name)
        patch.setattr(owner, name, lambda self, *arguments: change(original, self, *arguments))

    return mutate


def class_method(owner: Any, name: str, change: Callable[..., Any]) -> Callable[[Patch], None]:
    """`wrapped` for a class method."""

    def mutate(patch: Patch) -> None:
        original = getattr(owner, name)
        patch.setattr(owner, name, lambda *arguments: change(original, *arguments))

    return mutate


def half_spread(patch: Patch) -> None:
    patch.setattr(Zonotope, "spread", property(lambda z: 0.9 * np.abs(z.generators).sum(-2) + z.radius))


def constant(module: Any, name: str, value: Any) -> Callable[[Patch], None]:
    return lambda patch: patch.setattr(module, name, value)


def seed_zero(patch: Patch) -> None:
    """One neuron in each layer is taken for exact."""

    def exact_first(relax: Any, *arguments: Any) -> Any:
        found = relax(*arguments)
        error = found.error.copy()
        error[..., 0] = 0.0
        return replace(found, error=error)

    wrapped(network, "relax", exact_first)(patch)


# Laws on the subjects that show a bug -------------------------------------------------------------------------------


def tanh_law() -> None:
    laws.law_relaxation(Activation("tanh"), -1.0, 2.5)


def relu_law() -> None:
    laws.law_relaxation(Activation("relu"), -1.0, 2.0)


def unbounded_law() -> None:
    laws.law_relaxation_without_bounds(Activation("relu"))


def rounding_law() -> None:
    z, weight, bias = test_laws.adversarial_map("absorbed")
    laws.law_exact_affine(z, weight, bias, np.zeros_like(weight), np.ones(66))


def reduction_law() -> None:
    laws.law_reduction(random_set(3, 20, 2), 2, 8)


def merge_law() -> None:
    laws.law_merge(random_set(2, 14, 3), 4, 3)


def thin_end() -> None:
    laws.law_flow_end(flow_case("everything", 0.0, F(1, 5), 2))


def wide_end() -> None:
    laws.law_flow_end(flow_case("pendulum", 1.0, F(1, 5), 6))


def wide_between() -> None:
    laws.law_flow_between(flow_case("quotient", 0.3, F(1, 20), 5), 1)


def thin_between() -> None:
    laws.law_flow_between(flow_case("unicycle", 0.0, F(1, 5), 5), 2)


def orders_law() -> None:
    first = flow_case("everything", 0.0, F(1, 5), 6)
    laws.law_steps_intersect(first, replace(first, order=2))


def batch_law() -> None:
    test_laws.test_cells_of_a_batch_do_not_disturb_each_other()


def split_law() -> None:
    initial = splitting.InitialSet.of(np.array([-0.3, 0.1]), np.array([0.5, 0.7]))
    laws.law_children_cover(initial, np.array([-1.0, -0.5]), np.array([0.25, 0.5]), 1)


def tree_law() -> None:
    test_laws.test_the_leaves_of_a_proof_cover_the_initial_set()


def gap_between_children(patch: Patch) -> None:
    original = splitting._cut

    def cut(engine: Any, state: Any, cells: Any, most: int) -> None:
        before = state.tree.parent.size
        original(engine, state, cells, most)
        state.tree.upper[before::2] -= 2.0**-20

    patch.setattr(splitting, "_cut", cut)


def rewritten_law() -> None:
    test_laws.test_a_rewritten_network_gives_a_similar_set("tanh")


def options_law() -> None:
    start = test_laws.start_point(test_laws.paper_case("quadrotor1d", "0").loop, test_laws.POINTS["quadrotor1d"])
    case = LoopCase("thin", start, Options(deployed=False))
    laws.law_final_sets_intersect(case, replace(case, options=Options(taylor_order=8, deployed=False)))


def subset_law() -> None:
    laws.law_subset(test_laws.box_case("0.02"), test_laws.box_case("0.04"))


def small_is_large(patch: Patch) -> None:
    """The smaller the set, the larger what the engine starts from."""
    original = splitting.InitialSet.of.__func__

    def of(cls: Any, low: Any, high: Any) -> Any:
        middle, radius = 0.5 * (low + high), 0.5 * (high - low)
        return original(cls, middle - 1e-3 / radius, middle + 1e-3 / radius)

    patch.setattr(splitting.InitialSet, "of", classmethod(of))


def value_law() -> None:
    laws.law_value(test_laws.paper_case("quadrotor1d", "0.05"), 40)


def narrow_value_law() -> None:
    laws.law_value_is_the_return(
        LoopCase(
            "pendulum",
            test_laws.start_point(test_laws.paper_case("pendulum", "0").loop, test_laws.POINTS["pendulum"]),
            Options(deployed=False),
        ),
        1e-6,
    )


def penalty_law() -> None:
    laws.law_value(test_laws.penalty_case(), 10)


def closed_form_law(folder: Any) -> None:
    test_laws.test_v_of_a_linear_loop_is_the_closed_form("0.1", folder)


def nothing_law() -> None:
    laws.law_nan_never_proves(test_laws.nothing_case(False))


def nothing_valued_law() -> None:
    case = test_laws.nothing_case(False)
    laws.law_nan_never_proves(replace(case, loop=replace(case.loop, requirements=())))


def cost_law() -> None:
    laws.law_worst_cost(random_set(3, 4, 9), np.array([1.0, 0.5, 2.0]), np.array([0.1, 0.2, -0.3]))


def opposite_cost_law() -> None:
    z = Zonotope(np.zeros((1, 2)), np.array([[[1.0, -1.0]]]), np.zeros((1, 2)))
    laws.law_worst_cost(z, np.ones(2), np.zeros(2))


def separation_law() -> None:
    for seed in range(40):
        generator = np.random.default_rng(seed)
        laws.law_separation(random_set(2, 3, seed, 0.4), generator.normal(size=(4, 2)), generator.normal(size=4))


def deployed_law() -> None:
    test_deployed.test_the_runtime_is_within_its_bound("relu", "float32")


def cancelling_law() -> None:
    test_deployed.test_networks_that_cancel_are_within_their_bound(1e4)


def planted_law() -> None:
    for seed in (1, 2, 5, 7, 8, 10, 11):
        violated = test_planted_violations.violated(test_planted_violations.random_loop(seed), seed)
        laws.law_never_verified(violated, Options(splits=16))


def deadline_law() -> None:
    laws.law_deadline(splitting_problem("0.8"), 0.3)


TEETH = [
    Tooth("relaxation-error-0.95-tanh", wrapped(relaxations, "relax", shrunk_error), tanh_law),
    Tooth("relaxation-error-0.95-relu", wrapped(relaxations, "relax", shrunk_error), relu_law),
    Tooth("relaxation-midpoint-only", wrapped(relaxations, "relax", midpoint_only), tanh_law),
    Tooth("relaxation-swapped-bounds", wrapped(relaxations, "relax", swapped_bounds), relu_law),
    Tooth("relaxation-nan-is-zero", wrapped(relaxations, "relax", not_a_number_is_zero), unbounded_law),
    Tooth(
        "network-column-forgotten",
        constant(network, "append_rows", lambda z, rows: z),
        lambda: laws.law_image(image("network-tanh-3.0")),
    ),
    Tooth(
        "network-last-column-forgotten",
        wrapped(network, "append_rows", without_last_row),
        lambda: [laws.law_image(case, 3) for case in test_laws.IMAGES if case.name.startswith("network-")],
    ),
    Tooth(
        "network-error-0.8",
        wrapped(network, "relax", lambda relax, *a: replace(relax(*a), error=0.8 * relax(*a).error)),
        lambda: [laws.law_image(case, 3) for case in test_laws.IMAGES if case.name.startswith("activation-")],
    ),
    Tooth(
        "network-bounds-shrunk",
        wrapped(
            network, "LayerBounds", lambda bounds, low, high: bounds(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)
        ),
        lambda: test_laws.test_every_layer_sees_what_it_claims_to_see("tanh"),
    ),
    Tooth(
        "affine-box-dropped",
        wrapped(zonotope, "linear_map", without_radius),
        lambda: laws.law_image(image("linear_map")),
    ),
    Tooth(
        "affine-uncertainty-dropped",
        wrapped(zonotope, "linear_map", without_uncertainty),
        lambda: laws.law_image(image("linear_map-uncertain")),
    ),
    Tooth("affine-rounding-dropped", wrapped(zonotope, "linear_map", without_rounding), rounding_law),
    Tooth("reduction-box-dropped", wrapped(zonotope, "reduce_order", without_box), reduction_law),
    Tooth(
        "reduction-box-dropped-image",
        wrapped(zonotope, "reduce_order", without_box),
        lambda: laws.law_image(image("reduce_order")),
    ),
    Tooth("merge-box-dropped", wrapped(network, "diagonal_rows", lambda f, r: 0.0 * f(r)), merge_law),
    Tooth("hull-too-small", half_spread, lambda: laws.law_hull(image("linear_map"))),
    Tooth("flow-remainder-dropped", wrapped(flow, "flow_jets", without_remainder), thin_end),
    Tooth("flow-start-is-a-priori", wrapped(flow, "a_priori_enclosure", start_as_prior), thin_end),
    Tooth("flow-hessian-at-center", wrapped(flow, "enclose_map", hessian_at_center), wide_end),
    Tooth("flow-hessian-dropped", wrapped(flow, "enclose_map", without_hessian), wide_end),
    Tooth(
        "map-hessian-dropped",
        wrapped(flow, "enclose_map", without_hessian),
        lambda: laws.law_image(image("image_of-unicycle")),
    ),
    Tooth(
        "between-time-row-dropped",
        constant(flow, "append_rows", lambda z, rows: z),
        thin_between,
    ),
    Tooth("between-curvature-dropped", wrapped(flow, "half_quadratic", without_quadratic_drift), wide_between),
    Tooth("orders-remainder-dropped", wrapped(flow, "flow_jets", without_remainder), orders_law),
    Tooth(
        "period-off-by-one",
        method(closed_loop.Engine, "advance", one_period_late),
        lambda: laws.law_flowpipe(loop("pendulum")),
    ),
    Tooth(
        "observation-radius-dropped-flowpipe",
        method(closed_loop.Engine, "_act", without_noise),
        lambda: laws.law_flowpipe(loop("correlated")),
    ),
    Tooth(
        "observation-radius-dropped-period",
        method(closed_loop.Engine, "_act", without_noise),
        lambda: laws.law_one_period(loop("everything")),
    ),
    Tooth(
        "disturbance-dropped",
        method(closed_loop.Engine, "_with_disturbances", without_disturbance),
        lambda: laws.law_flowpipe(loop("discrete")),
    ),
    Tooth(
        "clip-moves-the-center-only",
        method(closed_loop.Engine, "_clip", without_clip),
        lambda: laws.law_one_period(loop("everything")),
    ),
    Tooth(
        "delayed-rows-collide",
        constant(closed_loop, "pad_rows", lambda rows, count: rows),
        lambda: laws.law_one_period(loop("correlated-delay-1")),
    ),
    Tooth("batch-all-or-none", method(closed_loop.Engine, "run", everyone_or_no_one), batch_law),
    Tooth("cells-too-narrow", method(splitting.InitialSet, "cells", narrow_cells), split_law),
    Tooth("children-leave-a-gap", gap_between_children, tree_law),
    Tooth("neuron-forgotten", seed_zero, rewritten_law),
    Tooth(
        "options-center-shifted",
        wrapped(flow, "flow_jets", lambda f, t, p, o, k, *r: scaled(f(t, p, o, k, *r), 1 + 1e-6 * (k > 8))),
        options_law,
    ),
    Tooth("subset-larger", small_is_large, subset_law),
    Tooth("nan-margin-accepted-stay", wrapped(requirements, "containment_margins", number_anyway), nothing_law),
    Tooth("nan-margin-accepted-avoid", wrapped(requirements, "facet_separation", pair_anyway), nothing_law),
    Tooth("nan-cost-accepted", wrapped(performance, "worst_cost", number_anyway), nothing_valued_law),
    Tooth("separation-support-0.95", method(Zonotope, "support", support_without_last), separation_law),
    Tooth("sign-patterns-0.95", wrapped(performance, "worst_cost", too_cheap), cost_law),
    Tooth("sign-patterns-as-printed", wrapped(performance, "worst_cost", printed_formula), opposite_cost_law),
    Tooth("value-cost-0.95", wrapped(performance, "worst_cost", too_cheap), narrow_value_law),
    Tooth("value-cost-0.5", wrapped(performance, "worst_cost", lambda f, *a: 0.5 * f(*a)), value_law),
    Tooth("value-penalty-dropped", class_method(performance.RewardModel, "prepare", no_penalty), penalty_law),
    Tooth("deployed-error-dropped", wrapped(deployed, "deployed_error", no_error), deployed_law),
    Tooth("deployed-summation-dropped", wrapped(deployed, "_affine", cast_only), cancelling_law),
    Tooth(
        "planted-disturbance-dropped",
        method(closed_loop.Engine, "_with_disturbances", without_disturbance),
        planted_law,
    ),
    Tooth("planted-noise-dropped", method(closed_loop.Engine, "_act", without_noise), planted_law),
    Tooth("deadline-never", lambda patch: patch.setattr(Deadline, "expired", False), deadline_law),
]


def scaled(jets: Ball, factor: float) -> Ball:
    """Coefficients of another vector field."""
    return Ball(jets.mid * factor, jets.rad)


@pytest.mark.parametrize("tooth", TEETH, ids=str)
def test_the_law_fails_on_the_broken_engine(tooth: Tooth, monkeypatch: Patch) -> None:
    tooth.law()
    tooth.mutate(monkeypatch)
    with np.errstate(all="ignore"), pytest.raises(AssertionError):
        tooth.law()


@pytest.mark.parametrize(
    "mutate",
    [
        wrapped(performance, "worst_cost", lambda f, *a: (1 + 1e-8) * f(*a)),
        class_method(performance.RewardModel, "prepare", no_discount),
        method(closed_loop.Engine, "_act", without_noise),
    ],
    ids=["a-little-too-dear", "discount-squared", "observation-radius-dropped"],
)
def test_the_closed_form_notices(mutate: Callable[[Patch], None], monkeypatch: Patch, tmp_path: Any) -> None:
    closed_form_law(tmp_path)
    mutate(monkeypatch)
    with pytest.raises(AssertionError):
        closed_form_law(tmp_path)


@pytest.mark.skipif("linearization" not in cases.METHODS, reason="there is one flow method only")
@pytest.mark.parametrize("name", ["lagrange_remainder", "_tail"])
def test_the_laws_notice_a_linearisation_without_its_remainder(name: str, monkeypatch: Patch) -> None:
    from setrl.verify import linearization

    def law() -> None:
        laws.law_flow_end(flow_case("pendulum", 0.3, F(1, 10), 4, "linearization"))
        laws.law_flow_end(flow_case("pendulum", 0.0, F(1, 2), 2, "linearization"))
        laws.law_flow_end(flow_case("quadrotor1d", 0.0, F(1, 2), 1, "linearization"))

    def dropped(original: Any, *arguments: Any) -> Any:
        result = original(*arguments)
        return Ball(0.0 * result.mid, 0.0 * result.rad) if isinstance(result, Ball) else 0.0 * result

    law()
    wrapped(linearization, name, dropped)(monkeypatch)
    with pytest.raises(AssertionError):
        law()
