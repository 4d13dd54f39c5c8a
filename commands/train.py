"""`setrl train`."""

from __future__ import annotations

from enum import StrEnum
from pathlib import Path
from typing import Annotated, Any

import typer

from .arguments import JsonOption, QuietOption, SpecOption, stop_after
from .exit_codes import ABORTED, OK
from .extras import require_training
from .inputs import require_specification
from .output import print_json, say, tell


class Algorithm(StrEnum):
    """Training algorithms."""

    pa_pc = "pa-pc"
    naive = "naive"
    grad = "grad"
    mad = "mad"
    sa_pc = "sa-pc"
    sa_sc = "sa-sc"


class Base(StrEnum):
    """What an algorithm is built on."""

    ddpg = "ddpg"
    td3 = "td3"


class Preset(StrEnum):
    """Where weights come from."""

    tuned = "tuned"
    paper = "paper"
    none = "none"


class Device(StrEnum):
    """Where the networks are."""

    cpu = "cpu"
    cuda = "cuda"


def train(
    spec: SpecOption = None,
    algorithm: Annotated[Algorithm | None, typer.Option(help="Default sa-pc.")] = None,
    base: Annotated[Base | None, typer.Option(help="Default ddpg.")] = None,
    seeds: Annotated[int | None, typer.Option(metavar="N", help="Seeds trained side by side; default 1.")] = None,
    first_seed: Annotated[int | None, typer.Option(metavar="N", help="The first of them; default 0.")] = None,
    episodes: Annotated[int | None, typer.Option(metavar="N", help="Default 2000.")] = None,
    epsilon: Annotated[
        float | None, typer.Option(metavar="RADIUS", help="Perturbation radius of the training.")
    ] = None,
    flowpipe: Annotated[
        int | None, typer.Option(metavar="STEPS", help="Steps of a second phase through the reachable sets; default 0.")
    ] = None,
    config: Annotated[Path | None, typer.Option(metavar="FILE", help="Options as YAML; see docs/train.md.")] = None,
    assignments: Annotated[
        list[str] | None, typer.Option("--set", metavar="NAME=VALUE", help="Any other option; several times.")
    ] = None,
    preset: Annotated[Preset | None, typer.Option(help="Weights: tuned for the specification, or the paper's.")] = None,
    name: Annotated[str | None, typer.Option(metavar="NAME", help="Of the run's folder.")] = None,
    runs: Annotated[Path, typer.Option(metavar="DIR", help="Where runs are.")] = Path("runs"),
    resume: Annotated[Path | None, typer.Option(metavar="RUN", help="Go on with a run that was stopped.")] = None,
    source: Annotated[
        Path | None, typer.Option("--from", metavar="RUN", help="Begin with that run's policies; for --flowpipe.")
    ] = None,
    until_verified: Annotated[
        bool, typer.Option("--until-verified", help="Further rounds until the policy verifies or --timeout ends.")
    ] = False,
    timeout: Annotated[
        float | None, typer.Option(metavar="SECONDS", help="With --until-verified: begin no further round after that.")
    ] = None,
    device: Annotated[Device | None, typer.Option(help="Default cpu.")] = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Train policies for a specification, export them as ONNX, and verify them.

    With --until-verified the exit code is that of the best policy's verdict; otherwise 0.
    """
    from ..specs.errors import UsageError

    require_training()
    stop_after(timeout)
    if timeout is not None and not until_verified:
        raise UsageError("is for --until-verified", where="--timeout", remedy="leave it out, or add --until-verified")
    values: dict[str, Any] = {
        "algorithm": algorithm,
        "base": base,
        "seeds": seeds,
        "first_seed": first_seed,
        "episodes": episodes,
        "epsilon": epsilon,
        "flowpipe.steps": flowpipe,
        "device": device,
    }
    given = {key: str(value) if isinstance(value, StrEnum) else value for key, value in values.items()}
    given = {key: value for key, value in given.items() if value is not None}
    from ..train import launch
    from ..train.configuration import read_assignment
    from ..train.run_folder import RunFolder
    from ..verify.interruption import interruptible

    given |= dict(read_assignment(text) for text in assignments or ())
    if resume is None:
        run = launch.create_run(
            require_specification(spec),
            given,
            name=name,
            folder=runs,
            file=config,
            preset=None if preset is None else preset.value,
            source=source,
        )
    else:
        if given or any(value is not None for value in (spec, config, preset, name, source)):
            raise UsageError("a run goes on as it began", where="--resume", remedy="give --resume RUN alone")
        run = RunFolder.open(resume)
    if not quiet:
        tell(f"run {run.path}")
    with interruptible(timeout) as deadline:
        try:
            outcome = launch.run_training(run, deadline, until_verified=until_verified, quiet=quiet, tell=tell)
        except launch.Interrupted:
            tell(f"setrl: stopped; go on with: setrl train --resume {run.path}")
            return ABORTED
    if as_json:
        print_json(launch.outcome_to_json(run, outcome))
    else:
        say(*launch.outcome_lines(run, outcome))
    return outcome.results[outcome.best].verdict.exit_code if until_verified else OK
