"""An adversary of its own for every policy and radius: what it does in every state is learnt for the lowest return.

Period k of a lane: ``beta_k = tanh(W_2 tanh(W_1 s_k + b) + c_k)``, s_k the state in units of what the start and the
targets span; the observation is off by beta_k times the radius. ``W, b, c`` minimise the discounted return by Adam
through the closed loop, differentiated from end to end: the adversary knows the plant, the policy and the state, which
`attacks` do not all. Disturbances within bounds are the adversary's too; one that is constant over a run is learnt as
such.

All policies, radii and restarts are lanes of one array program. What comes out is a sequence of perturbations per lane;
what it is worth is for `models.simulation` to say.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from ..specs.errors import UsageError
from .attacks import Stack
from .networks import Layout, Tensor
from .task import Task
from .tensor_loop import TensorLoop

Array = NDArray[np.float64]

NEARLY = 0.98
"""A first sequence that is given starts at most so far out: at +-1 itself tanh has no argument and no slope."""


@dataclass(frozen=True)
class AdversaryOptions:
    """How hard the adversary tries.

    Attributes
    ----------
    restarts : int
        Random first adversaries per policy and radius, besides the sequences that are given.
    steps : int
        Adam steps.
    hidden : int
        Width of its hidden layer.
    learning_rate : float
    """

    restarts: int = 3
    steps: int = 60
    hidden: int = 16
    learning_rate: float = 0.1

    def __post_init__(self) -> None:
        for name, least in (("restarts", 0), ("steps", 0), ("hidden", 1)):
            if getattr(self, name) < least:
                raise UsageError(f"at least {least} is required, received {getattr(self, name)}", where=name)
        if not (0.0 < self.learning_rate < np.inf):
            raise UsageError(f"a number > 0 is required, received {self.learning_rate}", where="learning_rate")


@dataclass(frozen=True, eq=False)
class Perturbations:
    """Sequences that an adversary found.

    Attributes
    ----------
    betas : array, shape (S, E, R, T, q)
        In [-1, 1]: shares of the rows of the perturbed set.
    forces : array, shape (S, E, R, T, d)
        Disturbances, within their bounds.
    """

    betas: Array
    forces: Array


def adapt(
    task: Task,
    layout: Layout,
    actor: Tensor,
    radii: Array,
    starts: Array,
    given: Array,
    generator: np.random.Generator,
    options: AdversaryOptions | None = None,
) -> Perturbations:
    """Learn perturbations for the lowest discounted return.

    Parameters
    ----------
    task : Task
    layout : Layout
    actor : Tensor, shape (S, P), float64
    radii : array, shape (E,)
    starts : array, shape (S, E, n)
        Initial state of each policy and radius.
    given : array, shape (S, E, G, T, q)
        Sequences from which G restarts begin.
    generator : numpy.random.Generator
    options : AdversaryOptions, optional

    Returns
    -------
    Perturbations
        Of R = 2 (G + restarts): each as it was learnt, and pushed to the nearest vertex of the set, where the worst
        perturbation usually is.
    """
    options = options or AdversaryOptions()
    seeds, count, warm = given.shape[:3]
    restarts = warm + options.restarts
    loop, stack = TensorLoop(task), Stack(layout, actor)
    rows = torch.from_numpy(radii[:, None, None] * task.perturbation).repeat_interleave(restarts, 0)
    state = torch.from_numpy(starts)[:, :, None].expand(-1, -1, restarts, -1).flatten(1, 2)
    adversary = _Adversary(task, loop, (seeds, count, restarts), given, starts, generator, options)
    adam = torch.optim.Adam(adversary.parameters, lr=options.learning_rate)
    best = torch.full((seeds, count * restarts), torch.inf, dtype=torch.float64)
    kept: tuple[Tensor, Tensor] | None = None
    for step in range(options.steps + 1):
        with torch.set_grad_enabled(step < options.steps):
            total, betas, forces = _roll_out(loop, stack, rows, state, adversary)
        found = total.detach().nan_to_num(nan=-torch.inf)
        if kept is None:
            kept, best = (betas.detach(), forces.detach()), found
        lower = (found < best)[..., None, None]
        kept = torch.where(lower, betas.detach(), kept[0]), torch.where(lower, forces.detach(), kept[1])
        best = torch.minimum(found, best)
        if not total.requires_grad:
            break  # nothing that is perturbed acts before the end
        if step < options.steps:
            adam.zero_grad()
            total.sum().backward()
            # a lane whose trajectory overflows has no gradient any more; the others go on
            for parameter in adversary.parameters:
                assert parameter.grad is not None
                parameter.grad.nan_to_num_(0.0, 0.0, 0.0)
            adam.step()
    assert kept is not None
    return _with_vertices(loop, kept, (seeds, count, restarts))


class _Adversary:
    """Parameters of all lanes, (S, E * R, ...); the last axis of outputs is q perturbations and d disturbances."""

    def __init__(
        self,
        task: Task,
        loop: TensorLoop,
        shape: tuple[int, int, int],
        given: Array,
        starts: Array,
        generator: np.random.Generator,
        options: AdversaryOptions,
    ) -> None:
        seeds, count, restarts = shape
        states, self.rows = starts.shape[-1], len(task.perturbation)
        outputs = self.rows + len(loop.forces_center)
        self.constant = torch.tensor([entry.constant for entry in task.loop.disturbances], dtype=torch.bool)
        # without a trajectory to look at: the start and the target say how large a state is
        target = loop.target.numpy()
        self.scale = torch.from_numpy(np.maximum(np.abs(starts - target).max((0, 1)), 1.0))
        size = (seeds, count, restarts)
        first = generator.normal(size=(*size, options.hidden, states))
        bias = generator.normal(size=(*size, options.hidden))
        second = generator.normal(size=(*size, outputs, options.hidden)) / np.sqrt(options.hidden)
        # a push that stays the same for the whole run, another one per lane
        periods = np.repeat(generator.normal(size=(*size, 1, outputs)), task.horizon, axis=3)
        warm = given.shape[2]
        second[:, :, :warm] = 0.0
        periods[:, :, :warm, :, self.rows :] = 0.0
        periods[:, :, :warm, :, : self.rows] = np.arctanh(np.clip(given, -NEARLY, NEARLY))
        flat = [torch.from_numpy(part).flatten(1, 2) for part in (first, bias, second, periods)]
        self.parameters = [part.clone().requires_grad_() for part in flat]

    def __call__(self, period: int, state: Tensor) -> tuple[Tensor, Tensor]:
        """Shares (S, E * R, q) of the rows, and (S, E * R, d) of the disturbances' radii."""
        first, bias, second, periods = self.parameters
        hidden = ((first @ (state / self.scale)[..., None])[..., 0] + bias).tanh()
        shares = ((second @ hidden[..., None])[..., 0] + periods[:, :, period]).tanh()
        forces = shares[..., self.rows :]
        if bool(self.constant.any()):
            forces = torch.where(self.constant, periods[:, :, 0, self.rows :].tanh(), forces)
        return shares[..., : self.rows], forces


