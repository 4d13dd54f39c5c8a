"""The command line: arguments, files, exit codes, progress. It holds no mathematics.

Exit codes: 0 verified, accepted or done, 10 falsified, 5 unknown, claimed or rejected, 2 bad input or usage, 6 internal
error; never 1, which is a Python crash. The verdict goes to stdout, the rest to stderr.

Besides typer this module imports nothing: every command imports what it needs when it runs. Help is plain text,
because typer's panels would load most of rich and take as long again as everything else together.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Sequence
from enum import StrEnum
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NoReturn

import typer

from . import __version__

if TYPE_CHECKING:
    from fractions import Fraction

    from .models.closed_loop import ClosedLoop
    from .models.simulation import Trajectories
    from .verify.options import Options
    from .verify.result import Result

OK, UNKNOWN, BAD_INPUT, INTERNAL = 0, 5, 2, 6
ABORTED, PIPE_CLOSED = 130, 141
"""What a shell reports for a program that SIGINT or SIGPIPE ended."""

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


class Method(StrEnum):
    """Flow enclosures."""

    jets = "jets"
    linearization = "linearization"


class Attack(StrEnum):
    """Perturbations of a simulation."""

    none = "none"
    uniform = "uniform"
    corner = "corner"


class Kind(StrEnum):
    """Files that have a schema."""

    specification = "specification"
    plant = "plant"
    certificate = "certificate"


PolicyArgument = Annotated[Path | None, typer.Argument(metavar="[POLICY]", help="ONNX file.", show_default=False)]
SpecOption = Annotated[
    str | None,
    typer.Option(
        "--spec", metavar="FILE", help="Specification: a file, or the name of a shipped one such as nav.yaml."
    ),
]
TimeoutOption = Annotated[
    float | None, typer.Option(metavar="SECONDS", help="Stop then; what is not proved is UNKNOWN.")
]
SplitsOption = Annotated[int | None, typer.Option(metavar="N", help="Most cells of the initial set; 1: no splitting.")]
MethodOption = Annotated[Method | None, typer.Option(help="Flow enclosure; default jets.")]
OrderOption = Annotated[
    int | None, typer.Option("--taylor-order", metavar="K", help="Time order of the flow enclosure.")
]
GeneratorsOption = Annotated[int | None, typer.Option(metavar="N", help="Generators kept per state dimension.")]
EpsilonOption = Annotated[
    str | None,
    typer.Option(metavar="RADIUS", help="Radius of the observation perturbation, instead of the specification's."),
]
JsonOption = Annotated[bool, typer.Option("--json", help="One JSON document on stdout.")]
RuntimeOption = Annotated[bool, typer.Option("--runtime", help="Measure the installed onnxruntime (minutes).")]
PlotOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Draw into a .png, .pdf or .svg file.")]
WitnessOption = Annotated[
    Path | None,
    typer.Option(
        metavar="FILE.json", help="Write the witness of a FALSIFIED; its trajectory as .csv and .png beside it."
    ),
]
CertificateOption = Annotated[
    Path | None,
    typer.Option(metavar="FILE", help="Write the certificate there; default: POLICY.cert in the current folder."),
]
NoCertificateOption = Annotated[bool, typer.Option("--no-certificate", help="Write no certificate.")]
NoCheckOption = Annotated[bool, typer.Option("--no-check", help="Do not run the checker: a proof is only CLAIMED.")]
WorkersOption = Annotated[
    int | None, typer.Option(metavar="N", help="Processes of the checker; default: one per processor.")
]
CsvOption = Annotated[Path | None, typer.Option(metavar="FILE", help="Write comma-separated values.")]
QuietOption = Annotated[bool, typer.Option("--quiet", "-q", help="Nothing but the verdict and errors.")]


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


@app.command("verify", short_help="Verify a policy: VERIFIED, FALSIFIED, or UNKNOWN and why.")
def verify_command(
    policy: PolicyArgument = None,
    spec: SpecOption = None,
    as_json: JsonOption = False,
    plot: PlotOption = None,
    witness: WitnessOption = None,
    certificate: CertificateOption = None,
    no_certificate: NoCertificateOption = False,
    no_check: NoCheckOption = False,
    workers: WorkersOption = None,
    timeout: TimeoutOption = None,
    epsilon: EpsilonOption = None,
    splits: SplitsOption = None,
    method: MethodOption = None,
    taylor_order: OrderOption = None,
    generators: GeneratorsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Verify a policy: VERIFIED, FALSIFIED or UNKNOWN on stdout, everything else on stderr.

    VERIFIED means that the checker accepted the certificate. Without arguments, verify the shipped example.
    """
    options = _options(timeout, splits, method, taylor_order, generators)
    radius = _radius(epsilon)
    _require_workers(workers)
    _require_outputs(plot=plot, witness=witness, certificate=certificate)
    place, note = _certificate_place(certificate, no_certificate, no_check, policy)
    network, specification = _inputs(policy, spec, quiet)
    from .verify import report
    from .verify.interruption import interruptible, progress_bar
    from .verify.verifier import verify

    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        result = verify(
            network,
            specification,
            options=options,
            epsilon=radius,
            deadline=deadline,
            progress=progress,
            check=not no_check,
            workers=workers,
        )
    trouble = None
    if result.certificate is None or place is None:
        place = None
    else:
        place, trouble = _save_certificate(place, result.certificate)
    if as_json:
        _print_json(report.result_to_json(result, options, None if place is None else str(place)))
    else:
        _say(report.verdict_line(result))
    if not quiet:
        _tell(*report.describe(result))
        if place is not None:
            _wrote(place, quiet)
        elif result.certificate is not None and note:
            _tell(f"no certificate was written: {note}")
    if trouble is not None:
        raise trouble
    if plot is not None:
        result.plot(str(plot))
        _wrote(plot, quiet)
    if witness is not None and result.witness is not None:
        _write_witness(witness, result, quiet)
    return result.verdict.exit_code


