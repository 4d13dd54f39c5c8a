"""The files that a specification consists of, so that a copy of them elsewhere means the same."""

from __future__ import annotations

import os
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

from ..specs.errors import InputError
from ..specs.files import write_atomically
from ..specs.reader import digest
from ..specs.specification import PlantDescription, Specification
from .plant import load_plant


@dataclass(frozen=True)
class InputFiles:
    """A specification and its plant, by their places in a folder of their own.

    Attributes
    ----------
    files : dict of place to bytes
    specification : str
        Place of the specification, with /.
    plant : str
        Place of the plant; "" where the specification holds it.
    plant_kind : str
        How the specification names its plant: "inline", "shipped", "absolute" (the copy is not what it reads then) or
        "relative".
    folders : tuple of str
        Folders without a file that a relative path goes through.
    """

    files: dict[str, bytes]
    specification: str
    plant: str
    plant_kind: str
    folders: tuple[str, ...]

    @property
    def plant_digest(self) -> str:
        """sha256 of the plant file's bytes; "" where the specification holds it."""
        return digest(self.files[self.plant]) if self.plant else ""

    def write(self, folder: Path) -> Path:
        """Write the files below a folder, which is made; returns the specification's path there."""
        for name, data in self.files.items():
            target = folder / name
            target.parent.mkdir(parents=True, exist_ok=True)
            write_atomically(target, data)
        for name in self.folders:
            (folder / name).mkdir(parents=True, exist_ok=True)
        return folder / self.specification


def input_files(specification: Specification) -> InputFiles:
    """The files of a specification that was read from one.

    Parameters
    ----------
    specification : Specification

    Returns
    -------
    InputFiles

    Raises
    ------
    InputError
        It was not read from a file, or the file has changed since; or there is no such plant.
    """
    source = Path(specification.source)
    content = source.read_bytes() if source.is_file() else b""
    if digest(content) != specification.digest:
        raise InputError(
            "the specification is needed as a file, with the bytes that were read",
            where=specification.source or "specification",
            remedy="write it to a file, and do not change it while it is read",
        )
    folder, plant, kind = PurePosixPath(), specification.plant, "inline"
    files: dict[str, bytes] = {}
    copy, way = "", list[str]()
    if isinstance(plant, str):
        found = Path(named_plant(specification).source)
        parts = PurePosixPath(plant).parts
        if "/" not in plant and not plant.endswith((".yaml", ".yml")):
            kind, copy = "shipped", f"plants/{plant}.yaml"
        elif PurePosixPath(plant).is_absolute():
            kind, copy = "absolute", f"plants/{found.name}"
        else:
            kind = "relative"
            depths = [parts[: n + 1].count("..") * 2 - (n + 1) for n in range(len(parts))]
            folder = PurePosixPath(*["specification"] * max(0, *depths))
            copy = os.path.normpath(folder / plant)
            way = [str(folder.joinpath(*parts[:n])) for n in range(1, len(parts))]  # a/../b.yaml needs a folder a
        files[copy] = found.read_bytes()
    name = str(folder / source.name)
    if name in files:
        raise InputError("specification and plant have one name", where=str(source), remedy="rename one of them")
    return InputFiles({**files, name: content}, name, copy, kind, tuple(way))


def named_plant(specification: Specification) -> PlantDescription:
    """The plant that a specification names, read from its file."""
    if not isinstance(specification.plant, str):
        raise AssertionError("the plant is inside the specification")
    return load_plant(specification.plant, Path(specification.source).parent).description
