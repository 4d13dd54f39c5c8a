"""Versions that numbers depend on."""

from __future__ import annotations

import hashlib
import platform
from collections.abc import Sequence
from contextlib import suppress
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

PACKAGE = Path(__file__).parent.parent


def versions(packages: Sequence[str]) -> dict[str, str]:
    """Version of setrl, of Python, and of those of the packages that are installed; none is imported for it."""
    from .. import __version__

    found = {"setrl": __version__, "python": platform.python_version()}
    for name in packages:
        with suppress(PackageNotFoundError):
            found[name] = version(name)
    return found


@cache
def source_digest() -> str:
    """sha256 over the files that decide a verdict: a checkout that was edited is another version.

    The rooms specs, models and verify, by relative path, in order; not what is compiled or cached.
    """
    total = hashlib.sha256()
    for room in ("specs", "models", "verify"):
        for path in sorted((PACKAGE / room).rglob("*")):
            if path.suffix in (".py", ".yaml") and "__pycache__" not in path.parts:
                total.update(f"{path.relative_to(PACKAGE).as_posix()}\0".encode())
                total.update(hashlib.sha256(path.read_bytes()).digest())
    return total.hexdigest()