def _require_workers(workers: int | None) -> None:
    if workers is not None:
        _require_whole("--workers", workers, 1, 1024)


def _certificate_place(
    given: Path | None, unwanted: bool, unchecked: bool, policy: Path | None
) -> tuple[Path | None, str]:
    """Where the certificate goes; None where it goes nowhere, and why where that was not asked for."""
    from .specs.errors import InputError, UsageError
    from .specs.files import require_writable
    from .verify.checker.certificate_file import MAGIC

    if given is not None and unwanted:
        raise UsageError("excludes --certificate", where="--no-certificate", remedy="give one of the two")
    if unwanted or (unchecked and given is None):
        return None, ""
    if policy is None:
        from .models.example import EXAMPLE_POLICY

        policy = Path(EXAMPLE_POLICY)
    path = Path(f"{policy.stem}.cert") if given is None else given
    if path.is_file() and _first_bytes(path, len(MAGIC)) != MAGIC:
        raise InputError(
            "the file exists and is no certificate of setrl: it is not replaced",
            where=str(path),
            remedy="choose another place with --certificate FILE, or none with --no-certificate",
        )
    try:
        require_writable(path)
    except InputError as error:
        if given is not None:
            raise
        return None, f"{_one_line(error.message)} (--certificate FILE chooses another place)"
    return path, ""


def _first_bytes(path: Path, count: int) -> bytes:
    try:
        with path.open("rb") as file:
            return file.read(count)
    except OSError:
        return b""


def _save_certificate(path: Path, content: bytes) -> tuple[Path | None, Exception | None]:
    """Write a certificate; a place that fails now does not take the verdict with it."""
    from .specs.errors import InputError
    from .specs.files import write_atomically

    try:
        write_atomically(path, content)
    except InputError as error:
        return None, error
    return path, None


