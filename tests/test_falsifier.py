"""The falsifier: right derivatives, violations that corners and random points miss, simulation has the last word."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from typing import Any

import laws
import numpy as np
import pytest
from loops import affine_map, box_region, gain, loop_of, network, plant_of, requirement, specification_of
from test_planted_violations import random_loop

from setrl.models.closed_loop import ClosedLoop
from setrl.models.plant import load_plant
from setrl.models.sampling import sample_disturbances, sample_noise, uniform_states
from setrl.models.simulation import simulate
from setrl.models.tape import compile_tape
from setrl.specs.expressions import parse_expression
from setrl.specs.reader import find_specification, read_specification
from setrl.specs.specification import Bounds, Halfspace, Polytope, Region
from setrl.verify.falsifier import Candidate, propose, propose_all, search, violations
from setrl.verify.falsifier.adjoint import TapeAdjoint
from setrl.verify.falsifier.attack import Ascent
from setrl.verify.falsifier.chart import Chart
from setrl.verify.falsifier.rollout import Rollout
from setrl.verify.falsifier.severity import Severity

F = Fraction
Array = Any


def halfspace(bound: Any, **coefficients: Any) -> Region:
    """A region that is one halfspace."""
    return Region((Polytope((Halfspace({name: F(c) for name, c in coefficients.items()}, F(bound), "planted"),)),))


def at_the_end(loop: ClosedLoop, region: Region, kind: str = "stay") -> ClosedLoop:
    """The same loop with one requirement, at the end of the horizon."""
    end = loop.specification.horizon
    return loop_of(loop.policy, replace(loop.specification, requirements=(requirement(kind, region, end, end),)))


def wide_starts(chart: Chart, count: int, seed: int = 0) -> Array:
    """Corners and random points of the cube."""
    points = np.random.default_rng(seed).uniform(-1.0, 1.0, (chart.size, count))
    points[:, ::2] = np.sign(points[:, ::2])
    return points


# Derivatives --------------------------------------------------------------------------------------------------------

EXPRESSIONS = {
    "add": "a + b",
    "subtract": "a - b",
    "multiply": "a * b",
    "divide": "a / b",
    "a quotient of a constant": "3 / a",
    "negate": "-a",
    "square": "a**2",
    "power": "a**-3",
    "sin": "sin(a)",
    "cos": "cos(a)",
    "both": "sin(a) * cos(a)",
    "tan": "tan(a)",
    "exp": "exp(a)",
    "log": "log(a)",
    "sqrt": "sqrt(a)",
    "tanh": "tanh(a)",
    "reuse": "a * (a + b) / (a - 3*b) - a",
    "input": "a",
    "constant": "2",
}


@pytest.mark.parametrize("text", EXPRESSIONS.values(), ids=EXPRESSIONS.keys())
def test_the_adjoint_of_an_operation_is_its_central_difference(text: str) -> None:
    adjoint = TapeAdjoint(compile_tape([parse_expression(text), parse_expression("b")], ["a", "b"]))
    generator = np.random.default_rng(0)
    point, seeds, step = generator.uniform(0.5, 1.4, (2, 50)), generator.normal(size=(2, 50)), 1e-6

    def total(values: Array) -> Array:
        slots, _ = adjoint.values(list(values))
        return sum(seed * slots[slot] for seed, slot in zip(seeds, adjoint.outputs, strict=True))

    found = adjoint.pull(*adjoint.values(list(point)), list(seeds))
    for row in range(2):
        shift = np.zeros((2, 1))
        shift[row] = step
        difference = (total(point + shift) - total(point - shift)) / (2 * step)
        gradient = np.zeros(50) if found[row] is None else found[row]
        assert np.allclose(gradient, difference, rtol=1e-7, atol=1e-8)


def shipped(name: str, kind: str) -> ClosedLoop:
    """A shipped plant and specification with a random network."""
    specification = read_specification(find_specification(name))
    plant = load_plant(str(specification.plant))
    observed = specification.controller.observe or plant.states
    policy = network([len(observed), 12, 8, len(plant.inputs)], [kind, kind, "tanh"], 3, 0.7)
    return loop_of(policy, specification, F(1, 20))


def small(discrete: bool = False, kind: str = "tanh", **controller: Any) -> ClosedLoop:
    """A plant with two inputs' worth of everything: disturbances held and varying, noise, and what is asked for."""
    plant = plant_of(
        {"x": "0.8*x + 0.3*sin(y) + u + d", "y": "0.7*y - 0.2*x*v + e*x"}
        if discrete
        else {"x": "y - x**3/(2 + cos(y)) + u + d", "y": "-sin(x) + v*exp(-x) - e*sqrt(2 + y)"},
        inputs="u v",
        disturbances="d e",
        discrete=discrete,
    )
    specification = specification_of(
        plant,
        {"x": ("0.1", "0.5"), "y": ("-0.4", "0.2")},
        period="0.2",
        periods=5,
        observation="0.1",
        disturbances={"d": ("-0.1", "0.2", True), "e": ("-0.3", "0.1", False)},
        **controller,
    )
    inputs = len(controller.get("observe", "xy"))
    inputs = len(specification.controller.before.matrix) if "before" in controller else inputs
    return loop_of(network([inputs, 6, 2], [kind, "none"], 1, 1.5), specification)


