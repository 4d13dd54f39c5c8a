"""Taylor expansions: coefficients as flint's own power series have them, enclosures that contain closed forms."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, arb_series, ctx

from setrl.verify.checker.expressions import parse
from setrl.verify.checker.taylor import Program, ball, coefficients, compile_program, evaluate, solve

F = Fraction


def program(*texts: str, inputs: str = "x") -> Program:
    return compile_program([parse(text) for text in texts], inputs.split())


@pytest.mark.parametrize(
    "text",
    [
        "x*x - 3*x/7 + 2",
        "1/(2 + x)",
        "x**5 - x**-3",
        "exp(-x)",
        "log(3 + x)",
        "sqrt(2 + x*x)",
        "sin(2*x)",
        "cos(x)*x",
        "tan(x/3)",
        "tanh(x)",
        "x**0",
        "tanh(exp(-x**2)) + sqrt(3 + x)/log(2 + x)",
    ],
)
def test_coefficients_are_those_of_the_composed_series(text: str) -> None:
    """x' = f(x): f of the solution's series must be the series' derivative."""
    with ctx.workprec(256):
        found = [row[0] for row in coefficients(program(text), [arb(0.75)], [], 12)]
        ctx.cap = 12
        x = arb_series(found[:12], prec=12)
        namespace: dict[str, Any] = {
            **{name: (lambda s, name=name: getattr(s, name)()) for name in ("exp", "log", "sqrt", "sin", "cos", "tan")},
            "tanh": lambda s: 1 - 2 / ((2 * s).exp() + 1),
            "x": x,
        }
        expected = eval(text, {"__builtins__": {}}, namespace)  # noqa: S307 - the texts above
        for k in range(11):
            wanted = expected[k] if isinstance(expected, arb_series) else arb(expected if k == 0 else 0)
            assert ((k + 1) * found[k + 1]).overlaps(wanted), k
            assert abs((k + 1) * found[k + 1] - wanted) < arb(2) ** -200


CLOSED: dict[str, tuple[Program, list[F], Any]] = {
    "decay": (program("-x"), [F(3, 2)], lambda t: [arb(1.5) * (-t).exp()]),
    "logistic": (program("x*(1 - x)"), [F(1, 4)], lambda t: [1 / (1 + 3 * (-t).exp())]),
    "blow-up": (program("x**2"), [F(1, 4)], lambda t: [1 / (4 - t)]),
    "rotation": (program("y", "-x", inputs="x y"), [F(1), F(0)], lambda t: [t.cos(), -t.sin()]),
    "tangent": (program("1 + tan(y)*0 + x**2", "1", inputs="x y"), [F(0), F(0)], lambda t: [t.tan(), t]),
    "root": (program("sqrt(x)"), [F(1)], lambda t: [(1 + t / 2) ** 2]),
    "log": (program("exp(-x)"), [F(0)], lambda t: [(1 + t).log()]),
    "hyperbolic": (program("cos(x)*0 + 1/tanh(x)"), [F(1)], lambda t: [(arb(1).cosh() * t.exp()).acosh()]),
}


@pytest.mark.parametrize("name", CLOSED)
def test_closed_forms_are_enclosed_at_every_time(name: str) -> None:
    field, start, solution = CLOSED[name]
    for precision in (128, 256):
        with ctx.workprec(precision):
            found = solve(field, [ball(x) for x in start], [], F(5, 4))
            assert found is not None
            segments, final = found
            for segment in segments:
                for share in (F(0), F(1, 3), F(1)):
                    time = segment.start + share * segment.length
                    with ctx.workprec(512):
                        expected = solution(ball(time))
                    for ours, true in zip(segment.at(time), expected, strict=True):
                        assert ours.overlaps(true) and float(ours.rad()) < 2.0 ** (30 - precision)
                    whole = segment.over(segment.start, segment.start + segment.length)
                    assert all(wide.overlaps(true) for wide, true in zip(whole, expected, strict=True))
                    assert all(box.overlaps(true) for box, true in zip(segment.box, expected, strict=True))
            assert all(float(value.rad()) < 2.0 ** (30 - precision) for value in final)