def _write_witness(path: Path, result: Result, quiet: bool) -> None:
    """The witness, and what its trajectory looks like: a table and a picture beside it."""
    from .verify.plot_witness import plot_witness
    from .verify.witness_trajectory import write_trajectory

    if result.witness is None or result.candidate is None:
        raise AssertionError("a witness without the candidate that it was made of")
    _, table, picture = _witness_files(path)
    _write(path, result.witness.content, quiet)
    write_trajectory(str(table), result.loop, result.candidate)
    _wrote(table, quiet)
    plot_witness(result.loop, result.candidate, result.witness, str(picture))
    _wrote(picture, quiet)


def _witness_files(path: Path) -> tuple[Path, Path, Path]:
    return path, path.with_suffix(".csv"), path.with_suffix(".png")


@app.command(short_help="Prove a certificate or a witness again, without the engine.")
def check(
    file: Annotated[Path, typer.Argument(metavar="FILE", help="Certificate or witness.", show_default=False)],
    policy: PolicyArgument = None,
    specification: Annotated[
        str | None, typer.Argument(metavar="[SPEC]", help="Specification, as of --spec.", show_default=False)
    ] = None,
    spec: SpecOption = None,
    replay: Annotated[
        bool, typer.Option("--replay", help="Run a witness's recorded actions again with the installed onnxruntime.")
    ] = False,
    workers: WorkersOption = None,
    timeout: TimeoutOption = None,
    as_json: JsonOption = False,
    quiet: QuietOption = False,
) -> int:
    """Prove a certificate (of a VERIFIED) or a witness (of a FALSIFIED) again: ACCEPTED or REJECTED on stdout.

    Only the checker runs, from the three files; REJECTED (exit 5) means that nothing is known. Without a policy and a
    specification, those of the shipped example.
    """
    _require_workers(workers)
    stop = _stop_after(timeout)
    network, contract = _checked_inputs(policy, specification, spec)
    from .specs.errors import InputError
    from .verify.checker.recheck import MOST_BYTES, most_bytes, recheck
    from .verify.interruption import progress_bar

    evidence = _content(file, "certificate or witness", most_bytes(_first_bytes(file, 64)))
    asked = _content(network, "policy", MOST_BYTES["policy"])
    about = _content(contract, "specification", MOST_BYTES["specification"])
    again = _replayed(network) if replay else None
    with progress_bar(not quiet) as progress:
        try:
            report = None if progress is None else progress.checking
            answer = recheck(
                evidence, asked, about, contract.parent, workers=workers, progress=report, stop=stop, replay=again
            )
        except InputError as error:
            remedy = error.remedy or "give the file as setrl verify wrote it, or write it again"
            raise InputError(error.message, where=str(file), remedy=remedy) from error
    if as_json:
        _print_json({"setrl": __version__, "exit_code": OK if answer.accepted else UNKNOWN, **answer.data})
    else:
        _say(f"{'ACCEPTED' if answer.accepted else 'REJECTED'}: {_one_line(answer.sentence)}")
    if not quiet:
        _tell(*answer.notes)
    return OK if answer.accepted else UNKNOWN


def _checked_inputs(policy: Path | None, specification: str | None, spec: str | None) -> tuple[Path, Path]:
    """Policy and specification of `setrl check`, found without the readers that the checker is independent of."""
    from .specs.errors import UsageError

    order = "the order is setrl check FILE POLICY.onnx SPEC.yaml"
    if specification is not None and spec is not None:
        raise UsageError(f"received {spec} and {specification}", where="--spec", remedy="give one specification")
    chosen = spec if specification is None else specification
    if policy is None and chosen is None:
        from .models.example import EXAMPLE_SPECIFICATION, example_policy_path

        policy, chosen = example_policy_path(), EXAMPLE_SPECIFICATION
    if policy is None or policy.suffix in (".yaml", ".yml"):
        received = "nothing" if policy is None else str(policy)
        raise UsageError(f"an ONNX file is required, received {received}", where="POLICY", remedy=order)
    if chosen is None or chosen.endswith(".onnx"):
        received = "nothing" if chosen is None else chosen
        raise UsageError(f"a specification is required, received {received}", where="SPEC", remedy=order)
    if Path(chosen).is_file() and chosen.endswith((".yaml", ".yml")):
        return policy, Path(chosen)
    from .specs.reader import find_specification

    return policy, find_specification(chosen)


