"""Two readers of the expression language that share nothing agree on every text."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from setrl.specs import expressions as specs
from setrl.specs.errors import ExpressionError
from setrl.specs.reader import read_plant
from setrl.verify.checker import expressions as checker

PLANTS = Path(__file__).resolve().parents[1] / "models" / "plants"
TEXTS = [
    "x",
    "-x**2",
    "(-x)**2",
    "2**-1*x",
    "x**(-2)",
    "x**+3",
    "x**2.0",
    "1 - 2 - 3",
    "1 - (2 - 3)",
    "8/4/2",
    "8/(4/2)",
    "-x*-y",
    "--x",
    "+x - +y",
    "2*sin(x)**2/-cos(y)",
    "1e-3*x + .5*y - 2.*z + 1E2",
    "tanh(exp(-x**2)) + sqrt(3 + x) - log(2 + y) + tan(x/4)",
    "((((x))))",
    "\tx\n + 1 ",
    "m*g/2*(1 + a1/2)",
    "sin(x)*(cos(y)+1)",
]
WRONG = [
    "",
    "x +",
    "* x",
    "x y",
    "2x",
    "0x1",
    "x.y",
    "x**y",
    "x**0.5",
    "x**2**3",
    "x**65",
    "sin",
    "sin x",
    "sin()",
    "sin(x, y)",
    "foo(x)",
    "x^2",
    "x // 2",
    "(x",
    "x)",
    "()",
    "01",
    "1_0",
    "1e",
    "1e999",
    "x < 1",
    "x = 1",
    "'x'",
    "x[0]",
    "x if y else z",
    "(((x**64)**64)**64)**64",
    "+".join(["x"] * 200),
    "(" * 200 + "x" + ")" * 200,
    "-" * 300 + "x",
    "x" * 5000,
    "ä",
]


def same(tree: Any) -> Any:
    """A tree of `specs` as the checker's."""
    match tree:
        case specs.Number(value):
            return checker.Number(value)
        case specs.Name(name):
            return checker.Name(name)
        case specs.Binary(operator, left, right):
            return checker.Operation(operator, (same(left), same(right)))
        case specs.Negate(operand):
            return checker.Operation("neg", (same(operand),))
        case specs.Power(base, exponent):
            return checker.Power(same(base), exponent)
        case specs.Call(function, argument):
            return checker.Operation(function, (same(argument),))
    raise AssertionError(tree)


@pytest.mark.parametrize("text", TEXTS)
def test_both_readers_read_the_same_tree(text: str) -> None:
    assert checker.parse(text) == same(specs.parse_expression(text))


@pytest.mark.parametrize("text", WRONG)
def test_both_readers_refuse_the_same_texts(text: str) -> None:
    for parse in (checker.parse, specs.parse_expression):
        with pytest.raises(ExpressionError):
            parse(text)


def test_both_readers_agree_on_every_shipped_plant() -> None:
    for path in PLANTS.glob("*.yaml"):
        for tree in read_plant(path).dynamics.values():
            assert checker.parse(specs.format_expression(tree)) == same(tree)


LEAVES = st.sampled_from(["x", "y", "2", "0.5", "1e-3", "velocity"])
TREES = st.recursive(
    LEAVES,
    lambda inner: st.one_of(
        st.tuples(inner, st.sampled_from(["+", "-", "*", "/", " - "]), inner).map("".join),
        inner.map(lambda text: f"({text})"),
        inner.map(lambda text: f"-{text}"),
        inner.map(lambda text: f"sin({text})"),
        inner.map(lambda text: f"({text})**2"),
    ),
    max_leaves=12,
)


@given(TREES)
def test_both_readers_agree_on_random_texts(text: str) -> None:
    try:
        expected = specs.parse_expression(text)
    except ExpressionError:
        return  # divisions by a constant zero: the checker finds those where it evaluates
    assert checker.parse(text) == same(expected)


@given(st.text(alphabet="xy12.e()+-*/ sin", max_size=12))
def test_the_checker_accepts_no_text_that_specs_refuses(text: str) -> None:
    try:
        tree = checker.parse(text)
    except ExpressionError:
        return
    try:
        expected = specs.parse_expression(text)
    except ExpressionError as error:
        assert "zero" in str(error)
        return
    assert tree == same(expected)


def test_affine_forms_agree() -> None:
    for text in ("x - 3*y + 2/4", "-(x + y)*2", "x/3 - x/3 + 1", "2**-2*x", "(1 + 1)*(x - 1)"):
        ours, theirs = checker.affine(checker.parse(text)), specs.affine_form(specs.parse_expression(text))
        assert theirs is not None
        assert {name: value for name, value in ours[0].items() if value} == theirs[0] and ours[1] == theirs[1]
    for text in ("x*y", "sin(x)", "1/x", "x**2", "sqrt(4)"):
        with pytest.raises(ExpressionError):
            checker.affine(checker.parse(text))
    assert checker.constant("1/3 - 2") == Fraction(-5, 3)


@pytest.mark.parametrize("text", ["in", "x + if", "lambda"])
def test_reserved_words_are_no_names(text: str) -> None:
    for parse in (checker.parse, specs.parse_expression):
        with pytest.raises(ExpressionError):
            parse(text)
