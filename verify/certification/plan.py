"""From a manifest to rows: globs are resolved, files are read once, every row gets its key."""

from __future__ import annotations

import glob
import hashlib
import json
import os
import platform
from collections.abc import Iterable
from dataclasses import dataclass, field
from fractions import Fraction
from pathlib import Path
from typing import Any, NoReturn

from ...models.input_files import InputFiles, input_files
from ...specs.errors import InputError, SetrlError, SpecificationError
from ...specs.exact import decimal_text, shown
from ...specs.manifest import Entry, Manifest, Search
from ...specs.reader import SHIPPED, digest, read_bytes, read_specification, shipped_specifications
from ...specs.versions import source_digest, versions
from ..runtime_error import runtime_error, runtime_name
from .document import Subject
from .question import Question

PACKAGES = ("numpy", "onnx", "onnxruntime", "python-flint")
MOST_ROWS = 10_000
MOST_POLICY_BYTES = 64 << 20
"""As the reader of policies: what is larger is refused there, with its reason, and need not be read here."""


@dataclass(frozen=True)
class Planned:
    """A row before it is decided.

    Attributes
    ----------
    name, key : str
        See `document.Row`.
    entry : Entry
    policy, specification, plant : Subject
    epsilon : Fraction or None
    search : Search or None
    allow_unknown : bool
    question : Question or None
        None where a file cannot be used; then `problem` says why.
    problem : str
    """

    name: str
    key: str
    entry: Entry
    policy: Subject
    specification: Subject
    plant: Subject
    epsilon: Fraction | None
    search: Search | None
    allow_unknown: bool
    question: Question | None
    problem: str = ""


@dataclass
class _Files:
    """Files that were read, by path: many rows share one."""

    contracts: dict[Path, Any] = field(default_factory=dict)
    policies: dict[Path, tuple[bytes, str]] = field(default_factory=dict)

    def contract(self, path: Path) -> tuple[InputFiles | None, str, bool, str, str]:
        """Files of a specification, its digest, whether it allows UNKNOWN, its plant's name; and what is wrong."""
        if path not in self.contracts:
            try:
                read = read_specification(path)
                plant = read.plant if isinstance(read.plant, str) else ""
                self.contracts[path] = input_files(read), read.digest, read.allow_unknown, plant, ""
            except SetrlError as error:
                self.contracts[path] = None, _digest_or_none(path), False, "", str(error)
        found: tuple[InputFiles | None, str, bool, str, str] = self.contracts[path]
        return found

    def policy(self, path: Path) -> tuple[bytes, str]:
        """Bytes of a policy, and what is wrong: a file that cannot be read costs its own rows only."""
        if path not in self.policies:
            try:
                with path.open("rb") as file:
                    self.policies[path] = file.read(MOST_POLICY_BYTES + 1), ""
            except OSError as error:
                reason = error.strerror or type(error).__name__
                self.policies[path] = b"", str(InputError(f"cannot read the policy: {reason}", where=str(path)))
        return self.policies[path]


def current_versions() -> dict[str, str]:
    """What a verdict depends on beside its files: versions, the runtime's constants, the machine's architecture."""
    constants = " ".join(f"{precision} {runtime_error(precision):g}" for precision in ("float32", "float64"))
    return {
        **versions(PACKAGES),
        "runtime": f"{runtime_name()}, tanh and sigmoid off by at most {constants}",
        "architecture": platform.machine(),
        "source": source_digest(),
    }


def plan(manifest: Manifest, spread: int = 1) -> tuple[Planned, ...]:
    """All rows of a manifest, in its order.

    Parameters
    ----------
    manifest : Manifest
    spread : int
        Parts of a hard row where the manifest says nothing.

    Returns
    -------
    tuple of Planned

    Raises
    ------
    SpecificationError
        A path or a glob without a file, a row that appears twice; with the manifest's line.
    """
    folder = Path(manifest.source).parent
    files = _Files()
    known = current_versions()
    rows: dict[str, Planned] = {}
    for entry in manifest.entries:
        place = f"{manifest.source}:{entry.line}"
        policies = _unique(path for text in entry.policies for path in _policies(text, folder, place))
        contracts = _unique(path for text in entry.specifications for path in _specifications(text, folder, place))
        cases = [(radius, None) for radius in entry.radii] + ([(None, entry.search)] if entry.search else [])
        for policy_name, policy in policies:
            for contract_name, contract in contracts:
                for radius, search in cases:
                    row = _row(
                        entry, files, known, (policy_name, policy), (contract_name, contract), radius, search, spread
                    )
                    if row.name in rows:
                        _fail(
                            place, f"the row {shown(row.name, 200)} appears twice", "name the file or the radius once"
                        )
                    rows[row.name] = row
                    if len(rows) > MOST_ROWS:
                        _fail(place, f"the table has more than {MOST_ROWS} rows", "split the manifest")
    return tuple(rows.values())


