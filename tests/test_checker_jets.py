"""The checker's jets enclose derivatives that are computed independently, and are no wider than the engine's.

The oracle: flint's power series in time at 300 bits, Picard's recurrence on them, and difference quotients in the start
values. It shares the reader of expressions with the checker, and nothing with the engine.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import combinations_with_replacement, pairwise
from typing import Any

import cases
import numpy as np
import pytest
from flint import arb, arb_series, ctx
from loops import plant_of

from setrl.models.plant import compile_plant, load_plant
from setrl.models.tape import Tape
from setrl.verify import series
from setrl.verify.balls import Ball
from setrl.verify.checker import ranges
from setrl.verify.checker.contract import PLANTS as FOLDER
from setrl.verify.checker.contract import read_plant
from setrl.verify.checker.documents import load
from setrl.verify.checker.expressions import Name, Number, Power, parse
from setrl.verify.checker.jets import flow_jets, map_jets, used_inputs
from setrl.verify.checker.program import Program, ball, compile_program
from setrl.verify.plan import plan_of

SIZES = (0.0, 1e-15, 1e-12, 1e-7, 1e-3, 0.05, 0.3)


@dataclass(frozen=True)
class Subject:
    """One vector field, as both islands compile it."""

    trees: tuple[Any, ...]
    program: Program
    tape: Tape
    center: list[float]


def of_texts(texts: dict[str, str], center: list[float], inputs: str = "u", disturbances: str = "") -> Subject:
    trees = tuple(parse(text) for text in texts.values())
    program = compile_program(trees, [*texts, *inputs.split(), *disturbances.split()])
    return Subject(trees, program, compile_plant(plant_of(texts, inputs, disturbances)).tape, center)


def shipped(name: str) -> Subject:
    plant = read_plant(load((FOLDER / f"{name}.yaml").read_bytes()))
    program = compile_program(plant.dynamics, (*plant.states, *plant.inputs, *plant.disturbances))
    return Subject(plant.dynamics, program, load_plant(name).tape, cases.CENTERS[name])


SUBJECTS = {
    **{name: shipped(name) for name in ("navigation", "pendulum", "quadrotor1d", "quadrotor2d", "unicycle")},
    "everything": of_texts(
        {
            "x": "tanh(y) - x/(2 + sin(x)) + u",
            "y": "exp(-x**2)*cos(y) + sqrt(3 + x) - log(2 + y) + tan(x/4) - d*y**3",
        },
        [0.4, 0.3, -0.2, 0.1],
        disturbances="d",
    ),
    "functions": of_texts(
        {
            "a": "sin(x)*cos(y) + tan(x/3)",
            "b": "exp(-x*y)/(1 + x**2)",
            "x": "tanh(x + 2*y)**3 - u**2 + b*b",
            "y": "(x - y)**-2 + x**5 - u + sqrt(2 + x*u)*log(3 + a)",
        },
        [0.1, 0.2, -0.3, 0.6, 0.4],
    ),
}


def random_text(generator: np.random.Generator, depth: int) -> str:
    """An expression over x, y, u, d whose functions are defined near most points, and never of a constant."""
    if depth == 0:
        return str(generator.choice(["x", "y", "u", "d", "x", "y", "2", "0.3", "1"]))

    def part() -> str:
        return random_text(generator, depth - 1 if generator.random() < 0.8 else 0)

    power = generator.integers(1, 6)
    forms = [
        lambda: f"({part()} + {part()})",
        lambda: f"({part()} - {part()})",
        lambda: f"{part()}*{part()}",
        lambda: f"({part()})/(2 + x/9 + {part()})",
        lambda: f"-({part()})",
        lambda: f"({part()})**{power}",
        lambda: f"(3 + y/9 + {part()})**-{power}",
        lambda: f"sin({part()})",
        lambda: f"cos({part()})",
        lambda: f"tan(({part()})/4)",
        lambda: f"exp(-({part()})/3)",
        lambda: f"log(3 + x/9 + {part()})",
        lambda: f"sqrt(2 + y/9 + {part()})",
        lambda: f"tanh({part()})",
    ]
    return forms[generator.integers(len(forms))]()


def random_subject(seed: int) -> Subject:
    generator = np.random.default_rng(seed)
    texts = {name: random_text(generator, int(generator.integers(1, 5))) for name in "xy"}
    return of_texts(texts, generator.uniform(-1, 1, 4).tolist(), disturbances="d")


def every(jets: Any) -> list[Any]:
    """All numbers of nested lists."""
    return [x for part in jets for x in every(part)] if isinstance(jets, list) else [jets]


# What both islands compute ------------------------------------------------------------------------


@pytest.mark.parametrize("name", SUBJECTS)
def test_no_ball_is_wider_than_the_engines(name: str) -> None:
    for seed, size in enumerate(SIZES):
        for order in (0, 1, 2):
            compare(SUBJECTS[name], size, order, 5, np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(60))
def test_no_ball_of_a_random_field_is_wider_than_the_engines(seed: int) -> None:
    subject, generator = random_subject(seed), np.random.default_rng(1000 + seed)
    assert used_inputs(subject.program) == tuple(plan_of(subject.tape).used.tolist())
    for size in SIZES:
        compare(subject, size, int(generator.integers(0, 3)), int(generator.integers(2, 6)), generator)


def compare(subject: Subject, size: float, order: int, terms: int, generator: np.random.Generator) -> None:
    """Whether our balls meet the engine's and have no larger radius.

    Radii of flint have 30 bits, and are rounded upwards in every operation: 2^-16 is a generous bound of what that adds
    up to. The 1e-14 is the engine's own rounding, which may be smaller or larger than ours.
    """
    count = len(subject.center)
    radii = size * generator.uniform(0, 1, count)
    variables = sorted(generator.choice(count, int(generator.integers(1, count + 1)), replace=False).tolist())
    point = Ball(np.array([subject.center]), radii[None])
    with np.errstate(all="ignore"):
        flow = series.flow_jets(subject.tape, point, order, terms, np.array(variables))
        single = series.map_jets(subject.tape, point, order, np.array(variables))
    with ctx.workprec(64):
        box = [arb(m, r) for m, r in zip(subject.center, radii, strict=True)]
        ours = [flow_jets(subject.program, box, order, terms, variables)]
        ours += [map_jets(subject.program, box, order, variables)]
        for theirs, jets in zip((flow, single), ours, strict=True):
            numbers = every(jets)
            bounded = np.isfinite(theirs.rad).all()
            assert len(numbers) == theirs.mid.size
            for x, mid, rad in zip(numbers, theirs.mid.ravel(), theirs.rad.ravel(), strict=True):
                if not x.is_finite():
                    assert not bounded
                elif np.isfinite(rad):
                    assert x.overlaps(arb(mid, rad))
                    assert float(x.rad()) <= (1 + 2.0**-16) * rad + 1e-14 * (abs(mid) + rad)


@pytest.mark.parametrize("name", SUBJECTS)
def test_the_inputs_that_are_read_are_those_of_the_engine(name: str) -> None:
    subject = SUBJECTS[name]
    assert used_inputs(subject.program) == tuple(plan_of(subject.tape).used.tolist())


def test_an_input_counts_as_read_where_a_step_or_an_output_reads_it() -> None:
    texts = {"x": "y", "y": "(1 + z)**0 + 0*u + log(3)", "z": "x*0 + 2*3"}
    subject = of_texts(texts, [0.0] * 4)
    assert used_inputs(subject.program) == tuple(plan_of(subject.tape).used.tolist()) == (0, 1, 3)


# Derivatives --------------------------------------------------------------------------------------


def series_of(tree: Any, names: dict[str, Any]) -> Any:
    """An expression over flint's power series."""
    match tree:
        case Number(value):
            return arb_series([ball(value)])
        case Name(name):
            return names[name]
        case Power(base, exponent):
            product = arb_series([1])
            for _ in range(abs(exponent)):
                product = product * series_of(base, names)
            return product if exponent >= 0 else arb_series([1]) / product
    operands = [series_of(operand, names) for operand in tree.operands]
    if tree.operator == "tanh":
        e = (2 * operands[0]).exp()
        return (e - 1) / (e + 1)
    binary: dict[str, Callable[..., Any]] = {
        "+": lambda a, b: a + b,
        "-": lambda a, b: a - b,
        "*": lambda a, b: a * b,
        "/": lambda a, b: a / b,
        "neg": lambda a: -a,
    }
    return binary[tree.operator](*operands) if tree.operator in binary else getattr(operands[0], tree.operator)()


