"""Text to syntax tree, through Python's `ast` and a whitelist.

The text is scanned before `ast` sees it: length, characters and nesting are bounded and the usual mistakes get a
message of their own, so that hostile text ends in an `ExpressionError` and never in a full stack.
"""

from __future__ import annotations

import ast
import difflib
import keyword
import re
from collections.abc import Collection
from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, NoReturn

from .errors import ExpressionError, InputError
from .exact import check_exponent, shown
from .expressions import FUNCTIONS, Binary, Call, Expression, Name, Negate, Number, Power

MAX_LENGTH = 4096
MAX_DEPTH = 64
MAX_POWER = 64
MAX_SIZE = 1024
"""Bound of the work an expression can cause when constants are folded exactly: leaves, multiplied by exponents."""

_TOKEN = re.compile(
    r"(?P<space>[ \t\r\n]+)|(?P<number>(?:[0-9]+\.?[0-9]*|\.[0-9]+)(?:[eE][+-]?[0-9]+)?)"
    r"|(?P<name>[A-Za-z_][A-Za-z0-9_]*)|(?P<power>\*\*)|(?P<floor>//)|(?P<operator>[-+*/])|(?P<open>\()|(?P<close>\))"
)
_REMEDIES = {
    "^": "write ** for a power",
    ",": "every function takes one argument",
    ".": "a name has no parts; write x, not plant.x",
    "[": "a name has no parts; give every component its own name",
    "=": "an expression is a value; comparisons belong to requirements",
    "<": "an expression is a value; comparisons belong to requirements",
    ">": "an expression is a value; comparisons belong to requirements",
    "!": "an expression is a value; comparisons belong to requirements",
    "'": "text has no place in an expression",
    '"': "text has no place in an expression",
    "%": "only + - * / and ** are known",
}
_OPERATORS: dict[type[ast.operator], Literal["+", "-", "*", "/"]] = {
    ast.Add: "+",
    ast.Sub: "-",
    ast.Mult: "*",
    ast.Div: "/",
}


def parse(text: str, names: Collection[str] | None = None) -> Expression:
    """Read the text of an expression; `expressions.parse_expression` is its public name and states the contract."""
    if len(text) > MAX_LENGTH:
        raise ExpressionError(
            f"expected at most {MAX_LENGTH} characters, found {len(text)}",
            where="column 1",
            remedy="split the expression, for example into more parameters or states",
        )
    _scan(text)
    line = re.sub(r"\s", " ", text)
    offset = len(line) - len(line.lstrip())
    try:
        tree = ast.parse(line.strip(), mode="eval")
    except SyntaxError as error:
        _fail((error.offset or 1) + offset, "found something that is no expression", "complete it as in 2*sin(x) - 1")
    except (MemoryError, RecursionError, ValueError):
        _too_deep(1)
    return _Converter(line, offset, names).convert(tree.body, 1).node


def suggestion(word: str, known: Collection[str]) -> str:
    """A remedy for an unknown word: the nearest known one, and the list of all."""
    listed = ", ".join(known) or "none"
    near = difflib.get_close_matches(word, list(known), n=1)
    return f"did you mean {near[0]}? known: {listed}" if near else f"known: {listed}"


def _fail(column: int, message: str, remedy: str) -> NoReturn:
    raise ExpressionError(message, where=f"column {column}", remedy=remedy) from None


def _too_deep(column: int) -> NoReturn:
    _fail(column, f"nested more than {MAX_DEPTH} deep", "group the terms with parentheses into a balanced sum")


def _scan(text: str) -> None:
    """Reject what is not a sequence of operands and operators, and nesting that no tree of the language has."""
    levels = [0]
    """Per open parenthesis: signs and powers since the last other operator; each nests the tree once more."""
    opened: list[int] = []
    previous, before = "", ""
    position = 0
    while position < len(text):
        token = _TOKEN.match(text, position)
        column = position + 1
        if token is None:
            character = text[position]
            remedy = _REMEDIES.get(character, "use decimals, names in ASCII letters, + - * / ** and parentheses")
            _fail(column, f"found {shown(character)}, which is not in the language", remedy)
        kind, position = token.lastgroup or "", token.end()
        if kind == "space":
            continue
        operand_ended = previous in ("number", "name", "close")
        if kind == "floor":
            _fail(column, "found '//'", "write / for a quotient")
        if kind == "number" and position < len(text) and re.match(r"[A-Za-z_0-9.]", text[position]):
            _fail(column, f"found a number followed by {shown(text[position])}", "write 2*x, and numbers as decimals")
        if kind == "name" and keyword.iskeyword(token.group()):
            _fail(column, f"{token.group()} is a reserved word", "use another name")
        if operand_ended and (kind in ("number", "name") or (kind == "open" and previous != "name")):
            _fail(column, f"found {shown(token.group())} after {shown(before)}", "write an operator between the two")
        if kind == "number" and re.match(r"0[0-9]", token.group()):
            _fail(column, f"found the number {shown(token.group())}", "leave the leading zeros out")
        if not operand_ended and (kind in ("power", "close") or token.group() in ("*", "/")):
            _fail(column, f"found {shown(token.group())} where a value is expected", "complete the expression")
        if kind == "open":
            opened.append(column)
            levels.append(0)
        elif kind == "close":
            if not opened:
                _fail(column, "found ')' without its '('", "remove it")
            opened.pop()
            levels.pop()
        elif kind == "operator" and operand_ended:
            levels[-1] = 0
        elif kind in ("operator", "power"):
            levels[-1] += 1
        if len(opened) + levels[-1] > MAX_DEPTH:
            _too_deep(column)
        previous, before = kind, token.group()
    if opened:
        _fail(opened[-1], "found '(' without its ')'", "close it")
    if previous not in ("number", "name", "close"):
        _fail(len(text) + 1, "the expression ends where a value is expected", "complete it")


