"""`setrl sweep`."""

from __future__ import annotations

from typing import Annotated

import typer

from .arguments import (
    CsvOption,
    EnclosureOption,
    GeneratorsOption,
    JsonOption,
    MethodOption,
    OrderOption,
    PlotOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    SplitsOption,
    TimeoutOption,
    read_options,
    read_radii,
)
from .inputs import read_inputs
from .output import print_json, say, write, wrote
from .output_files import require_outputs


def sweep(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    epsilon: Annotated[
        str,
        typer.Option(metavar="FIRST:LAST:STEP", help="Radii of the observation perturbation; or a list: 0,0.1,0.2."),
    ] = "0:0.5:0.05",
    as_json: JsonOption = False,
    csv: CsvOption = None,
    plot: PlotOption = None,
    timeout: TimeoutOption = None,
    splits: SplitsOption = None,
    method: MethodOption = None,
    enclosure: EnclosureOption = None,
    taylor_order: OrderOption = None,
    generators: GeneratorsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Verify for several perturbation radii at once: verdict, worst reward and margins as a table.

    The exit code is that of the worst radius.
    """
    radii = read_radii(epsilon)
    options = read_options(timeout, splits, method, taylor_order, generators, enclosure)
    require_outputs(plot=plot, csv=csv)
    network, specification = read_inputs(policy, spec, quiet)
    from ..verify import tables
    from ..verify.interruption import interruptible, progress_bar
    from ..verify.verifier import verify_radii

    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        results = verify_radii(network, specification, radii, options=options, deadline=deadline, progress=progress)
    if as_json:
        print_json(tables.sweep_to_json(radii, results))
    else:
        say(*tables.sweep_table(radii, results))
    if csv is not None:
        write(csv, tables.sweep_csv(radii, results), quiet)
    if plot is not None:
        from ..verify.plot import plot_sweep

        plot_sweep([float(radius) for radius in radii], results, str(plot))
        wrote(plot, quiet)
    return max(result.verdict.exit_code for result in results)
