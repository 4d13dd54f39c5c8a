"""Jets of tapes and of flows enclose derivatives that are computed independently, with 300 bits.

The oracle: flint's power series in time, Picard's recurrence on them, and difference quotients with a step of 2^-60 in
the start values. Nothing of it is shared with the engine.
"""

from __future__ import annotations

from itertools import combinations_with_replacement
from typing import Any

import cases
import numpy as np
import pytest
from flint import arb, arb_series, ctx
from loops import plant_of

from setrl.models.float_algebra import FloatAlgebra
from setrl.models.plant import compile_plant
from setrl.models.tape import Tape, run
from setrl.verify import balls, picard
from setrl.verify.balls import Ball
from setrl.verify.series import flow_jets, map_jets


@pytest.fixture(autouse=True)
def precise() -> Any:
    before = ctx.prec, ctx.cap
    ctx.prec, ctx.cap = 300, 12
    yield
    ctx.prec, ctx.cap = before


class SeriesAlgebra:
    """Univariate power series of flint, an implementation that shares nothing with the engine."""

    def constant(self, value: Any) -> Any:
        return arb_series([arb(value.numerator) / arb(value.denominator)])

    def add(self, a: Any, b: Any) -> Any:
        return a + b

    def subtract(self, a: Any, b: Any) -> Any:
        return a - b

    def multiply(self, a: Any, b: Any) -> Any:
        return a * b

    def divide(self, a: Any, b: Any) -> Any:
        return a / b

    def negate(self, a: Any) -> Any:
        return -a

    def square(self, a: Any) -> Any:
        return a * a

    def sincos(self, a: Any) -> Any:
        return a.sin(), a.cos()

    def exp(self, a: Any) -> Any:
        return a.exp()

    def log(self, a: Any) -> Any:
        return a.log()

    def sqrt(self, a: Any) -> Any:
        return a.sqrt()

    def tanh(self, a: Any) -> Any:
        e = (a + a).exp()
        return (e - 1) / (e + 1)


def coefficient(series: Any, k: int) -> Any:
    return series[k] if k < len(series) else arb(0)


def taylor(tape: Tape, point: list[Any], terms: int) -> list[list[Any]]:
    """Time-Taylor coefficients of the flow from a point of 300-bit balls, (terms, states)."""
    states = len(tape.outputs)
    path = [[x] for x in point[:states]]
    for k in range(1, terms):
        ctx.cap = k
        inputs = [arb_series(list(p)) for p in path] + [arb_series([x]) for x in point[states:]]
        rates = run(tape, SeriesAlgebra(), inputs)
        for i in range(states):
            path[i].append(coefficient(rates[i], k - 1) / k)
    return [[path[i][k] for i in range(states)] for k in range(terms)]