def _row(
    entry: Entry,
    files: _Files,
    known: dict[str, str],
    policy: tuple[str, Path],
    contract: tuple[str, Path],
    radius: Fraction | None,
    search: Search | None,
    spread: int,
) -> Planned:
    inputs, contract_digest, allowed, plant, problem = files.contract(contract[1])
    content, unread = files.policy(policy[1])
    policy_digest, plant_digest = "" if unread else digest(content), inputs.plant_digest if inputs else ""
    parts = (entry.spread or spread) if search is None else 1
    identity = {
        "policy": policy_digest,
        "specification": contract_digest,
        "plant": plant_digest,
        "epsilon": None if radius is None else str(radius),
        "search": None if search is None else [str(search.most), str(search.resolution)],
        "options": entry.options,
        "timeout": str(entry.timeout),
        "memory": entry.memory,
        "spread": parts,
        "versions": known,
    }
    key = hashlib.sha256(json.dumps(identity, sort_keys=True).encode()).hexdigest()
    at = "" if radius is None else f" @ {decimal_text(radius)}"
    question = None
    if inputs is not None and not unread:
        question = Question(policy[1].name, content, inputs, radius, search, entry.options, float(entry.timeout), parts)
    return Planned(
        f"{policy[0]} x {contract[0]}{at}{' (certified radius)' if search else ''}",
        key,
        entry,
        Subject(policy[0], policy_digest),
        Subject(contract[0], contract_digest),
        Subject(plant, plant_digest),
        radius,
        search,
        allowed if entry.allow_unknown is None else entry.allow_unknown,
        question,
        problem or unread,
    )


def _policies(text: str, folder: Path, place: str) -> list[tuple[str, Path]]:
    return _matches(text, folder, place, "policy", "policies/*.onnx")


def _specifications(text: str, folder: Path, place: str) -> list[tuple[str, Path]]:
    """Files, or the shipped specification of that name; as for `setrl verify`, a file that is there comes first."""
    name = text.removesuffix(".yaml")
    if name in shipped_specifications() and not (folder / text).exists():
        own = folder / f"{name}.yaml"
        return [(own.name, own if own.is_file() else SHIPPED / own.name)]
    return _matches(text, folder, place, "specification", "specs/*.yaml")


def _matches(text: str, folder: Path, place: str, what: str, example: str) -> list[tuple[str, Path]]:
    try:
        return _found(text, folder, place, what, example)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        _fail(place, f"the {what} {shown(text)} cannot be looked for: {reason}", f"write a path; a glob is {example}")


def _found(text: str, folder: Path, place: str, what: str, example: str) -> list[tuple[str, Path]]:
    if (folder / text).is_file():  # also where its name has a character that globs use
        return [(Path(text).as_posix(), folder / text)]
    if not glob.has_magic(text):
        problem = "is a folder" if (folder / text).is_dir() else "does not exist"
        _fail(
            place, f"the {what} {shown(text)} {problem}", f"paths start at the manifest's folder; a glob is {example}"
        )
    names = sorted(glob.glob(text, root_dir=folder, recursive=True))
    found = [(Path(name).as_posix(), folder / name) for name in names if (folder / name).is_file()]
    if not found:
        _fail(place, f"no {what} matches {shown(text)}", f"paths start at the manifest's folder, {folder.absolute()}")
    return found


def _unique(found: Iterable[tuple[str, Path]]) -> list[tuple[str, Path]]:
    """A file that two globs of one entry match is one row."""
    return list({os.path.normpath(path): (name, path) for name, path in found}.values())


def _digest_or_none(path: Path) -> str:
    """sha256 of a specification that is wrong; "" where it cannot even be read."""
    try:
        return digest(read_bytes(path))
    except SetrlError:
        return ""


def _fail(place: str, message: str, remedy: str) -> NoReturn:
    raise SpecificationError(message, where=place, remedy=remedy)
