"""A certification manifest as data: which rows, with which limits, and what the gate demands of them."""

from __future__ import annotations

import os
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from .manifest_document import EntryDocument, ManifestDocument, SettingsDocument
from .reader import digest, read_bytes
from .validation import validate
from .yaml_nodes import line_table, load_nodes

TIMEOUT = Fraction(300)
MEMORY = 4 << 30


@dataclass(frozen=True)
class Search:
    """Search for the certified radius; see `manifest_document.RadiusDocument`."""

    most: Fraction
    resolution: Fraction
    floor: Fraction | None = None


@dataclass(frozen=True)
class Entry:
    """Policies times specifications, times radii.

    Attributes
    ----------
    policies, specifications : tuple of str
        Paths, globs and shipped names as they were written.
    radii : tuple of Fraction or None
        None is the specification's own.
    search : Search or None
    expected : tuple of str
        Verdicts that pass; empty is VERIFIED.
    value, margin : Fraction or None
        Floors.
    allow_unknown : bool or None
        None is what the specification says.
    timeout : Fraction
        Seconds.
    memory : int
        Bytes.
    spread : int or None
        Parts of a hard row; None is what the command says.
    options : dict of str
        Numerical options by name; only those that were given.
    line : int
    """

    policies: tuple[str, ...]
    specifications: tuple[str, ...]
    radii: tuple[Fraction | None, ...]
    search: Search | None
    expected: tuple[str, ...]
    value: Fraction | None
    margin: Fraction | None
    allow_unknown: bool | None
    timeout: Fraction
    memory: int
    spread: int | None
    options: dict[str, Any] = field(default_factory=dict)
    line: int = 0


@dataclass(frozen=True)
class Manifest:
    """A whole manifest.

    Attributes
    ----------
    entries : tuple of Entry
    source : str
        File it was read from.
    digest : str
        sha256 of its bytes.
    """

    entries: tuple[Entry, ...]
    source: str
    digest: str


def read_manifest(path: str | os.PathLike[str]) -> Manifest:
    """Read a manifest file.

    Parameters
    ----------
    path : path

    Returns
    -------
    Manifest

    Raises
    ------
    SpecificationError
        Naming file, line and remedy.
    """
    return parse_manifest(read_bytes(path), str(path))


def parse_manifest(content: bytes | str, source: str = "<text>") -> Manifest:
    """Read a manifest from bytes or text; `source` is its name for messages."""
    root = load_nodes(content, source)
    document = validate(ManifestDocument, root, source)
    lines = line_table(root)
    entries = [
        _entry(entry, document.defaults, lines.get(f"certify.{position}", 0))
        for position, entry in enumerate(document.certify)
    ]
    return Manifest(tuple(entries), source, digest(content))


def _entry(entry: EntryDocument, defaults: SettingsDocument, line: int) -> Entry:
    def said(name: str) -> Any:
        own = getattr(entry, name)
        return getattr(defaults, name) if own is None else own

    options: dict[str, Any] = {}
    for document in (defaults.options, entry.options):
        if document is not None:
            options |= document.model_dump(exclude_none=True)
    radii: tuple[Fraction | None, ...] = entry.epsilon or (() if entry.radius is not None else (None,))
    floors, search = entry.require, entry.radius
    return Entry(
        _texts(entry.policy),
        _texts(entry.specification),
        radii,
        None if search is None else Search(search.most, search.resolution, search.floor),
        _texts(entry.expect or ()),
        None if floors is None else floors.value,
        None if floors is None else floors.margin,
        said("allow_unknown"),
        said("timeout") or TIMEOUT,
        said("memory") or MEMORY,
        said("spread"),
        options,
        line,
    )


def _texts(given: Any) -> tuple[str, ...]:
    return (str(given),) if isinstance(given, str) else tuple(str(text) for text in given)