OBSERVED = {"a": "x*y", "b": "sin(x) + y", "c": "x"}
LOOPS: dict[str, Any] = {
    **{f"{name} {kind}": (shipped, name, kind) for name, kind in (("nav", "tanh"), ("nav", "relu"))},
    **{f"{name}": (shipped, name, "sigmoid") for name in ("navigation", "pendulum", "quadrotor1d", "quadrotor2d")},
    **{f"small {kind}": (small, False, kind) for kind in ("relu", "leaky_relu", "sigmoid", "clip")},
    "discrete": (small, True),
}
MORE: dict[str, dict[str, Any]] = {
    "delay": {"delay": 2, "delayed_action": {"u": F(1, 2), "v": F(-1, 3)}},
    "clip": {"clip": {"u": Bounds(F(-1, 10), F(1, 5)), "v": Bounds(F(-1, 4), F(1))}},
    "observation": {"observe": OBSERVED},
    "maps": {
        "before": affine_map([[1, 2], ["0.5", -1], [3, 1]], [0, 1, 2]),
        "after": affine_map([["0.5", 1], [0, 2]], ["0.1", 0]),
    },
}


@pytest.mark.parametrize("name", [*LOOPS, *MORE, *(f"discrete {name}" for name in MORE)])
def test_the_adjoint_of_a_rollout_is_its_central_difference(name: str) -> None:
    if name in LOOPS:
        make, *given = LOOPS[name]
        loop = make(*given)
    else:
        loop = small(name.startswith("discrete"), **MORE[name.removeprefix("discrete ")])
    rollout, chart = Rollout(loop, 2), Chart(loop)
    generator = np.random.default_rng(5)
    point, step = generator.uniform(-0.9, 0.9, (chart.size, 1)), 1e-4
    trace = rollout.run(chart.choices(point))
    assert trace is not None
    seeds = generator.normal(size=trace.states.shape)
    found = chart.pull(rollout.pull(trace, seeds))[:, 0]
    shifts = step * np.eye(chart.size)
    either = rollout.run(chart.choices(point + np.concatenate([shifts, -shifts], axis=1)))
    assert either is not None
    total = (seeds * either.states).sum((0, 1))
    difference = (total[: chart.size] - total[chart.size :]) / (2 * step)
    scale = np.abs(difference).max()
    assert scale > 1e-3, "nothing depends on the choices"
    rounding = 1e-15 * np.abs(seeds * trace.states).sum() / step
    assert np.abs(found - difference).max() <= 1e-6 * scale + rounding and rounding <= 1e-3 * scale


