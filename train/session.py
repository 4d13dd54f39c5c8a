"""A training run from its folder to its reports: episodes, the phase through reachable sets, exported policies.

Whatever is written is written so that a run that was killed goes on where its last checkpoint was taken, and ends with
the files of an undisturbed one.
"""

from __future__ import annotations

import shutil
from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.onnx_reader import read_policy
from ..models.onnx_writer import policy_bytes
from ..models.policy import Policy
from ..specs.errors import UsageError
from ..specs.exact import signed_text
from ..verify.deadline import Deadline
from ..verify.options import Options
from ..verify.result import Result, Verdict
from . import checkpoints
from .algorithms.flowpipe import FlowpipeTrainer
from .evaluation import verified_performance
from .events import EventWriter
from .export import export_policy, publish_best, report_policy
from .learning_curves import LearningCurves, plot_curves, read_curves
from .networks import Layout, Tensor, layers_of
from .options import FlowpipeOptions, TrainingOptions
from .progress import TrainingProgress
from .run_folder import RunFolder
from .task import Task, start_bounds, task_of
from .trainer import Trainer, make_lanes

Array = NDArray[np.float64]
Stop = Callable[[], bool]
Tell = Callable[[str], None]

FIRST = "first"
"""Folder of a run that begins with another one's policies."""
EPISODES, SETS, DONE = "episodes", "flowpipe", "done"
"""Phases of a run."""
ROUND_STEPS = 100
"""Steps through reachable sets of one further round, where a run goes on until it verifies."""
ROUND_RADIUS = 1.2
"""Largest radius of such a round, in units of the one that has to verify."""
MOST_ROUNDS = 20
REPORT_SECONDS = 20.0
"""For the verification report of one policy; `setrl verify` takes as long as it is given."""
CURVES_OF_SETS = ("step", "seed", "loss", "value")


class Interrupted(Exception):
    """The run was stopped; its last checkpoint has everything."""


@dataclass(frozen=True)
class Outcome:
    """What a run came to.

    Attributes
    ----------
    values : mapping of seed to float
        V(s0) at the validation radius.
    results : mapping of seed to Result
        Of every policy, at the specification's own radius.
    best : int
        The seed whose policy is the run's.
    """

    values: Mapping[int, float]
    results: Mapping[int, Result]
    best: int