def _content(path: Path, what: str, most: int) -> bytes:
    """The bytes of a regular file: of nothing else it is known that they end."""
    from .specs.errors import InputError

    try:
        if not path.is_file():
            raise InputError(f"a file is required: there is no such {what}", where=str(path), remedy="check the path")
        if path.stat().st_size > most:
            raise InputError(f"no {what} has more than {most} bytes", where=str(path), remedy="check the path")
        return path.read_bytes()
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise InputError(f"cannot read the {what}: {reason}", where=str(path), remedy="check the path") from error


def _stop_after(timeout: float | None) -> Callable[[], bool] | None:
    """What the checker asks between two leaves; an interrupt aborts it, because half a check is none."""
    import time

    from .specs.errors import UsageError

    if timeout is None:
        return None
    if not timeout > 0.0:
        raise UsageError(f"received {timeout:g}", where="--timeout", remedy="use a positive number of seconds")
    end = time.monotonic() + timeout
    return lambda: time.monotonic() >= end


def _replayed(policy: Path) -> Callable[[Any], str]:
    """What runs a recording again: the runtime's name where it returns the same bits, else ""."""
    from .models.onnx_reader import read_policy
    from .verify.witness_replay import replay, runtime_name

    network = read_policy(policy)
    return lambda given: runtime_name() if replay(given.observations, given.actions, network) else ""


@app.command(short_help="Verify for several perturbation radii at once.")
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
    taylor_order: OrderOption = None,
    generators: GeneratorsOption = None,
    quiet: QuietOption = False,
) -> int:
    """Verify for several perturbation radii at once: verdict, worst reward and margins as a table.

    The exit code is that of the worst radius.
    """
    radii = _radii(epsilon)
    options = _options(timeout, splits, method, taylor_order, generators)
    _require_outputs(plot=plot, csv=csv)
    network, specification = _inputs(policy, spec, quiet)
    from .verify import tables
    from .verify.interruption import interruptible, progress_bar
    from .verify.verifier import verify_radii

    with interruptible(options.timeout) as deadline, progress_bar(not quiet) as progress:
        results = verify_radii(network, specification, radii, options=options, deadline=deadline, progress=progress)
    if as_json:
        _print_json(tables.sweep_to_json(radii, results))
    else:
        _say(*tables.sweep_table(radii, results))
    if csv is not None:
        _write(csv, tables.sweep_csv(radii, results), quiet)
    if plot is not None:
        from .verify.plot import plot_sweep

        plot_sweep([float(radius) for radius in radii], results, str(plot))
        _wrote(plot, quiet)
    return max(result.verdict.exit_code for result in results)


@app.command()
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
    _require_whole("--rollouts", rollouts, 1, 100_000)
    _require_whole("--seed", seed, 0, 2**63)
    radius = _radius(epsilon)
    _require_outputs(plot=plot, csv=csv)
    network, specification = _inputs(policy, spec, quiet)
    from .verify import tables

    loop, trajectories, summary = _simulated(network, specification, radius, rollouts, seed, attack)
    if as_json:
        _print_json(summary)
    else:
        _say(*tables.simulation_table(summary))
    if csv is not None:
        _write(csv, tables.trajectories_csv(loop, trajectories), quiet)
    if plot is not None:
        from .verify.plot import plot_trajectories

        plot_trajectories(loop, trajectories, str(plot))
        _wrote(plot, quiet)
    return OK