@pytest.mark.parametrize("name", ["nav", "navigation", "pendulum", "quadrotor1d", "quadrotor2d"])
def test_a_rollout_is_close_to_the_simulator(name: str) -> None:
    loop = shipped(name, "tanh")
    chart, rollout = Chart(loop), Rollout(loop, 4)
    choices = chart.choices(wide_starts(chart, 10))
    trace = rollout.run(choices)
    assert trace is not None
    noise, forces = choices.noise.transpose(2, 0, 1), choices.disturbances.transpose(2, 0, 1)
    truth = simulate(loop, choices.initial.T, noise, forces, samples_per_period=4)
    assert np.allclose(rollout.times, truth.times)
    assert np.abs(trace.states - truth.states.transpose(1, 2, 0)).max() <= 1e-4 * np.abs(truth.states).max()


# What an adversary may choose ---------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["nav", "navigation", "quadrotor2d", "small"])
def test_a_chart_stays_within_exact_bounds_and_is_inverted(name: str) -> None:
    loop = small() if name == "small" else shipped(name, "tanh")
    chart = Chart(loop)
    b = wide_starts(chart, 20)
    choices = chart.choices(b)
    assert np.allclose(chart.coordinates(choices), b, atol=1e-12)
    sides = [
        (choices.initial[None], loop.initial),
        (choices.noise, [(-radius, radius) for radius in loop.observation_radius]),
        (choices.disturbances, [(entry.lower, entry.upper) for entry in loop.disturbances]),
    ]
    for values, bounds in sides:
        for row, (low, high) in enumerate(bounds):
            exact = [F(x) for x in values[:, row].ravel().tolist()]
            assert (low <= min(exact) and max(exact) <= high) or low == high
    for row, entry in enumerate(loop.disturbances):
        assert (np.ptp(choices.disturbances[:, row], axis=0) == 0).all() == entry.constant


# How bad a trajectory is --------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kind", ["avoid", "stay", "reach"])
@pytest.mark.parametrize("members", [1, 2])
def test_severity_is_the_amount_of_violation_with_its_derivative(kind: str, members: int) -> None:
    polytopes = [*box_region(x=("0.2", "0.6"), y=(-1, 1)).members, *halfspace("0.1", x=1, y=2).members][:members]
    loop = small()
    wanted = requirement(kind, Region(tuple(polytopes)), "0.4", 1)
    loop = loop_of(loop.policy, replace(loop.specification, requirements=(wanted,)))
    rollout = Rollout(loop, 2)
    severity = Severity(loop.requirements[0], rollout.times, 2, 0.2)
    states = np.random.default_rng(0).normal(size=(rollout.times.size, 2, 200))
    none = np.full(200, -1)
    amounts, table, seeds = severity.measure(states, np.zeros(200), none)
    truth, _ = violations(loop.requirements[0], rollout.times, states.transpose(2, 0, 1), 2, 0.2)
    assert (amounts == truth).all()
    direction, step = np.random.default_rng(1).normal(size=states.shape), 1e-7
    ahead, behind = (severity.measure(states + s * direction, np.zeros(200), none)[0] for s in (step, -step))
    assert np.allclose((seeds * direction).sum((0, 1)), (ahead - behind) / (2 * step), atol=1e-6)
    assert (len(table) == 0) if kind == "reach" else (table.max(0) == amounts).all()
    for aim in range(len(table)):
        row = np.full(200, aim)
        seeds = severity.measure(states, np.full(200, 0.1), row)[2]
        if members == 1 and kind == "stay":
            ahead, behind = (severity.measure(states + s * direction, np.zeros(200), row)[1] for s in (step, -step))
            assert np.allclose((seeds * direction).sum((0, 1)), (ahead - behind)[aim] / (2 * step), atol=1e-6)
        assert (np.count_nonzero(np.abs(seeds).max(1), axis=0) == 1).all(), "an aim is one time"


# What it finds ------------------------------------------------------------------------------------------------------


