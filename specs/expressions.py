"""The expression language: its syntax tree, and what can be read off a tree exactly.

Numbers (exact decimals), names, ``+ - * /``, ``**`` with a constant integer exponent, and the functions
sin cos tan exp log sqrt tanh of one argument. `parse_expression` reads the text; nothing is ever evaluated by Python.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, TypeAlias

from .exact import decimal_text

FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")


@dataclass(frozen=True)
class Number:
    """An exact constant."""

    value: Fraction


@dataclass(frozen=True)
class Name:
    """A state, input, disturbance or parameter."""

    name: str


@dataclass(frozen=True)
class Binary:
    """``left operator right``."""

    operator: Literal["+", "-", "*", "/"]
    left: Expression
    right: Expression


@dataclass(frozen=True)
class Negate:
    """``-operand``."""

    operand: Expression


@dataclass(frozen=True)
class Power:
    """``base ** exponent`` with a constant integer exponent (may be negative)."""

    base: Expression
    exponent: int


@dataclass(frozen=True)
class Call:
    """``function(argument)``, function one of `FUNCTIONS`."""

    function: str
    argument: Expression


Expression: TypeAlias = Number | Name | Binary | Negate | Power | Call
AffineForm: TypeAlias = tuple[dict[str, Fraction], Fraction]


def parse_expression(text: str, names: Collection[str] | None = None) -> Expression:
    """Read the text of an expression.

    Parameters
    ----------
    text : str
        At most 4096 characters, nested at most 64 deep.
    names : collection of str, optional
        The names that may occur; None allows every identifier that is not a function.

    Returns
    -------
    Expression
        The tree as written: nothing is folded or reordered.

    Raises
    ------
    ExpressionError
        Naming the column, what was found and the remedy.
    """
    from .expression_parser import parse  # the parser needs the node classes of this file

    return parse(text, names)


def names_in(expression: Expression) -> tuple[str, ...]:
    """Names that occur in an expression, each once, in order of first occurrence."""
    found: dict[str, None] = {}
    _collect(expression, found)
    return tuple(found)


def _collect(expression: Expression, found: dict[str, None]) -> None:
    match expression:
        case Name(name):
            found.setdefault(name)
        case Binary(_, left, right):
            _collect(left, found)
            _collect(right, found)
        case Negate(operand) | Power(operand, _) | Call(_, operand):
            _collect(operand, found)


def affine_form(expression: Expression) -> AffineForm | None:
    """Write an expression as ``sum_i coefficients[name_i] * name_i + constant`` in exact rationals.

    Parameters
    ----------
    expression : Expression

    Returns
    -------
    (dict of name to Fraction, Fraction) or None
        Names with coefficient zero are left out. None where the expression is not such a form: it multiplies names
        with each other, divides by one (or by zero), raises one to a power, or calls a function, even of a constant
        (``sqrt(2)`` is no rational).
    """
    match expression:
        case Number(value):
            return {}, value
        case Name(name):
            return {name: Fraction(1)}, Fraction(0)
        case Negate(operand):
            form = affine_form(operand)
            return None if form is None else _scaled(form, Fraction(-1))
        case Power(base, exponent):
            form = affine_form(base)
            if form is None or exponent == 1:
                return form
            if exponent == 0:
                return {}, Fraction(1)
            coefficients, constant = form
            if coefficients or (constant == 0 and exponent < 0):
                return None
            return {}, constant**exponent
        case Binary(operator, left, right):
            first, second = affine_form(left), affine_form(right)
            if first is None or second is None:
                return None
            return _combined(operator, first, second)
        case Call():
            return None
    raise AssertionError(f"unknown node {expression!r}")


def _combined(operator: str, first: AffineForm, second: AffineForm) -> AffineForm | None:
    if operator in "+-":
        other = second if operator == "+" else _scaled(second, Fraction(-1))
        total = dict(first[0])
        for name, coefficient in other[0].items():
            total[name] = total.get(name, Fraction(0)) + coefficient
        return {name: value for name, value in total.items() if value}, first[1] + other[1]
    if operator == "*":
        if not second[0]:
            return _scaled(first, second[1])
        return _scaled(second, first[1]) if not first[0] else None
    if second[0] or second[1] == 0:
        return None
    return _scaled(first, 1 / second[1])


def _scaled(form: AffineForm, factor: Fraction) -> AffineForm:
    return {name: value * factor for name, value in form[0].items() if factor}, form[1] * factor


def evaluate_constant(expression: Expression) -> Fraction | None:
    """Exact value of an expression without names and functions; None for any other."""
    form = affine_form(expression)
    return form[1] if form is not None and not names_in(expression) else None


_SUM, _PRODUCT, _SIGN, _POWER, _ATOM = range(1, 6)


def format_expression(expression: Expression) -> str:
    """Write an expression with as few parentheses as the grammar allows.

    For every tree that `parse_expression` returns, ``parse_expression(format_expression(tree)) == tree``.
    """
    return _format(expression)[0]


def _format(expression: Expression) -> tuple[str, int]:
    """Text and binding strength of its outermost operation."""
    match expression:
        case Number(value):
            return (decimal_text(value), _ATOM) if value >= 0 else (f"-{decimal_text(-value)}", _SIGN)
        case Name(name):
            return name, _ATOM
        case Call(function, argument):
            return f"{function}({_format(argument)[0]})", _ATOM
        case Power(base, exponent):
            return f"{_wrapped(base, _ATOM)}**{exponent}", _POWER
        case Negate(operand):
            return f"-{_wrapped(operand, _SIGN)}", _SIGN
        case Binary(operator, left, right):
            strength = _SUM if operator in "+-" else _PRODUCT
            space = " " if strength == _SUM else ""
            text = f"{_wrapped(left, strength)}{space}{operator}{space}{_wrapped(right, strength + 1)}"
            return text, strength
    raise AssertionError(f"unknown node {expression!r}")


def _wrapped(expression: Expression, strength: int) -> str:
    text, own = _format(expression)
    return text if own >= strength else f"({text})"
