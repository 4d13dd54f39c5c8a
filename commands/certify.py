"""`setrl certify`: a batch of policies and specifications, with reports for CI."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated

import typer

from .arguments import JsonOption, QuietOption, read_radius, require_whole, require_workers
from .exit_codes import ABORTED
from .output import print_json, say, tell

SPREAD_ON_RAY = 8
"""Parts of a hard row on a cluster, where nobody says how many."""


class ExecutorKind(StrEnum):
    """Where rows run."""

    local = "local"
    ray = "ray"


def certify_command(
    manifest: Annotated[Path, typer.Argument(metavar="MANIFEST", help="YAML file.", show_default=False)],
    out: Annotated[Path, typer.Option(metavar="DIR", help="Folder of certificates, journal and reports.")] = Path(
        "certification"
    ),
    workers: Annotated[
        int | None, typer.Option(metavar="N", help="Rows that run side by side; default: one per processor.")
    ] = None,
    executor: Annotated[
        ExecutorKind, typer.Option(help="Processes here, or tasks of a Ray cluster (RAY_ADDRESS, else a local one).")
    ] = ExecutorKind.local,
    spread: Annotated[
        int | None, typer.Option(metavar="N", help="Cut a hard row into N parts; default 1, with ray 8.")
    ] = None,
    baseline: Annotated[
        Path | None, typer.Option(metavar="FILE", help="certification.json of an earlier run: what got worse fails.")
    ] = None,
    tolerance: Annotated[
        str | None, typer.Option(metavar="X", help="What V(s0), margin and radius may lose; default 0.000001.")
    ] = None,
    recheck: Annotated[bool, typer.Option("--recheck", help="Check the evidence of unchanged rows again.")] = False,
    no_cache: Annotated[bool, typer.Option("--no-cache", help="Decide every row again.")] = False,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Verify every policy of a manifest against its specifications; write reports for people and for CI.

    Rows that have not changed keep their verdict. The exit code is that of the worst row: 0 all pass, 5 unknown or a
    regression, 10 falsified, 2 bad input, 6 internal error.
    """
    from ..specs.errors import UsageError
    from ..specs.manifest import read_manifest
    from ..verify.certification.baseline import TOLERANCE
    from ..verify.certification.certify import certify
    from ..verify.certification.progress import watch_of
    from ..verify.certification.reports.files import write_reports
    from ..verify.executors.choice import executor_of
    from ..verify.interruption import interruptible

    require_workers(workers)
    if spread is not None:
        require_whole("--spread", spread, 1, 1024)
    if recheck and no_cache:
        raise UsageError("excludes --no-cache", where="--recheck", remedy="give one of the two")
    if tolerance is not None and baseline is None:
        raise UsageError("is for --baseline", where="--tolerance", remedy="give --baseline FILE too")
    allowed = read_radius(tolerance, "--tolerance")
    table = read_manifest(manifest)
    engine = executor_of(executor.value, workers)
    parts = spread if spread is not None else 1 if executor is ExecutorKind.local else SPREAD_ON_RAY
    with interruptible(None) as deadline, watch_of(quiet) as watch:
        report = certify(
            table,
            out,
            engine,
            spread=parts,
            cached=not no_cache,
            recheck=recheck,
            baseline=baseline,
            tolerance=TOLERANCE if allowed is None else allowed,
            stop=lambda: deadline.expired,
            watch=watch,
        )
    if report is None:
        tell(f"setrl: stopped; finished rows are kept, go on with: setrl certify {manifest}")
        return ABORTED
    written = write_reports(report, out)
    if as_json:
        print_json(report.to_json())
    else:
        from ..verify.certification.summary import summary_lines

        say(*summary_lines(report))
    if not quiet:
        tell(f"wrote {', '.join(path.name for path in written.values())} into {out}")
    return report.exit_code