def coefficient(power_series: Any, k: int) -> Any:
    return power_series[k] if k < len(power_series) else arb(0)


def taylor(subject: Subject, point: list[Any], terms: int) -> list[Any]:
    """Time-Taylor coefficients of the flow, (terms, states) in one list."""
    states = len(subject.trees)
    path = [[x] for x in point]
    before = ctx.cap
    for k in range(1, terms):
        ctx.cap = k
        names = {name: arb_series(p) for name, p in zip(subject.program.inputs, path, strict=True)}
        rates = [series_of(tree, names) for tree in subject.trees]
        for i in range(states):
            path[i].append(coefficient(rates[i], k - 1) / k)
    ctx.cap = before
    return [path[i][k] for k in range(terms) for i in range(states)]


def derivatives(function: Any, point: list[Any], variables: list[int]) -> list[list[Any]]:
    """Values, gradients and Hessians by central differences with a step of 2^-60: one row per entry of a jet."""
    step = arb(2) ** -60

    def at(*moves: tuple[int, int]) -> list[Any]:
        moved = list(point)
        for i, sign in moves:
            moved[i] = moved[i] + sign * step
        return function(moved)

    rows = [at()]
    for i in variables:
        rows.append([(p - m) / (2 * step) for p, m in zip(at((i, 1)), at((i, -1)), strict=True)])
    for i, j in combinations_with_replacement(variables, 2):
        corners = [at((i, s), (j, t)) for s, t in ((1, 1), (1, -1), (-1, 1), (-1, -1))]
        rows.append([(a - b - c + d) / (4 * step * step) for a, b, c, d in zip(*corners, strict=True)])
    return rows


