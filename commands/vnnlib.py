"""`setrl vnnlib`: other people's queries about a network, answered by the engine."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from .. import __version__
from .arguments import JsonOption, QuietOption, read_options
from .exit_codes import FALSIFIED, OK, UNKNOWN
from .output import print_json, say, tell, write

if TYPE_CHECKING:
    from ..specs.queries import Query

EXIT_CODES = {"unsat": OK, "sat": FALSIFIED, "unknown": UNKNOWN, "timeout": UNKNOWN}


def vnnlib(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="ONNX file.", show_default=False)],
    query: Annotated[Path, typer.Argument(metavar="QUERY", help="VNN-LIB file, 1.0 or 2.0.", show_default=False)],
    timeout: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="Stop then; what is not decided is timeout.")
    ] = None,
    splits: Annotated[int | None, typer.Option(metavar="N", help="Most boxes that are bounded.")] = None,
    as_json: JsonOption = False,
    witness: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the counterexample of a sat.")] = None,
    quiet: QuietOption = False,
) -> int:
    """Answer a VNN-LIB query about a network: sat (with a counterexample), unsat, unknown or timeout on stdout.

    A query describes a violation: unsat, exit code 0, is the proof that no input violates; sat is exit code 10.
    """
    from ..specs.files import require_writable
    from ..verify.interruption import interruptible

    options = read_options(timeout, splits, None, None, None)
    if witness is not None:
        require_writable(witness)
    with interruptible(timeout) as deadline:
        from ..models.onnx_reader import read_policy
        from ..verify.open_loop.decide import SPLITS, decide

        asked = _read_query(query)
        network = read_policy(policy)
        answer = decide(network, asked, splits=SPLITS if splits is None else options.splits, deadline=deadline)
    code, found = EXIT_CODES[answer.word], answer.counterexample
    if as_json:
        print_json({"setrl": __version__, "exit_code": code, "policy_sha256": network.digest, **answer.to_json()})
    else:
        say(answer.word, *([] if found is None else [found.text()]))
    if found is not None and witness is not None:
        write(witness, found.text() + "\n", quiet)
    if not quiet:
        tell(*asked.comment.splitlines(), f"{answer.word}: {answer.reason} ({answer.cells} cells, {answer.runtime})")
    return code


def _read_query(path: Path) -> Query:
    """The query in a regular file: of nothing else it is known that it ends."""
    from ..specs.errors import InputError
    from ..specs.vnnlib_reader import parse_vnnlib
    from ..specs.vnnlib_syntax import MOST_BYTES

    try:
        if not path.is_file():
            raise InputError("a file is required: there is no such query", where=str(path), remedy="check the path")
        with path.open("rb") as file:
            content = file.read(MOST_BYTES + 1)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"cannot read the query: {reason}", where=str(path), remedy="check the path") from error
    return parse_vnnlib(content, str(path))