class Session:
    """One run, new or resumed.

    Parameters
    ----------
    run : RunFolder
    progress : TrainingProgress
    stop : callable
        Asked after every episode and step; once it says True the run ends with a checkpoint and `Interrupted`.
    tell : callable
        Takes sentences for people.
    """

    def __init__(self, run: RunFolder, progress: TrainingProgress, stop: Stop, tell: Tell) -> None:
        self.run, self.progress, self.stop, self.tell = run, progress, stop, tell
        self.options = run.options()
        specification = run.read_specification()
        start = run.configuration.get("start")
        self.task = task_of(specification, None if start is None else start_bounds(start))
        radius = self.options.validation_epsilon
        if radius is None:
            radius = self.task.epsilon if self.options.epsilon is None else self.options.epsilon
        self.radius = Fraction(repr(radius))
        self.radii = (self.radius, Fraction(0))
        self.trainer = Trainer(make_lanes(self.task, self.options), self.options)
        self.phase, self.rounds = EPISODES, 0
        self.best_actor, self.best_critic = self.trainer.actor.cpu().clone(), self.trainer.critic.cpu().clone()
        self.best = np.full((len(self.options.seed_numbers), 2), -np.inf)
        self.sets: FlowpipeTrainer | None = None
        self._restore()

    def _restore(self) -> None:
        first = self.run.path / FIRST
        if checkpoints.stored(first):
            tensors, _, _ = checkpoints.load(first, tell=self.tell)
            networks = self.trainer.networks
            for online, target in (("actor", "target_actor"), ("critic", "target_critic")):
                given = tensors[f"best.{online}"]
                for name in (online, target):
                    getattr(networks, name)[: len(given)] = given
            self.best_actor, self.best_critic = tensors["best.actor"], tensors["best.critic"]
        if not checkpoints.stored(self.run.checkpoints):
            return
        tensors, numbers, _ = checkpoints.load(self.run.checkpoints, tell=self.tell)
        self.trainer.restore(_part(tensors, "trainer."), numbers["trainer"])
        self.phase, self.rounds = numbers["phase"], numbers["rounds"]
        self.best_actor, self.best_critic = tensors["best.actor"], tensors["best.critic"]
        self.best = np.array(numbers["best"])
        if "sets" in numbers:
            self.sets = self._sets(tensors["sets_start"], self._set_options(self.rounds))
            self.sets.restore(_part(tensors, "sets."), numbers["sets"])

    def _save(self) -> None:
        tensors = {f"trainer.{name}": value for name, value in self.trainer.tensors().items()}
        tensors |= {"best.actor": self.best_actor, "best.critic": self.best_critic}
        numbers: dict[str, Any] = {
            "trainer": self.trainer.numbers(),
            "phase": self.phase,
            "rounds": self.rounds,
            "best": self.best.tolist(),
        }
        if self.sets is not None:
            tensors |= {f"sets.{name}": value for name, value in self.sets.tensors().items()}
            tensors["sets_start"] = self._sets_start
            numbers["sets"] = self.sets.numbers()
        checkpoints.save(self.run.checkpoints, tensors, numbers)

    def values(self, actor: Tensor) -> Array:
        """V(s0) of policies (S, P) at the validation radius, by the verifier; -inf where there is none."""
        return self._verified(actor)[:, 0]

    def _verified(self, actor: Tensor) -> Array:
        """V(s0) at the validation radius and without perturbation, (S, 2)."""
        found = np.full((len(actor), 2), -np.inf)
        for row, values in zip(actor, found, strict=True):
            if torch.isfinite(row).all():  # else it is no policy
                policy = as_policy(self.trainer.actor_layout, row, self.options.precision)
                values[:] = verified_performance(self.task, policy, self.radii).discounted
        return found

    def train(self) -> Outcome:
        """Run what is left of the run: episodes, reachable sets, reports."""
        self._episodes()
        if self.phase == SETS or (self.phase == EPISODES and self.options.flowpipe.steps):
            self._through_sets()
        self._finish()
        return self.report()

    def _finish(self) -> None:
        self.phase = DONE
        self._save()

    def train_until_verified(self, deadline: Deadline) -> Outcome:
        """`train`, then further rounds through reachable sets until the best policy verifies or time is up."""
        outcome = self.train()
        while not _verified(outcome) and not deadline.expired and self.rounds < MOST_ROUNDS:
            self.tell(f"not verified yet; round {self.rounds + 1} through the reachable sets")
            self._through_sets()
            self._finish()
            outcome = self.report()
        return outcome

    def _episodes(self) -> None:
        trainer, options = self.trainer, self.options
        curves = LearningCurves(self.run.curves, self.options.seed_numbers, completed=trainer.episode)
        events = EventWriter(self.run.events, self.options.seed_numbers, completed=trainer.episode)
        self.progress.begin(options.episodes, "episode", trainer.episode)
        if trainer.episode == 0 and not np.isfinite(self.best).any():
            self._validate()  # what it begins with is never lost
        try:
            while trainer.episode < options.episodes:
                statistics = trainer.run_episode()
                episode = statistics.episode
                row = {
                    "return": statistics.returns,
                    "steps": statistics.steps,
                    "critic_loss": statistics.critic_loss,
                    "actor_loss": statistics.actor_loss,
                }
                last = episode == options.episodes
                if last or (options.validation_every and episode % options.validation_every == 0):
                    row["value"] = self._validate()
                curves.add(episode, row)
                events.add(episode, row)
                self.progress.advance(episode, statistics.returns)
                stopped = self.stop()
                if last or stopped or episode % options.checkpoint_every == 0:
                    curves.flush()
                    events.flush()
                    self._save()
                if stopped and not last:
                    raise Interrupted
        finally:
            curves.close()
            events.close()

    def _validate(self) -> Array:
        """V of every seed now; those that are better than ever are kept.

        Where nothing is proved at the validation radius, what is proved without perturbation decides; where nothing is
        proved at all, the later one is kept.
        """
        values, best = self._verified(self.trainer.actor), self.best
        higher = values > best
        better = np.flatnonzero(higher[:, 0] | ((values[:, 0] == best[:, 0]) & (values[:, 1] >= best[:, 1])))
        self.best_actor[better] = self.trainer.actor[better].cpu()
        self.best_critic[better] = self.trainer.critic[better].cpu()
        self.best[better] = values[better]
        self.progress.validated(values[:, 0])
        return np.asarray(values[:, 0])

    def _set_options(self, rounds: int) -> FlowpipeOptions:
        """Options of a round: the run's own first, then margins too, at the radius that has to verify."""
        options = self.options.flowpipe
        if rounds <= 1 and options.steps:
            return options
        return replace(
            options,
            objective="both" if self.task.loop.requirements else "value",
            steps=options.steps or ROUND_STEPS,
            epsilon=ROUND_RADIUS * self.task.epsilon,
        )

    def _sets(self, actor: Tensor, options: FlowpipeOptions) -> FlowpipeTrainer:
        self._sets_start = actor
        seeds = self.options.seed_numbers
        return FlowpipeTrainer(self.task, self.trainer.actor_layout, actor, options, seeds, self.values)

    def _through_sets(self) -> None:
        """One round of the second phase, from the best policies so far."""
        if self.phase != SETS or self.sets is None:
            self.rounds += 1
            self.phase = SETS
            self.sets = self._sets(self.best_actor.clone(), self._set_options(self.rounds))
        sets = self.sets
        total, seeds = sets.options.steps, self.options.seed_numbers
        path = self.run.path / f"flowpipe-{self.rounds}.csv"
        curves = LearningCurves(path, seeds, completed=sets.step, columns=CURVES_OF_SETS)
        self.progress.begin(total, "step", sets.step)
        try:
            while not sets.done:
                statistics = sets.advance()
                row = {"loss": statistics.loss}
                if statistics.score is not None:
                    row["value"] = statistics.score
                    self.progress.validated(statistics.score)
                curves.add(statistics.step, row)
                self.progress.advance(statistics.step)
                stopped = self.stop()
                if stopped or sets.done or statistics.score is not None:
                    curves.flush()
                    self._save()
                if stopped and not sets.done:
                    raise Interrupted
        finally:
            curves.close()
        self.best_actor = sets.best.clone()
        self.best = self._verified(self.best_actor)

    def report(self) -> Outcome:
        """Export every seed's best policy and verify it; the best one is the run's."""
        run, options = self.run, self.options
        name = f"{options.algorithm} ({options.base}) for {Path(run.specification).name}"
        values = dict(zip(options.seed_numbers, self.best[:, 0].tolist(), strict=True))
        results = {}
        for seed, row in zip(options.seed_numbers, self.best_actor, strict=True):
            folder = run.seed(seed)
            description = f"Trained by setrl: {name}, seed {seed}."
            export_policy(folder, self.trainer.actor_layout, row, precision=options.precision, description=description)
            budget = Options(timeout=REPORT_SECONDS, splits=2000)
            results[seed] = report_policy(folder, run.specification, options=budget)
        proved = {seed for seed, result in results.items() if result.verdict is Verdict.VERIFIED}
        candidates = {seed: value for seed, value in values.items() if seed in proved} or values
        facts = {
            "validation_epsilon": signed_text(self.radius),
            "verdicts": {str(seed): result.verdict.value for seed, result in results.items()},
        }
        best = publish_best(run, candidates, {"all_values": _finite(values), **facts})
        if run.curves.is_file() and options.episodes:
            subtitle = f"V(s0) at radius {signed_text(self.radius)}"
            plot_curves(read_curves(run.curves), str(run.curves_picture), name, subtitle)
        return Outcome(values, results, best)