@dataclass(frozen=True)
class _Converted:
    node: Expression
    constant: Fraction | None
    size: int


class _Converter:
    """From Python's tree to ours, one whitelisted node at a time, folding constants only to find divisions by zero."""

    def __init__(self, text: str, offset: int, names: Collection[str] | None) -> None:
        self.text = text
        self.offset = offset
        self.names = names

    def column(self, node: ast.expr) -> int:
        return node.col_offset + self.offset + 1

    def source(self, node: ast.expr) -> str:
        return self.text[node.col_offset + self.offset : (node.end_col_offset or 0) + self.offset]

    def convert(self, node: ast.expr, depth: int) -> _Converted:
        column = self.column(node)
        if depth > MAX_DEPTH:
            _too_deep(column)
        match node:
            case ast.Constant():
                value = self.number(node)
                size = 1 + (value.numerator.bit_length() + value.denominator.bit_length()) // 64
                result = _Converted(Number(value), value, size)
            case ast.Name(id=name):
                result = self.name(name, column)
            case ast.UnaryOp(op=ast.UAdd(), operand=operand):
                result = self.convert(operand, depth + 1)
            case ast.UnaryOp(op=ast.USub(), operand=operand):
                inner = self.convert(operand, depth + 1)
                value_or_none = None if inner.constant is None else -inner.constant
                result = _Converted(Negate(inner.node), value_or_none, inner.size)
            case ast.BinOp(left=base, op=ast.Pow(), right=exponent):
                result = self.power(self.convert(base, depth + 1), self.exponent(exponent), column)
            case ast.BinOp(left=left, op=operator, right=right) if type(operator) in _OPERATORS:
                first, second = self.convert(left, depth + 1), self.convert(right, depth + 1)
                result = self.binary(_OPERATORS[type(operator)], first, second, self.column(right))
            case ast.Call(func=ast.Name(id=function), args=[argument], keywords=[]):
                result = self.call(function, argument, column, depth)
            case ast.Call():
                _fail(column, f"found {shown(self.source(node))}", "every function takes one argument")
            case _:
                remedy = "use numbers, names, + - * / **, parentheses and " + " ".join(FUNCTIONS)
                _fail(column, f"found {shown(self.source(node))}, which is not in the language", remedy)
        if result.size > MAX_SIZE:
            _fail(column, "the powers in this expression multiply out to too many factors", "use smaller exponents")
        return result

    def number(self, node: ast.Constant) -> Fraction:
        text = self.source(node)
        if type(node.value) not in (int, float):
            _fail(self.column(node), f"found {shown(text)}, which is not a number", "write a decimal such as 0.25")
        try:
            check_exponent(text)
        except InputError as error:
            _fail(self.column(node), error.message, error.remedy or "")
        return Fraction(text)

    def name(self, name: str, column: int) -> _Converted:
        if name in FUNCTIONS:
            _fail(column, f"{name} is a function", f"write {name}(...)")
        if self.names is not None and name not in self.names:
            _fail(column, f"unknown name {shown(name)}", suggestion(name, self.names))
        return _Converted(Name(name), None, 1)

    def exponent(self, node: ast.expr) -> int:
        remedy = "the exponent is a constant whole number; write sqrt(x) for a root and exp(y*log(x)) for x**y"
        sign, inner = 1, node
        while isinstance(inner, ast.UnaryOp) and isinstance(inner.op, ast.USub | ast.UAdd):
            sign, inner = (-sign if isinstance(inner.op, ast.USub) else sign), inner.operand
        if not isinstance(inner, ast.Constant):
            _fail(self.column(node), f"found the exponent {shown(self.source(node))}", remedy)
        value = sign * self.number(inner)
        if value.denominator != 1:
            _fail(self.column(node), f"found the exponent {shown(self.source(node))}", remedy)
        if abs(value) > MAX_POWER:
            found = shown(self.source(node))
            _fail(self.column(node), f"found the exponent {found}", f"use exponents between +-{MAX_POWER}")
        return int(value)

    def power(self, base: _Converted, exponent: int, column: int) -> _Converted:
        size = base.size * max(1, abs(exponent))
        if base.constant is None or size > MAX_SIZE:
            return _Converted(Power(base.node, exponent), None, size)
        if base.constant == 0 and exponent < 0:
            _fail(column, "found a negative power of zero", "it has no value; change the base or the exponent")
        return _Converted(Power(base.node, exponent), base.constant**exponent, size)

    def binary(
        self, operator: Literal["+", "-", "*", "/"], left: _Converted, right: _Converted, column: int
    ) -> _Converted:
        node, size = Binary(operator, left.node, right.node), left.size + right.size
        if operator == "/" and right.constant == 0:
            _fail(column, "found a division by zero", "it has no value; change the divisor")
        if left.constant is None or right.constant is None:
            return _Converted(node, None, size)
        a, b = left.constant, right.constant
        value = a + b if operator == "+" else a - b if operator == "-" else a * b if operator == "*" else a / b
        return _Converted(node, value, size)

    def call(self, function: str, argument: ast.expr, column: int, depth: int) -> _Converted:
        if function not in FUNCTIONS:
            _fail(column, f"unknown function {shown(function)}", suggestion(function, FUNCTIONS))
        inner = self.convert(argument, depth + 1)
        value = inner.constant
        if value is not None and ((function == "log" and value <= 0) or (function == "sqrt" and value < 0)):
            _fail(column, f"{function} is not defined here", "its argument is a constant outside its domain")
        return _Converted(Call(function, inner.node), None, inner.size)