def oscillator(discrete: bool, kind: str = "linear") -> ClosedLoop:
    """Weakly damped: the worst noise and disturbance change their signs with the swing, period by period."""
    text = (
        {"x": "0.9*x + 0.4*y", "y": "-0.4*x + 0.9*y + u + d"} if discrete else {"x": "y", "y": "-4*x - 0.1*y + u + d"}
    )
    policy = gain([0.1, -0.2]) if kind == "linear" else network([2, 8, 1], ["tanh", "none"], 4, 0.5)
    plant = plant_of(text, disturbances="d", discrete=discrete)
    boxes = {"x": ("-0.1", "0.1"), "y": ("0.9", "1.1")}
    force = {"d": ("-0.05", "0.1", False)}
    return loop_of(
        policy, specification_of(plant, boxes, period="0.25", periods=20, observation="0.2", disturbances=force)
    )


def reachable(loop: ClosedLoop, line: Array) -> tuple[float, float]:
    """Largest ``line . x(T)`` of a loop that is affine in all choices, and the radius of its range."""
    chart = Chart(loop)
    points = np.concatenate([np.zeros((chart.size, 1)), np.eye(chart.size)], axis=1)
    choices = chart.choices(points)
    noise, forces = choices.noise.transpose(2, 0, 1), choices.disturbances.transpose(2, 0, 1)
    ends = simulate(loop, choices.initial.T, noise, forces, rtol=1e-12, atol=1e-14).states[:, -1] @ line
    radius = float(np.abs(ends[1:] - ends[0]).sum())
    return float(ends[0]) + radius, radius


@pytest.mark.parametrize("discrete", [True, False])
@pytest.mark.parametrize("share", [1e-1, 1e-3, 1e-6])
def test_the_worst_signs_of_an_affine_loop_are_found(discrete: bool, share: float) -> None:
    line = np.array([1.0, -0.5])
    loop = oscillator(discrete)
    most, radius = reachable(loop, line)
    region = halfspace(most - share * radius, x=1, y="-0.5")
    planted = at_the_end(loop, region)
    assert propose(planted, iterations=0) is None, "corners and random points find it, too"
    found = propose(planted)
    assert found is not None and 0.0 < found.violation <= share * radius + 1e-9
    assert propose(at_the_end(loop, halfspace(most + 1e-6 * radius, x=1, y="-0.5"))) is None
    signs = np.sign(found.noise[:, 0])
    assert (signs > 0).any() and (signs < 0).any(), "the worst noise is held: this problem shows nothing"


def reach_of(loop: ClosedLoop, line: Array, seed: int) -> tuple[float, float]:
    """The largest ``line . x(T)`` that two searches find, with far more effort than the falsifier, and the radius."""
    generator = np.random.default_rng(seed)
    ended = at_the_end(loop, halfspace(0, **dict(zip("xy", map(float, line), strict=True))))
    chart, rollout = Chart(ended), Rollout(ended, 4)
    severity = Severity(ended.requirements[0], rollout.times, rollout.substeps, float(loop.period))
    ascent = Ascent(rollout, chart, [severity], [wide_starts(chart, 256, seed)], generator)
    with np.errstate(all="ignore"):
        ascent.run(80)
    climb = ascent.climbs()[0]
    top = chart.choices(climb.points[:, np.argsort(-climb.amounts)[:4]])
    noise, forces = top.noise.transpose(2, 0, 1), top.disturbances.transpose(2, 0, 1)
    best = float((simulate(loop, top.initial.T, noise, forces, rtol=1e-11, atol=1e-13).states[:, -1] @ line).max())
    starts = uniform_states(loop, 200, generator)
    shaken, forced = sample_noise(loop, "corner", 200, generator), sample_disturbances(loop, "corner", 200, generator)
    ends = simulate(loop, starts, shaken, forced, rtol=1e-7, atol=1e-9).states[:, -1] @ line
    return max(best, laws.planted_boundary(loop, line, seed, rounds=3)), 0.5 * float(np.ptp(ends))