def as_policy(layout: Layout, row: Tensor, precision: str) -> Policy:
    """The network of one seed as the verifier reads it from a file."""
    return read_policy(policy_bytes(layers_of(layout, row), precision=precision))


def critics_of(run: RunFolder) -> tuple[Layout, Tensor] | None:
    """Critics that belong to the policies of a finished run, with their layout; None where there is no checkpoint."""
    if not checkpoints.stored(run.checkpoints):
        return None
    tensors, _, _ = checkpoints.load(run.checkpoints)
    task = task_of(run.read_specification())
    return Layout((task.inputs + task.actions, *run.options().hidden, 1), False), tensors["best.critic"]


def _part(tensors: Mapping[str, Tensor], prefix: str) -> dict[str, Tensor]:
    return {name.removeprefix(prefix): value for name, value in tensors.items() if name.startswith(prefix)}


def _verified(outcome: Outcome) -> bool:
    return outcome.results[outcome.best].verdict is Verdict.VERIFIED


def _finite(values: Mapping[int, float]) -> dict[str, float | None]:
    return {str(seed): value if np.isfinite(value) else None for seed, value in values.items()}


def require_trainable(task: Task, options: TrainingOptions) -> None:
    """Check before any folder is made that the run can begin.

    Raises
    ------
    SetrlError
        The specification cannot be trained with these options.
    """
    if options.device == "cuda" and not torch.cuda.is_available():
        raise UsageError("no CUDA device is available", where="device", remedy="leave --device out")
    if options.compile and not any(shutil.which(name) for name in ("c++", "g++", "clang++")):
        raise UsageError("no C++ compiler was found", where="compile", remedy="install g++, or leave compile out")
    if options.flowpipe.steps:
        layout = Layout((task.inputs, *options.hidden, task.actions), True)
        none = torch.zeros((1, layout.parameters))
        FlowpipeTrainer(task, layout, none, options.flowpipe, (0,))
