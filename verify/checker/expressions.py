"""The expression language, read by recursive descent: ``+ - * /``, whole powers, and functions of one argument.

`specs` reads the same language through Python's own parser; two readers that share nothing must agree on what a file
says.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from keyword import iskeyword
from typing import NoReturn, TypeAlias

from ...specs.errors import ExpressionError

FUNCTIONS = ("sin", "cos", "tan", "exp", "log", "sqrt", "tanh")
MAX_LENGTH, MAX_DEPTH, MAX_POWER, MAX_SIZE, MAX_EXPONENT = 4096, 64, 64, 1024, 300

_TOKEN = re.compile(
    r"[ \t\r\n]*(?:(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]{1,3})?)(?![0-9A-Za-z_.])"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*)|(?P<sign>\*\*|[-+*/()]))"
)


@dataclass(frozen=True)
class Number:
    """An exact constant."""

    value: Fraction


@dataclass(frozen=True)
class Name:
    """A state, input, disturbance or parameter."""

    name: str


@dataclass(frozen=True)
class Operation:
    """``+ - * /`` of two operands, ``neg`` of one, or a function of one."""

    operator: str
    operands: tuple[Expression, ...]


@dataclass(frozen=True)
class Power:
    """``base ** exponent``, the exponent a constant whole number."""

    base: Expression
    exponent: int


Expression: TypeAlias = Number | Name | Operation | Power
Affine: TypeAlias = tuple[dict[str, Fraction], Fraction]


def parse(text: str) -> Expression:
    """Read an expression; `ExpressionError` for anything that is not wholly in the language."""
    if len(text) > MAX_LENGTH:
        raise ExpressionError(f"an expression of {len(text)} characters, more than {MAX_LENGTH}")
    parser = _Parser(_tokens(text), text)
    tree = parser.sum(0)
    if parser.kind:
        parser.fail()
    if size(tree) > MAX_SIZE:
        raise ExpressionError(f"the powers in {text[:60]!r} multiply out to too many factors")
    return tree


def _tokens(text: str) -> list[tuple[str, str]]:
    found, position, end = [], 0, len(text.rstrip(" \t\r\n"))
    while position < end:
        match = _TOKEN.match(text, position)
        if match is None:
            raise ExpressionError(f"column {position + 1} of {text[:60]!r} is not in the language")
        found.append((str(match.lastgroup), match.group(str(match.lastgroup))))
        position = match.end()
    return [*found, ("", "")]


class _Parser:
    def __init__(self, tokens: list[tuple[str, str]], source: str) -> None:
        self.tokens, self.source, self.position = tokens, source, 0
        self.depths: dict[int, int] = {}
        self.nodes: list[Expression] = []

    @property
    def kind(self) -> str:
        return self.tokens[self.position][0]

    @property
    def text(self) -> str:
        return self.tokens[self.position][1]

    def fail(self) -> NoReturn:
        raise ExpressionError(f"unexpected {self.text or 'end'!r} in {self.source[:60]!r}")

    def take(self) -> str:
        self.position += 1
        return self.tokens[self.position - 1][1]

    def expect(self, text: str) -> None:
        if self.text != text:
            self.fail()
        self.take()

    def node(self, tree: Expression) -> Expression:
        """The tree, unless it is nested too deep; long sums nest as well."""
        depth = 1 + max((self.depths[id(child)] for child in children(tree)), default=0)
        if depth > MAX_DEPTH:
            raise ExpressionError(f"{self.source[:60]!r} is nested too deep")
        self.depths[id(tree)] = depth
        self.nodes.append(tree)
        return tree

    def deeper(self, depth: int) -> int:
        if depth > 3 * MAX_DEPTH:
            raise ExpressionError(f"{self.source[:60]!r} is nested too deep")
        return depth + 1

    def sum(self, depth: int) -> Expression:
        tree = self.product(self.deeper(depth))
        while self.text in ("+", "-"):
            tree = self.node(Operation(self.take(), (tree, self.product(depth))))
        return tree

    def product(self, depth: int) -> Expression:
        tree = self.signed(self.deeper(depth))
        while self.text in ("*", "/"):
            tree = self.node(Operation(self.take(), (tree, self.signed(depth))))
        return tree

    def signed(self, depth: int) -> Expression:
        if self.text == "-":
            self.take()
            return self.node(Operation("neg", (self.signed(self.deeper(depth)),)))
        if self.text == "+":
            self.take()
            return self.signed(self.deeper(depth))
        base = self.atom(depth)
        if self.text != "**":
            return base
        self.take()
        exponent = self.exponent(depth)
        if exponent.denominator != 1 or abs(exponent) > MAX_POWER or self.text == "**":
            self.fail()
        return self.node(Power(base, int(exponent)))

    def exponent(self, depth: int) -> Fraction:
        if self.text in ("+", "-"):
            sign = -1 if self.take() == "-" else 1
            return sign * self.exponent(self.deeper(depth))
        if self.text == "(":
            self.take()
            value = self.exponent(self.deeper(depth))
            self.expect(")")
            return value
        return self.number()

    def number(self) -> Fraction:
        if self.kind != "number" or re.match("0[0-9]", self.text):
            self.fail()
        if int(self.text.lower().partition("e")[2] or 0) not in range(-MAX_EXPONENT, MAX_EXPONENT + 1):
            self.fail()
        return Fraction(self.take())

    def atom(self, depth: int) -> Expression:
        if self.kind == "number":
            return self.node(Number(self.number()))
        if self.kind == "name":
            name = self.take()
            if iskeyword(name):  # a word that other readers of the language cannot have as a name
                self.fail()
            if name not in FUNCTIONS:
                return self.node(Name(name))
            self.expect("(")
            argument = self.sum(depth)
            self.expect(")")
            return self.node(Operation(name, (argument,)))
        self.expect("(")
        tree = self.sum(depth)
        self.expect(")")
        return tree


def children(tree: Expression) -> tuple[Expression, ...]:
    """Direct subexpressions."""
    return tree.operands if isinstance(tree, Operation) else (tree.base,) if isinstance(tree, Power) else ()


def size(tree: Expression) -> int:
    """Leaves, multiplied by the exponents above them: a bound of the work that exact arithmetic can cause."""
    if isinstance(tree, Power):
        return size(tree.base) * max(1, abs(tree.exponent))
    return sum(map(size, children(tree))) if isinstance(tree, Operation) else 1


def names_in(tree: Expression) -> set[str]:
    """Names that occur."""
    return {tree.name} if isinstance(tree, Name) else set().union(*map(names_in, children(tree)))


def substitute(tree: Expression, values: Mapping[str, Fraction]) -> Expression:
    """The same expression with constants in the place of some names."""
    match tree:
        case Name(name):
            return Number(values[name]) if name in values else tree
        case Operation(operator, operands):
            return Operation(operator, tuple(substitute(operand, values) for operand in operands))
        case Power(base, exponent):
            return Power(substitute(base, values), exponent)
    return tree


def affine(tree: Expression) -> Affine:
    """Coefficients by name and constant, exact; `ExpressionError` where the expression is not of that form."""
    match tree:
        case Number(value):
            return {}, value
        case Name(name):
            return {name: Fraction(1)}, Fraction(0)
        case Operation("neg", (operand,)):
            return _scaled(affine(operand), Fraction(-1))
        case Operation("+" | "-" as operator, (left, right)):
            total, second = affine(left), _scaled(affine(right), Fraction(1 if operator == "+" else -1))
            names = {**total[0], **second[0]}
            return {n: total[0].get(n, Fraction(0)) + second[0].get(n, Fraction(0)) for n in names}, total[1] + second[
                1
            ]
        case Operation("*", (left, right)):
            first, second = affine(left), affine(right)
            if not any(first[0].values()):
                return _scaled(second, first[1])
            if not any(second[0].values()):
                return _scaled(first, second[1])
        case Operation("/", (left, right)):
            first, second = affine(left), affine(right)
            if not any(second[0].values()) and second[1]:
                return _scaled(first, 1 / second[1])
        case Power(base, exponent):
            form = affine(base)
            if exponent == 1:
                return form
            if not any(form[0].values()) and (form[1] or exponent >= 0):
                return {}, form[1] ** exponent
    raise ExpressionError("a linear expression with rational coefficients is required")


def _scaled(form: Affine, factor: Fraction) -> Affine:
    return {name: value * factor for name, value in form[0].items()}, form[1] * factor


def constant(text: str) -> Fraction:
    """Exact value of an expression without names and functions."""
    coefficients, value = affine(parse(text))
    if coefficients:
        raise ExpressionError(f"{text[:60]!r} is no constant")
    return value
