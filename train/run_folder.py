"""The folder of a training run: what was asked for, with which files, and who may write into it.

::

    runs/<name>/
    |-- configuration.json   options, digests, versions; written last: a folder that has it is complete
    |-- inputs/              the specification and its plant, at the same places relative to each other
    |-- checkpoints/         newest and the one before it
    |-- curves.csv, curves.png
    |-- events/              for TensorBoard
    |-- seed-<n>/            policy.onnx, policy.cert, report.txt, report.json
    |-- policy.onnx          of the best seed
    `-- summary.json         which one that is, and what every seed is worth

Nothing in it depends on where it lies: it can be copied to another machine and continued there.
"""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath
from typing import TYPE_CHECKING, Any

from ..models.input_files import input_files, named_plant
from ..specs.errors import InputError, SetrlError
from ..specs.files import write_atomically
from ..specs.folders import locked, unwritable
from ..specs.reader import digest, read_plant, read_specification
from ..specs.specification import PlantDescription, Specification
from ..specs.versions import versions

if TYPE_CHECKING:
    from .options import TrainingOptions

FORMAT = "setrl-run/1"
CONFIGURATION = "configuration.json"
INPUTS = "inputs"
LARGEST = 1 << 22
"""Bytes of a configuration that are read; one has a few thousand."""

_PACKAGES = ("torch", "numpy", "onnx", "onnxruntime")


@dataclass(frozen=True)
class RunFolder:
    """One run's folder.

    Attributes
    ----------
    path : Path
    configuration : mapping
        What configuration.json holds: the keys given to `create` ("options" among them) and format, specification,
        plant, versions.
    """

    path: Path
    configuration: Mapping[str, Any]

    @classmethod
    def create(
        cls, path: str | os.PathLike[str], configuration: Mapping[str, Any], specification: Specification
    ) -> RunFolder:
        """Make the folder of a new run.

        Parameters
        ----------
        path : path
            Missing, or an empty folder. Folders above it are made.
        configuration : mapping
            Plain data; its key "options" holds `options.plain` of the options.
        specification : Specification
            As read from a file, which is copied together with its plant's.

        Returns
        -------
        RunFolder

        Raises
        ------
        InputError
            There is something already, or nothing can be written there.
        """
        place = Path(path)
        inputs = input_files(specification)
        entries = {
            "specification": {"file": inputs.specification, "sha256": specification.digest},
            "plant": {"kind": inputs.plant_kind, "file": inputs.plant, "sha256": inputs.plant_digest},
        }
        content = {"format": FORMAT, **configuration, **entries, "versions": versions(_PACKAGES)}
        made = _make(place)
        try:
            inputs.write(place / INPUTS)
            text = json.dumps(content, indent=2, allow_nan=False) + "\n"
            write_atomically(place / CONFIGURATION, text.encode())
        except BaseException as error:
            # half a run would be in the way of the next attempt
            shutil.rmtree(place if made else place / INPUTS, ignore_errors=True)
            if isinstance(error, OSError):
                raise unwritable(place, error) from None
            raise
        return cls(place, json.loads(text))

    @classmethod
    def open(cls, path: str | os.PathLike[str]) -> RunFolder:
        """Read the configuration of a run.

        Parameters
        ----------
        path : path

        Returns
        -------
        RunFolder

        Raises
        ------
        InputError
            This is no run's folder, or its configuration is damaged.
        """
        place = Path(path)
        file = place / CONFIGURATION
        if not place.is_dir():
            raise InputError("there is no such folder", where=str(path), remedy=f"runs here: {_neighbours(place)}")
        if not file.is_file():
            raise InputError(
                f"this is no folder of a training run: it has no {CONFIGURATION}",
                where=str(path),
                remedy="setrl train --name NAME makes one",
            )
        return cls(place, _configuration(file))

    @property
    def checkpoints(self) -> Path:
        """Folder for `checkpoints.save`."""
        return self.path / "checkpoints"

    @property
    def curves(self) -> Path:
        """Learning curves, comma-separated."""
        return self.path / "curves.csv"

    @property
    def curves_picture(self) -> Path:
        """Learning curves, drawn."""
        return self.path / "curves.png"

    @property
    def events(self) -> Path:
        """Folder for TensorBoard."""
        return self.path / "events"

    @property
    def policy(self) -> Path:
        """Policy of the best seed."""
        return self.path / "policy.onnx"

    @property
    def summary(self) -> Path:
        """Which seed is the best, and what every seed is worth."""
        return self.path / "summary.json"

    def seed(self, number: int) -> Path:
        """Folder of one seed's policy and report."""
        return self.path / f"seed-{number}"

    @property
    def specification(self) -> Path:
        """The run's own copy of the specification."""
        return self.path / INPUTS / str(self.configuration["specification"]["file"])

    def options(self) -> TrainingOptions:
        """The options of the run.

        Raises
        ------
        SetrlError
            The configuration holds options that this version does not know; names the file.
        """
        from .options import options_from

        try:
            return options_from(dict(self.configuration["options"]))
        except SetrlError as error:
            raise error.at(str(self.path / CONFIGURATION)) from None

    def read_specification(self) -> Specification:
        """The specification that the run was started with, from its copy.

        Returns
        -------
        Specification

        Raises
        ------
        InputError
            A copy was changed, or the plant that it names outside of the run is no longer the same.
        """
        stated = self.configuration["specification"]
        specification = read_specification(self.specification)
        if specification.digest != stated["sha256"]:
            raise _changed(self.specification)
        plant = self.configuration["plant"]
        if plant["kind"] != "inline":
            copy = self.path / INPUTS / plant["file"]
            if not copy.is_file() or digest(copy.read_bytes()) != plant["sha256"]:
                raise _changed(copy)
            if plant["kind"] != "relative" and _said(named_plant(specification)) != _said(read_plant(copy)):
                raise InputError(
                    f"the plant {specification.plant} is no longer the one of this run, which is in {copy}",
                    where=str(self.path),
                    remedy=f"go on with setrl {self.configuration['versions'].get('setrl')} and the plant file of then",
                )
        return specification

    def version_changes(self) -> list[str]:
        """What is installed in another version than the run was started with; results may differ in the last bits."""
        then, now = self.configuration["versions"], versions(_PACKAGES)
        return [f"{name} {then[name]} then, {now.get(name)} now" for name in then if then[name] != now.get(name)]

    @contextmanager
    def locked(self) -> Iterator[None]:
        """Keep other processes from writing this run; the system ends the lock of a process that dies.

        Raises
        ------
        InputError
            Another process is writing, or the folder cannot be written.
        """
        with locked(self.path, "run"):
            yield


