"""The command line: arguments, files, exit codes, progress. It holds no mathematics.

Exit codes: 0 verified (or done), 10 falsified, 5 unknown, 2 bad input or usage, 6 internal error; never 1, which is a
Python crash. The verdict goes to stdout, the rest to stderr.

Besides typer this module imports nothing: every command imports what it needs when it runs. Help is plain text,
because typer's panels would load most of rich and take as long again as everything else together.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from typing import Annotated

import typer

from . import __version__

PLACEHOLDER = True
"""No command has landed; the tests that execute the documentation wait for this line to go."""

app = typer.Typer(
    name="setrl",
    add_completion=False,
    no_args_is_help=True,
    rich_markup_mode=None,
    pretty_exceptions_enable=False,
    context_settings={"help_option_names": ["-h", "--help"]},
)


def _print_version(asked: bool) -> None:
    if asked:
        typer.echo(f"setrl {__version__}")
        raise typer.Exit


@app.callback(epilog="The commands (verify, sweep, simulate, init, inspect, doctor, schema) have not landed yet.")
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Does a policy network keep a plant within its specification? A sound verdict, with its reason."""


def main(arguments: Sequence[str] | None = None) -> None:
    """Run the command line and exit.

    Parameters
    ----------
    arguments : sequence of str, optional
        What follows the program's name; the process's own arguments by default.
    """
    app(args=None if arguments is None else list(arguments), prog_name="setrl")
    sys.exit(0)
