"""Places of a command's output files, and the evidence that is written there."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from .inputs import first_bytes
from .output import one_line, write, wrote

if TYPE_CHECKING:
    from ..verify.result import Result


def require_outputs(
    *, plot: Path | None = None, csv: Path | None = None, witness: Path | None = None, certificate: Path | None = None
) -> None:
    """Unusable output paths are found before hours of work, and so are two outputs in one place."""
    from ..specs.errors import UsageError
    from ..specs.files import require_suffix, require_writable

    outputs = [("--plot", plot), ("--csv", csv), ("--certificate", certificate)]
    if witness is not None:
        require_suffix(witness, (".json",))
        outputs += [("--witness", path) for path in witness_files(witness)]
    taken: dict[Path, str] = {}
    for flag, path in outputs:
        if path is None:
            continue
        require_writable(path)
        other = taken.setdefault(path.resolve(), flag)
        if other != flag:
            raise UsageError(f"{other} and {flag} write the same file", where=str(path), remedy="choose another name")
    if plot is not None:
        require_suffix(plot, (".png", ".pdf", ".svg"))


def witness_files(path: Path) -> tuple[Path, Path, Path]:
    """The witness, and the table and the picture of its trajectory beside it."""
    return path, path.with_suffix(".csv"), path.with_suffix(".png")


def certificate_place(
    given: Path | None, unwanted: bool, unchecked: bool, policy: Path | None
) -> tuple[Path | None, str]:
    """Where the certificate goes; None where it goes nowhere, and why where that was not asked for."""
    from ..specs.errors import InputError, UsageError
    from ..specs.files import require_writable
    from ..verify.checker.certificate_file import MAGIC

    if given is not None and unwanted:
        raise UsageError("excludes --certificate", where="--no-certificate", remedy="give one of the two")
    if unwanted or (unchecked and given is None):
        return None, ""
    if policy is None:
        from ..models.example import EXAMPLE_POLICY

        policy = Path(EXAMPLE_POLICY)
    path = Path(f"{policy.stem}.cert") if given is None else given
    if path.is_file() and first_bytes(path, len(MAGIC)) != MAGIC:
        raise InputError(
            "the file exists and is no certificate of setrl: it is not replaced",
            where=str(path),
            remedy="choose another place with --certificate FILE, or none with --no-certificate",
        )
    try:
        require_writable(path)
    except InputError as error:
        if given is not None:
            raise
        return None, f"{one_line(error.message)} (--certificate FILE chooses another place)"
    return path, ""


def save_certificate(path: Path, content: bytes) -> tuple[Path | None, Exception | None]:
    """Write a certificate; a place that fails now does not take the verdict with it."""
    from ..specs.errors import InputError
    from ..specs.files import write_atomically

    try:
        write_atomically(path, content)
    except InputError as error:
        return None, error
    return path, None


def write_witness(path: Path, result: Result, quiet: bool) -> None:
    """The witness, and what its trajectory looks like: a table and a picture beside it."""
    from ..verify.plot_witness import plot_witness
    from ..verify.witness_trajectory import write_trajectory

    if result.witness is None or result.candidate is None:
        raise AssertionError("a witness without the candidate that it was made of")
    _, table, picture = witness_files(path)
    write(path, result.witness.content, quiet)
    write_trajectory(str(table), result.loop, result.candidate)
    wrote(table, quiet)
    plot_witness(result.loop, result.candidate, result.witness, str(picture))
    wrote(picture, quiet)
