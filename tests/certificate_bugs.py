"""Bugs of the engine, planted on purpose, each with a closed loop on which the broken engine still claims a proof."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
import test_teeth as teeth
from test_teeth import class_method, constant, method, wrapped

from setrl.verify import (
    certificate,
    closed_loop,
    evidence,
    flow,
    integrator,
    linearization,
    network,
    performance,
    relaxations,
    splitting,
)
from setrl.verify.balls import Ball
from setrl.verify.zonotope import Zonotope

Patch = pytest.MonkeyPatch
Mutation = Callable[[Patch], None]


@dataclass(frozen=True, eq=False)
class Bug:
    """A mutation, and the case it shows itself on (see `certificates.case_of`)."""

    name: str
    mutate: Mutation
    number: int
    given: dict[str, Any] = field(default_factory=dict)

    def __str__(self) -> str:
        return self.name


def both(*mutations: Mutation) -> Mutation:
    def mutate(patch: Patch) -> None:
        for mutation in mutations:
            mutation(patch)

    return mutate


def error_times(factor: float) -> Callable[..., Any]:
    return lambda relax, *a: replace(relax(*a), error=factor * relax(*a).error)


def radius_times(factor: float) -> Callable[..., Any]:
    """Of the first zonotope of a result."""

    def change(function: Any, *arguments: Any) -> Any:
        first, *rest = function(*arguments)
        return (replace(first, radius=factor * first.radius), *rest)

    return change


def tight_tangent(tangent: Any, *arguments: Any) -> Any:
    return 0.5 * tangent(*arguments)


def no_offset(relax: Any, *arguments: Any) -> Any:
    found = relax(*arguments)
    return replace(found, offset=0.0 * found.offset)


def without_products(enclose_map: Any, *arguments: Any) -> Any:
    image, added, products = enclose_map(*arguments)
    generators = image.generators.copy()
    generators[:, arguments[4].generators.shape[1] :] = 0.0
    return replace(image, generators=generators), added, products


def off_center(enclose_map: Any, *arguments: Any) -> Any:
    image, added, products = enclose_map(*arguments)
    return replace(image, center=image.center + 1e-3 * np.abs(image.generators).sum(1) + 1e-6), added, products


def shorter_period(integrate: Any, plant: Any, joint: Any, period: Any, *rest: Any) -> Any:
    return integrate(plant, joint, period * Fraction(9, 10), *rest)


def with_half_the_box(reduce_order: Any, z: Any, *rest: Any) -> Any:
    result, boxed, kept = reduce_order(z, *rest)
    return replace(result, radius=0.5 * result.radius), boxed, kept


def few_rows(patch: Patch) -> None:
    """Few generators are kept, so that something is dropped; no bug by itself."""
    patch.setattr(closed_loop, "LEAST_GENERATORS", 3)


def swapped_states(see: Any, recorder: Any, period: Any) -> Any:
    end = period.end
    mirrored = Zonotope(end.center[:, ::-1], end.generators[:, :, ::-1], end.radius[:, ::-1])
    return see(recorder, replace(period, end=mirrored))


def wrong_link(put: Any, stream: Any, kept: Any, count: int) -> Any:
    """The certificate says that another row is kept."""
    return put(stream, np.where(np.arange(kept.size) == kept.size - 1, count - 1, kept), count)


def constant_is_fixed(start: Any, engine: Any, *rest: Any) -> Any:
    cells = start(engine, *rest)
    generators = cells.tracked.generators.copy()
    generators[:, :, engine.model.states :] = 0.0
    return replace(cells, tracked=replace(cells.tracked, generators=generators))


def moved_cut(tree: Any, *arguments: Any) -> Any:
    """The certificate's cuts are a little above those of the cells."""
    nodes, leaves = tree(*arguments)
    return [None if node is None else [node[0], str(Fraction(node[1]) + Fraction(1, 2**30))] for node in nodes], leaves


def bold_margins(with_room: Any, margin: float) -> float:
    return margin + 0.5


def no_penalty(observe: Any, performance_: Any, index: Any, numbers: Any, end: Any) -> Any:
    """The penalty is never charged."""
    observe(performance_, index, numbers, end)
    performance_.costs[index, numbers] -= float(performance_.reward.penalty.mid)


def last_period_free(value: Any, performance_: Any) -> Any:
    performance_.costs[:, -1] = 0.0
    return value(performance_)


def first_factor_only(cells: Any, initial: Any, *rest: Any) -> Any:
    center, rows, radius = cells(initial, *rest)
    rows = rows.copy()
    rows[:, 1:] = 0.0
    return center, rows, radius


def half_the_noise(act: Any, engine: Any, state: Any, radius: Any, *rest: Any) -> Any:
    return act(engine, state, 0.5 * radius, *rest)


def action_of_the_center(patch: Patch) -> None:
    """The action of the set's center only."""

    def act(original: Any, engine: Any, state: Any, radius: Any, shared: int) -> Any:
        action, error, share, choices = original(engine, state, radius, shared)
        generators = action.generators.copy()
        generators[:, :shared] = 0.0
        return replace(action, generators=generators), error, share, choices

    method(closed_loop.Engine, "_act", act)(patch)


