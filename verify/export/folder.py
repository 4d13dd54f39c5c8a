"""The folder of an export: networks, queries, the list of both; whole or not there.

::

    onnx/NETWORK.onnx
    vnnlib/QUERY.vnnlib      version 1.0
    vnnlib2/QUERY.vnnlib     version 2.0, the network is called N
    instances.csv            onnx,vnnlib,timeout
    claims.json              what every query asks, exactly, with digests
    README.md                what an answer means
"""

from __future__ import annotations

import contextlib
import hashlib
import json
import secrets
import shutil
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...specs.errors import InputError
from ...specs.files import write_atomically
from ...specs.folders import make_folder, unwritable
from ...specs.queries import Query
from ...specs.vnnlib_writer import vnnlib_1_text, vnnlib_2_text

FORMAT = "setrl-export/1"
"""Name of the layout of `claims.json`; it changes when a key changes its meaning or goes."""

SECONDS = 60
"""The time limit that `instances.csv` suggests."""


@dataclass(frozen=True)
class Asked:
    """One query: its file name without suffix, and what `claims.json` says about it."""

    name: str
    query: Query
    about: dict[str, Any]


@dataclass(frozen=True)
class Part:
    """One network with its queries.

    Attributes
    ----------
    name : str
        File name without suffix.
    content : bytes
        Of the ONNX file.
    about : dict
        What `claims.json` says about it.
    queries : tuple of Asked
    """

    name: str
    content: bytes
    about: dict[str, Any]
    queries: tuple[Asked, ...]


@dataclass(frozen=True)
class Exported:
    """How much was written."""

    networks: int
    queries: int


def require_place(place: Path) -> None:
    """Refuse a place that holds something else than an export, before anything is computed.

    Raises
    ------
    InputError
        Something is there that is not to be replaced.
    """
    if place.is_symlink() or (place.exists() and not place.is_dir()):
        raise InputError("a folder is required, this is none", where=str(place), remedy="choose another folder")
    if place.is_dir() and any(place.iterdir()) and not _is_export(place):
        raise InputError(
            "the folder is not empty, and no export: it is not replaced",
            where=str(place),
            remedy="choose another folder with --out",
        )


def write_export(place: Path, parts: Iterable[Part], head: dict[str, Any], readme: str) -> Exported:
    """Write an export; an older one in its place is replaced.

    Parameters
    ----------
    place : Path
        A folder that is not there, is empty, or is an export.
    parts : iterable of Part
        Written one after the other; names are different.
    head : dict
        The beginning of `claims.json`.
    readme : str

    Returns
    -------
    Exported

    Raises
    ------
    InputError
        Something else is there, or it cannot be written.
    """
    require_place(place)
    networks: list[dict[str, Any]] = []
    queries: list[dict[str, Any]] = []
    with _replacing(place) as folder:
        for kind in ("onnx", "vnnlib", "vnnlib2"):
            make_folder(folder / kind)
        for part in parts:
            networks.append({"onnx": f"onnx/{part.name}.onnx", **_digest(part.content), **part.about})
            write_atomically(folder / "onnx" / f"{part.name}.onnx", part.content)
            queries += [_write_query(folder, part, asked) for asked in part.queries]
        data = {"format": FORMAT, **head, "networks": networks, "queries": queries}
        rows = "".join(f"{entry['onnx']},{entry['vnnlib']},{SECONDS}\n" for entry in queries)
        write_atomically(folder / "instances.csv", rows.encode())
        write_atomically(folder / "README.md", readme.encode())
        text = json.dumps(data, indent=1, ensure_ascii=False, allow_nan=False)
        write_atomically(folder / "claims.json", f"{text}\n".encode())
    return Exported(len(networks), len(queries))


def _write_query(folder: Path, part: Part, asked: Asked) -> dict[str, Any]:
    texts = {"vnnlib": vnnlib_1_text(asked.query), "vnnlib2": vnnlib_2_text(asked.query)}
    entry: dict[str, Any] = {"query": asked.name, "onnx": f"onnx/{part.name}.onnx"}
    for kind, text in texts.items():
        write_atomically(folder / kind / f"{asked.name}.vnnlib", text.encode())
        entry[kind] = f"{kind}/{asked.name}.vnnlib"
        entry[f"{kind}_sha256"] = hashlib.sha256(text.encode()).hexdigest()
    return {**entry, **asked.about}


def _digest(content: bytes) -> dict[str, str]:
    return {"sha256": hashlib.sha256(content).hexdigest()}


def _is_export(place: Path) -> bool:
    try:
        data = json.loads((place / "claims.json").read_bytes())
    except (OSError, ValueError, RecursionError):
        return False
    return isinstance(data, dict) and str(data.get("format", "")).startswith("setrl-export/")


@contextlib.contextmanager
def _replacing(place: Path) -> Iterator[Path]:
    """A folder beside a place that takes the place in the end; after an error the place is as it was."""
    place = place.absolute()
    make_folder(place.parent)
    token = secrets.token_hex(6)
    fresh, old = (place.with_name(f".{place.name[:100]}.{token}.{kind}") for kind in ("tmp", "old"))
    try:
        make_folder(fresh)
        yield fresh
        try:
            if place.exists():
                place.rename(old)
            fresh.rename(place)
        except OSError as error:
            if old.exists() and not place.exists():
                old.rename(place)
            raise unwritable(place, error) from error
    finally:
        for leftover in (fresh, old):
            shutil.rmtree(leftover, ignore_errors=True)
