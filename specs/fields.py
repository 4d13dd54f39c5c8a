"""The leaves of a document: how one text or one pair becomes a number, a name, an interval, a comparison.

Each is a type annotation that carries both its validator and its JSON Schema. Validators see the plain data of
`yaml_nodes.plain_data`: text, lists, dictionaries and None.
"""

from __future__ import annotations

import keyword
import re
from collections.abc import Callable
from fractions import Fraction
from typing import Annotated, Any, TypeAlias

from pydantic import Discriminator, PlainValidator, WithJsonSchema
from pydantic_core import PydanticCustomError

from .errors import ExpressionError, InputError
from .exact import exact_decimal, shown, signed_text
from .expressions import FUNCTIONS, evaluate_constant, parse_expression
from .halfspaces import parse_halfspace
from .specification import Bounds, Halfspace
from .yaml_nodes import Quoted

RESERVED = ("union",)
MAX_PARAMETER_BITS = 1024
MAX_TEXT_LENGTH = 10_000

OpenBounds: TypeAlias = tuple[Fraction | None, Fraction | None]


def problem(message: str, remedy: str, key: str | None = None) -> PydanticCustomError:
    """An error of a document, with its remedy; `key` is the entry below the validated value that it is about."""
    return PydanticCustomError("setrl", "{message}", {"message": message, "remedy": remedy, "key": key})


def found(value: object) -> str:
    """What a value is, for messages."""
    if value is None:
        return "nothing"
    if isinstance(value, list):
        return f"a list of {len(value)}"
    if isinstance(value, dict):
        return "a mapping"
    return f"the quoted text {shown(value)}" if isinstance(value, Quoted) else shown(str(value))


def by_kind(expected: str, remedy: str, kind: Callable[[Any], str | None] | None = None) -> Discriminator:
    """Choose the alternative of a union by what the value is: tags ``<text>``, ``<list>``, ``<mapping>``.

    So a message is about the alternative that was meant, never about all of them. Message and remedy share one text,
    two lines, because a `Discriminator` with a context of its own cannot be hashed.
    """
    return Discriminator(
        kind or node_kind,
        custom_error_type="setrl_kind",
        custom_error_message=f"expected {expected}\n{remedy}",
    )


def node_kind(value: object) -> str | None:
    """Tag of a value for `by_kind`."""
    if isinstance(value, str):
        return "<text>"
    return "<list>" if isinstance(value, list) else "<mapping>" if isinstance(value, dict) else None


def number(value: object) -> Fraction:
    """An exact decimal."""
    if isinstance(value, Quoted):
        raise problem(f"expected a number, found {found(value)}", "remove the quotes")
    if not isinstance(value, str):
        raise problem(f"expected a number, found {found(value)}", "write a decimal such as -0.25 or 1e-3")
    try:
        return exact_decimal(value)
    except InputError as error:
        raise problem(error.message, error.remedy or "") from None


def _positive(value: object) -> Fraction:
    result = number(value)
    if result <= 0:
        raise problem(f"expected a number greater than 0, found {found(value)}", "make it positive")
    return result


def _nonnegative(value: object) -> Fraction:
    result = number(value)
    if result < 0:
        raise problem(f"expected a number that is not negative, found {found(value)}", "remove the minus sign")
    return result


def _discount(value: object) -> Fraction:
    result = _positive(value)
    if result > 1:
        raise problem(f"expected a discount in (0, 1], found {found(value)}", "write 1 for no discounting")
    return result


def _whole(value: object) -> int:
    result = _nonnegative(value)
    if result.denominator != 1 or result > 10**9:
        raise problem(f"expected a whole number of periods, found {found(value)}", "write 0, 1, 2, ...")
    return int(result)


def _version(value: object) -> int:
    if value != "1":
        raise problem(f"expected language version 1, found {found(value)}", "write 'setrl: 1'")
    return 1


def _flag(value: object) -> bool:
    if isinstance(value, Quoted) or value not in ("true", "false"):
        raise problem(f"expected true or false, found {found(value)}", "write true or false, without quotes")
    return value == "true"


def _text(value: object) -> str:
    if not isinstance(value, str) or not value.strip():
        raise problem(f"expected text, found {found(value)}", "write a word or a sentence, or remove the key")
    if len(value) > MAX_TEXT_LENGTH:
        raise problem(f"expected at most {MAX_TEXT_LENGTH} characters, found {len(value)}", "shorten the text")
    return str(value).strip()


def _label(value: object) -> str:
    result = _text(value)
    if len(result) > 100 or not result.isprintable():
        raise problem(f"expected a short name, found {found(value)}", "use at most 100 characters on one line")
    return result


def _unit(value: object) -> str:
    return "" if value is None or value == "" else _label(value)


def identifier(value: object) -> str:
    """A name of a state, input, disturbance or parameter."""
    if not isinstance(value, str) or not re.fullmatch(r"[A-Za-z_][A-Za-z0-9_]*", value):
        raise problem(f"expected a name, found {found(value)}", "use ASCII letters, digits and _, no digit first")
    if keyword.iskeyword(value) or value in FUNCTIONS or value in RESERVED:
        raise problem(f"{value} is a reserved word", "use another name")
    if len(value) > 100:
        raise problem("found a name of more than 100 characters", "shorten it")
    return str(value)


def _dynamics_key(value: object) -> str:
    name = value[:-1] if isinstance(value, str) and value.endswith("+") else value
    identifier(name)
    return str(value)


def _expression(value: object) -> str:
    if not isinstance(value, str):
        raise problem(f"expected an expression, found {found(value)}", "write text such as v*cos(theta)")
    try:
        parse_expression(value)
    except ExpressionError as error:
        raise from_expression(error, value) from None
    return str(value)


