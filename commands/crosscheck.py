"""`setrl crosscheck`: the same claims, decided by verifiers that others wrote."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .arguments import (
    EpsilonOption,
    JsonOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    SplitsOption,
    require_whole,
    require_workers,
)
from .exit_codes import ABORTED
from .export import write_queries
from .output import print_json, say, tell, write

MEMORY = 8 << 30
"""Bytes that a tool may hold."""


class ToolName(StrEnum):
    """External verifiers with an adapter."""

    vibecheck = "vibecheck"
    marabou = "marabou"


def crosscheck(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    tools: Annotated[
        list[ToolName] | None,
        typer.Option("--with", help="External verifier; may be given several times. Default: all that are installed."),
    ] = None,
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of the queries that are asked.")] = Path(
        "crosscheck"
    ),
    exported: Annotated[
        Path | None, typer.Option("--export", metavar="DIR", help="Ask the queries of this export instead.")
    ] = None,
    certificate: Annotated[
        Path | None, typer.Option(metavar="FILE", help="Check the claims of this certificate; default: verify first.")
    ] = None,
    periods: Annotated[str | None, typer.Option(metavar="A:B", help="Periods A to B - 1 only; N: the first N.")] = None,
    leaves: Annotated[int | None, typer.Option(metavar="N", help="The first N parts of the initial set only.")] = None,
    closed_loop: Annotated[bool, typer.Option("--closed-loop", help="Ask about the unrolled loop.")] = False,
    epsilon: EpsilonOption = None,
    splits: SplitsOption = None,
    seconds: Annotated[float, typer.Option("--timeout", metavar="SECONDS", help="Limit of one query.")] = 60.0,
    workers: Annotated[int | None, typer.Option(metavar="N", help="Queries side by side; default 1.")] = None,
    csv: Annotated[Path | None, typer.Option(metavar="FILE", help="Write the table.")] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Ask external verifiers every claim that a certificate makes about the network.

    Exit 0: all that were asked are confirmed; 5: some are not decided; 6: a claim is contradicted, and the
    counterexample was replayed.
    """
    from ..specs.errors import UsageError
    from ..specs.files import require_writable
    from ..verify.crosscheck.ask import TOOLS
    from ..verify.crosscheck.crosscheck import crosscheck as ask_all
    from ..verify.crosscheck.crosscheck import read_queries
    from ..verify.crosscheck.table import Entry, exit_code, summary, table_csv
    from ..verify.executors.choice import executor_of
    from ..verify.interruption import interruptible

    require_workers(workers)
    if not 0.0 < seconds <= 10.0**6:
        raise UsageError(f"received {seconds:g}", where="--timeout", remedy="use a positive number of seconds")
    if leaves is not None:
        require_whole("--leaves", leaves, 1, 10**9)
    if csv is not None:
        require_writable(csv)
    if exported is not None and (policy is not None or spec is not None or certificate is not None):
        raise UsageError("excludes a policy and a specification", where="--export", remedy="give one of the two")
    versions = _installed([tool.value for tool in tools] if tools else None, list(TOOLS))
    if exported is None:
        written = write_queries(
            policy=policy,
            spec=spec,
            out=out,
            certificate=certificate,
            periods=periods,
            leaves=leaves,
            closed_loop=closed_loop,
            epsilon=epsilon,
            splits=splits,
        )
        if isinstance(written, int):
            return written
    queries = read_queries(out if exported is None else exported)

    def show(entry: Entry) -> None:
        facts = (
            entry.tool,
            entry.query,
            entry.answer or "-",
            entry.agreement.value,
            f"{entry.seconds:.2f} s",
            entry.detail,
        )
        tell("  ".join(fact for fact in facts if fact))

    with interruptible(None) as deadline:
        entries = ask_all(
            queries,
            list(versions),
            executor_of("local", workers or 1),
            seconds=seconds,
            memory=MEMORY,
            stop=lambda: deadline.expired,
            watch=(lambda entry: None) if quiet else show,
        )
    if entries is None:
        tell("setrl: stopped")
        return ABORTED
    if csv is not None:
        write(csv, table_csv(entries, versions), quiet)
    code = exit_code(entries)
    if as_json:
        from dataclasses import asdict

        rows = [{**asdict(entry), "agreement": entry.agreement.value} for entry in entries]
        print_json({"format": "setrl-crosscheck/1", "tools": versions, "entries": rows, "exit_code": code})
    else:
        say(*summary(entries))
    return code


def _installed(wanted: list[str] | None, known: list[str]) -> dict[str, str]:
    """Versions of the tools that are asked; all that are installed where nobody says which."""
    from ..specs.errors import UsageError
    from ..verify.crosscheck.ask import TOOLS

    if wanted is not None:
        return {name: TOOLS[name]().version() for name in dict.fromkeys(wanted)}
    found = {}
    problems: list[UsageError] = []
    for name in known:
        try:
            found[name] = TOOLS[name]().version()
        except UsageError as error:
            problems.append(error)
    if not found:
        raise problems[0]
    return found
