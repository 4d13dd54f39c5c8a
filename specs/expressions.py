"""The expression language: text to syntax tree.

Numbers (exact decimals), names, ``+ - * /``, ``**`` with a constant integer exponent, and the functions
sin cos tan exp log sqrt tanh of one argument. Parsed with Python's `ast` against this whitelist; nothing is evaluated.
"""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from typing import Literal, TypeAlias

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
