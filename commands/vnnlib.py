"""`setrl vnnlib`: other people's queries about a network, answered by the engine."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import JsonOption, QuietOption, SplitsOption, TimeoutOption
from .exit_codes import UNKNOWN


def vnnlib(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="ONNX file.", show_default=False)],
    query: Annotated[Path, typer.Argument(metavar="QUERY", help="VNN-LIB file.", show_default=False)],
    timeout: TimeoutOption = None,
    splits: SplitsOption = None,
    as_json: JsonOption = False,
    witness: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Write the counterexample of a sat there.")
    ] = None,
    quiet: QuietOption = False,
) -> int:
    """Answer a VNN-LIB query about a network: sat, unsat, unknown or timeout on stdout."""
    return UNKNOWN