def _roll_out(
    loop: TensorLoop, stack: Stack, rows: Tensor, state: Tensor, adversary: _Adversary
) -> tuple[Tensor, Tensor, Tensor]:
    """Returns (S, E * R), and what was done: betas (S, E * R, T, q), disturbances (S, E * R, T, d)."""
    pending = [loop.delayed_action.expand(*state.shape[:-1], -1)] * loop.delay
    total = state.new_zeros(state.shape[:-1])
    betas, forces = [], []
    for period, discount in enumerate(loop.discounts.tolist()):
        beta, share = adversary(period, state)
        force = loop.forces_center + share * loop.forces_radius
        shown = loop.observe(state) + (beta[..., None, :] @ rows)[..., 0, :]
        pending.append(loop.act(stack(shown)))
        state = loop.advance(state, pending.pop(0), force)
        total = total - discount * loop.cost(state)
        betas.append(beta)
        forces.append(force)
    return total, torch.stack(betas, 2), torch.stack(forces, 2)


def _with_vertices(loop: TensorLoop, found: tuple[Tensor, Tensor], shape: tuple[int, int, int]) -> Perturbations:
    betas, forces = found
    extreme = torch.where(betas < 0.0, -1.0, 1.0)
    corner = loop.forces_center + torch.where(forces < loop.forces_center, -1.0, 1.0) * loop.forces_radius
    both = [
        torch.cat([part.unflatten(1, shape[1:]), pushed.unflatten(1, shape[1:])], 2).numpy()
        for part, pushed in ((betas, extreme), (forces, corner))
    ]
    return Perturbations(both[0], both[1])