def derivatives(function: Any, point: list[Any], order: int) -> dict[tuple[int, ...], list[Any]]:
    """Values, gradients and Hessians by central differences with a step of 2^-60 at 300 bits."""
    step = arb(2) ** -60
    count = len(point)

    def at(*moves: tuple[int, int]) -> list[Any]:
        moved = list(point)
        for i, sign in moves:
            moved[i] = moved[i] + sign * step
        return function(moved)

    center = at()
    found: dict[tuple[int, ...], list[Any]] = {(): center}
    if order >= 1:
        for i in range(count):
            found[i,] = [(p - m) / (2 * step) for p, m in zip(at((i, 1)), at((i, -1)), strict=True)]
    if order == 2:
        for i, j in combinations_with_replacement(range(count), 2):
            corners = [at((i, s), (j, t)) for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
            found[i, j] = [(a - b - c + d) / (4 * step * step) for a, b, c, d in zip(*corners, strict=True)]
    return found


def jet_entries(count: int, order: int) -> list[tuple[int, ...]]:
    entries: list[tuple[int, ...]] = [()]
    if order >= 1:
        entries += [(i,) for i in range(count)]
    if order == 2:
        entries += list(combinations_with_replacement(range(count), 2))
    return entries


def assert_encloses(mid: float, rad: float, truth: Any, what: Any, tight: float | None = None) -> None:
    # the difference quotient is itself off by about 2^-120
    slack = arb(2) ** -90 * (1 + abs(truth))
    assert abs(truth - arb(mid)) <= arb(rad) + slack, what
    if tight is not None:
        assert rad <= tight * (1 + abs(mid)), (what, rad)


FUNCTIONS = compile_plant(
    plant_of(
        {
            "a": "sin(x)*cos(y) + tan(x/3)",
            "b": "exp(-x*y)/(1 + x**2)",
            "c": "log(2 + x) - sqrt(3 + y)*u",
            "x": "tanh(x + 2*y)**3 - u**2",
            "y": "(x - y)**-2 + x**5",
            "u": "x/7 - 0.1 + u",
        },
        inputs="",
    )
).tape
TAPES: dict[str, Tape] = {**{name: plant.tape for name, plant in cases.PLANTS.items()}, "functions": FUNCTIONS}
CENTERS = {**cases.CENTERS, "functions": [0.1, 0.2, 0.3, 0.4, -0.7, 0.3]}


@pytest.mark.parametrize("name", TAPES)
def test_jets_of_a_map_enclose_value_gradient_and_hessian(name: str) -> None:
    tape, point = TAPES[name], CENTERS[name]
    center = [arb(x) for x in point]

    def function(values: list[Any]) -> list[Any]:
        ctx.cap = 1
        return [coefficient(s, 0) for s in run(tape, SeriesAlgebra(), [arb_series([v]) for v in values])]

    truth = derivatives(function, center, 2)
    for order in (0, 1, 2):
        jets = map_jets(tape, balls.exact(np.array([point])), order)
        for position, entry in enumerate(jet_entries(len(point), order)):
            for output in range(len(tape.outputs)):
                mid, rad = jets.mid[output, 0, position], jets.rad[output, 0, position]
                assert_encloses(mid, rad, truth[entry][output], (name, entry, output), 1e-12)


@pytest.mark.parametrize("name", TAPES)
def test_jets_of_a_flow_enclose_taylor_coefficients_and_their_derivatives(name: str) -> None:
    tape, point, terms = TAPES[name], CENTERS[name], 6

    def function(values: list[Any]) -> list[Any]:
        return [x for row in taylor(tape, values, terms) for x in row]

    order = 2 if len(point) <= 6 else 1
    truth = derivatives(function, [arb(x) for x in point], order)
    states = len(tape.outputs)
    for wanted in range(order + 1):
        jets = flow_jets(tape, balls.exact(np.array([point])), wanted, terms)
        for position, entry in enumerate(jet_entries(len(point), wanted)):
            for k in range(terms):
                for i in range(states):
                    mid, rad = jets.mid[k, i, 0, position], jets.rad[k, i, 0, position]
                    assert_encloses(mid, rad, truth[entry][k * states + i], (name, entry, k, i), 1e-9)


@pytest.mark.parametrize("name", TAPES)
def test_jets_over_a_box_enclose_those_at_its_points(name: str) -> None:
    tape, point, terms = TAPES[name], np.array(CENTERS[name]), 5
    generator = np.random.default_rng(3)
    for size in (1e-6, 1e-2, 0.1):
        box = Ball(point[None], np.full((1, point.size), size))
        for order in (0, 1, 2):
            wide, flat = flow_jets(tape, box, order, terms), map_jets(tape, box, order)
            inside = generator.uniform(-1, 1, size=(30, point.size)) * size
            inside[:10] = np.sign(inside[:10]) * size
            thin = flow_jets(tape, balls.exact(point + inside), order, terms)
            value = map_jets(tape, balls.exact(point + inside), order)
            for whole, single in ((wide, thin), (flat, value)):
                distance = np.abs(single.mid - whole.mid)
                slack = 1e-9 * (1 + np.abs(single.mid)) + single.rad
                assert not (distance > whole.rad + slack).any()
                assert np.isfinite(whole.rad).all()


@pytest.mark.parametrize("name", TAPES)
def test_jets_by_some_variables_are_a_part_of_those_by_all(name: str) -> None:
    tape, point = TAPES[name], np.array([CENTERS[name]])
    some = np.arange(0, point.shape[1], 2)
    box = Ball(point, np.full_like(point, 0.01))
    part, whole = flow_jets(tape, box, 2, 4, some), flow_jets(tape, box, 2, 4)
    entries = jet_entries(point.shape[1], 2)
    chosen = [i for i, entry in enumerate(entries) if set(entry) <= set(some.tolist())]
    np.testing.assert_allclose(part.mid, whole.mid[..., chosen], rtol=1e-9, atol=1e-12)
    np.testing.assert_allclose(part.rad, whole.rad[..., chosen], rtol=1e-6, atol=1e-12)


@pytest.mark.parametrize("name", TAPES)
def test_the_interval_evaluation_of_a_tape_encloses_its_values(name: str) -> None:
    tape, point = TAPES[name], np.array(CENTERS[name])
    generator = np.random.default_rng(6)
    for size in (0.0, 1e-3, 0.15):
        bounds = picard.derivative_bounds(tape, Ball(point[None], np.full((1, point.size), size)))
        inside = point + size * generator.uniform(-1, 1, size=(300, point.size))
        values = np.stack([np.broadcast_to(v, 300) for v in run(tape, FloatAlgebra(), list(inside.T))], 1)
        slack = 1e-13 * (1 + np.abs(values))
        assert (values >= bounds.lower - slack).all() and (values <= bounds.upper + slack).all()


def test_the_a_priori_box_contains_trajectories_and_refuses_what_escapes() -> None:
    from laws import true_flow

    for name, tape in TAPES.items():
        if name == "functions":
            continue
        point = np.array([CENTERS[name]])
        box = Ball(point, np.full_like(point, 0.02))
        step = balls.rational(cases.F(1, 20))
        found, proved = picard.a_priori_enclosure(tape, box, step)
        assert proved.all()
        corners = point + 0.02 * np.sign(np.random.default_rng(1).normal(size=(40, point.shape[1])))
        path = true_flow(tape, corners, np.linspace(0.005, 0.05, 10))
        states = len(tape.outputs)
        assert (path >= found.lower[0, :states] - 1e-11).all() and (path <= found.upper[0, :states] + 1e-11).all()
    escape = compile_plant(plant_of({"x": "x**2"}, inputs="")).tape
    with np.errstate(all="ignore"):
        _, proved = picard.a_priori_enclosure(
            escape, Ball(np.array([[4.0]]), np.array([[0.1]])), balls.rational(cases.F(1, 2))
        )
    assert not proved.any()
