"""Exact numbers as VNN-LIB text and back: plain decimals, rounded only outward and only where nothing exact exists."""

from __future__ import annotations

import re
from decimal import Decimal
from fractions import Fraction

from .errors import InputError
from .exact import decimal_text, shown

LEAST = Fraction(2) ** -1022
"""Smallest normal float64: what is smaller is written as 0 or as this, because readers stumble over it."""
LARGEST = (2 - Fraction(2) ** -52) * Fraction(2) ** 1023
"""Largest float64: what is larger is no number for a reader of floats."""
MOST_CHARACTERS = 1200
"""Of one number; every normal float64 has its exact decimal in fewer."""
DIGITS = 40
"""Significant digits of what is rounded."""
MOST_EXPONENT = 400

_NUMBER = re.compile(r"[+-]?(?:[0-9]+(?:\.[0-9]*)?|\.[0-9]+)(?:[eE]([+-]?[0-9]{1,6}))?", re.ASCII)


def number_text(value: Fraction, toward: int) -> str:
    """Write a number as ``-?digits.digits``, the only form that all versions of VNN-LIB share.

    A finite decimal is written exactly, hence every normal float64. What has no finite decimal, more than
    `MOST_CHARACTERS`, or is below `LEAST` in size without being 0, is moved in the given direction.

    Parameters
    ----------
    value : Fraction
    toward : {-1, 1}
        Direction in which a number may be moved: 1 never writes less than `value`, -1 never more.

    Returns
    -------
    str

    Raises
    ------
    InputError
        The number is larger than any float64.
    """
    if abs(value) > LARGEST:
        raise InputError("a number is larger than any float64", remedy="scale the query")
    text = _exact_text(value)
    if text is not None:
        return text
    moved = value if abs(value) < LEAST else _rounded(value, toward)
    if 0 < abs(moved) < LEAST:
        moved = LEAST * toward if moved * toward > 0 else Fraction(0)
    written = _exact_text(moved)
    if written is None:
        raise AssertionError(f"{moved} was rounded and has no text")
    return written


def is_exact(value: Fraction) -> bool:
    """Whether `number_text` writes exactly this number."""
    return abs(value) <= LARGEST and _exact_text(value) is not None


def _exact_text(value: Fraction) -> str | None:
    """The finite decimal of a number that is 0 or normal; None where there is none of a bearable length."""
    if 0 < abs(value) < LEAST:
        return None
    text = decimal_text(abs(value))
    if text.startswith("("):
        return None
    digits = format(Decimal(text), "f")
    digits = f"{'-' if value < 0 else ''}{digits}{'' if '.' in digits else '.0'}"
    return digits if len(digits) <= MOST_CHARACTERS else None


def _rounded(value: Fraction, toward: int) -> Fraction:
    """The nearest number of `DIGITS` significant digits in a direction."""
    size = abs(value)
    # the number of digits before the point, or minus the number of zeros after it, up to one
    magnitude = len(str(size.numerator)) - len(str(size.denominator))
    scale = Fraction(10) ** (DIGITS - magnitude)
    scaled = value * scale
    whole = -(-scaled.numerator // scaled.denominator) if toward > 0 else scaled.numerator // scaled.denominator
    return Fraction(whole) / scale


def read_number(text: str) -> Fraction:
    """Read a decimal, with or without exponent, as an exact rational.

    Parameters
    ----------
    text : str

    Returns
    -------
    Fraction

    Raises
    ------
    InputError
        It is no decimal (``nan``, ``inf``, ``0x1``), or has more than `MOST_CHARACTERS` characters or an exponent
        beyond `MOST_EXPONENT`.
    """
    if len(text) > MOST_CHARACTERS:
        raise InputError(
            f"expected a number of at most {MOST_CHARACTERS} characters, found {len(text)}", remedy="round it"
        )
    found = _NUMBER.fullmatch(text)
    if found is None:
        raise InputError(f"expected a number, found {shown(text)}", remedy="write a decimal such as -0.25")
    if found[1] is not None and abs(int(found[1])) > MOST_EXPONENT:
        raise InputError(
            f"the exponent of {shown(text)} is out of range", remedy=f"use an exponent between +-{MOST_EXPONENT}"
        )
    return Fraction(Decimal(text))
