"""Output folders: made where they are missing, and written by one process at a time."""

from __future__ import annotations

import fcntl
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from .errors import InputError


def make_folder(place: Path) -> None:
    """Make a folder, and those above it, where they are missing.

    Raises
    ------
    InputError
        Nothing can be written there.
    """
    try:
        place.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise unwritable(place, error) from None


def unwritable(place: Path, error: OSError) -> InputError:
    """The error of a folder into which nothing can be written."""
    reason = error.strerror or str(error)
    return InputError(f"nothing can be written here: {reason}", where=str(place), remedy="choose another folder")


@contextmanager
def locked(place: Path, what: str) -> Iterator[None]:
    """Keep other processes from writing a folder; the system ends the lock of a process that dies.

    Parameters
    ----------
    place : Path
    what : str
        What is in the folder, for the message: "run".

    Raises
    ------
    InputError
        Another process is writing, or the folder cannot be written.
    """
    try:
        file = open(place / ".lock", "a+", encoding="utf-8")
    except OSError as error:
        raise unwritable(place, error) from None
    with file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            file.seek(0)
            holder = file.read(20).strip() or "unknown"
            raise InputError(
                f"another process is writing this {what} (its number: {holder})",
                where=str(place),
                remedy="wait until it ends, or end it",
            ) from None
        # the file stays: to delete it would let a third process lock a new one beside a second that waits
        file.truncate(0)
        file.write(f"{os.getpid()}\n")
        file.flush()
        yield
