"""Node tree to document; the validator's errors become one line with file, line, key and remedy."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any, TypeVar

from pydantic import ValidationError

from .errors import SpecificationError
from .plant_document import Document
from .yaml_nodes import MappingNode, Node, SequenceNode, plain_data

Model = TypeVar("Model", bound=Document)

_GENERIC = {
    "list_type": ("expected a list", "write [a, b] or one '- ' line per item"),
    "dict_type": ("expected a mapping", "write {key: value} or key: value lines"),
    "too_short": ("expected at least one entry", "add one, or remove the key"),
}


def validate(model: type[Model], root: MappingNode, source: str) -> Model:
    """Read a node tree as a document.

    Parameters
    ----------
    model : type of Document
    root : MappingNode
    source : str
        Name of the file, for messages.

    Returns
    -------
    Document
        Of the given type.

    Raises
    ------
    SpecificationError
        For the error nearest to the top of the file; a missing key only where nothing else is wrong, since it is
        often the other half of a misspelled one.
    """
    try:
        return model.model_validate(plain_data(root))
    except ValidationError as invalid:
        errors = [_described(error, root, source) for error in invalid.errors(include_url=False, include_input=False)]
        _, _, chosen = min(errors, key=lambda entry: entry[:2])
        raise chosen from None


def _described(error: Any, root: MappingNode, source: str) -> tuple[bool, int, SpecificationError]:
    context = error.get("ctx", {})
    place = list(error["loc"])
    if context.get("key") is not None:
        place.append(context["key"])
    missing = error["type"] == "missing"
    line, path = _locate(root, place)
    if missing:
        message = f"the key {place[-1]!r} is missing"
        remedy = f"add '{place[-1]}: ...'"
    elif error["type"] == "setrl":
        message, remedy = context["message"], context["remedy"]
    elif error["type"] == "setrl_kind":
        message, remedy = error["msg"].split("\n")
    else:
        message, remedy = _GENERIC.get(error["type"], (error["msg"], "see 'setrl schema' for the language"))
    text = f"{path}: {message}" if path else message
    return missing, line, SpecificationError(text, where=f"{source}:{line}", remedy=remedy or None)


def _locate(root: MappingNode, place: Sequence[int | str]) -> tuple[int, str]:
    """Line and dotted path of an error's place; elements that are no keys of the file (union tags) are skipped."""
    node: Node = root
    line = min(root.key_lines.values(), default=root.line)
    path: list[str] = []
    for element in place:
        if isinstance(node, MappingNode) and element in node.entries:
            line, node = node.key_lines[str(element)], node.entries[str(element)]
        elif isinstance(node, SequenceNode) and isinstance(element, int) and element < len(node.items):
            node = node.items[element]
            line = node.line
        else:
            continue
        path.append(str(element))
    return line, ".".join(path)
