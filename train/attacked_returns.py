"""Returns of simulated closed loops, undisturbed and under every adversary; all policies, radii and starts at once.

Whatever a simulation loses is an upper bound of the worst return; V(s0) is a lower one. Trajectories are those of
`models.simulation` (DOP853), not of the training's environment.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.closed_loop import ClosedLoop
from ..models.policy import Activation, Affine, Policy
from ..models.sampling import center_state, corner_states
from ..models.simulation import Trajectories, returns, simulate
from ..specs.errors import UsageError
from . import attacks
from .adversary import AdversaryOptions, adapt
from .attacks import Stack
from .networks import Layout, Tensor
from .task import Task

Array = NDArray[np.float64]

CORNERS = 32
"""Most corners of an initial box from which trajectories start, besides its middle."""


@dataclass(frozen=True, eq=False)
class Returns:
    """Returns, or bounds of them, of one shape; minus infinity where a trajectory diverged or there is no bound.

    Attributes
    ----------
    discounted, undiscounted : array
    """

    discounted: Array
    undiscounted: Array

    def least(self, axis: int | tuple[int, ...]) -> Returns:
        """The smallest of each along an axis."""
        return Returns(self.discounted.min(axis), self.undiscounted.min(axis))

    def no_more_than(self, other: Returns) -> Returns:
        """The smaller one of both."""
        lower = np.minimum(self.discounted, other.discounted), np.minimum(self.undiscounted, other.undiscounted)
        return Returns(*lower)


@dataclass(frozen=True)
class Agents:
    """Policies that are evaluated side by side, as stacks.

    Attributes
    ----------
    layout : Layout
    actor : Tensor, shape (S, P), float64
    critic_layout : Layout or None
    critic : Tensor, shape (S, P'), float64, or None
        Without critics there is no `naive` and no `grad`.
    """

    layout: Layout
    actor: Tensor
    critic_layout: Layout | None = None
    critic: Tensor | None = None

    @classmethod
    def of(
        cls, policies: Sequence[Policy], critic_layout: Layout | None = None, critic: Tensor | None = None
    ) -> Agents:
        """Stack policies with the numbers of their files.

        Parameters
        ----------
        policies : sequence of Policy
            ReLU networks of one shape; tanh at the end, or nothing.
        critic_layout : Layout, optional
        critic : Tensor, shape (S, P'), optional

        Returns
        -------
        Agents

        Raises
        ------
        UsageError
            The policies are of different shapes or have other activations.
        """
        stacked = [_flat(policy) for policy in policies]
        if len({layout for layout, _ in stacked}) != 1:
            shapes = sorted({" ".join(map(str, layout.sizes)) for layout, _ in stacked})
            raise UsageError(f"policies of one shape are required, received {', '.join(shapes) or 'none'}")
        actor = torch.stack([row for _, row in stacked])
        return cls(stacked[0][0], actor, critic_layout, None if critic is None else critic.detach().cpu().double())


def initial_states(loop: ClosedLoop) -> Array:
    """Middle of the initial box and its corners, at most `CORNERS`: (K, n); one state where it is a point."""
    return np.unique(np.concatenate([center_state(loop)[None], corner_states(loop, CORNERS)]), axis=0)


def undisturbed(task: Task, agents: Agents, starts: Array) -> tuple[Returns, Trajectories]:
    """Simulate without perturbation.

    Parameters
    ----------
    task : Task
    agents : Agents
    starts : array, shape (K, n)

    Returns
    -------
    tuple of Returns, shape (S, K), and Trajectories, S * K of them
    """
    stack, seeds = Stack(agents.layout, agents.actor), len(agents.actor)

    def act(_: int, x: Tensor) -> Tensor:
        return stack(x)

    return _simulated(task, act, np.broadcast_to(starts, (seeds, *starts.shape)))


def constant_actions(task: Task, starts: Array, actions: Array) -> Returns:
    """What a constant output of the network achieves: outputs (A, actions) to returns (A, K)."""
    held = torch.from_numpy(actions)[:, None].expand(-1, len(starts), -1)
    return _simulated(task, lambda _, x: held, np.broadcast_to(starts, (len(actions), *starts.shape)))[0]


def attacked(
    task: Task,
    agents: Agents,
    radii: Array,
    starts: Array,
    *,
    draws: int,
    steps: int,
    adversary: AdversaryOptions,
    seed: int,
) -> dict[str, Returns]:
    """Returns under every adversary, the worst one over the starts.

    Parameters
    ----------
    task : Task
    agents : Agents
    radii : array, shape (E,)
    starts : array, shape (K, n)
    draws : int
        Candidates of `naive`.
    steps : int
        Gradient steps of `mad`.
    adversary : AdversaryOptions
    seed : int
        Of the adversaries' random numbers, which are the same for every policy.

    Returns
    -------
    dict of name to Returns, shape (S, E)
        naive, grad (these two with critics only), mad, adaptive. The last one begins at the start that is worst under
        the others, from the best of their sequences among others, and is the worst of everything that was tried.
    """
    generator = np.random.default_rng(seed)
    shown = _adversaries(task, agents, radii, len(starts), draws, steps, generator)
    played = {name: _played(task, agents, radii, starts, look) for name, look in shown.items()}
    found = {name: worst.least(2) for name, (worst, _) in played.items()}
    # the worst attack and start of every policy and radius: there the adaptive one begins
    every = np.stack([worst.discounted for worst, _ in played.values()], 2).reshape(*found["mad"].discounted.shape, -1)
    attack, start = np.divmod(every.argmin(2), len(starts))
    betas = np.stack([beta for _, beta in played.values()], 2)
    policies, grid = np.indices(attack.shape)
    first, given = starts[start], betas[policies, grid, attack, start][:, :, None]
    learnt = adapt(task, agents.layout, agents.actor, radii, first, given, generator, adversary)
    adaptive = _replayed(task, agents, radii, first, learnt.betas, learnt.forces).least(2)
    for other in found.values():
        adaptive = adaptive.no_more_than(other)
    return {**found, "adaptive": adaptive}


_Look = Callable[[Tensor, Tensor], Tensor]
"""Network inputs (S, B, inputs) and the rows of every point (B, q, inputs): what the policy is shown instead."""


def _adversaries(
    task: Task, agents: Agents, radii: Array, starts: int, draws: int, steps: int, generator: np.random.Generator
) -> dict[str, _Look]:
    layout, actor, critic_layout, critic = agents.layout, agents.actor, agents.critic_layout, agents.critic
    size, q = len(radii) * starts, len(task.perturbation)

    def random(*shape: int) -> Tensor:
        """The same numbers for every policy: what one meets does not depend on how many are beside it."""
        return torch.from_numpy(generator.random((1, size, *shape, q))).expand(len(actor), *[-1] * (len(shape) + 2))

    looks: dict[str, _Look] = {}
    if critic_layout is not None and critic is not None:
        value = layout, actor, critic_layout, critic
        looks["naive"] = lambda x, rows: attacks.naive(*value, x, rows, random(draws))
        looks["grad"] = lambda x, rows: attacks.grad(*value, x, rows)
    looks["mad"] = lambda x, rows: attacks.mad(layout, actor, x, rows, random(), steps)
    return looks


def _played(task: Task, agents: Agents, radii: Array, starts: Array, look: _Look) -> tuple[Returns, Array]:
    """Returns (S, E, K), and the shares of the rows (S, E, K, T, q) that were used."""
    stack, seeds = Stack(agents.layout, agents.actor), len(agents.actor)
    rows = torch.from_numpy(radii[:, None, None] * task.perturbation).repeat_interleave(len(starts), 0)
    inverse = np.linalg.pinv(task.perturbation)
    moved: list[Array] = []

    def act(_: int, x: Tensor) -> Tensor:
        shown = look(x, rows)
        moved.append((shown - x).numpy() @ inverse)
        return stack(shown)

    begin = np.broadcast_to(np.tile(starts, (len(radii), 1)), (seeds, len(rows), starts.shape[1]))
    shape = (seeds, len(radii), len(starts))
    found, _ = _simulated(task, act, begin)
    share = np.stack(moved, 2).reshape(*shape, task.horizon, -1)
    with np.errstate(invalid="ignore", divide="ignore"):
        betas = np.where(radii[:, None, None, None] > 0.0, share / radii[:, None, None, None], 0.0)
    betas = np.clip(np.nan_to_num(betas), -1.0, 1.0)
    return Returns(found.discounted.reshape(shape), found.undiscounted.reshape(shape)), betas


def _replayed(task: Task, agents: Agents, radii: Array, first: Array, betas: Array, forces: Array) -> Returns:
    """Returns (S, E, R) of sequences (S, E, R, T, q) and disturbances (S, E, R, T, d) from starts (S, E, n)."""
    stack, shape = Stack(agents.layout, agents.actor), betas.shape[:3]
    moves = radii[:, None, None, None] * betas @ task.perturbation
    shifts = torch.from_numpy(moves.reshape(shape[0], -1, *moves.shape[3:]))

    def act(period: int, x: Tensor) -> Tensor:
        return stack(x + shifts[:, :, period])

    begin = np.repeat(first, shape[2], axis=1)
    found, _ = _simulated(task, act, begin, forces.reshape(int(np.prod(shape)), *forces.shape[3:]))
    return Returns(found.discounted.reshape(shape), found.undiscounted.reshape(shape))


def _simulated(
    task: Task, act: Callable[[int, Tensor], Tensor], starts: Array, forces: Array | None = None
) -> tuple[Returns, Trajectories]:
    """Trajectories from starts (S, B, n), lanes in this order, of networks that see clean inputs (S, B, inputs)."""
    lanes, period = starts.shape[:2], 0

    def network(x: Array) -> Array:
        nonlocal period
        with torch.no_grad():
            output = act(period, torch.from_numpy(np.ascontiguousarray(x)).view(*lanes, -1))
        period += 1
        return np.asarray(output.reshape(len(x), -1).numpy())

    flat = starts.reshape(-1, starts.shape[-1])
    trajectories = simulate(task.loop, flat, disturbances=forces, policy=network)
    reward = task.loop.reward
    assert reward is not None, "a task has a reward"
    plain = replace(task.loop, reward=replace(reward, discount=Fraction(1)))
    both = [returns(loop, trajectories).reshape(lanes) for loop in (task.loop, plain)]
    return Returns(both[0], both[1]), trajectories


def _flat(policy: Policy) -> tuple[Layout, Tensor]:
    """A policy's numbers as a row of a stack."""
    affine = [layer for layer in policy.layers if isinstance(layer, Affine)]
    kinds = [layer.kind for layer in policy.layers if isinstance(layer, Activation)]
    squashed = bool(kinds) and kinds[-1] == "tanh" and policy.layers[-1] is not affine[-1]
    expected = [Affine, Activation] * (len(affine) - 1) + [Affine] + [Activation] * squashed
    hidden = kinds[: len(kinds) - squashed]
    if [type(layer) for layer in policy.layers] != expected or set(hidden) - {"relu"}:
        raise UsageError(
            "the adversaries know ReLU networks with tanh or nothing at the end",
            where=policy.name or None,
            remedy="see its layers with: setrl inspect",
        )
    sizes = (affine[0].weight.shape[1], *(layer.weight.shape[0] for layer in affine))
    assert all(first.weight.shape[0] == second.weight.shape[1] for first, second in pairwise(affine))
    numbers = [part for layer in affine for part in (layer.weight.ravel(), layer.bias)]
    return Layout(sizes, squashed), torch.from_numpy(np.concatenate(numbers))