def from_expression(error: ExpressionError, text: str) -> PydanticCustomError:
    """An expression's error as a document's, which adds the file and the line."""
    return problem(f"{error.where} of {shown(text)}: {error.message}", error.remedy or "")


def _constant(value: object) -> Fraction:
    if not isinstance(value, str):
        raise problem(f"expected a number, found {found(value)}", "write a number, or a fraction such as 1/3")
    try:
        result = evaluate_constant(parse_expression(value, ()))
    except ExpressionError as error:
        raise from_expression(error, value) from None
    if result is None:
        raise problem(f"expected a rational constant, found {found(value)}", "functions belong to the dynamics")
    if max(result.numerator.bit_length(), result.denominator.bit_length()) > MAX_PARAMETER_BITS:
        raise problem(f"expected fewer digits than {found(value)} has", "round it")
    return result


def _halfspaces(value: object) -> tuple[Halfspace, ...]:
    if not isinstance(value, str):
        raise problem(f"expected a comparison, found {found(value)}", "write text such as x - 3*y <= 4")
    try:
        return parse_halfspace(value)
    except ExpressionError as error:
        raise from_expression(error, value) from None


def _pair(value: object, remedy: str) -> list[object]:
    if not isinstance(value, list) or len(value) != 2:
        raise problem(f"expected [lower, upper], found {found(value)}", remedy)
    return value


def _closed(value: object) -> Bounds:
    lower, upper = (number(item) for item in _pair(value, "write two numbers"))
    if lower > upper:
        message = f"empty box: lower bound {signed_text(lower)} is greater than upper bound {signed_text(upper)}"
        raise problem(message, "swap the two bounds")
    return Bounds(lower, upper)


def _interval(value: object) -> Bounds:
    if isinstance(value, list):
        return _closed(value)
    point = number(value)
    return Bounds(point, point)


def _symmetric(value: object) -> Bounds:
    if isinstance(value, list):
        return _closed(value)
    radius = _nonnegative(value)
    return Bounds(-radius, radius)


def _open(value: object) -> OpenBounds:
    pair = _pair(value, "write two bounds; null is a side without a bound, as in [1, null]")
    lower, upper = (None if item is None else number(item) for item in pair)
    if lower is None and upper is None:
        raise problem("expected at least one bound", "states that are not named are free; leave this one out")
    if lower is not None and upper is not None:
        _closed(value)
    return lower, upper


def _components(value: object) -> Fraction | tuple[Fraction, ...]:
    if not isinstance(value, list):
        return number(value)
    if not value:
        raise problem("expected at least one number, found an empty list", "write one number per component")
    return tuple(number(item) for item in value)


_NUMBER: dict[str, Any] = {"type": "number"}
_PAIR: dict[str, Any] = {"type": "array", "items": _NUMBER, "minItems": 2, "maxItems": 2}
_NAME = {"type": "string", "pattern": "^[A-Za-z_][A-Za-z0-9_]*$"}

ExactNumber = Annotated[Fraction, PlainValidator(number), WithJsonSchema(_NUMBER)]
Positive = Annotated[Fraction, PlainValidator(_positive), WithJsonSchema({**_NUMBER, "exclusiveMinimum": 0})]
NonNegative = Annotated[Fraction, PlainValidator(_nonnegative), WithJsonSchema({**_NUMBER, "minimum": 0})]
Discount = Annotated[
    Fraction, PlainValidator(_discount), WithJsonSchema({**_NUMBER, "exclusiveMinimum": 0, "maximum": 1})
]
Whole = Annotated[int, PlainValidator(_whole), WithJsonSchema({"type": "integer", "minimum": 0})]
Version = Annotated[int, PlainValidator(_version), WithJsonSchema({"const": 1})]
Flag = Annotated[bool, PlainValidator(_flag), WithJsonSchema({"type": "boolean"})]
Text = Annotated[str, PlainValidator(_text), WithJsonSchema({"type": "string", "minLength": 1})]
Label = Annotated[str, PlainValidator(_label), WithJsonSchema({"type": "string", "minLength": 1, "maxLength": 100})]
Unit = Annotated[str, PlainValidator(_unit), WithJsonSchema({"type": ["string", "number", "null"]})]
Identifier = Annotated[str, PlainValidator(identifier), WithJsonSchema(_NAME)]
DynamicsKey = Annotated[
    str, PlainValidator(_dynamics_key), WithJsonSchema({**_NAME, "pattern": r"^[A-Za-z_][A-Za-z0-9_]*\+?$"})
]
ExpressionText = Annotated[str, PlainValidator(_expression), WithJsonSchema({"type": ["string", "number"]})]
Constant = Annotated[Fraction, PlainValidator(_constant), WithJsonSchema({"type": ["string", "number"]})]
Comparison = Annotated[tuple[Halfspace, ...], PlainValidator(_halfspaces), WithJsonSchema({"type": "string"})]
Closed = Annotated[Bounds, PlainValidator(_closed), WithJsonSchema(_PAIR)]
Interval = Annotated[Bounds, PlainValidator(_interval), WithJsonSchema({"anyOf": [_NUMBER, _PAIR]})]
Symmetric = Annotated[Bounds, PlainValidator(_symmetric), WithJsonSchema({"anyOf": [_NUMBER, _PAIR]})]
OpenInterval = Annotated[
    OpenBounds, PlainValidator(_open), WithJsonSchema({**_PAIR, "items": {"type": ["number", "null"]}})
]
Components = Annotated[
    Fraction | tuple[Fraction, ...],
    PlainValidator(_components),
    WithJsonSchema({"anyOf": [_NUMBER, {"type": "array", "items": _NUMBER, "minItems": 1}]}),
]
