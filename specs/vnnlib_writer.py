"""A `Query` as VNN-LIB text, versions 1.0 and 2.0.

The text asks at least what the query asks: what no decimal expresses exactly is moved so that more inputs violate,
hence `unsat` of the text is `unsat` of the query. Coefficients are always exact: no direction is outward for them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from fractions import Fraction
from math import lcm, prod
from typing import TypeAlias

from .errors import InputError
from .queries import Case, LinearConstraint, Query
from .specification import Bounds
from .vnnlib_numbers import is_exact, number_text

Name: TypeAlias = Callable[[str, int], str]
"""How a dialect calls entry number i of X or Y."""


def vnnlib_1_text(query: Query) -> str:
    """Write a query in VNN-LIB 1.0: ``X_0``, ``Y_0``, entries counted in row-major order.

    Bounds that all cases share are assertions of their own, as most verifiers of networks need it.

    Parameters
    ----------
    query : Query

    Returns
    -------
    str
        ASCII, with a line break at the end.

    Raises
    ------
    InputError
        The query has no case, which this format cannot say, or a number that no text expresses.
    """

    def name(kind: str, index: int) -> str:
        return f"{kind}_{index}"

    sizes = (("X", prod(query.inputs)), ("Y", prod(query.outputs)))
    declared = [f"(declare-const {name(kind, index)} Real)" for kind, size in sizes for index in range(size)]
    return _text(query, [*_comments(query.comment), *declared], name)


def vnnlib_2_text(query: Query, network: str = "N") -> str:
    """Write a query in VNN-LIB 2.0: one network with input ``X`` and output ``Y``, over ``real``.

    Parameters
    ----------
    query : Query
    network : str
        The network's name: a letter, then letters, digits and underscores.

    Returns
    -------
    str
        ASCII, with a line break at the end.

    Raises
    ------
    InputError
        The query has no case, which this format cannot say, a number that no text expresses, or the name is none.
    """
    if not (network.isascii() and network[:1].isalpha() and network.replace("_", "a").isalnum()):
        raise InputError(f"{network!r} is no name of a network", remedy="use letters, digits and underscores")
    shapes = {"X": query.inputs, "Y": query.outputs}

    def name(kind: str, index: int) -> str:
        places = []
        for size in reversed(shapes[kind]):
            index, place = divmod(index, size)
            places.append(str(place))
        return f"{kind}[{','.join(reversed(places))}]" if places else kind

    shown = {kind: ",".join(map(str, shape)) for kind, shape in shapes.items()}
    header = [
        *_comments(query.comment),
        "(vnnlib-version <2.0>)",
        f"(declare-network {network}",
        f"  (declare-input X real [{shown['X']}])",
        f"  (declare-output Y real [{shown['Y']}])",
        ")",
    ]
    return _text(query, header, name)


def _comments(comment: str) -> list[str]:
    lines = comment.encode("ascii", "replace").decode("ascii").splitlines()
    return [f"; {line}".rstrip() for line in lines]


def _text(query: Query, header: list[str], name: Name) -> str:
    cases = [case for case in query.cases if not any(_is_false(constraint) for constraint in case.constraints)]
    if not cases:
        raise InputError("a query without a case cannot be written as VNN-LIB", remedy="it is unsat, ask nobody")
    _require_shape(query)
    lines = [*header, ""]
    if all(case.box == cases[0].box for case in cases):
        lines += [f"(assert {line})" for line in _bounds(cases[0].box, name)]
        parts = [list(_constraints(case, name)) for case in cases]
        if not all(parts):  # a case that asks for nothing else is satisfied wherever the others are
            parts = [[]]
    else:
        parts = [[*_bounds(case.box, name), *_constraints(case, name)] for case in cases]
    if len(parts) == 1:
        lines += [f"(assert {line})" for line in parts[0]]
    else:
        lines += ["(assert (or", *(f"  (and {' '.join(part)})" for part in parts), "))"]
    return "\n".join(lines) + "\n"


def _require_shape(query: Query) -> None:
    inputs, outputs = prod(query.inputs), prod(query.outputs)
    for case in query.cases:
        places = [index for constraint in case.constraints for index, _ in constraint.inputs]
        results = [index for constraint in case.constraints for index, _ in constraint.outputs]
        if len(case.box) != inputs or not all(0 <= i < inputs for i in places):
            raise AssertionError(f"a case of another network: it has not {inputs} inputs")
        if not all(0 <= j < outputs for j in results):
            raise AssertionError(f"a case of another network: it has not {outputs} outputs")


def _is_false(constraint: LinearConstraint) -> bool:
    return not constraint.inputs and not constraint.outputs and constraint.bound < 0


def _bounds(box: Sequence[Bounds], name: Name) -> Iterator[str]:
    for index, bounds in enumerate(box):
        yield f"(>= {name('X', index)} {number_text(bounds.lower, -1)})"
        yield f"(<= {name('X', index)} {number_text(bounds.upper, 1)})"


def _constraints(case: Case, name: Name) -> Iterator[str]:
    for constraint in case.constraints:
        terms = [(name("X", index), number) for index, number in constraint.inputs]
        terms += [(name("Y", index), number) for index, number in constraint.outputs]
        if terms:
            yield _comparison(terms, constraint.bound)


def _comparison(terms: list[tuple[str, Fraction]], bound: Fraction) -> str:
    """``sum coefficient * variable <= bound`` in the simplest form that says it, which more programs read."""
    first, factor = terms[0]
    if len(terms) == 1 and (abs(factor) == 1 or is_exact(bound / factor)):
        side = 1 if factor > 0 else -1
        return f"({'<=' if side > 0 else '>='} {first} {number_text(bound / factor, side)})"
    if len(terms) == 2 and factor + terms[1][1] == 0 and bound == 0:
        return f"({'<=' if factor > 0 else '>='} {first} {terms[1][0]})"
    scale = _scale([number for _, number in terms])
    parts = [_term(variable, number * scale) for variable, number in terms]
    total = parts[0] if len(parts) == 1 else f"(+ {' '.join(parts)})"
    return f"(<= {total} {number_text(bound * scale, 1)})"


def _term(variable: str, coefficient: Fraction) -> str:
    if coefficient == 1:
        return variable
    if not is_exact(coefficient):
        raise InputError(f"the coefficient of {variable} has no decimal in the range of float64", remedy="scale it")
    return f"(* {number_text(coefficient, 1)} {variable})"


def _scale(numbers: list[Fraction]) -> int:
    """A positive factor that makes all numbers finite decimals: denominators without their twos and fives."""
    common = lcm(*(number.denominator for number in numbers))
    while common % 2 == 0:
        common //= 2
    while common % 5 == 0:
        common //= 5
    return common