def _simulated(
    policy: str, spec: str, radius: Fraction | None, rollouts: int, seed: int, attack: Attack
) -> tuple[ClosedLoop, Trajectories, dict[str, Any]]:
    import numpy as np

    from .models.binding import bind
    from .models.rollouts import roll_out
    from .models.simulation import returns
    from .verify.falsifier import violations
    from .verify.tables import simulation_to_json
    from .verify.verifier import load

    network, specification = load(policy, spec)
    loop = bind(specification, network, None, radius)
    run = roll_out(loop, rollouts, attack.value, np.random.default_rng(seed))
    period, samples = float(loop.period), run.samples_per_period
    amounts = {entry.name: violations(entry, run.times, run.states, samples, period)[0] for entry in loop.requirements}
    total = None if loop.reward is None else returns(loop, run)
    return loop, run, simulation_to_json(loop, run, total, amounts)


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


@app.command(short_help="Train policies that verify.")
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
    from .specs.errors import UsageError

    _require_training()
    _stop_after(timeout)
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
    from .train import launch
    from .train.configuration import read_assignment
    from .train.run_folder import RunFolder
    from .verify.interruption import interruptible

    given |= dict(read_assignment(text) for text in assignments or ())
    if resume is None:
        if spec is None:
            from .specs.reader import shipped_specifications

            names = ", ".join(shipped_specifications())
            raise UsageError("a specification is required", where="--spec", remedy=f"a file, or a shipped one: {names}")
        run = launch.create_run(
            spec,
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
        _tell(f"run {run.path}")
    with interruptible(timeout) as deadline:
        try:
            outcome = launch.run_training(run, deadline, until_verified=until_verified, quiet=quiet, tell=_tell)
        except launch.Interrupted:
            _tell(f"setrl: stopped; go on with: setrl train --resume {run.path}")
            return ABORTED
    if as_json:
        _print_json(launch.outcome_to_json(run, outcome))
    else:
        _say(*launch.outcome_lines(run, outcome))
    return outcome.results[outcome.best].verdict.exit_code if until_verified else OK


def _require_training() -> None:
    """The extra that only trainers need, before anything is read."""
    from importlib.util import find_spec

    from .specs.errors import UsageError

    missing = [module for module in ("torch", "safetensors", "gymnasium", "tensorboard") if find_spec(module) is None]
    if missing:
        raise UsageError(
            f"training needs {', '.join(missing)}, which is not installed",
            where="train",
            remedy="install the extra: pip install 'setrl[train]'",
        )


@app.command(short_help="What trained policies are worth: V(s0), attacks, certified radius.")
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
    _require_training()
    radii, finest = _radii(epsilon), _radius(resolution, "--resolution")
    csv, plot = csv or run / "evaluation.csv", plot or run / "evaluation.png"
    from .train import launch
    from .train.run_folder import RunFolder

    RunFolder.open(run)
    _require_outputs(plot=plot, csv=csv)
    from .train.evaluation_report import evaluation_csv, evaluation_lines, evaluation_to_json
    from .train.plot_evaluation import plot_evaluation
    from .verify.interruption import share_bar

    with share_bar(not quiet) as progress:
        found = launch.evaluate_run(run, radii, certify=not no_certify, resolution=finest, progress=progress)
    if as_json:
        _print_json(evaluation_to_json(found))
    else:
        _say(*evaluation_lines(found))
    _write(csv, evaluation_csv(found), quiet)
    plot_evaluation(found, str(plot))
    _wrote(plot, quiet)
    return OK


@app.command(short_help="Print a commented specification to fill in.")
def init(
    plant: Annotated[str, typer.Argument(metavar="PLANT", help="A shipped plant's name, or a plant file.")],
    out: Annotated[Path | None, typer.Option(metavar="FILE", help="Write to a file instead of stdout.")] = None,
    force: Annotated[bool, typer.Option("--force", help="Replace the file.")] = False,
) -> int:
    """Print a commented specification for a plant, to be filled in."""
    from .models.plant import load_plant
    from .models.template import specification_template
    from .specs.files import require_writable

    if out is not None:
        require_writable(out, overwrite=force)
    text = specification_template(load_plant(plant), plant, out.parent if out is not None else Path())
    if out is None:
        _say(text.rstrip("\n"))
    else:
        _write(out, text, False)
    return OK


@app.command(short_help="List what is in a policy and what is not supported.")
def inspect(
    policy: Annotated[Path, typer.Argument(metavar="POLICY", help="ONNX file.", show_default=False)],
    as_json: JsonOption = False,
) -> int:
    """List a policy's operators, layers and sizes, and everything in it that is not supported."""
    from .models.onnx_reader import describe_policy, read_policy
    from .verify.report import policy_lines

    description = describe_policy(policy)
    if as_json:
        _print_json(description)
    else:
        _say(*policy_lines(description))
    read_policy(policy)
    return OK


@app.command(short_help="Test this machine and print versions.")
def doctor(as_json: JsonOption = False, runtime: RuntimeOption = False) -> int:
    """Test what the engine assumes about this machine, and print versions.

    With --runtime, measure tanh and sigmoid of the installed onnxruntime on all float32 numbers instead (minutes), and
    store what claims about its execution use.
    """
    if runtime:
        return _measure_runtime(as_json)
    from .verify.doctor import examination_lines, examine

    facts = examine()
    if as_json:
        _print_json(facts)
    else:
        _say(*examination_lines(facts))
    if facts["problems"]:
        _tell(*(f"setrl: error: {problem}: no verdict on this machine can be trusted" for problem in facts["problems"]))
        return BAD_INPUT
    return OK


def _measure_runtime(as_json: bool) -> int:
    from dataclasses import asdict

    from .verify.doctor import measurement_bar, measurement_lines
    from .verify.runtime_error import require_storable, store_measurement
    from .verify.runtime_measurement import measure_runtime

    require_storable()
    with measurement_bar(True) as progress:
        measurement = measure_runtime(progress)
    path = store_measurement(measurement)
    if as_json:
        _print_json(asdict(measurement))
    else:
        _say(*measurement_lines(measurement))
    _tell(f"wrote {path}")
    return OK


@app.command()
def schema(
    kind: Annotated[Kind, typer.Argument(help="Kind of file.")] = Kind.specification,
) -> int:
    """Print the JSON Schema of specifications, of plants, or of the header of certificates."""
    if kind is Kind.certificate:
        from .verify.certificate_schema import certificate_schema

        _print_json(certificate_schema())
        return OK
    from .specs.schema import json_schema

    _print_json(json_schema(kind.value))
    return OK


def _options(
    timeout: float | None,
    splits: int | None,
    method: Method | None,
    taylor_order: int | None,
    generators: int | None,
) -> Options:
    from .specs.errors import UsageError
    from .verify.options import Options

    given = {
        "--timeout": ("timeout", timeout),
        "--splits": ("splits", splits),
        "--method": ("method", None if method is None else method.value),
        "--taylor-order": ("taylor_order", taylor_order),
        "--generators": ("generators", generators),
    }
    chosen: dict[str, Any] = {}
    for flag, (name, value) in given.items():
        if value is None:
            continue
        try:
            Options(**{**chosen, name: value})
        except UsageError as error:
            raise UsageError(error.message, where=flag, remedy=f"leave {flag} out for the default") from error
        chosen[name] = value
    return Options(**chosen)


def _require_whole(flag: str, value: int, least: int, most: int) -> None:
    from .specs.errors import UsageError

    if not least <= value <= most:
        raise UsageError(f"received {value}", where=flag, remedy=f"use a whole number from {least} to {most}")


def _radii(text: str | None, flag: str = "--epsilon") -> tuple[Fraction, ...]:
    from .specs.errors import InputError
    from .specs.exact import decimal_range

    try:
        return () if text is None else decimal_range(text)
    except InputError as error:
        raise error.at(flag) from error


def _radius(text: str | None, flag: str = "--epsilon") -> Fraction | None:
    from .specs.errors import UsageError

    radii = _radii(text, flag)
    if len(radii) > 1:
        raise UsageError(f"one radius is required, received {text}", where=flag, remedy="use setrl sweep")
    return radii[0] if radii else None


def _inputs(policy: Path | None, spec: str | None, quiet: bool) -> tuple[str, str]:
    """Policy and specification as given, or the shipped example."""
    from .specs.errors import UsageError

    if policy is None and spec is None:
        from .verify.verifier import example

        network, specification = example()
        if not quiet:
            _tell(
                f"No policy was given: this is the shipped example, {Path(network).name} with {specification}.yaml.",
                "Your own: setrl verify POLICY.onnx --spec FILE.yaml; a specification to start from: setrl init PLANT",
                "",
            )
        return network, specification
    from .specs.reader import shipped_specifications

    if spec is None:
        names = ", ".join(shipped_specifications())
        raise UsageError("a specification is required", where="--spec", remedy=f"a file, or a shipped one: {names}")
    if policy is None:
        raise UsageError("a policy is required", where="POLICY", remedy="give an ONNX file before --spec")
    return str(policy), spec


def _require_outputs(
    *, plot: Path | None = None, csv: Path | None = None, witness: Path | None = None, certificate: Path | None = None
) -> None:
    """Unusable output paths are found before hours of work, and so are two outputs in one place."""
    from .specs.errors import UsageError
    from .specs.files import require_suffix, require_writable

    outputs = [("--plot", plot), ("--csv", csv), ("--certificate", certificate)]
    if witness is not None:
        require_suffix(witness, (".json",))
        outputs += [("--witness", path) for path in _witness_files(witness)]
    taken: dict[Path, str] = {}
    for flag, path in outputs:
        if path is None:
            continue
        require_writable(path)
        other = taken.setdefault(path.resolve(), flag)
        if other != flag:
            raise UsageError(f"{other} and {flag} write the same file", where=str(path), remedy="choose another name")
    if plot is not None:
        require_suffix(plot, (".png", ".pdf", ".svg"))


def _say(*lines: str) -> None:
    """Write lines to stdout."""
    typer.echo("\n".join(lines))


def _tell(*lines: str) -> None:
    """Write lines to stderr."""
    typer.echo("\n".join(lines), err=True)


def _print_json(data: Any) -> None:
    import json

    typer.echo(json.dumps(data, indent=2, ensure_ascii=False, allow_nan=False))


def _write(path: Path, text: str, quiet: bool) -> None:
    from .specs.files import write_atomically

    write_atomically(path, text.encode())
    _wrote(path, quiet)


def _wrote(path: Path, quiet: bool) -> None:
    if not quiet:
        _tell(f"wrote {path}")


def _one_line(text: object) -> str:
    return " ".join(str(text).split())


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
        _tell("setrl: aborted")
        return ABORTED
    except SystemExit as end:  # typer leaves with 1 when stdout is closed early, as by `| head`
        return PIPE_CLOSED if end.code == 1 else int(end.code or 0)
    except BrokenPipeError:
        return PIPE_CLOSED
    except Exception as error:  # noqa: BLE001 - the outermost frame: nothing continues after it
        return _failure(error)


def _usage_error(error: Any) -> int:
    if type(error).__name__ == "NoArgsIsHelpError":
        _tell(error.format_message())
        return BAD_INPUT
    command = getattr(getattr(error, "ctx", None), "command_path", "setrl")
    _tell(f"setrl: error: {_one_line(error.format_message())} (see {command} --help)")
    return BAD_INPUT


def _failure(error: Exception) -> int:
    """Wrong input is one line; anything else, a broken invariant above all, is a bug to report."""
    from .specs.errors import SetrlError

    if isinstance(error, SetrlError):
        _tell(f"setrl: error: {_one_line(error)}")
        return BAD_INPUT
    import traceback

    traceback.print_exception(error, file=sys.stderr)
    _tell(
        f"setrl: internal error: {type(error).__name__}: {_one_line(error)} (please report this "
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
