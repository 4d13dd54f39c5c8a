"""From a command's arguments to a run: what `setrl train` and `setrl evaluate` do, without the command line."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

from ..models.onnx_reader import read_policy
from ..specs.errors import InputError, UsageError
from ..specs.reader import find_specification, read_specification
from ..verify.deadline import Deadline
from . import checkpoints
from .configuration import configure
from .evaluation import Evaluation, EvaluationOptions, evaluate
from .options import TrainingOptions, plain
from .progress import training_progress
from .run_folder import RunFolder
from .session import FIRST, Interrupted, Outcome, Session, Tell, critics_of, require_trainable
from .task import start_bounds, task_of


def create_run(
    spec: str,
    given: Mapping[str, Any],
    *,
    name: str | None = None,
    folder: Path = Path("runs"),
    file: Path | None = None,
    preset: str | None = None,
    source: Path | None = None,
) -> RunFolder:
    """Check everything, then make the folder of a new run.

    Parameters
    ----------
    spec : str
        A file or a shipped specification's name.
    given : mapping
        Options of the command line, see `configuration.configure`.
    name : str, optional
        Default: specification, algorithm, and td3 where that is its base.
    folder : Path
    file, preset
        See `configuration.configure`.
    source : Path, optional
        A finished run whose best policies and critics are what this one begins with, seed by seed; then it has no
        episodes of its own unless `given` says so.

    Returns
    -------
    RunFolder

    Raises
    ------
    SetrlError
        Before anything is written.
    """
    specification = read_specification(find_specification(spec))
    if source is not None:
        given = {**inherited(source), "episodes": 0, **given}
    configuration = configure(specification, given, file=file, preset=preset)
    options, start = configuration.options, configuration.start
    first = None if source is None else first_policies(source, options)
    task = task_of(specification, None if start is None else start_bounds(start))
    require_trainable(task, options)
    if name is None:
        parts = [Path(specification.source).stem, options.algorithm]
        parts += ["td3"] if options.base == "td3" else []
        parts += ["flowpipe"] if options.flowpipe.steps else []
        name = "-".join(parts)
    elif Path(name).name != name or name in (".", ".."):
        raise UsageError(
            f"a plain name is required, received {name!r}", where="--name", remedy="use --runs for folders"
        )
    content = {"options": plain(options), "start": start, "radii": list(configuration.radii)}
    run = RunFolder.create(folder / name, content, specification)
    if first is not None:
        checkpoints.save(run.path / FIRST, first, {"from": Path(source or "").name})
    return run


def inherited(source: Path) -> dict[str, Any]:
    """What a run has in common with the one that it begins with."""
    options = RunFolder.open(source).options()
    names = ("algorithm", "base", "seeds", "first_seed", "hidden", "precision")
    return {name: list(value) if isinstance(value := getattr(options, name), tuple) else value for name in names}


def first_policies(source: Path, options: TrainingOptions) -> dict[str, Any]:
    """Best policies and critics of a run, by name.

    Raises
    ------
    SetrlError
        The run has none, or networks or seeds of another kind.
    """
    run = RunFolder.open(source)
    if not checkpoints.stored(run.checkpoints):
        raise InputError("the run has no checkpoint", where=str(source), remedy="finish it: setrl train --resume RUN")
    theirs = run.options()
    for name in ("hidden", "base", "seed_numbers", "precision"):
        if getattr(theirs, name) != getattr(options, name):
            raise UsageError(
                f"the run has {getattr(theirs, name)}, this one would have {getattr(options, name)}",
                where=f"--from {source}: {name}",
                remedy="leave the option out",
            )
    tensors, _, _ = checkpoints.load(run.checkpoints)
    return {name: tensors[name] for name in ("best.actor", "best.critic")}


def run_training(
    run: RunFolder, deadline: Deadline, *, until_verified: bool = False, quiet: bool = False, tell: Tell
) -> Outcome:
    """Run what is left of a run; one process at a time.

    Raises
    ------
    Interrupted
        The deadline was interrupted; the run can be resumed.
    SetrlError
        The run cannot go on, for example because the disk is full.
    """
    import torch

    torch.set_num_threads(1)  # small networks: more threads wait for each other most of the time
    changes = run.version_changes()
    if changes:
        tell(f"since this run began: {', '.join(changes)}; it may continue with other bits")
    with run.locked(), training_progress(not quiet, run.options().episodes) as progress:
        session = Session(run, progress, lambda: deadline.interrupted, tell)
        return session.train_until_verified(deadline) if until_verified else session.train()


def outcome_lines(run: RunFolder, outcome: Outcome) -> list[str]:
    """A table for people: every seed's V at the validation radius and its verdict."""
    lines = ["seed   V(s0)      verdict"]
    for seed, value in outcome.values.items():
        mark = "  <- policy.onnx" if seed == outcome.best else ""
        lines.append(f"{seed:<6} {value:<10.4g} {outcome.results[seed].verdict.value}{mark}")
    return [*lines, f"{run.policy}"]


def outcome_to_json(run: RunFolder, outcome: Outcome) -> dict[str, Any]:
    """The same as plain data."""
    return {
        "run": str(run.path),
        "policy": str(run.policy),
        "best_seed": outcome.best,
        "seeds": {
            str(seed): {
                "value": value if math.isfinite(value) else None,
                "verdict": outcome.results[seed].verdict.value,
            }
            for seed, value in outcome.values.items()
        },
    }


def evaluate_run(
    path: Path,
    radii: Sequence[Fraction] = (),
    *,
    certify: bool = True,
    resolution: Fraction | None = None,
    progress: Any = None,
) -> Evaluation:
    """Evaluate the exported policies of a run.

    Parameters
    ----------
    path : Path
        Folder of a run that has finished.
    radii : sequence of Fraction
        Default: those of the specification's tuned settings, else 0 to twice the specification's radius.
    certify : bool
        Whether the certified radius is searched.
    resolution : Fraction, optional
        Of the certified radius.
    progress : callable, optional
        See `evaluation.evaluate`.

    Returns
    -------
    Evaluation

    Raises
    ------
    SetrlError
        There are no policies yet, or they do not fit.
    """
    import torch

    torch.set_num_threads(1)
    run = RunFolder.open(path)
    options = run.options()
    start = run.configuration.get("start")
    task = task_of(run.read_specification(), None if start is None else start_bounds(start))
    files = [run.seed(seed) / "policy.onnx" for seed in options.seed_numbers]
    missing = [file for file in files if not file.is_file()]
    if missing:
        raise InputError(
            "the run has not finished: this policy is not there yet",
            where=str(missing[0]),
            remedy=f"finish it: setrl train --resume {path}",
        )
    chosen = tuple(radii) or tuple(Fraction(str(radius)) for radius in run.configuration.get("radii", ()))
    if not chosen:
        chosen = tuple(Fraction(repr(task.epsilon)) * step / 5 for step in range(11))
    critics = critics_of(run)
    wanted = EvaluationOptions(chosen, certify=certify)
    return evaluate(
        task,
        [read_policy(str(file)) for file in files],
        wanted if resolution is None else replace(wanted, resolution=resolution),
        seeds=options.seed_numbers,
        critic_layout=None if critics is None else critics[0],
        critic=None if critics is None else critics[1],
        progress=progress,
    )


__all__ = ["Interrupted", "create_run", "evaluate_run", "outcome_lines", "outcome_to_json", "run_training"]
