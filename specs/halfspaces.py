"""Text such as ``x - 3*y <= 4`` to halfspaces with exact coefficients."""

from __future__ import annotations

import re
from collections.abc import Collection

from .errors import ExpressionError
from .exact import shown
from .expression_parser import MAX_LENGTH
from .expressions import Expression, affine_form, parse_expression
from .specification import Halfspace

_COMPARISON = re.compile(r"<=|>=|==|!=|<|>|=")


def parse_halfspace(text: str, names: Collection[str] | None = None) -> tuple[Halfspace, ...]:
    """Read a linear comparison, or a chain of comparisons that point the same way.

    Parameters
    ----------
    text : str
        ``x - 3*y <= 4``, ``v > 0``, ``1 <= x <= 2``. Sets are closed: ``<`` is read as ``<=``, ``>`` as ``>=``.
    names : collection of str, optional
        The names that may occur; None allows every identifier.

    Returns
    -------
    tuple of Halfspace
        One per comparison; the set is their intersection.

    Raises
    ------
    ExpressionError
        Naming the column, what was found and the remedy.
    """
    if len(text) > MAX_LENGTH:
        raise ExpressionError(
            f"expected at most {MAX_LENGTH} characters, found {len(text)}",
            where="column 1",
            remedy="write a list of comparisons",
        )
    comparisons = list(_COMPARISON.finditer(text))
    if not comparisons:
        raise ExpressionError(
            f"expected a comparison, found {shown(text)}",
            where="column 1",
            remedy="write for example x - 3*y <= 4, or a box {x: [1, 2]}",
        )
    for comparison in comparisons:
        _check_sign(comparison)
    if len({comparison.group()[0] for comparison in comparisons}) > 1:
        raise ExpressionError(
            "found comparisons that point in different directions",
            where=f"column {comparisons[-1].start() + 1}",
            remedy="write them as a list, one comparison each",
        )
    starts = [0, *(comparison.end() for comparison in comparisons)]
    ends = [*(comparison.start() for comparison in comparisons), len(text)]
    sides = [_side(text, start, end, names) for start, end in zip(starts, ends, strict=True)]
    return tuple(
        _halfspace(text, starts[index], ends[index + 1], comparison, sides[index], sides[index + 1])
        for index, comparison in enumerate(comparisons)
    )


def _check_sign(comparison: re.Match[str]) -> None:
    sign = comparison.group()
    if sign in ("==", "=", "!="):
        remedy = "use <= and >= with a tolerance: a set without interior can be neither entered nor left provably"
        raise ExpressionError(f"found {sign!r}", where=f"column {comparison.start() + 1}", remedy=remedy)


def _side(text: str, start: int, end: int, names: Collection[str] | None) -> Expression:
    # Blanks instead of the other sides, so that the columns in messages are columns of the whole text.
    part = text[start:end]
    if not part.strip():
        remedy = "write an expression on both sides of every comparison"
        raise ExpressionError("found nothing beside a comparison", where=f"column {start + 1}", remedy=remedy)
    return parse_expression(" " * start + part, names)


def _halfspace(
    text: str, start: int, end: int, comparison: re.Match[str], left: Expression, right: Expression
) -> Halfspace:
    first, second = affine_form(left), affine_form(right)
    column = f"column {start + 1}"
    own = text[start:end].strip()
    if first is None or second is None:
        raise ExpressionError(
            f"{shown(own)} is not linear in the states",
            where=column,
            remedy="requirements are linear in the states, with rational coefficients; "
            "enclose the set by halfspaces, or add a state that follows the nonlinear term",
        )
    if comparison.group()[0] == ">":
        first, second = second, first
    coefficients = dict(first[0])
    for name, value in second[0].items():
        coefficients[name] = coefficients.get(name, 0) - value
    coefficients = {name: value for name, value in coefficients.items() if value}
    if not coefficients:
        remedy = "every comparison restricts at least one state"
        raise ExpressionError(f"{shown(own)} does not depend on any state", where=column, remedy=remedy)
    return Halfspace(coefficients, second[1] - first[1], own)
