"""`setrl simulate`."""

from __future__ import annotations

from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Annotated, Any

import typer

from .arguments import (
    CsvOption,
    EpsilonOption,
    JsonOption,
    PlotOption,
    PolicyArgument,
    QuietOption,
    SpecOption,
    read_radius,
    require_whole,
)
from .exit_codes import OK
from .inputs import read_inputs
from .output import print_json, say, write, wrote
from .output_files import require_outputs

if TYPE_CHECKING:
    from ..models.closed_loop import ClosedLoop
    from ..models.simulation import Trajectories


class Attack(StrEnum):
    """Perturbations of a simulation."""

    none = "none"
    uniform = "uniform"
    corner = "corner"


def simulate(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    rollouts: Annotated[int, typer.Option(metavar="N", help="Number of trajectories.")] = 20,
    seed: Annotated[int, typer.Option(help="The same seed draws the same trajectories.")] = 0,
    attack: Annotated[Attack, typer.Option(help="Perturbations: none, anywhere or at corners of their bounds.")] = (
        Attack.uniform
    ),
    epsilon: EpsilonOption = None,
    csv: CsvOption = None,
    plot: PlotOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Simulate trajectories of the closed loop. It is for looking; it proves nothing."""
    require_whole("--rollouts", rollouts, 1, 100_000)
    require_whole("--seed", seed, 0, 2**63)
    radius = read_radius(epsilon)
    require_outputs(plot=plot, csv=csv)
    network, specification = read_inputs(policy, spec, quiet)
    from ..verify import tables

    loop, trajectories, summary = _simulated(network, specification, radius, rollouts, seed, attack)
    if as_json:
        print_json(summary)
    else:
        say(*tables.simulation_table(summary))
    if csv is not None:
        write(csv, tables.trajectories_csv(loop, trajectories), quiet)
    if plot is not None:
        from ..verify.plot import plot_trajectories

        plot_trajectories(loop, trajectories, str(plot))
        wrote(plot, quiet)
    return OK


def _simulated(
    policy: str, spec: str, radius: Fraction | None, rollouts: int, seed: int, attack: Attack
) -> tuple[ClosedLoop, Trajectories, dict[str, Any]]:
    import numpy as np

    from ..models.binding import bind
    from ..models.rollouts import roll_out
    from ..models.simulation import returns
    from ..verify.falsifier import violations
    from ..verify.tables import simulation_to_json
    from ..verify.verifier import load

    network, specification = load(policy, spec)
    loop = bind(specification, network, None, radius)
    run = roll_out(loop, rollouts, attack.value, np.random.default_rng(seed))
    period, samples = float(loop.period), run.samples_per_period
    amounts = {entry.name: violations(entry, run.times, run.states, samples, period)[0] for entry in loop.requirements}
    total = None if loop.reward is None else returns(loop, run)
    return loop, run, simulation_to_json(loop, run, total, amounts)