@pytest.mark.parametrize("seeds", [range(12), pytest.param(range(12, 72), marks=pytest.mark.slow)])
def test_of_random_planted_violations_most_are_found_where_simulation_finds_few(seeds: range) -> None:
    simulated, attacked = 0, 0
    for seed in seeds:
        loop = random_loop(seed)
        line = np.random.default_rng(1000 + seed).choice([-1.0, -0.5, 0.5, 1.0], size=2)
        most, radius = reach_of(loop, line, 5000 + seed)
        planted = at_the_end(loop, halfspace(most - 1e-3 * radius, x=float(line[0]), y=float(line[1])))
        simulated += propose(planted, iterations=0) is not None
        attacked += propose(planted) is not None
    assert attacked >= 0.9 * len(seeds) and simulated <= 0.4 * len(seeds), (attacked, simulated)


@pytest.mark.parametrize("discrete", [True, False])
def test_a_tanh_policy_is_driven_further_than_by_corners(discrete: bool) -> None:
    loop, line = oscillator(discrete, "tanh"), np.array([1.0, 1.0])
    most, radius = reach_of(loop, line, 1)
    planted = at_the_end(loop, halfspace(most - 1e-3 * radius, x=1, y=1))
    assert propose(planted, iterations=0) is None
    assert propose(planted) is not None


def still(dynamics: dict[str, str], *wanted: Any, periods: int = 6, **given: Any) -> ClosedLoop:
    """A plant in discrete time without control."""
    boxes = given.pop("initial", {"x": (-1, 1), "y": (0, 0)})
    plant = plant_of(
        {name: f"{text} + 0*u" for name, text in dynamics.items()}, discrete=True, **given.pop("plant", {})
    )
    return loop_of(
        gain([0.0, 0.0]), specification_of(plant, boxes, period=1, periods=periods, requirements=wanted, **given)
    )


def test_a_worst_case_inside_the_boxes_is_found() -> None:
    wanted = requirement("stay", halfspace("-0.000001", y=1), 3, 3)
    loop = still({"x": "x", "y": "-(x - 0.37)**2"}, wanted)
    assert propose(loop, iterations=0) is None
    found = propose(loop)
    assert found is not None and found.initial[0] == pytest.approx(0.37, abs=1e-3)


def test_a_time_that_nothing_can_change_does_not_hide_a_later_one() -> None:
    # y starts at 0.99 of its bound, whatever the adversary does; it passes it later where nearly every sign is right
    most = sum(0.09 * 0.9**k for k in range(11))
    bound = 0.999 * most
    boxes = {"x": (0, 0), "y": (F(0.99 * bound), F(0.99 * bound))}
    loop = still(
        {"x": "-0.9*x + 0.9*d", "y": "x"},
        requirement("stay", halfspace(bound, y=1), 0, 12),
        periods=12,
        plant={"disturbances": "d"},
        disturbances={"d": ("-0.1", "0.1", False)},
        initial=boxes,
    )
    assert propose(loop, iterations=0) is None
    found = propose(loop)
    assert found is not None and found.time == 12.0


def test_a_facet_that_is_nearly_reached_does_not_hide_one_that_is_crossed() -> None:
    # x comes close to its bound in every period with d = 1; y passes its own only where the signs of d alternate
    region = box_region(x=(-9, 1), y=(-9, F(0.999 * 1.4)))
    loop = still(
        {"x": "0.94 + 0.05*d", "y": "0.1*d - y"},
        requirement("stay", region, 0, 14),
        periods=14,
        plant={"disturbances": "d"},
        disturbances={"d": (-1, 1, False)},
        initial={"x": ("0.5", "0.5"), "y": (0, 0)},
    )
    assert propose(loop, iterations=0) is None
    found = propose(loop)
    assert found is not None and found.time == 14.0


def test_the_tip_of_a_wedge_is_reached_along_its_ridge() -> None:
    # 100 |x - y| <= x + y - 0.738 and x + y <= 0.74: a subgradient of the depth turns at every step
    sides = [({"x": F(99), "y": F(-101)}, F("-0.738")), ({"x": F(-101), "y": F(99)}, F("-0.738"))]
    facets = [Halfspace(normal, bound, "side") for normal, bound in [*sides, ({"x": F(1), "y": F(1)}, F("0.74"))]]
    wedge = Region((Polytope(tuple(facets)),))
    loop = still({"x": "x", "y": "y"}, requirement("avoid", wedge, 1, 2), initial={"x": (-1, 1), "y": (-1, 1)})
    assert propose(loop, iterations=0) is None
    assert propose(loop) is not None


