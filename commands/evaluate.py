"""`setrl evaluate`."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from .arguments import CsvOption, JsonOption, PlotOption, QuietOption, read_radii, read_radius
from .exit_codes import OK
from .extras import require_training
from .output import print_json, say, write, wrote
from .output_files import require_outputs


def evaluate(
    run: Annotated[Path, typer.Argument(metavar="RUN", help="Folder of a run.", show_default=False)],
    epsilon: Annotated[
        str | None, typer.Option(metavar="FIRST:LAST:STEP", help="Radii; default: those tuned for the specification.")
    ] = None,
    no_certify: Annotated[bool, typer.Option("--no-certify", help="Do not search the certified radius.")] = False,
    resolution: Annotated[
        str | None, typer.Option(metavar="RADIUS", help="Of the certified radius; default 0.001.")
    ] = None,
    as_json: JsonOption = False,
    csv: CsvOption = None,
    plot: PlotOption = None,
    quiet: QuietOption = False,
) -> int:
    """Evaluate a run's policies: V(s0) over radii, returns under attack, the certified radius, collapse.

    The table goes to stdout; evaluation.csv and evaluation.png are written into the run, or where you say.
    """
    require_training()
    radii, finest = read_radii(epsilon), read_radius(resolution, "--resolution")
    csv, plot = csv or run / "evaluation.csv", plot or run / "evaluation.png"
    from ..train import launch
    from ..train.run_folder import RunFolder

    RunFolder.open(run)
    require_outputs(plot=plot, csv=csv)
    from ..train.evaluation_report import evaluation_csv, evaluation_lines, evaluation_to_json
    from ..train.plot_evaluation import plot_evaluation
    from ..verify.interruption import share_bar

    with share_bar(not quiet) as progress:
        found = launch.evaluate_run(run, radii, certify=not no_certify, resolution=finest, progress=progress)
    if as_json:
        print_json(evaluation_to_json(found))
    else:
        say(*evaluation_lines(found))
    write(csv, evaluation_csv(found), quiet)
    plot_evaluation(found, str(plot))
    wrote(plot, quiet)
    return OK
