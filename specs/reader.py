"""Files to data: specifications and plants, from a path, a shipped name or text."""

from __future__ import annotations

import difflib
import hashlib
import os
from pathlib import Path

from .builder import build_specification
from .documents import SpecificationDocument
from .errors import InputError, SpecificationError
from .exact import shown
from .plant_builder import Place, build_plant
from .plant_document import PlantDocument
from .specification import PlantDescription, Specification
from .validation import validate
from .yaml_nodes import MAX_BYTES, line_table, load_nodes

SHIPPED = Path(__file__).parent


def read_specification(path: str | os.PathLike[str]) -> Specification:
    """Read a specification file.

    Parameters
    ----------
    path : path
        As it should appear in messages; `find_specification` turns a shipped name into one.

    Returns
    -------
    Specification
        With `source` the path as given and `digest` of the bytes that were parsed.

    Raises
    ------
    SpecificationError
        Naming file, line and remedy.
    """
    return parse_specification(read_bytes(path), source=str(path))


def parse_specification(content: bytes | str, source: str = "<text>") -> Specification:
    """Read a specification from bytes or text.

    Parameters
    ----------
    content : bytes or str
    source : str
        Name for messages; a plant's path is relative to its folder.

    Returns
    -------
    Specification
    """
    root = load_nodes(content, source)
    document = validate(SpecificationDocument, root, source)
    return build_specification(document, Place(source, line_table(root)), digest(content))


def read_plant(path: str | os.PathLike[str]) -> PlantDescription:
    """Read a plant file; its name is the file's, unless it states one.

    Parameters
    ----------
    path : path

    Returns
    -------
    PlantDescription

    Raises
    ------
    SpecificationError
        Naming file, line and remedy.
    """
    return parse_plant(read_bytes(path), source=str(path), name=Path(path).stem)


def parse_plant(content: bytes | str, source: str = "<text>", name: str = "plant") -> PlantDescription:
    """Read a plant from bytes or text.

    Parameters
    ----------
    content : bytes or str
    source : str
        Name for messages.
    name : str
        The plant's name where the text states none.

    Returns
    -------
    PlantDescription
    """
    root = load_nodes(content, source)
    document = validate(PlantDocument, root, source)
    return build_plant(document, name, Place(source, line_table(root)))


def shipped_specifications() -> tuple[str, ...]:
    """Names of the specifications that come with the package, sorted."""
    return tuple(sorted(path.stem for path in SHIPPED.glob("*.yaml")))


def find_specification(name: str | os.PathLike[str]) -> Path:
    """Find a specification: a file as given, else a shipped one of that name.

    Parameters
    ----------
    name : str or path
        ``nav.yaml`` or ``nav``, or any path.

    Returns
    -------
    Path
        The file in the current folder where there is one.

    Raises
    ------
    InputError
        Listing the shipped specifications.
    """
    path = Path(name)
    candidates = [path] if path.suffix in (".yaml", ".yml") else [path, Path(f"{path}.yaml")]
    for candidate in candidates:
        if candidate.is_file():
            return candidate
    shipped = shipped_specifications()
    if path.parent == Path() and path.stem in shipped and path.suffix in ("", ".yaml"):
        return SHIPPED / f"{path.stem}.yaml"
    near = difflib.get_close_matches(path.stem, shipped, n=1)
    hint = f"did you mean {near[0]}? " if near else ""
    remedy = f"{hint}give a path to a file, or one of the shipped specifications: {', '.join(shipped)}"
    raise InputError(f"no specification {shown(str(name))} here or among the shipped ones", remedy=remedy)


def digest(content: bytes | str) -> str:
    """sha256 of a file's bytes, as lower-case hexadecimal; text counts as its UTF-8."""
    data = content.encode("utf-8", "surrogatepass") if isinstance(content, str) else content
    return hashlib.sha256(data).hexdigest()


def read_bytes(path: str | os.PathLike[str]) -> bytes:
    """The bytes of a text file, at most one more than it may have; SpecificationError where it cannot be read."""
    try:
        with open(path, "rb") as file:
            return file.read(MAX_BYTES + 1)
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise SpecificationError(
            f"cannot read the file: {reason}", where=str(path), remedy="check the path and its permissions"
        ) from None