def test_of_two_hills_in_every_period_the_higher_ones_are_found() -> None:
    # both ends of d are local maxima in each of 8 periods, and which is higher alternates: 256 hills, one highest
    loop = still(
        {"x": "-x", "y": "y + d**2 + 0.05*x*d + 0.2*d*(1 - d**2)"},
        requirement("stay", halfspace(F("1.05") * 8 - F("0.05"), y=1), 8, 8),
        periods=8,
        plant={"disturbances": "d"},
        disturbances={"d": (-1, 1, False)},
        initial={"x": (1, 1), "y": (0, 0)},
    )
    assert propose(loop, iterations=0) is None
    assert propose(loop) is not None


def test_a_narrow_obstacle_between_samples_is_hit() -> None:
    plant = plant_of({"x": "1 + 0*u", "y": "d"}, disturbances="d")
    obstacle = requirement("avoid", box_region(x=("0.951", "0.954"), y=("0.0475", "0.2")), 0, 2)
    given = {"observation": 0, "disturbances": {"d": ("-0.05", "0.05", False)}, "requirements": [obstacle]}
    loop = loop_of(gain([0.0, 0.0]), specification_of(plant, {"x": (0, 0), "y": (0, 0)}, periods=20, **given))
    assert propose(loop, iterations=0) is None
    found = propose(loop)
    assert found is not None and found.time == pytest.approx(0.9525, abs=0.002)


def test_a_goal_is_missed_only_if_it_is_missed_at_every_time_of_the_window() -> None:
    sides = [box_region(x=(-9, "0.5"), y=(-9, 9)), box_region(x=("0.52", 9), y=(-9, 9))]
    region = Region(tuple(member for side in sides for member in side.members))
    loop = still({"x": "x", "y": "y"}, requirement("reach", region, 1, 6))
    found = propose(loop)
    assert found is not None and 0.5 < found.initial[0] < 0.52
    moving = still({"x": "x + 0.05", "y": "y"}, requirement("reach", region, 1, 6))
    assert propose(moving) is None


# What it hands over -------------------------------------------------------------------------------------------------


def test_a_candidate_is_what_the_simulator_says_within_exact_bounds() -> None:
    loop = oscillator(False, "tanh")
    most, radius = reach_of(loop, np.array([1.0, 1.0]), 1)
    planted = at_the_end(loop, halfspace(most - 1e-2 * radius, x=1, y=1))
    found = propose(planted)
    assert found is not None
    again = simulate(loop, found.initial, found.noise[None], found.disturbances[None], rtol=1e-12, atol=1e-14)
    amount, _ = violations(planted.requirements[0], again.times, again.states, 1, float(loop.period))
    assert amount[0] == pytest.approx(found.violation, abs=1e-9)
    sides = [
        (found.initial[None], loop.initial),
        (found.noise, [(-radius, radius) for radius in loop.observation_radius]),
        (found.disturbances, [(entry.lower, entry.upper) for entry in loop.disturbances]),
    ]
    for values, bounds in sides:
        for column, (low, high) in zip(values.T, bounds, strict=True):
            assert all(low <= F(x) <= high for x in column.tolist())


def test_what_only_the_rollout_violates_is_not_proposed(monkeypatch: pytest.MonkeyPatch) -> None:
    measure = Severity.measure

    def wrong(self: Severity, *given: Any) -> Any:
        amounts, table, seeds = measure(self, *given)
        return amounts + 10.0, table + 10.0, seeds

    monkeypatch.setattr(Severity, "measure", wrong)
    loop = oscillator(True)
    most, radius = reachable(loop, np.array([1.0, 0.0]))
    assert propose(at_the_end(loop, halfspace(most + 1e-3 * radius, x=1))) is None