def test_enclosures_shrink_with_the_precision() -> None:
    radii = []
    for precision in (128, 192, 256):
        with ctx.workprec(precision):
            found = solve(program("y - x**3", "-sin(x)", inputs="x y"), [arb(0.5), arb(-0.25)], [], F(2))
            assert found is not None
            radii.append(max(float(value.rad()) for value in found[1]))
    assert radii[0] < 1e-30 and radii[1] < radii[0] * 1e-15 and radii[2] < radii[1] * 1e-15


def test_a_solution_that_does_not_exist_is_not_enclosed() -> None:
    with ctx.workprec(128):
        assert solve(program("x**2"), [arb(1)], [], F(2)) is None  # blows up at 1
        assert solve(program("1/x"), [arb(0)], [], F(1)) is None
        assert solve(program("log(x)"), [arb(-1)], [], F(1)) is None
        assert solve(program("sqrt(x)"), [arb(0)], [], F(1)) is None  # not unique


def test_a_wide_start_encloses_every_thin_one() -> None:
    field = program("y + u", "-sin(x)*y", inputs="x y u")
    generator = np.random.default_rng(0)
    with ctx.workprec(128):
        wide = solve(field, [arb(0.5, 0.01), arb(-0.2, 0.01)], [arb(0.3)], F(1, 2))
        assert wide is not None
        for _ in range(10):
            start = [arb(0.5 + 0.01 * generator.uniform(-1, 1)), arb(-0.2 + 0.01 * generator.uniform(-1, 1))]
            thin = solve(field, start, [arb(0.3)], F(1, 2))
            assert thin is not None
            assert all(box.contains(value) for box, value in zip(wide[1], thin[1], strict=True))


def test_a_program_computes_equal_subexpressions_once() -> None:
    twice = program("sin(x)*sin(x) + sin(x)")
    assert sum(step[0] == "sin" for step in twice.steps) == 1
    with ctx.workprec(128):
        assert evaluate(twice, [arb(0.5)])[0].contains(arb(0.5).sin() ** 2 + arb(0.5).sin())


@pytest.mark.parametrize(
    ("text", "operations"),
    [
        ("x**2", ["square"]),
        ("x*x", ["square"]),
        ("x**3", ["square", "*"]),
        ("x**6", ["square", "*", "square"]),
        ("x**-2", ["square", "reciprocal"]),
        ("x/(2/3) - 0*1", ["constant", "*", "constant", "-"]),
        ("(1 - 1 + x)*(3/3)", []),
        ("log(x)**0*5", ["constant"]),
        ("2*3 + 4**-1", ["constant"]),
        ("tan(x)", ["sin", "cos", "reciprocal", "*"]),
        ("log(x) + 1/x", ["log", "reciprocal", "+"]),
        ("sqrt(x)", ["sqrt", "+", "reciprocal"]),
        ("tanh(x)", ["tanh", "constant", "square", "-"]),
    ],
)
def test_a_program_has_the_steps_that_have_recurrences_and_no_others(text: str, operations: list[str]) -> None:
    assert [step[0] for step in program(text).steps] == operations
    values = {"sqrt(x)": 1, "tanh(x)": 1, "tan(x)": 4, "log(x) + 1/x": 3}
    assert len(program(text).direct) == values.get(text, len(operations))


def test_a_program_names_its_inputs() -> None:
    with pytest.raises(KeyError):
        program("x + z")
    with pytest.raises(AssertionError):
        evaluate(program("x + y", inputs="x y"), [arb(1)])


def test_wide_balls_have_the_ranges_of_the_functions() -> None:
    with ctx.workprec(128):
        for text, start, low, high in (
            ("x**2", arb(0, 2), 0, 4),
            ("exp(x)", arb(0, 1), -1, 1),
            ("x**4", arb(0, 1), 0, 1),
        ):
            found = evaluate(program(text), [start])[0]
            ends = [arb(end).exp() if text == "exp(x)" else arb(end) for end in (low, high)]
            assert all(found.overlaps(end) for end in ends) and found.rad() < (ends[1] - ends[0]) / 2 * (1 + 1e-6)
