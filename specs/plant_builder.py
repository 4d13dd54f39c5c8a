"""Plant document to `PlantDescription`: names are unique, every state has its dynamics, every name is known."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NoReturn

from .errors import ExpressionError, SpecificationError
from .exact import shown
from .expression_parser import suggestion
from .expressions import Expression, parse_expression
from .plant_document import PlantDocument, PlantParameter
from .specification import PlantDescription


@dataclass(frozen=True)
class Place:
    """Where a document came from: turns a dotted key into ``file:line``."""

    source: str
    lines: Mapping[str, int]
    prefix: str = ""
    """Dotted path of the document within the file, with its dot."""

    def line(self, key: str) -> int:
        """Line of a key, or of the nearest key around it."""
        path = self.prefix + key
        while path and path not in self.lines:
            path = path.rpartition(".")[0]
        return self.lines.get(path, min(self.lines.values(), default=1))

    def fail(self, key: str, message: str, remedy: str) -> NoReturn:
        """Raise a `SpecificationError` at a key."""
        where = f"{self.source}:{self.line(key)}"
        raise SpecificationError(f"{self.prefix}{key}: {message}", where=where, remedy=remedy)

    def expression(self, key: str, text: str, names: tuple[str, ...] | None = None) -> Expression:
        """Parse an expression that stands at a key."""
        try:
            return parse_expression(text, names)
        except ExpressionError as error:
            self.fail(key, f"{error.where} of {shown(text)}: {error.message}", error.remedy or "")


def build_plant(document: PlantDocument, name: str, place: Place) -> PlantDescription:
    """Check a plant document and parse its dynamics.

    Parameters
    ----------
    document : PlantDocument
    name : str
        The plant's name where the document has none.
    place : Place

    Returns
    -------
    PlantDescription
    """
    names = _unique_names(document, place)
    discrete = _is_discrete(document, place)
    mark = "+" if discrete else ""
    given = {key.removesuffix("+"): key for key in document.dynamics}
    for state, key in given.items():
        if state not in document.states:
            place.fail(f"dynamics.{key}", f"{shown(state)} is not a state", suggestion(state, document.states))
    for state in document.states:
        if state not in given:
            place.fail("dynamics", f"the state {shown(state)} has no dynamics", f"add '{state}{mark}: ...'")
    dynamics = {
        state: place.expression(f"dynamics.{given[state]}", document.dynamics[given[state]], names)
        for state in document.states
    }
    return PlantDescription(
        name=document.name or name,
        states=document.states,
        inputs=document.inputs,
        disturbances=document.disturbances,
        parameters={
            key: (entry.value, entry.unit) if isinstance(entry, PlantParameter) else (entry, "")
            for key, entry in document.parameters.items()
        },
        dynamics=dynamics,
        discrete=discrete,
        description=document.description or "",
        source=place.source,
        lines={state: place.line(f"dynamics.{given[state]}") for state in document.states},
    )


def _unique_names(document: PlantDocument, place: Place) -> tuple[str, ...]:
    owner: dict[str, str] = {}
    for kind in ("states", "inputs", "disturbances", "parameters"):
        for name in getattr(document, kind):
            if name in owner:
                place.fail(f"{kind}.{name}", f"the name is also one of the {owner[name]}", "rename one of the two")
            owner[name] = kind
    return tuple(owner)


def _is_discrete(document: PlantDocument, place: Place) -> bool:
    marked = [key for key in document.dynamics if key.endswith("+")]
    for key in document.dynamics:
        if marked and not key.endswith("+"):
            remedy = "write all keys as 'x+' (next state) or none (time derivative)"
            place.fail(f"dynamics.{key}", f"mixes with {shown(marked[0])}", remedy)
    return bool(marked)
