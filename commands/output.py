"""What a command writes: its answer to stdout, everything else to stderr."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import typer


def say(*lines: str) -> None:
    """Write lines to stdout."""
    typer.echo("\n".join(lines))


def tell(*lines: str) -> None:
    """Write lines to stderr."""
    typer.echo("\n".join(lines), err=True)


def print_json(data: Any) -> None:
    """Write one JSON document to stdout."""
    import json

    typer.echo(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False))


def write(path: Path, text: str, quiet: bool) -> None:
    """Write a file whole or not at all, and say so."""
    from ..specs.files import write_atomically

    write_atomically(path, text.encode())
    wrote(path, quiet)


def wrote(path: Path, quiet: bool) -> None:
    """Say on stderr that a file was written."""
    if not quiet:
        tell(f"wrote {path}")


def one_line(text: object) -> str:
    """Any text without line breaks."""
    return " ".join(str(text).split())
