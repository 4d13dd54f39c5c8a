"""Checkpoints: the whole state of a run in one safetensors file, its JSON in the same file's header.

Tensors and numbers cannot come apart, because there is only one file; a process or a machine that dies at any moment
leaves the file before or the file after, because it is synced and then renamed. A digest over all of it tells a damaged
file; the one before it is kept for that case.
"""

from __future__ import annotations

import contextlib
import json
import os
import sys
from collections.abc import Callable, Mapping
from hashlib import sha256
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from ..specs.errors import InputError
from ..specs.files import write_atomically
from ..specs.folders import make_folder

if TYPE_CHECKING:
    from torch import Tensor

FORMAT = "setrl-checkpoint/1"
KEPT = 2
"""The newest one, and an intact one before it."""


def save(folder: str | os.PathLike[str], tensors: Mapping[str, Any], numbers: Mapping[str, Any]) -> Path:
    """Write the next checkpoint; the intact one before it is kept, older ones are deleted.

    Only one process may save into a folder (`run_folder.RunFolder.locked`).

    Parameters
    ----------
    folder : path
        Made where it is missing.
    tensors : mapping of str to Tensor or array
        Any shapes; on any device.
    numbers : mapping
        What JSON can hold, NaN and infinities included.

    Returns
    -------
    Path
        The file.

    Raises
    ------
    InputError
        It cannot be written, for example because the disk is full; earlier checkpoints are untouched.
    """
    place = Path(folder)
    arrays = {name: _array(value) for name, value in tensors.items()}
    make_folder(place)
    earlier = stored(place)
    for left_over in place.glob(".checkpoint-*.tmp"):  # of a process that was killed while it wrote
        _delete(left_over)
    path = place / f"checkpoint-{_number(earlier[0]) + 1 if earlier else 1:06d}.safetensors"
    try:
        write_atomically(path, _content(arrays, json.dumps(dict(numbers))))
        sync_folder(place)
    except InputError as error:
        remedy = "make room on the disk, then go on with --resume: the checkpoint before this one is intact"
        raise InputError(error.message, where=error.where, remedy=remedy) from None
    _prune(earlier)
    return path


def load(
    folder: str | os.PathLike[str], *, tell: Callable[[str], None] | None = None
) -> tuple[dict[str, Tensor], dict[str, Any], Path]:
    """Read the newest intact checkpoint.

    Parameters
    ----------
    folder : path
    tell : callable, optional
        Takes a sentence for every damaged checkpoint that was passed over; printed on stderr by default.

    Returns
    -------
    tensors : dict of str to Tensor
        On the CPU, bit for bit as they were saved.
    numbers : dict
    where : Path
        The file that was read.

    Raises
    ------
    InputError
        There is no checkpoint, or none that is intact.
    """
    import torch

    say = tell or _say
    found = stored(folder)
    if not found:
        raise InputError("there is no checkpoint", where=str(folder), remedy="start again under another --name")
    for path in found:
        try:
            arrays, numbers = _read(path)
        except InputError as error:
            say(f"{error}: passed over")
            continue
        return {name: torch.from_numpy(array.copy()) for name, array in arrays.items()}, numbers, path
    raise InputError(
        f"none of {len(found)} checkpoints is intact", where=str(folder), remedy="start again under another --name"
    )


def stored(folder: str | os.PathLike[str]) -> list[Path]:
    """Checkpoints of a folder, intact or not, the newest first."""
    found = [path for path in Path(folder).glob("checkpoint-*.safetensors") if _number(path) > 0]
    return sorted(found, key=_number, reverse=True)


def sync_folder(folder: str | os.PathLike[str]) -> None:
    """Make the names in a folder as durable as the files: a rename is lost with the power otherwise."""
    descriptor = os.open(folder, os.O_RDONLY)
    try:
        os.fsync(descriptor)
    finally:
        os.close(descriptor)


def _content(arrays: Mapping[str, Any], numbers: str) -> bytes:
    from safetensors.numpy import save as serialize

    metadata = {"format": FORMAT, "numbers": numbers, "sha256": _digest(arrays, numbers)}
    content: bytes = serialize(dict(arrays), metadata)
    return content


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Any]]:
    """Arrays and numbers of a file whose digest is right."""
    from safetensors import SafetensorError
    from safetensors.numpy import load as deserialize

    damaged = "the checkpoint is damaged"
    try:
        content = path.read_bytes()
        arrays = deserialize(content)
        # the header was accepted: eight bytes of length, then JSON whose metadata are texts
        header = json.loads(content[8 : 8 + int.from_bytes(content[:8], "little")])
        metadata = header.get("__metadata__", {})
        if metadata.get("format") != FORMAT:
            raise InputError(f"no checkpoint of setrl, or of another version: {FORMAT} is needed", where=str(path))
        if _digest(arrays, metadata.get("numbers", "")) != metadata.get("sha256"):
            raise InputError(f"{damaged}: its digest is another one", where=str(path))
        return arrays, dict(json.loads(metadata["numbers"]))
    except OSError as error:
        raise InputError(f"cannot read the file: {error.strerror or error}", where=str(path)) from None
    except (SafetensorError, KeyError, TypeError, ValueError, RecursionError) as error:
        reason = (str(error).splitlines() or [type(error).__name__])[0]
        raise InputError(f"{damaged}: {reason}", where=str(path)) from None


def _digest(arrays: Mapping[str, Any], numbers: str) -> str:
    """sha256 of the numbers, then of every array in the order of names, with its name, type and shape."""
    found = sha256(f"{len(numbers)} {numbers}".encode("utf-8", "surrogatepass"))
    for name in sorted(arrays):
        array = arrays[name]
        found.update(json.dumps([name, array.dtype.name, list(array.shape)]).encode())
        found.update(array.reshape(-1).view(np.uint8))
    return found.hexdigest()


def _array(value: Any) -> Any:
    return np.asarray(value.detach().cpu() if hasattr(value, "detach") else value, order="C")


def _prune(earlier: list[Path]) -> None:
    """Keep the first intact ones of those before the newest: a damaged one is nothing to go back to."""
    kept = 1
    for path in earlier:
        if kept < KEPT and _intact(path):
            kept += 1
        else:
            _delete(path)


def _intact(path: Path) -> bool:
    try:
        _read(path)
    except InputError:
        return False
    return True


def _delete(path: Path) -> None:
    with contextlib.suppress(OSError):  # what stays costs room, nothing else
        path.unlink()


def _number(path: Path) -> int:
    digits = path.stem.partition("-")[2]
    return int(digits) if digits.isdecimal() else 0


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)
