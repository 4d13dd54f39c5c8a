"""Decimal text to exact rational: ``0.1`` is one tenth, not the float nearest to it."""

from __future__ import annotations

import re
from fractions import Fraction

from .errors import InputError

MAX_EXPONENT = 300
MAX_NUMBER_LENGTH = 100

_DECIMAL = re.compile(r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?[0-9]+)?", re.ASCII)
_LEADING_ZERO = re.compile(r"-?0+[0-9]", re.ASCII)


def shown(text: str, limit: int = 60) -> str:
    """Quote text that came from a file for a message: escaped, and cut where it is long."""
    return repr(text if len(text) <= limit else text[: limit - 3] + "...")


def exact_decimal(text: str) -> Fraction:
    """Read ``-?digits[.digits][e[+-]digits]`` as an exact rational.

    Parameters
    ----------
    text : str
        At most `MAX_NUMBER_LENGTH` characters; the exponent is at most `MAX_EXPONENT` in size.

    Returns
    -------
    Fraction

    Raises
    ------
    InputError
        With the remedy, for ``nan``, ``inf``, hexadecimal, leading zeros and anything else that is not a decimal.
    """
    if len(text) > MAX_NUMBER_LENGTH:
        raise InputError(
            f"expected a number of at most {MAX_NUMBER_LENGTH} characters, found {len(text)}", remedy="round it"
        )
    if not _DECIMAL.fullmatch(text):
        raise InputError(f"expected a number, found {shown(text)}", remedy=_remedy(text))
    check_exponent(text)
    return Fraction(text)


MAX_RANGE = 1000


def decimal_range(text: str) -> tuple[Fraction, ...]:
    """Read ``first:last:step`` (first, first + step, ... up to last) or a list ``0,0.1,0.2`` of non-negative numbers.

    Parameters
    ----------
    text : str

    Returns
    -------
    tuple of Fraction
        At least one number, at most `MAX_RANGE`; in a range both ends, where the step divides it.

    Raises
    ------
    InputError
        With the remedy.
    """
    remedy = "write first:last:step such as 0:0.5:0.05, or a list such as 0,0.1,0.2"
    parts = text.split(":")
    if len(parts) not in (1, 3):
        raise InputError(f"expected a range or a list of numbers, found {shown(text)}", remedy=remedy)
    values = [exact_decimal(part.strip()) for part in (parts if len(parts) == 3 else text.split(","))]
    if len(parts) == 3:
        first, last, step = values
        if step <= 0 or last < first:
            raise InputError(f"expected first <= last and a positive step, found {shown(text)}", remedy=remedy)
        count = (last - first) // step + 1
        values = [first + index * step for index in range(min(count, MAX_RANGE + 1))]
    if len(values) > MAX_RANGE:
        raise InputError(f"expected at most {MAX_RANGE} numbers, found more", remedy="choose a larger step")
    if min(values) < 0:
        raise InputError(f"expected numbers that are not negative, found {shown(text)}", remedy=remedy)
    return tuple(values)


def check_exponent(text: str) -> None:
    """Reject a decimal whose exponent is beyond `MAX_EXPONENT`; expanding it would need that many digits."""
    _, _, exponent = text.lower().partition("e")
    digits = exponent.lstrip("+-").lstrip("0")
    if len(digits) > 3 or (digits and int(digits) > MAX_EXPONENT):
        raise InputError(
            f"the exponent of {shown(text)} is out of range", remedy=f"use an exponent between +-{MAX_EXPONENT}"
        )


def _remedy(text: str) -> str:
    lowered = text.lower().lstrip("+-.")
    if lowered in ("nan", "inf", "infinity"):
        return "every number is finite; write null for a side without a bound, where a side may be open"
    if lowered.startswith(("0x", "0o", "0b")):
        return "write it as a decimal"
    if _LEADING_ZERO.match(text):
        return "leave the leading zeros out"
    if text.startswith("+"):
        return "leave the plus sign out"
    if text.startswith((".", "-.")):
        return "write a digit before the point, for example 0.5"
    if "_" in text or "," in text:
        return "write the digits without separators"
    return "write a decimal such as -0.25 or 1e-3"


def decimal_text(value: Fraction) -> str:
    """Write a non-negative rational as decimal text that reads back exactly, or ``(p/q)`` where no decimal does."""
    if value < 0:
        raise ValueError(f"expected a non-negative number, received {value}")
    twos = fives = 0
    rest = value.denominator
    while rest % 2 == 0:
        rest, twos = rest // 2, twos + 1
    while rest % 5 == 0:
        rest, fives = rest // 5, fives + 1
    if rest != 1:
        return f"({value.numerator}/{value.denominator})"
    places = max(twos, fives)
    digits = str(value.numerator * 10**places // value.denominator)
    if places == 0:
        stripped = digits.rstrip("0")
        zeros = len(digits) - len(stripped)
        return f"{stripped}e{zeros}" if stripped and zeros > 15 else digits
    if places > 15 and len(digits) < places:
        return f"{digits}e-{places}"
    digits = digits.rjust(places + 1, "0")
    return f"{digits[:-places]}.{digits[-places:]}"


def signed_text(value: Fraction) -> str:
    """`decimal_text` for numbers of either sign, for messages."""
    return decimal_text(value) if value >= 0 else f"-{decimal_text(-value)}"