@pytest.mark.parametrize("name", SUBJECTS)
def test_jets_of_a_flow_are_the_taylor_coefficients_and_their_derivatives(name: str) -> None:
    subject, terms = SUBJECTS[name], 5
    variables = list(range(len(subject.center)))[:5]
    with ctx.workprec(300):
        point = [arb(x) for x in subject.center]
        rows = derivatives(lambda values: taylor(subject, values, terms), point, variables)
        for order, size in ((0, 1), (1, 1 + len(variables)), (2, len(rows))):
            found = [jet for jets in flow_jets(subject.program, point, order, terms, variables) for jet in jets]
            field = map_jets(subject.program, point, order, variables)
            for number, jet in enumerate(found):
                assert len(jet) == size
                for row, entry in zip(rows[:size], jet, strict=True):
                    # a difference quotient is itself off by about 2^-120
                    assert abs(entry - row[number]) < arb(2) ** -90 * (1 + abs(row[number]))
                    assert entry.rad() < arb(2) ** -250 * (1 + abs(entry))
            states = len(subject.trees)
            assert all(x.overlaps(y) for x, y in zip(every(field), every(found[states : 2 * states]), strict=True))


@pytest.mark.parametrize("name", SUBJECTS)
def test_jets_over_a_box_enclose_those_at_its_points(name: str) -> None:
    subject, generator = SUBJECTS[name], np.random.default_rng(3)
    center, variables = np.array(subject.center), range(len(subject.center))
    for size in (1e-12, 1e-6, 1e-2, 0.15):
        with ctx.workprec(64):
            box = [arb(x, size) for x in subject.center]
            wide = every(flow_jets(subject.program, box, 2, 5, variables))
            flat = every(map_jets(subject.program, box, 2, variables))
            assert all(x.is_finite() for x in [*wide, *flat])
        inside = generator.uniform(-1, 1, size=(8, center.size)) * size
        inside[:4] = np.sign(inside[:4]) * size * (1 - 1e-3)
        for moved in center + inside:
            with ctx.workprec(300):
                point = [arb(x) for x in moved]
                thin = every(flow_jets(subject.program, point, 2, 5, variables))
                single = every(map_jets(subject.program, point, 2, variables))
            assert all(x.contains(y) or (x - y).is_zero() for x, y in zip(wide, thin, strict=True))
            assert all(x.contains(y) or (x - y).is_zero() for x, y in zip(flat, single, strict=True))


def test_what_does_not_depend_on_a_variable_has_an_exact_zero() -> None:
    program = SUBJECTS["unicycle"].program
    box = [arb(x, 0.1) for x in SUBJECTS["unicycle"].center]
    x, _, speed, _ = flow_jets(program, box, 2, 4, (0, 2, 5))[1]  # x' = v cos(theta), v' = a
    assert [entry.is_zero() for entry in x] == [False, True, False, True, *[True] * 6]
    assert [entry.is_zero() for entry in speed] == [False, *[True] * 9]
    assert all(entry.is_zero() for entry in flow_jets(program, box, 2, 4, (0, 2, 5))[3][2])


def test_jets_by_some_variables_are_a_part_of_those_by_all() -> None:
    subject = SUBJECTS["functions"]
    box = [arb(x, 0.01) for x in subject.center]
    whole = flow_jets(subject.program, box, 2, 4, range(5))
    part = flow_jets(subject.program, box, 2, 4, (3, 1))
    # entries of the whole: value, 5 of the gradient, Hessian rows from 6, 11, 15, 18, 20
    for jets, others in zip(whole, part, strict=True):
        for jet, other in zip(jets, others, strict=True):
            chosen = [jet[i] for i in (0, 4, 2, 18, 13, 11)]
            for a, b in zip(chosen, other, strict=True):
                assert a.overlaps(b) and abs(a.rad() - b.rad()) <= 1e-6 * a.rad()


# Where nothing is defined ---------------------------------------------------------------------------


