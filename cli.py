"""The command line: the program `setrl`, its commands, and every way in which it can end.

Exit codes: 0 verified, accepted or done, 10 falsified, 5 unknown, claimed or rejected, 2 bad input or usage, 6 internal
error; never 1, which is a Python crash. The verdict goes to stdout, the rest to stderr.

Besides typer the command line imports nothing: every command imports what it needs when it runs. Help is plain text,
because typer's panels would load most of rich and take as long again as everything else together.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from typing import Annotated, Any, NoReturn

import typer

from . import __version__
from .commands import (
    certify,
    check,
    crosscheck,
    doctor,
    evaluate,
    export,
    init,
    inspect,
    radius,
    schema,
    simulate,
    sweep,
    train,
    verify,
    vnnlib,
)
from .commands.exit_codes import ABORTED, BAD_INPUT, INTERNAL, OK, PIPE_CLOSED
from .commands.output import one_line, tell

COMMANDS: tuple[tuple[Callable[..., int], str, str | None], ...] = (
    (verify.verify_command, "verify", "Verify a policy: VERIFIED, FALSIFIED, or UNKNOWN and why."),
    (check.check, "check", "Prove a certificate or a witness again, without the engine."),
    (sweep.sweep, "sweep", "Verify for several perturbation radii at once."),
    (radius.radius, "radius", "How much perturbation a policy withstands: what verifies, what fails."),
    (simulate.simulate, "simulate", None),
    (certify.certify_command, "certify", "Verify a table of policies and specifications, with reports for CI."),
    (train.train, "train", "Train policies that verify."),
    (evaluate.evaluate, "evaluate", "What trained policies are worth: V(s0), attacks, certified radius."),
    (export.export, "export", "Write a proof's claims as ONNX and VNN-LIB, for other verifiers."),
    (crosscheck.crosscheck, "crosscheck", "Ask verifiers that others wrote about the same claims."),
    (init.init, "init", "Print a commented specification to fill in."),
    (inspect.inspect, "inspect", "List what is in a policy and what is not supported."),
    (doctor.doctor, "doctor", "Test this machine and print versions."),
    (vnnlib.vnnlib, "vnnlib", "Answer a VNN-LIB query about a network: sat or unsat."),
    (schema.schema, "schema", None),
)
"""Function, name, and its line in the list of commands where that is not the function's own first line."""

_USAGE: type[Exception] = next(base for base in typer.BadParameter.__mro__ if base.__name__ == "ClickException")
"""Base of typer's usage errors; typer brings its own click from some version on."""

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


@app.callback(
    epilog="Exit codes: 0 verified, accepted or done, 5 unknown, claimed or rejected, 10 falsified, "
    "2 bad input or usage, 6 internal error."
)
def root(
    version: Annotated[
        bool, typer.Option("--version", callback=_print_version, is_eager=True, help="Print the version and exit.")
    ] = False,
) -> None:
    """Does a policy network keep a plant within its specification? A sound verdict, with its reason."""


for _command, _name, _line in COMMANDS:
    app.command(_name, short_help=_line)(_command)


def _run(arguments: Sequence[str] | None) -> int:
    """Run a command; every way in which it can end is an exit code."""
    try:
        code = app(args=None if arguments is None else list(arguments), prog_name="setrl", standalone_mode=False)
        sys.stdout.flush()
        if code == ABORTED:  # typer's own answer to an interrupt
            raise KeyboardInterrupt
        return code if isinstance(code, int) else OK
    except _USAGE as error:
        return _usage_error(error)
    except (typer.Abort, KeyboardInterrupt):
        tell("setrl: aborted")
        return ABORTED
    except SystemExit as end:  # typer leaves with 1 when stdout is closed early, as by `| head`
        return PIPE_CLOSED if end.code == 1 else int(end.code or 0)
    except BrokenPipeError:
        return PIPE_CLOSED
    except Exception as error:  # noqa: BLE001 - the outermost frame: nothing continues after it
        return _failure(error)


def _usage_error(error: Any) -> int:
    if type(error).__name__ == "NoArgsIsHelpError":
        tell(error.format_message())
        return BAD_INPUT
    command = getattr(getattr(error, "ctx", None), "command_path", "setrl")
    tell(f"setrl: error: {one_line(error.format_message())} (see {command} --help)")
    return BAD_INPUT


def _failure(error: Exception) -> int:
    """Wrong input is one line; anything else, a broken invariant above all, is a bug to report."""
    from .specs.errors import SetrlError

    if isinstance(error, SetrlError):
        tell(f"setrl: error: {one_line(error)}")
        return BAD_INPUT
    import traceback

    traceback.print_exception(error, file=sys.stderr)
    tell(
        f"setrl: internal error: {type(error).__name__}: {one_line(error)} (please report this "
        "with the policy, the specification and the output of `setrl doctor`)"
    )
    return INTERNAL


def main(arguments: Sequence[str] | None = None) -> NoReturn:
    """Run the command line and exit.

    Parameters
    ----------
    arguments : sequence of str, optional
        What follows the program's name; the process's own arguments by default.
    """
    code = _run(arguments)
    if code == PIPE_CLOSED:  # nothing can be written any more, not even what is still buffered
        import os

        os.dup2(os.open(os.devnull, os.O_WRONLY), 1)
    sys.exit(code)
