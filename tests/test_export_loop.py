"""The closed loop as a network: every trajectory is one of it, and its queries are the requirements' violations."""

from __future__ import annotations

import itertools
from dataclasses import replace
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import onnx
import pytest
from certificates import SUBJECTS, case_of
from export_cases import ALL, NUMBERS, case, loop, run, satisfied, source
from flint import arb, ctx

from setrl.models.policy import forward
from setrl.models.sampling import sample_disturbances, sample_noise, uniform_states
from setrl.models.simulation import Trajectories, observe, simulate
from setrl.specs.errors import InputError
from setrl.verify.checker.contract import read_contract
from setrl.verify.checker.jets import flow_jets
from setrl.verify.checker.program import Program, ball, compile_program
from setrl.verify.checker.regions import Facet
from setrl.verify.export.exact import rounded
from setrl.verify.export.graph import Graph
from setrl.verify.export.loop_bounds import held_terms, step_values
from setrl.verify.export.loop_network import Loop, LoopNetwork, loop_network
from setrl.verify.export.requirement_queries import violation, wanted_queries
from setrl.verify.export.rounding_bounds import Known, RoundingBounds
from setrl.verify.export.series import Terms, flow_series, map_values
from setrl.verify.export.sources import Source

RUNS = 8
SHARES = (0.15, 0.5, 0.8, 1.0)
ORDER = 2
LOOSE = 2e-10
"""Error of the simulation itself."""


class Floats:
    """Float64 numbers, constants rounded as in a file."""

    def __init__(self, precision: str) -> None:
        self.precision = precision

    def constant(self, value: Fraction) -> Any:
        return rounded(value, self.precision)

    def add(self, left: Any, right: Any) -> Any:
        return left + right

    def subtract(self, left: Any, right: Any) -> Any:
        return left - right

    def multiply(self, left: Any, right: Any) -> Any:
        return left * right

    def reciprocal(self, operand: Any) -> Any:
        return 1.0 / operand

    def function(self, name: str, operand: Any) -> Any:
        return getattr(np, name)(operand)


@lru_cache(maxsize=32)
def unrolled(number: int, order: int = ORDER) -> Loop:
    return Loop.of(source(number), 0, source(number).layout.periods, order)


@lru_cache(maxsize=32)
def whole(number: int) -> LoopNetwork:
    """All states at sampling instants, and one during every period."""
    periods = range(source(number).layout.periods)
    between: list[Any] = [] if source(number).layout.discrete else [("during", k) for k in periods]
    return loop_network(unrolled(number), [*(("at", k) for k in [*periods, len(periods)]), *between])


