"""Flowpipe training: ascend what is verified itself, by differentiating through the closed loop's reachable sets.

A second phase, for policies that were trained on sets: from others it ends in conservative optima. Per step and seed P
pairs of a start and a radius are drawn, and the loss is their mean of ``log(-V(s0, eps))`` or of the smallest margin's
shortfall. Only the actor moves, through slopes and errors of every relaxation. It needs the plant's model, unlike the
first phase. Which of the policies on the way is kept is decided by the verifier.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ...models.closed_loop import Intervals
from ...specs.errors import UsageError
from ..networks import Layout, Tensor
from ..options import FlowpipeOptions
from ..reachable import Outcome, ReachableSets
from ..task import Task

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Evaluate = Callable[[Tensor], Array]
"""Verified performance, or margin, of every policy: parameters (S, N) to (S,), higher is better."""
Progress = Callable[[int, int, float], None]
"""Receives the step, the number of steps and the median of the surrogate's V over seeds."""

STREAM = 1000
"""Separates the draws of this phase from all others: seed, this number and the step are their seed sequence."""
EVALUATE_EVERY = 20
"""Steps between two evaluations by the verifier."""
RADIUS_FACTOR = 5.0
"""Largest radius where the options leave it open, in units of the specification's."""
AT_START = 2
"""One pair in so many starts from the specification's initial set, the others from the box of training starts. Margins
are asked of the initial set alone: a requirement says nothing about other starts."""
ROOM = 0.1
"""Margin up to which `both` asks for more of it, in the requirement's unit: between periods' ends some is lost."""
MEMORY = (0.9, 0.999)
SMALLEST = 1e-8
"""Adam's: decay of the moments, and what is added to the root of the second one."""


@dataclass(frozen=True)
class Pairs:
    """Start boxes and radii of one step.

    Attributes
    ----------
    center, radius : array, shape (S, P, n)
    epsilon : array, shape (S, P)
    """

    center: Array
    radius: Array
    epsilon: Array


@dataclass(frozen=True)
class FlowpipeStatistics:
    """What happened in one step; arrays of shape (S,).

    Attributes
    ----------
    step : int
        1 for the first.
    loss : array
    value : array
        Median over the pairs of the surrogate's V, which is no proof.
    skipped : array of bool
        Seeds whose gradient was not finite: they did not move.
    score : array or None
        What the verifier says about the policies after this step, where it was asked.
    """

    step: int
    loss: Array
    value: Array
    skipped: Bools
    score: Array | None