def two_requirements() -> ClosedLoop:
    shallow = requirement("stay", halfspace("0.9", x=1), 0, 6, "shallow")
    deep = requirement("stay", halfspace("0.5", x=-1), 0, 6, "deep")
    kept = requirement("stay", halfspace(2, x=1), 0, 6, "kept")
    inner = requirement("stay", halfspace("-0.000001", y=1), 3, 3, "inner")
    return still({"x": "x", "y": "-(x - 0.37)**2"}, shallow, kept, inner, deep)


def test_every_violated_requirement_has_one_candidate_deepest_first() -> None:
    found = propose_all(two_requirements())
    assert [candidate.requirement for candidate in found] == ["deep", "shallow", "inner"]
    assert found[0].violation > found[1].violation > found[2].violation > 0.0
    one = propose(two_requirements())
    assert isinstance(one, Candidate) and one.requirement == "deep"


def test_the_same_seed_proposes_the_same() -> None:
    loop = oscillator(True)
    most, radius = reachable(loop, np.array([1.0, 0.0]))
    planted = at_the_end(loop, halfspace(most - 1e-3 * radius, x=1))
    one, other = propose(planted), propose(planted)
    assert one is not None and other is not None and one.violation == other.violation
    assert (one.noise == other.noise).all() and (one.initial == other.initial).all()


def test_no_requirement_no_candidate() -> None:
    assert propose(still({"x": "x", "y": "y"})) is None and propose_all(still({"x": "x", "y": "y"})) == []


def test_an_attack_ends_when_time_is_up(monkeypatch: pytest.MonkeyPatch) -> None:
    rollouts, late = 0, 0
    run = Rollout.run

    def counted(self: Rollout, *given: Any) -> Any:
        nonlocal rollouts
        rollouts += 1
        return run(self, *given)

    def stop() -> bool:
        nonlocal late
        late += rollouts >= 5
        return rollouts >= 5

    monkeypatch.setattr(Rollout, "run", counted)
    loop = oscillator(False)
    most, radius = reachable(loop, np.array([1.0, 0.0]))
    assert propose(at_the_end(loop, halfspace(most - 1e-9 * radius, x=1)), stop=stop) is None
    assert rollouts == 5 and late <= 3


def test_a_long_horizon_costs_fewer_columns_and_iterations(monkeypatch: pytest.MonkeyPatch) -> None:
    sizes: list[int] = []
    run = Rollout.run

    def counted(self: Rollout, *given: Any) -> Any:
        sizes.append(given[0].initial.shape[1])
        return run(self, *given)

    monkeypatch.setattr(Rollout, "run", counted)
    monkeypatch.setattr(search, "MOST_NUMBERS", 20_000)
    monkeypatch.setattr(search, "MOST_OPERATIONS", 1)
    loop = oscillator(True)
    most, radius = reachable(loop, np.array([1.0, 0.0]))
    propose_all(at_the_end(loop, halfspace(most + 1e-9 * radius, x=1)))
    climbed = [size for size in sizes if size != 16]
    operations = Rollout(loop, 1).operations
    assert climbed == [20_000 // operations] * search.PATIENCE


def test_a_loop_without_choices_is_only_simulated(monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_: Any) -> None:
        raise AssertionError("there is nothing to climb")

    monkeypatch.setattr(Rollout, "run", forbidden)
    point = {"x": ("0.5", "0.5"), "y": (0, 0)}
    kept, broken = (requirement("stay", halfspace(bound, x=1), 0, 6) for bound in (1, "0.25"))
    assert propose(still({"x": "x", "y": "y"}, kept, initial=point)) is None
    assert propose(still({"x": "x", "y": "y"}, broken, initial=point)) is not None


def test_trajectories_that_escape_stop_nothing() -> None:
    loop = still(
        {"x": "exp(3*x)", "y": "x"},
        requirement("stay", halfspace("1000", y=1), 0, 1),
        initial={"x": (-1, 1), "y": (0, 0)},
    )
    with np.errstate(all="ignore"):
        assert propose(loop) is None
