"""Where external verifiers are installed: an environment of their own, which `make verifiers` makes."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

from ...specs.errors import UsageError

VARIABLE = "SETRL_VERIFIERS"
FOLDER = ".verifiers"


def verifiers_folder() -> Path:
    """The environment: what ``SETRL_VERIFIERS`` names, else ``.verifiers`` in the current folder or beside setrl."""
    given = os.environ.get(VARIABLE)
    if given:
        return Path(given).absolute()
    here = Path.cwd() / FOLDER
    return here if here.is_dir() else Path(__file__).resolve().parents[2] / FOLDER


def program(name: str, package: str) -> Path:
    """A program of that environment.

    Raises
    ------
    UsageError
        It is not there.
    """
    path = verifiers_folder() / "bin" / name
    if not os.access(path, os.X_OK):
        raise UsageError(
            f"{package} is not installed",
            where=str(path),
            remedy=f"make verifiers, or name an environment that has it: {VARIABLE}=FOLDER",
        )
    return path


def package_version(package: str) -> str:
    """``name version`` of a package in that environment, asked of its own Python."""
    asked = f"import importlib.metadata as m; print(m.version({package!r}))"
    python = program("python", package)
    ended = subprocess.run([str(python), "-I", "-c", asked], capture_output=True, text=True)
    if ended.returncode != 0:
        raise UsageError(f"{package} is not installed", where=str(verifiers_folder()), remedy="make verifiers")
    return f"{package} {ended.stdout.strip()}"
