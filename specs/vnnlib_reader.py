"""VNN-LIB text, 1.0 or 2.0, as a `Query`: exact, or an error that names the line.

Of the language: one network with one input and one output, linear arithmetic, ``<=``, ``>=``, ``==``, ``and``, ``or``.
Strict comparisons are refused, because a query is closed: rounding ``<`` to ``<=`` would turn an answer around.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from fractions import Fraction
from math import prod
from typing import Any

from .errors import InputError
from .exact import shown
from .queries import Query
from .vnnlib_cases import cases_of
from .vnnlib_logic import Formula, Linear, Normalizer, combine, multiply
from .vnnlib_numbers import read_number
from .vnnlib_syntax import close_lists, leading_comment, text_of

MOST_VARIABLES = 1_000_000
TYPES = ("real", "float32", "float64")
"""Element types of 2.0; the answer says for which arithmetic it holds, whatever the file declares."""

_CONSTANT = re.compile(r"([XY])_(0|[1-9][0-9]{0,6})", re.ASCII)
_NAME = re.compile(r"[A-Za-z][A-Za-z0-9_]*", re.ASCII)
_ENTRY = re.compile(r"([A-Za-z][A-Za-z0-9_]*)\[([0-9,\s]*)\]", re.ASCII)
_NUMERIC = re.compile(r"[+-]?\.?[0-9]", re.ASCII)


def parse_vnnlib(content: bytes | str, source: str = "query") -> Query:
    """Read a query.

    Parameters
    ----------
    content : bytes or str
    source : str
        Name of the file, for messages.

    Returns
    -------
    Query
        Its cases have boxes that are not empty; a case whose bounds contradict each other is left out, and the comment
        says so.

    Raises
    ------
    InputError
        With file and line: anything that is not understood completely, an input without finite bounds, or a text that
        is larger, nested deeper or has more cases than the caps.
    """
    text = text_of(content, source)
    reader = _Reader()
    close_lists(text, source, reader.close)
    try:
        inputs, outputs = reader.shapes()
        if not reader.asserted:
            raise InputError("nothing is asserted", remedy="add (assert ...)")
        found = cases_of(reader.asserted, prod(inputs), reader.normalizer)
    except InputError as error:
        raise error.at(source) from None
    comment = "\n".join(line for line in (leading_comment(text), found.note) if line)
    return Query(inputs, outputs, found.cases, comment)


@dataclass(frozen=True)
class _Declared:
    """``(declare-input X real [1,4])``: which side, name, shape."""

    side: str
    name: str
    shape: tuple[int, ...]


class _Done:
    """What an outermost list becomes."""


class _Reader:
    """Declarations and assertions in the order of the file."""

    def __init__(self) -> None:
        self.version = ""
        self.constants: dict[str, set[int]] = {"X": set(), "Y": set()}
        self.networks: dict[str, _Declared] = {}  # by side
        self.names: dict[str, _Declared] = {}
        self.asserted: list[Formula] = []
        self.normalizer = Normalizer()
        self.heads: dict[str, Callable[[list[Any]], Any]] = {
            "vnnlib-version": self._version,
            "declare-const": self._constant,
            "declare-network": self._network,
            "declare-input": lambda items: self._tensor("X", items),
            "declare-output": lambda items: self._tensor("Y", items),
            "assert": self._assertion,
            "and": lambda items: self.normalizer.conjunction([_formula(item) for item in items]),
            "or": lambda items: self.normalizer.disjunction([_formula(item) for item in items]),
            "<=": lambda items: self._comparison(items, (1,)),
            ">=": lambda items: self._comparison(items, (-1,)),
            "==": lambda items: self._comparison(items, (1, -1)),
            "=": lambda items: self._comparison(items, (1, -1)),
            "+": lambda items: combine([(1, self._form(item)) for item in items]),
            "-": self._difference,
            "*": lambda items: multiply([self._form(item) for item in items]),
        }

    def close(self, items: list[Any], outermost: bool) -> Any:
        """What a list means."""
        head = items[0] if items else ""
        if not isinstance(head, str) or head not in self.heads:
            name = shown(head) if isinstance(head, str) and head else "a list without a name"
            raise InputError(f"{name} is not supported", remedy=f"supported: {', '.join(self.heads)}")
        if len(items) == 1:
            raise InputError(f"({head}) without anything", remedy="is the file complete?")
        value = self.heads[head](items[1:])
        if outermost != isinstance(value, _Done):
            place = "only allowed outside of other lists" if isinstance(value, _Done) else "no statement"
            raise InputError(f"({head} ...) is {place}", remedy="write (assert ...)")
        return value

    def shapes(self) -> tuple[tuple[int, ...], tuple[int, ...]]:
        """Shapes of input and output."""
        if self.version == "2.0":
            if not self.networks:
                raise InputError("no network is declared", remedy="add (declare-network ...)")
            return self.networks["X"].shape, self.networks["Y"].shape
        sizes = []
        for kind, what in (("X", "input"), ("Y", "output")):
            places = self.constants[kind]
            if not places:
                raise InputError(f"no {what} is declared", remedy=f"add (declare-const {kind}_0 Real)")
            if max(places) != len(places) - 1:
                missing = next(index for index in range(len(places)) if index not in places)
                raise InputError(f"{kind}_{missing} is not declared", remedy="declare all entries, from 0")
            sizes.append((1, len(places)))
        return sizes[0], sizes[1]

    def _version(self, items: list[Any]) -> _Done:
        if self.version or self.asserted or self.constants["X"] or self.constants["Y"]:
            raise InputError("the version is the first statement", remedy="write it once, at the top")
        if items not in (["<1.0>"], ["<2.0>"]):
            raise InputError("this version is not supported", remedy="write (vnnlib-version <2.0>)")
        self.version = items[0][1:-1]
        return _Done()

    def _constant(self, items: list[Any]) -> _Done:
        if self.version == "2.0":
            raise InputError("declare-const is of version 1.0", remedy="use declare-network")
        match items:
            case [str() as name, "Real"] if found := _CONSTANT.fullmatch(name):
                index, places = int(found[2]), self.constants[found[1]]
            case _:
                raise InputError("not a declaration", remedy="write (declare-const X_0 Real), and Y_0 for outputs")
        if index in places:
            raise InputError(f"{name} is declared twice", remedy="declare it once")
        if index >= MOST_VARIABLES:
            raise InputError(f"more than {MOST_VARIABLES} variables", remedy="is this the right network?")
        places.add(index)
        return _Done()

    def _tensor(self, side: str, items: list[Any]) -> _Declared:
        match items:
            case [str() as name, str() as kind, str() as shape] if _NAME.fullmatch(name) and shape.startswith("["):
                pass
            case _:
                raise InputError("not a declaration", remedy="write (declare-input X real [1,4])")
        if kind not in TYPES:
            raise InputError(f"the type {shown(kind)} is not supported", remedy=f"supported: {', '.join(TYPES)}")
        sizes = _whole_numbers(shape[1:-1])
        if not all(0 < size <= MOST_VARIABLES for size in sizes) or prod(sizes) > MOST_VARIABLES:
            raise InputError(f"the shape {shown(shape)} is not supported", remedy=f"1 to {MOST_VARIABLES} entries")
        return _Declared(side, name, sizes)

    def _network(self, items: list[Any]) -> _Done:
        if self.version != "2.0":
            raise InputError("declare-network is of version 2.0", remedy="put (vnnlib-version <2.0>) at the top")
        if self.networks:
            raise InputError("several networks", remedy="only queries about one network are supported")
        match items:
            case [str() as name, _Declared(side="X") as first, _Declared(side="Y") as second] if _NAME.fullmatch(name):
                pass
            case _:
                raise InputError("not one network with one input and one output", remedy="declare these and no more")
        if first.name == second.name:
            raise InputError(f"{first.name} is declared twice", remedy="give the output another name")
        self.networks = {"X": first, "Y": second}
        self.names = {first.name: first, second.name: second}
        return _Done()

    def _assertion(self, items: list[Any]) -> _Done:
        if len(items) != 1:
            raise InputError(f"assert takes one formula, received {len(items)}", remedy="use (and ...)")
        self.asserted.append(_formula(items[0]))
        return _Done()

    def _comparison(self, items: list[Any], signs: tuple[int, ...]) -> Formula:
        """``sign (left - right) <= 0`` for every sign."""
        if len(items) != 2:
            raise InputError(f"a comparison has two sides, received {len(items)}", remedy="compare two at a time")
        left, right = self._form(items[0]), self._form(items[1])
        return Formula((tuple(combine([(sign, left), (-sign, right)]) for sign in signs),))

    def _difference(self, items: list[Any]) -> Linear:
        forms = [self._form(item) for item in items]
        rest = [(-1, form) for form in forms[1:]]
        return combine([(-1, forms[0])] if len(forms) == 1 else [(1, forms[0]), *rest])

    def _form(self, item: Any) -> Linear:
        """A number, a variable, or arithmetic that is closed already."""
        if isinstance(item, Linear):
            return item
        if not isinstance(item, str):
            raise InputError("a formula or a declaration where arithmetic is required", remedy="compare numbers")
        if _NUMERIC.match(item):
            return Linear({}, read_number(item))
        return Linear({self._variable(item): Fraction(1)}, Fraction(0))

    def _variable(self, text: str) -> tuple[str, int]:
        if self.version != "2.0":
            found = _CONSTANT.fullmatch(text)
            if found is None or int(found[2]) not in self.constants[found[1]]:
                raise InputError(f"{shown(text)} is not declared", remedy="declare it before it is used")
            return found[1], int(found[2])
        entry = _ENTRY.fullmatch(text)
        declared = self.names.get(text if entry is None else entry[1])
        if declared is None:
            raise InputError(f"{shown(text)} is not declared", remedy="declare the network before it is used")
        places = () if entry is None else _whole_numbers(entry[2])
        index = 0
        if len(places) != len(declared.shape) or (entry is not None and not places):
            raise InputError(f"{shown(text)} has not {len(declared.shape)} indices", remedy="name one entry")
        for place, size in zip(places, declared.shape, strict=True):
            if place >= size:
                raise InputError(f"{shown(text)} is outside of the shape", remedy="indices begin at 0")
            index = index * size + place
        return declared.side, index


def _formula(item: Any) -> Formula:
    if not isinstance(item, Formula):
        raise InputError("arithmetic or a name where a formula is required", remedy="write a comparison")
    return item


def _whole_numbers(text: str) -> tuple[int, ...]:
    """``1, 4`` as whole numbers; nothing for an empty text."""
    parts: Sequence[str] = [part.strip() for part in text.split(",")] if text.strip() else []
    if not all(part.isdigit() and len(part) <= 9 for part in parts) or len(parts) > 32:
        raise InputError(f"[{text[:60]}] is no list of whole numbers", remedy="write [1,4]")
    return tuple(int(part) for part in parts)