@pytest.mark.parametrize("order", [0, 1, 2])
@pytest.mark.parametrize(
    ("text", "point"),
    [
        ("log(x)", arb(0.1, 0.2)),
        ("log(x)", arb(-1)),
        ("log(x)", arb(1, 1)),
        ("1/x", arb(0)),
        ("1/x", arb(0.1, 0.2)),
        ("x**-2", arb(-0.1, 0.2)),
        ("sqrt(x)", arb(0.1, 0.2)),
        ("sqrt(x)", arb(-1)),
        ("tan(x)", arb(1.5, 0.2)),
        ("tanh(log(x))", arb(0.1, 0.2)),
        ("sin(1/x)", arb(0.1, 0.2)),
        ("0*log(x) + 1", arb(-1, 0.1)),
        ("1/(1 + 1/x)", arb(0, 0.1)),
        ("exp(exp(exp(exp(exp(x)))))", arb(9)),
        ("tanh(x)", arb("inf")),
        ("1/(x*x)", arb("inf")),
        ("sin(x)", arb(0, float("inf"))),
        ("cos(x) + log(2)", arb.nan()),
    ],
)
def test_what_is_not_defined_on_the_whole_ball_is_not_finite(text: str, point: Any, order: int) -> None:
    # as the field of the state it depends on, and of one that only sees it as a parameter
    own = compile_program([parse(text)], ["x"])
    other = compile_program([parse(text), parse("2*y")], ["z", "y", "x"])
    with ctx.workprec(64):
        assert not map_jets(own, [point], order, [0])[0][0].is_finite()
        for row in flow_jets(own, [point], order, 4, [0])[1:]:
            assert not row[0][0].is_finite()
        assert all(not x.is_finite() for x in every(flow_jets(other, [arb(0), arb(1), point], order, 4, [0, 2])))


def test_a_root_of_zero_has_a_value_and_no_slope() -> None:
    root = compile_program([parse("sqrt(x)")], ["x"])
    with ctx.workprec(64):
        assert map_jets(root, [arb(0)], 0, ())[0][0].is_zero()
        value, slope, bend = map_jets(root, [arb(0)], 2, [0])[0]
        assert value.is_zero() and not slope.is_finite() and not bend.is_finite()
        assert not flow_jets(root, [arb(0)], 0, 3, ())[2][0][0].is_finite()


# Ranges -----------------------------------------------------------------------------------------------

RANGES: dict[str, tuple[Callable[[Any], Any], Callable[[Any], Any], bool]] = {
    "square": (ranges.square, lambda x: x * x, False),
    "exp": (ranges.exp, lambda x: x.exp(), False),
    "tanh": (ranges.tanh, lambda x: x.tanh(), False),
    "log": (ranges.log, lambda x: x.log(), True),
    "sqrt": (ranges.sqrt, lambda x: x.sqrt(), True),
    "reciprocal": (ranges.reciprocal, lambda x: 1 / x, True),
    "reciprocal of negatives": (lambda x: ranges.reciprocal(-x), lambda x: -1 / x, True),
    "sin": (lambda x: ranges.sincos(x)[0], lambda x: x.sin(), False),
    "cos": (lambda x: ranges.sincos(x)[1], lambda x: x.cos(), False),
}


@pytest.mark.parametrize("precision", [53, 64, 160])
@pytest.mark.parametrize("name", RANGES)
def test_ranges_enclose_every_value_and_are_tight(name: str, precision: int) -> None:
    enclosure, function, positive = RANGES[name]
    generator = np.random.default_rng(5)
    tight = 0
    for number in range(300):
        mid = generator.normal() * 10.0 ** generator.uniform(-6, 1.3)
        if name in ("sin", "cos") and number % 3 == 0:
            mid = np.pi / 2 * number / 3  # where one of them turns
        rad = 10.0 ** generator.uniform(-17, 0.5)
        if positive:
            mid = abs(mid)
            rad = min(rad, mid * (1 - 10.0 ** generator.uniform(-3, -0.1)))
        with ctx.workprec(precision):
            found = enclosure(arb(mid, rad))
        with ctx.workprec(300):
            values = [function(arb(mid) + arb(rad) * k / 8) for k in range(-8, 9)]
            assert all(found.contains(value) for value in values)
            steps = [b - a for a, b in pairwise(values)]
            turns = any(step * steps[0] < abs(steps[0]) * max(map(abs, steps), key=float) / 10 for step in steps)
            if not turns:  # also not between the last two samples
                size = 1 if name in ("sin", "cos") else abs(found)
                spread = abs(values[-1] - values[0]) / 2
                assert found.rad() < spread * 1.0001 + arb(2) ** (4 - min(precision, 50)) * size
                tight += 1
    assert tight > 100