BUGS = [
    Bug(
        "relaxation error 0.95, tanh",
        wrapped(network, "relax", error_times(0.95)),
        9,
        {"wide": 8.0, "kind": "tanh", "method": "jets", "taylor_order": 5},
    ),
    Bug("relaxation error halved, relu", wrapped(network, "relax", error_times(0.5)), 0, {"wide": 8.0}),
    Bug("relaxation error halved, sigmoid", wrapped(network, "relax", error_times(0.5)), 35),
    Bug("relaxation error halved, leaky relu", wrapped(network, "relax", error_times(0.5)), 18),
    Bug("relaxation error halved, clip", wrapped(network, "relax", error_times(0.5)), 36, {"wide": 6.0}),
    Bug("wrong extremum of tanh", wrapped(relaxations, "_tangent_bound", tight_tangent), 11, {"wide": 6.0}),
    Bug("residual at ends and middle only", wrapped(network, "relax", teeth.midpoint_only), 11, {"wide": 6.0}),
    Bug("offset forgotten", wrapped(network, "relax", no_offset), 0, {"wide": 8.0}),
    Bug("bounds swapped", wrapped(network, "relax", teeth.swapped_bounds), 0, {"wide": 8.0}),
    Bug("one neuron taken for exact", teeth.seed_zero, 11, {"wide": 6.0}),
    Bug("columns forgotten", constant(network, "append_rows", lambda z, rows: z), 12, {"wide": 6.0}),
    Bug("last column forgotten", wrapped(network, "append_rows", teeth.without_last_row), 11, {"wide": 4.0}),
    Bug(
        "layer bounds shrunk",
        wrapped(network, "LayerBounds", lambda b, low, high: b(0.75 * low + 0.25 * high, 0.25 * low + 0.75 * high)),
        10,
    ),
    Bug("merged rows dropped", wrapped(network, "diagonal_rows", lambda f, r: 0.0 * f(r)), 0),
    Bug("rounding of a layer dropped", wrapped(network, "linear_map", teeth.without_rounding), 5),
    Bug("boxed part of a layer dropped", wrapped(network, "linear_map", teeth.without_radius), 5),
    Bug("set of the center's action", action_of_the_center, 6),
    Bug("perturbation dropped", method(closed_loop.Engine, "_act", teeth.without_noise), 2),
    Bug("perturbation halved", method(closed_loop.Engine, "_act", half_the_noise), 11),
    Bug("disturbance dropped", method(closed_loop.Engine, "_with_disturbances", teeth.without_disturbance), 10),
    Bug("constant disturbance dropped", method(closed_loop.Engine, "start", constant_is_fixed), 11),
    Bug("clip moves the center only", method(closed_loop.Engine, "_clip", teeth.without_clip), 10, {"wide": 3.0}),
    Bug("deployed error dropped", wrapped(closed_loop, "deployed_error", teeth.no_error), 6),
    Bug("order reduction without its box", both(few_rows, wrapped(closed_loop, "reduce_order", teeth.without_box)), 11),
    Bug("order reduction, half the box", both(few_rows, wrapped(closed_loop, "reduce_order", with_half_the_box)), 11),
    Bug(
        "substeps' reduction without its box",
        wrapped(integrator, "reduce_order", teeth.without_box),
        9,
        {"method": "jets"},
    ),
    Bug("remainder dropped", wrapped(flow, "flow_jets", teeth.without_remainder), 13, {"taylor_order": 2}),
    Bug(
        "start for a-priori enclosure",
        wrapped(flow, "a_priori_enclosure", teeth.start_as_prior),
        13,
        {"taylor_order": 2},
    ),
    Bug("Hessian at the center", wrapped(flow, "enclose_map", teeth.hessian_at_center), 1),
    Bug("Hessian dropped", wrapped(flow, "enclose_map", teeth.without_hessian), 10),
    Bug("Hessian of a map dropped", wrapped(flow, "enclose_map", teeth.without_hessian), 2),
    Bug("products forgotten", wrapped(flow, "enclose_map", without_products), 8),
    Bug("rest of the quadratic map dropped", wrapped(flow, "enclose_map", radius_times(0.0)), 1),
    Bug("center moved", wrapped(flow, "enclose_map", off_center), 5),
    Bug("period too short", wrapped(closed_loop, "integrate", shorter_period), 6),
    Bug("period off by one", method(closed_loop.Engine, "advance", teeth.one_period_late), 5),
    Bug(
        "remainder of the linearisation dropped",
        wrapped(linearization, "lagrange_remainder", lambda f, *a: Ball(0.0 * f(*a).mid, 0.0 * f(*a).rad)),
        9,
    ),
    Bug(
        "tail of the linearisation dropped",
        wrapped(linearization, "_tail", lambda f, *a: 0.0 * f(*a)),
        9,
        {"taylor_order": 2},
    ),
    Bug("states swapped", method(evidence.Recorder, "see", swapped_states), 11),
    Bug("wrong link", wrapped(evidence, "_put_dropped", wrong_link), 11),
    Bug("cells too narrow", method(splitting.InitialSet, "cells", teeth.narrow_cells), 2),
    Bug("only one initial factor", method(splitting.InitialSet, "cells", first_factor_only), 6),
    Bug("cut in another place", wrapped(certificate, "cover_of", moved_cut), 2, {"tight": 0.7, "splits": 64}),
    Bug("margins with too much room", wrapped(certificate.rounding, "with_room", bold_margins), 2),
    Bug("support 0.95", method(Zonotope, "support", teeth.support_without_last), 0),
    Bug("cost 0.95", wrapped(performance, "worst_cost", teeth.too_cheap), 5),
    Bug("penalty never charged", method(performance.Performance, "observe", no_penalty), 3),
    Bug("last period free", method(performance.Performance, "value", last_period_free), 5),
    Bug("discount squared", class_method(performance.RewardModel, "prepare", teeth.no_discount), 5, {"periods": 5}),
    Bug("between samples: time dropped", constant(flow, "append_rows", lambda z, rows: z), 0),
]