def _make(place: Path) -> bool:
    """Make the folder; whether it is new. What is there is never written into."""
    if (place / CONFIGURATION).exists():
        raise InputError(
            "there is a run of this name",
            where=str(place),
            remedy=f"choose another --name, or continue it: setrl train --resume {place}",
        )
    try:
        made = not place.exists()
        place.mkdir(parents=True, exist_ok=True)
        if next(place.iterdir(), None) is not None:
            raise InputError(
                "the folder is not empty", where=str(place), remedy="choose another --name, or delete the folder"
            )
    except OSError as error:
        raise unwritable(place, error) from None
    return made


def _said(plant: PlantDescription) -> PlantDescription:
    """A plant without where it was read from."""
    return replace(plant, source="", lines={}, description="")


def _configuration(file: Path) -> dict[str, Any]:
    remedy = "put the file back as it was, or start again under another --name"
    try:
        with file.open("rb") as opened:
            content = opened.read(LARGEST + 1)
        data = json.loads(content)
    except OSError as error:
        reason = error.strerror or str(error)
        raise InputError(f"cannot read the file: {reason}", where=str(file), remedy="check its permissions") from None
    except (ValueError, RecursionError):
        raise InputError("the configuration is damaged: it is no JSON", where=str(file), remedy=remedy) from None
    if not isinstance(data, dict) or data.get("format") != FORMAT:
        received = data.get("format", "none") if isinstance(data, dict) else "none"
        raise InputError(
            f"the format {FORMAT} is required, received {str(received)[:40]!r}",
            where=str(file),
            remedy="the run was made by another version of setrl, or this is another program's file",
        )
    for key, names in {"options": (), "specification": ("file", "sha256"), "plant": ("kind", "file", "sha256")}.items():
        entry = data.get(key)
        if not isinstance(entry, dict) or not all(isinstance(entry.get(name), str) for name in names):
            raise InputError(f"the configuration is damaged: {key} is missing", where=str(file), remedy=remedy)
        place = PurePosixPath(entry["file"]) if "file" in names else PurePosixPath()
        if place.is_absolute() or ".." in place.parts:
            raise InputError(f"{key} is not inside the run's folder", where=str(file), remedy=remedy)
    if not isinstance(data.get("versions"), dict):
        raise InputError("the configuration is damaged: versions is missing", where=str(file), remedy=remedy)
    return data


def _neighbours(place: Path) -> str:
    found = sorted(entry.parent.name for entry in place.parent.glob(f"*/{CONFIGURATION}"))
    return ", ".join(found[:20]) or "none"


def _changed(file: Path) -> InputError:
    return InputError(
        "the file is not the one that the run was started with",
        where=str(file),
        remedy="put it back, or start a new run with the changed one",
    )
