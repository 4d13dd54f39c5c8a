"""Output files: whole or not at all, and an unusable destination is found before the work, not after it."""

from __future__ import annotations

import contextlib
import os
import secrets
import stat
from pathlib import Path

from .errors import InputError


def require_writable(path: str | os.PathLike[str], *, overwrite: bool = True) -> None:
    """Check that a file can be written, without touching anything.

    Parameters
    ----------
    path : path
    overwrite : bool
        Whether a file that is there may be replaced.

    Raises
    ------
    InputError
        Naming the path and the remedy.
    """
    target = Path(path)
    folder = _destination(target).parent
    if target.is_dir():
        raise InputError("this is a folder, a file is needed", where=str(path), remedy="add a file name")
    if _is_special(target):
        return
    if not folder.is_dir():
        shown = target.parent
        raise InputError(f"there is no folder {shown}", where=str(path), remedy=f"create it: mkdir -p {shown}")
    if target.exists() and not overwrite:
        raise InputError("the file exists", where=str(path), remedy="choose another name, or replace it with --force")
    if not os.access(folder, os.W_OK | os.X_OK):
        raise InputError(f"nothing can be written to {folder}", where=str(path), remedy="choose another folder")


def write_atomically(path: str | os.PathLike[str], content: bytes) -> None:
    """Write a file through a temporary one beside it that is synced and renamed: a reader never sees half of it.

    Parameters
    ----------
    path : path
        A link is followed, its target is replaced. What is no regular file (``/dev/stdout``) is written directly.
    content : bytes

    Raises
    ------
    InputError
        The file cannot be written; what was there before is still there.
    """
    given = Path(path)
    target = _destination(given)
    temporary = target.with_name(f".{target.name[:100]}.{secrets.token_hex(6)}.tmp")
    try:
        if _is_special(given):
            given.write_bytes(content)
            return
        mode = stat.S_IMODE(target.stat().st_mode) if target.exists() else None
        with os.fdopen(os.open(temporary, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666), "wb") as file:
            file.write(content)
            file.flush()
            os.fsync(file.fileno())
        if mode is not None:
            temporary.chmod(mode)
        temporary.replace(target)
    except OSError as error:
        with contextlib.suppress(OSError):
            temporary.unlink(missing_ok=True)
        reason = error.strerror or str(error)
        raise InputError(
            f"cannot write the file: {reason}", where=str(path), remedy="choose another place for it"
        ) from error
    except BaseException:
        temporary.unlink(missing_ok=True)
        raise


def _destination(path: Path) -> Path:
    return Path(os.path.realpath(path))


def _is_special(path: Path) -> bool:
    device = path.is_absolute() and path.parts[1:2] in (("dev",), ("proc",))
    return path.exists() and not path.is_dir() and (device or not path.is_file())


def require_suffix(path: str | os.PathLike[str], suffixes: tuple[str, ...]) -> None:
    """Check that a file's name says a format that can be written.

    Raises
    ------
    InputError
        Naming the formats.
    """
    suffix = Path(path).suffix
    if suffix.lower() not in suffixes:
        received = f"{suffix} cannot be written" if suffix else "the name has no suffix"
        raise InputError(received, where=str(path), remedy=f"supported: {', '.join(suffixes)}")