@lru_cache(maxsize=32)
def trajectories(number: int) -> Trajectories:
    given, generator = loop(number), np.random.default_rng(number)
    shares = 1 if given.plant.discrete else SHARES
    noise = np.concatenate([sample_noise(given, kind, RUNS // 2, generator) for kind in ("uniform", "corner")])
    forces = np.concatenate([sample_disturbances(given, kind, RUNS // 2, generator) for kind in ("uniform", "corner")])
    return simulate(
        given,
        uniform_states(given, RUNS, generator),
        noise,
        forces,
        rtol=1e-12,
        atol=1e-14,
        samples_per_period=shares,
    )


def written_actions(number: int, found: Trajectories) -> Any:
    """What the file's controller does on the trajectories' own states, delay included: (N, T, m)."""
    given, terms = source(number), Terms(Floats(source(number).network.precision))
    layers = tuple(written.layer for written in unrolled(number).controller.layers)
    size = found.samples_per_period
    actions = [np.tile([float(x) for x in given.contract.delayed_action], (RUNS, 1))] * given.layout.delay
    from setrl.verify.checker.layout import observation_program

    program = observation_program(given.contract)
    for k in range(given.layout.periods):
        state = found.states[:, k * size]
        seen = [terms.value(term) for term in map_values(program, terms, list(state.T))]
        rows = np.stack([np.broadcast_to(x, RUNS) for x in seen], axis=1) + found.noise[:, k]
        actions.append(forward(layers, rows))
    return np.stack(actions[: given.layout.periods], axis=1)


def left_over(number: int, share: Fraction, position: int) -> Any:
    """What the polynomials leave of the trajectories at a share of every period, (N, T, n)."""
    given, found = source(number), trajectories(number)
    terms = Terms(Floats(given.network.precision))
    actions, size = written_actions(number, found), found.samples_per_period
    rest = []
    for k in range(given.layout.periods):
        state = found.states[:, k * size]
        acting: list[Any] = list(actions[:, k].T)
        if k < given.layout.delay:
            acting = list(given.contract.delayed_action)
        fixed = held_terms(given)
        held = [x if x is not None else found.disturbances[:, k, i] for i, x in enumerate(fixed)]
        time = Fraction(1) if share == 1 else float(share)
        point = [*state.T, *acting, *held]
        values = step_values(given.setting.field, terms, point, given, unrolled(number).order, time)
        reached = np.stack([np.broadcast_to(terms.value(value), RUNS) for value in values], axis=1)
        rest.append(found.states[:, k * size + position] - reached)
    return np.stack(rest, axis=1)


def inside(bounds: Any, values: Any, slack: float) -> bool:
    low, high = (0.0, 0.0) if bounds is None else (float(bounds.lower), float(bounds.upper))
    return bool(((low - slack <= values) & (values <= high + slack)).all())


@pytest.mark.parametrize("number", ALL)
def test_every_trajectory_is_one_of_the_network_for_some_admissible_remainder(number: int) -> None:
    given = source(number)
    assert trajectories(number).observations.shape[2] == given.layout.observations
    end = left_over(number, Fraction(1), trajectories(number).samples_per_period)
    for k, remainder in enumerate(unrolled(number).remainders):
        for i, bounds in enumerate(remainder.end):
            assert inside(bounds, end[:, k, i], LOOSE), (k, i, bounds, end[:, k, i])
    if given.layout.discrete:
        return
    for position, share in enumerate(SHARES, 1):
        rest = left_over(number, Fraction(share), position)
        for k, remainder in enumerate(unrolled(number).remainders):
            for i, bounds in enumerate(remainder.during):
                assert inside(bounds, rest[:, k, i], LOOSE), (share, k, i)


def test_the_boxes_of_remainders_are_not_far_too_large() -> None:
    shares = []
    for number in (3, 7, 22):
        rest = left_over(number, Fraction(1), trajectories(number).samples_per_period)
        for k, remainder in enumerate(unrolled(number).remainders):
            for i, bounds in enumerate(remainder.end):
                if bounds is not None and bounds.upper - bounds.lower > Fraction(1, 10**6):
                    shares.append(np.ptp(rest[:, k, i]) / float(bounds.upper - bounds.lower))
    assert max(shares) > 0.1 and float(np.median(shares)) > 0.002


def inputs_of(number: int, row: int, ends: Any, during: Any, share: float) -> Any:
    """The network's inputs that belong to a trajectory."""
    found, values = trajectories(number), []
    for entry in whole(number).inputs:
        k, i = entry.period, entry.position
        values.append(
            {
                "initial": lambda i=i, k=k: found.states[row, 0, i],
                "perturbation": lambda i=i, k=k: found.noise[row, k, i],
                "disturbance": lambda i=i, k=k: found.disturbances[row, k or 0, i],
                "remainder": lambda i=i, k=k: ends[row, k, i],
                "during": lambda i=i, k=k: during[row, k, i],
                "share": lambda i=i, k=k: share,
            }[entry.kind]()
        )
    return np.array(values)


@pytest.mark.parametrize("number", ALL)
def test_the_network_reproduces_trajectories(number: int) -> None:
    given, found = source(number), trajectories(number)
    network = whole(number)
    onnx.checker.check_model(onnx.load_from_string(network.content), full_check=True)
    size, states = found.samples_per_period, given.layout.states
    ends = left_over(number, Fraction(1), size)
    during = ends if given.layout.discrete else left_over(number, Fraction(SHARES[1]), 2)
    for row in range(3):
        inputs = inputs_of(number, row, ends, during, SHARES[1])
        for entry, value in zip(network.inputs, inputs, strict=True):
            assert entry.bounds.lower - Fraction(LOOSE) <= Fraction(value) <= entry.bounds.upper + Fraction(LOOSE)
        received = run(network.content, inputs).reshape(-1, states)
        points = found.states[row, ::size]
        assert np.allclose(received[: len(points)], points, rtol=0.0, atol=3e-5)
        if not given.layout.discrete:
            assert np.allclose(received[len(points) :], found.states[row, 2::size], rtol=0.0, atol=3e-5)


def test_a_network_has_the_inputs_of_its_own_outputs_only() -> None:
    for kind, k, last in (("at", 0, -1), ("at", 1, 0), ("during", 1, 1)):
        network = loop_network(unrolled(22), [(kind, k)])  # type: ignore[list-item]
        assert network.outputs == ((kind, k),)
        assert max((entry.period for entry in network.inputs if entry.period is not None), default=-1) == last
        assert ("share" in {entry.kind for entry in network.inputs}) == (kind == "during")


# Requirements ------------------------------------------------------------------------------------------------------


def asked(number: int, given: Source) -> Any:
    """Every violation of a source with the whole network, and the positions of its states."""
    for wanted in wanted_queries(given, given.layout.periods):
        yield wanted, violation(given, wanted, whole(number))


def outputs_of(number: int, row: int) -> Any:
    """Inputs and outputs of a trajectory; the outputs are the simulation's, to be exact."""
    found = trajectories(number)
    size = found.samples_per_period
    ends = left_over(number, Fraction(1), size)
    during = ends if source(number).layout.discrete else left_over(number, Fraction(SHARES[1]), 2)
    inputs = inputs_of(number, row, ends, during, SHARES[1])
    # neither is a simulation exact to the last digit, nor every bound a float
    exact = [
        min(max(Fraction(x), e.bounds.lower), e.bounds.upper) for x, e in zip(inputs, whole(number).inputs, strict=True)
    ]
    states = [found.states[row, ::size]]
    if not source(number).layout.discrete:
        states.append(found.states[row, 2::size])
    return exact, np.concatenate(states).ravel()


@pytest.mark.parametrize("number", ALL)
def test_no_trajectory_of_a_verified_loop_is_a_violation(number: int) -> None:
    queries = list(asked(number, source(number)))
    assert {wanted.requirement for wanted, _ in queries} == set(range(len(source(number).contract.requirements)))
    for row in range(3):
        inputs, outputs = outputs_of(number, row)
        assert not any(satisfied(query, inputs, outputs) for _, query in queries)


def with_region(given: Source, number: int, kind: str, member: Any) -> Source:
    """The same source with another requirement in a place; the window stays."""
    conditions = list(given.layout.conditions)
    requirement = replace(conditions[number].requirement, kind=kind, region=member)
    conditions[number] = replace(conditions[number], requirement=requirement)
    layout = replace(given.layout, conditions=tuple(conditions))
    return replace(given, setting=replace(given.setting, layout=layout))


@pytest.mark.parametrize("number", [7, 22, 24, 29])
def test_a_trajectory_that_violates_a_requirement_satisfies_its_query(number: int) -> None:
    """avoid what the trajectory is in, stay and reach where it is not."""
    given = source(number)
    size = given.layout.states
    inputs, outputs = outputs_of(number, 0)
    for position, wanted in {w.requirement: w for w in wanted_queries(given, given.layout.periods)}.items():
        state = outputs.reshape(-1, size)[whole(number).outputs.index(wanted.outputs[-1])]
        units = [tuple(Fraction(int(i == j)) for j in range(size)) for i in range(size)]
        around = tuple(
            Facet(tuple(sign * c for c in unit), sign * Fraction(x) + Fraction(1, 1000))
            for unit, x in zip(units, state, strict=True)
            for sign in (1, -1)
        )
        least = Fraction(outputs.reshape(-1, size)[:, 0].min())
        beyond = (Facet(units[0], least - Fraction(1, 1000)),)
        near, far = (around,), (beyond, (*beyond, around[1]))
        for kind, region, expected in (
            ("avoid", near, True),
            ("avoid", (beyond,), False),
            ("avoid", (beyond, around), True),
            ("stay", near, False),
            ("stay", (beyond,), True),
            ("stay", far, True),
            ("stay", (beyond, around), False),
        ):
            changed = with_region(given, position, kind, region)
            last = replace(wanted, outputs=wanted.outputs[-1:])
            query = violation(changed, last, whole(number))
            # the share of the sample has to be one of the window's
            shares = [(Fraction(SHARES[1]), last.share) for kind_, _ in last.outputs if kind_ == "during"]
            if all(b.lower <= s <= b.upper for s, b in shares):
                assert satisfied(query, inputs, outputs) == expected, (kind, region)


@pytest.mark.slow
def test_a_reach_is_violated_only_by_missing_all_of_the_region_at_every_instant() -> None:
    number, given = 22, source(22)

    def side(low: int, high: int, state: int = 0) -> list[Facet]:
        unit = tuple(Fraction(int(i == state)) for i in range(2))
        return [Facet(tuple(-c for c in unit), Fraction(-low)), Facet(unit, Fraction(high))]

    region = (tuple(side(0, 1)), (*side(5, 6), *side(0, 2, state=1)))
    points = {(0.5, 9.0): True, (5.5, 1.0): True, (5.5, 3.0): False, (3.0, 1.0): False, (-2.0, 1.0): False}
    changed = with_region(given, 0, "reach", region)
    condition = replace(
        changed.layout.conditions[0],
        by_points=True,
        requirement=replace(
            changed.layout.conditions[0].requirement, start=given.layout.period, end=3 * given.layout.period
        ),
    )
    layout = replace(changed.layout, conditions=(condition,))
    changed = replace(changed, setting=replace(changed.setting, layout=layout))
    (wanted,) = wanted_queries(changed, 3)
    assert wanted.outputs == (("at", 1), ("at", 2), ("at", 3)) and not list(wanted_queries(changed, 2))
    query = violation(changed, wanted, whole(number))
    inputs = [(entry.bounds.lower + entry.bounds.upper) / 2 for entry in whole(number).inputs]
    places = [whole(number).outputs.index(output) for output in wanted.outputs]
    for chosen in itertools.product(points, repeat=3):
        outputs = np.full((len(whole(number).outputs), 2), 0.5)
        outputs[places] = chosen
        assert satisfied(query, inputs, outputs.ravel()) == (not any(points[point] for point in chosen)), chosen


def with_window(given: Source, start: Fraction, end: Fraction) -> Source:
    """The first requirement alone, for all times between two, in periods."""
    condition = given.layout.conditions[0]
    period = given.layout.period
    requirement = replace(condition.requirement, kind="stay", start=start * period, end=end * period)
    layout = replace(given.layout, conditions=(replace(condition, by_points=False, requirement=requirement),))
    return replace(given, setting=replace(given.setting, layout=layout))


@pytest.mark.parametrize(
    ("start", "end", "expected"),
    [
        ("0.3", "2.6", [(0, "0.3", "1"), (1, "0", "1"), (2, "0", "0.6")]),
        ("1", "2", [(1, "0", "1")]),
        ("1.5", "1.5", [(1, "0.5", "0.5")]),
        ("0", "0.2", [(0, "0", "0.2")]),
        ("2", "9", [(2, "0", "1")]),
    ],
)
def test_a_window_bounds_the_times_of_its_periods(start: str, end: str, expected: Any) -> None:
    """Three periods; what only touches a period is a time of its neighbour."""
    given = with_window(source(22), Fraction(start), Fraction(end))
    found = list(wanted_queries(given, 3))
    assert [(w.outputs, w.share.lower, w.share.upper) for w in found] == [
        ((("during", k),), Fraction(low), Fraction(high)) for k, low, high in expected
    ]
    for wanted in found:
        ((_, number),) = wanted.outputs
        for one in violation(given, wanted, whole(22)).cases:
            for bounds, entry in zip(one.box, whole(22).inputs, strict=True):
                chosen = entry.kind == "share" and entry.period == number
                assert bounds == (wanted.share if chosen else entry.bounds)


def test_a_violation_with_too_many_cases_is_refused() -> None:
    number, given = 22, source(22)
    wanted = next(w for w in wanted_queries(given, 1))
    facet = Facet((Fraction(1), Fraction(0)), Fraction(0))
    changed = with_region(given, wanted.requirement, "stay", ((facet,) * 9,) * 4)
    with pytest.raises(InputError, match="more than 4096 cases"):
        violation(changed, wanted, whole(number))


# Arithmetic --------------------------------------------------------------------------------------------------------


def field(name: str) -> Program:
    spec = case_of(list(SUBJECTS).index(name)).specification
    plant = read_contract(spec).plant
    return compile_program(plant.dynamics, (*plant.states, *plant.inputs, *plant.disturbances))


CONTINUOUS = [name for name, subject in SUBJECTS.items() if not subject.discrete]


@pytest.mark.parametrize("name", CONTINUOUS)
def test_series_are_those_of_the_checker(name: str) -> None:
    program, generator = field(name), np.random.default_rng(0)
    point = generator.uniform(0.2, 0.6, len(program.inputs))
    found = flow_series(program, Terms(Floats("float64")), list(point), 5)
    expected = flow_jets(program, [arb(x) for x in point], 0, 5, ())
    for row, other in zip(found, expected, strict=True):
        values = [0.0 if x is None else float(x) for x in row]
        assert np.allclose(values, [float(x.mid()) for (x,) in other], rtol=1e-9, atol=1e-12)


class Rounded(Floats):
    """Balls, constants rounded as in a file: the written computation, exactly."""

    def constant(self, value: Fraction) -> Any:
        return arb(rounded(value, self.precision))

    def reciprocal(self, operand: Any) -> Any:
        return 1 / operand

    def function(self, name: str, operand: Any) -> Any:
        return getattr(operand, name)()


class Exact(Rounded):
    def constant(self, value: Fraction) -> Any:
        return ball(value)


@pytest.mark.parametrize("name", SUBJECTS)
def test_what_rounded_constants_change_is_bounded(name: str) -> None:
    program, generator = field(name), np.random.default_rng(1)
    largest = 0.0
    with ctx.workprec(200):
        box = [(Fraction(low), Fraction(low) + Fraction(1, 50)) for low in generator.uniform(0.2, 0.6, 20)]
        box = box[: len(program.inputs)]
        bounds = Terms(RoundingBounds("float32"))
        known = [Known(ball(low).union(ball(high)), arb(0)) for low, high in box]
        discrete = name == "map"

        def values(terms: Any, point: Any) -> list[Any]:
            if discrete:
                return [terms.value(x) for x in map_values(program, terms, point)]
            rows = flow_series(program, terms, point, 4)
            scaled = [[terms.multiply(Fraction(1, 10) ** j, x) for x in row] for j, row in enumerate(rows)]
            return [terms.value(terms.polynomial(column, Fraction(1))) for column in zip(*scaled, strict=True)]

        claimed = values(bounds, known)
        for _ in range(20):
            point = [arb(float(low + (high - low) * Fraction(generator.uniform()))) for low, high in box]
            pairs = zip(values(Terms(Exact("")), point), values(Terms(Rounded("float32")), point), claimed, strict=True)
            for exact_value, written, most in pairs:
                assert bool(most.value.overlaps(exact_value))
                assert bool(abs(written - exact_value) <= most.error.upper())
                if not most.error.is_zero():
                    largest = max(largest, float(abs(written - exact_value) / most.error.upper()))
    assert largest > 0.02 or not any(float(most.error) for most in claimed)


@pytest.mark.parametrize("name", ["sin", "cos", "tanh", "exp", "log", "sqrt", "reciprocal"])
def test_what_an_error_in_front_of_a_function_becomes_is_bounded(name: str) -> None:
    arithmetic = RoundingBounds("float32")

    def of(value: Any) -> Any:
        return 1 / value if name == "reciprocal" else getattr(value, name)()

    for middle, error in itertools.product(("0.3", "1.7", "5"), ("1e-3", "0.1")):
        operand = Known(ball(Fraction(middle)), ball(Fraction(error)))
        known = arithmetic.reciprocal(operand) if name == "reciprocal" else arithmetic.function(name, operand)
        for sign in (-1, 1):
            moved = of(operand.value + sign * operand.error)
            assert bool(abs(moved - of(operand.value)) <= known.error.upper() + arb(2) ** -45)


def test_equal_nodes_of_a_graph_are_one_and_dead_ones_none() -> None:
    graph = Graph("float32")
    first, second = graph.number("inputs", 0), graph.number("inputs", 1)
    assert graph.add(first, second) == graph.add(first, second) != graph.add(second, first)
    total = graph.multiply(graph.add(first, second), graph.constant(Fraction(1, 3)))
    graph.function("sin", first)
    model = onnx.load_from_string(graph.content(2, total, 1, ""))
    assert [node.op_type for node in model.graph.node] == ["Slice", "Slice", "Add", "Mul", "Concat"]
    assert run(model.SerializeToString(), [3.0, 6.0])[0, 0] == pytest.approx(3.0)


def test_the_simulation_and_the_checkers_program_see_the_same() -> None:
    """The tests above use both: `observe` is the simulation's."""
    for number in NUMBERS:
        found, given = trajectories(number), loop(number)
        seen = observe(given, found.states[:, 0])
        assert np.allclose(seen + found.noise[:, 0], found.observations[:, 0])
        assert case(number).name