class FlowpipeTrainer:
    """The second phase of all seeds of one run.

    Every number of a seed depends on that seed alone, and every step's draws on seed and step: a seed among others
    becomes what it would become alone, and a run that goes on from `tensors` and `numbers` what it would have become
    undisturbed.

    Parameters
    ----------
    task : Task
    layout : Layout
        Of the policies.
    actor : Tensor, shape (S, N)
        What to start from; it is not changed.
    options : FlowpipeOptions
    seeds : sequence of int
    evaluate : callable, optional
        Decides which policies are kept: the best ones by its answer, the first ones included. Without it the last ones.
    every : int
        Steps between two evaluations.

    Raises
    ------
    UsageError
        Margins are asked for and the specification has no requirements.
    """

    def __init__(
        self,
        task: Task,
        layout: Layout,
        actor: Tensor,
        options: FlowpipeOptions,
        seeds: Sequence[int],
        evaluate: Evaluate | None = None,
        every: int = EVALUATE_EVERY,
    ) -> None:
        if options.objective != "value" and not task.loop.requirements:
            raise UsageError(
                f"{options.objective} asks for margins, and the specification has no requirements",
                where="flowpipe.objective",
                remedy="choose value, or add a requirement",
            )
        self.options, self.seeds, self.evaluate, self.every = options, tuple(seeds), evaluate, every
        self.sets = ReachableSets(task, layout)
        self.epsilon = RADIUS_FACTOR * task.epsilon if options.epsilon is None else options.epsilon
        self.start, self.initial = _box(task.start), _box(task.loop.initial)
        self.at_start = options.pairs if options.objective == "margin" else -(-options.pairs // AT_START)
        self.step, self._like = 0, actor.detach()
        self.parameters = actor.detach().to("cpu", torch.float64, copy=True)
        self.first, self.second = torch.zeros_like(self.parameters), torch.zeros_like(self.parameters)
        self.moves = torch.zeros((len(self.seeds), 1), dtype=torch.float64)
        self.kept = self.parameters.clone()
        self.scores = torch.full((len(self.seeds),), -torch.inf, dtype=torch.float64)

    @property
    def done(self) -> bool:
        """Whether all steps were made."""
        return self.step >= self.options.steps

    @property
    def actor(self) -> Tensor:
        """The policies as they are now, (S, N), of the type of those it started from."""
        return self.parameters.to(self._like, copy=True)

    @property
    def best(self) -> Tensor:
        """The policies that the verifier found best, (S, N); those that are now where nothing evaluates them."""
        return self.actor if self.evaluate is None else self.kept.to(self._like, copy=True)

    def advance(self) -> FlowpipeStatistics:
        """One gradient step of every seed."""
        if self.step == 0:
            self._evaluate()
        outcome, loss, gradient = self.gradient(self.pairs(self.step))
        finite = torch.isfinite(gradient).all(1, keepdim=True)
        self._move(torch.where(finite, gradient, 0.0), finite)
        self.step += 1
        score = self._evaluate() if self.step % self.every == 0 or self.done else None
        value = outcome.value.detach().numpy()
        return FlowpipeStatistics(self.step, loss.numpy(), np.median(value, 1), ~finite[:, 0].numpy(), score)

    def pairs(self, step: int) -> Pairs:
        """Draw starts and radii: radii stratified over [0, epsilon], in random order over the starts.

        The first starts are the initial set, the others have a center that is uniform in the box of training starts and
        the initial set's size, as far as it fits.
        """
        count = self.options.pairs
        centers, epsilons = [], []
        for seed in self.seeds:
            generator = np.random.default_rng(np.random.SeedSequence((seed, STREAM, step)))
            order = generator.permutation(count)
            epsilons.append(self.epsilon * (order + generator.random(count)) / count)
            shares = generator.random((count, self.start.shape[1]))
            centers.append(self.start[0] + shares * (self.start[1] - self.start[0]))
        center, middle = np.stack(centers), self.initial.mean(0)
        size = 0.5 * (self.initial[1] - self.initial[0])
        room = np.minimum(center - self.start[0], self.start[1] - center)
        radius = np.minimum(size, np.maximum(room, 0.0))
        center[:, : self.at_start], radius[:, : self.at_start] = middle, size
        return Pairs(center, radius, np.stack(epsilons))

    def gradient(self, pairs: Pairs) -> tuple[Outcome, Tensor, Tensor]:
        """Outcome, loss (S,) and gradient (S, N) of the policies as they are now, on given pairs."""
        actor = self.parameters.clone().requires_grad_()
        outcome = self.sets.outcome(actor, pairs.center, pairs.radius, pairs.epsilon)
        losses = self._losses(outcome)
        losses.sum().backward()
        assert actor.grad is not None
        return outcome, losses.detach(), actor.grad

    def tensors(self) -> dict[str, Tensor]:
        """Networks, moments and scores: the whole state, together with `numbers`."""
        return {name: getattr(self, name) for name in ("parameters", "first", "second", "moves", "kept", "scores")}

    def numbers(self) -> dict[str, Any]:
        """The step, as plain data."""
        return {"step": self.step}

    def restore(self, tensors: dict[str, Tensor], numbers: dict[str, Any]) -> None:
        """Go on from a state of the same run."""
        for name, tensor in self.tensors().items():
            tensor.copy_(tensors[name])
        self.step = int(numbers["step"])

    def _losses(self, outcome: Outcome) -> Tensor:
        """Means over the pairs, (S,)."""
        cost = (SMALLEST - outcome.value).log().mean(1)
        if self.options.objective == "value":
            return cost
        short = -outcome.margins.amin(-1)[:, : self.at_start]
        if self.options.objective == "both":
            return cost + (short + ROOM).clamp(min=0.0).log1p().mean(1)
        # as a logarithm where it is violated: what explodes must not outweigh the rest
        return torch.where(short > 0.0, short.clamp(min=0.0).log1p(), short).mean(1)

    def _move(self, gradient: Tensor, finite: Tensor) -> None:
        """Adam with a clipped gradient, seed by seed; a seed that is not finite keeps its moments too."""
        options = self.options
        norm = gradient.square().sum(1, keepdim=True).sqrt()
        gradient = gradient * (options.clip / norm.clamp(min=options.clip))
        self.moves += finite
        self.first.copy_(torch.where(finite, torch.lerp(gradient, self.first, MEMORY[0]), self.first))
        self.second.copy_(torch.where(finite, torch.lerp(gradient.square(), self.second, MEMORY[1]), self.second))
        share = self.step / max(options.steps - 1, 1)
        rate = options.learning_rate * (options.final_learning_rate / options.learning_rate) ** share
        moves = self.moves.clamp(min=1.0)
        mean = self.first / (1.0 - MEMORY[0] ** moves)
        size = (self.second / (1.0 - MEMORY[1] ** moves)).sqrt() + SMALLEST
        self.parameters -= torch.where(finite, rate * mean / size, 0.0)

    def _evaluate(self) -> Array | None:
        """Ask the verifier, and keep the policies that are better than before."""
        if self.evaluate is None:
            return None
        score = np.asarray(self.evaluate(self.actor), dtype=np.float64)
        better = torch.from_numpy(score > self.scores.numpy())
        self.scores[better] = torch.from_numpy(score)[better]
        self.kept[better] = self.parameters[better]
        return score


def ascend(
    task: Task,
    layout: Layout,
    actor: Tensor,
    options: FlowpipeOptions,
    seeds: Sequence[int],
    evaluate: Evaluate | None = None,
    progress: Progress | None = None,
) -> Tensor:
    """Run the whole second phase.

    Parameters
    ----------
    task : Task
    layout : Layout
        Of the policies.
    actor : Tensor, shape (S, N)
        What to start from; it is not changed.
    options : FlowpipeOptions
    seeds : sequence of int
    evaluate : callable, optional
        Decides which policies are kept; see `FlowpipeTrainer`.
    progress : callable, optional
        Told after every step.

    Returns
    -------
    Tensor, shape (S, N)

    Raises
    ------
    UsageError
        Margins are asked for and the specification has no requirements.
    """
    trainer = FlowpipeTrainer(task, layout, actor, options, seeds, evaluate)
    while not trainer.done:
        statistics = trainer.advance()
        if progress is not None:
            progress(statistics.step, options.steps, float(np.median(statistics.value)))
    return trainer.best


def _box(intervals: Intervals) -> Array:
    """Lower and upper bounds, (2, n)."""
    return np.array([[float(low), float(high)] for low, high in intervals]).T
