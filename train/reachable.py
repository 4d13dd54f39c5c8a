"""Differentiable reachable sets of a closed loop: S policies from P start sets each, over the whole horizon.

A set is an affine form per coordinate, <c, G> of shape (S, N, P, 1 + q): states, constant disturbances and delayed
actions. It follows `verify.closed_loop` period by period, with its choices of correlation: generators keep their
identity through the policy and the plant, what one period's action has of its own is merged among the actions, and
reduced order spares the factors of the start set. It leaves out every rounding term, the truncation error of the
integrator and what a deployed network rounds: these sets give gradients, and `setrl.verify` decides.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch.nn.functional import pad

from ..models.closed_loop import BoundAffine
from ..models.policy import Activation
from ..models.tape import Tape, run
from ..verify.options import LEAST_GENERATORS, Options
from ..verify.relaxations import relax
from .affine_forms import AffineForm, AffineFormAlgebra, Form, shifted
from .linear_dynamics import affine_map, exact_step
from .networks import Layout, Tensor
from .reachable_costs import Costs, Margins
from .reachable_network import Weights, enclose_actions
from .task import Task

Array = NDArray[np.float64]

LARGEST = 1e3
"""Sets are shrunk to so many times the size of what the task speaks of: a set that explodes keeps a finite gradient."""
SPARE = 1.5
"""Order is reduced once there are so many times more generators than are kept: less often is faster."""


@dataclass(frozen=True)
class Outcome:
    """What was reached.

    Attributes
    ----------
    value : Tensor, shape (S, P)
        V = - sum_{k=1..T} discount^(k-1) (worst cost + penalty) of period k.
    margins : Tensor, shape (S, P, R)
        One per requirement, from the sets at periods' ends.
    ends : tuple of Tensor, shape (S, n, P, 1 + q_k)
        States at the start and at every period's end, where asked for.
    """

    value: Tensor
    margins: Tensor
    ends: tuple[Tensor, ...]


class ReachableSets:
    """Enclosures of a task's closed loop.

    Parameters
    ----------
    task : Task
    layout : Layout
        Of the policies.
    substeps : int
        Runge-Kutta steps per control period, of a plant that is not linear.
    options : Options, optional
        The verifier's: how many generators are kept.
    """

    def __init__(self, task: Task, layout: Layout, substeps: int = 1, options: Options | None = None) -> None:
        loop, chosen = task.loop, options or Options()
        self.task, self.layout, self.substeps = task, layout, substeps
        self.states, self.inputs = len(loop.plant.states), len(loop.plant.inputs)
        self.before, self.after = _matrix(loop.before), _matrix(loop.after)
        self.noise = torch.from_numpy(task.perturbation.T.copy())
        self.clip = (
            [] if loop.clip is None else [Activation("clip", lower=float(a), upper=float(b)) for a, b in loop.clip]
        )
        self.action_rows = chosen.action_rows
        bounds = np.array([[float(d.lower), float(d.upper)] for d in loop.disturbances]).reshape(-1, 2)
        self.force_center, self.force_radius = bounds.mean(1), 0.5 * (bounds[:, 1] - bounds[:, 0])
        self.constant = [i for i, entry in enumerate(loop.disturbances) if entry.constant]
        self.varying = [i for i, entry in enumerate(loop.disturbances) if not entry.constant]
        coordinates = self.states + len(self.constant) + loop.delay * self.inputs
        self.kept = max(chosen.generators * coordinates, LEAST_GENERATORS)
        self.plant = _plant(task, substeps)
        self.costs = None if loop.reward is None else Costs(loop.reward)
        self.requirements = [Margins(entry, loop.period, loop.periods) for entry in loop.requirements]
        named = [bound for side in (task.start, loop.initial) for pair in side for bound in pair]
        targets = () if loop.reward is None else loop.reward.target
        self.largest = LARGEST * max(1.0, *(abs(float(number)) for number in (*named, *targets)))

    def outcome(self, actor: Tensor, center: Any, radius: Any, epsilon: Any, *, keep: bool = False) -> Outcome:
        """Follow all sets over the horizon.

        Parameters
        ----------
        actor : Tensor, shape (S, parameters)
            float64.
        center, radius : array, shape (S, P, n)
            Boxes of initial states.
        epsilon : array, shape (S, P)
            Radii of the observation perturbation.
        keep : bool
            Whether to return the sets at periods' ends.

        Returns
        -------
        Outcome
            Differentiable by `actor`.
        """
        terms = self._start(torch.tensor(center), torch.tensor(radius))
        protected = terms.shape[-1] - 1
        weights = Weights.of(self.layout, actor)
        noise = self.noise[:, None] * torch.tensor(epsilon)[:, None, :, None]
        total, weight = terms.new_zeros((terms.shape[0], terms.shape[2])), 1.0
        seen: list[list[Tensor]] = [[] for _ in self.requirements]
        ends = []
        for number in range(self.task.horizon + 1):
            if number:
                terms = self._reduced(self._advance(weights, terms, noise), protected)
            state = terms[:, : self.states]
            if keep:
                ends.append(state)
            for margins, requirement in zip(seen, self.requirements, strict=True):
                if number in requirement.numbers:
                    margins.append(requirement.at(state))
            if number and self.costs is not None:
                total = total - weight * self.costs(state)
                weight *= self.costs.discount
        found = [entry.over(margins) for entry, margins in zip(self.requirements, seen, strict=True)]
        margin = torch.stack(found, -1) if found else total.new_zeros((*total.shape, 0))
        return Outcome(total, margin, tuple(ends))

    def _start(self, center: Tensor, radius: Tensor) -> Tensor:
        """Initial sets with a factor per state and constant disturbance; delayed actions are known."""
        seeds, sets, _ = center.shape
        held, rest = self.force_center[self.constant], self.force_radius[self.constant]
        delayed = np.array([float(u) for u in self.task.loop.delayed_action] * self.task.loop.delay)
        known = torch.from_numpy(np.concatenate([held, delayed])).expand(seeds, sets, -1)
        spread = torch.cat([radius, torch.from_numpy(rest).expand(seeds, sets, -1)], -1)
        rows = torch.diag_embed(spread)
        rows = pad(rows, (0, 0, 0, len(delayed)))
        whole = torch.cat([torch.cat([center, known], -1)[..., None], rows], -1)
        return whole.transpose(1, 2).contiguous()

    def _advance(self, weights: Weights, terms: Tensor, noise: Tensor) -> Tensor:
        """One control period."""
        loop, states = self.task.loop, self.states
        first_delayed = states + len(self.constant)
        shared, private = self._act(weights, terms[:, :states], noise)
        fresh, new = private.shape[-1], len(self.varying)
        computed = pad(torch.cat([shared, private], -1), (0, new)) if new else torch.cat([shared, private], -1)
        padded = pad(terms, (0, fresh + new))
        queue = torch.cat([padded[:, first_delayed:], computed], 1) if loop.delay else computed
        joint = [padded[:, :states], queue[:, : self.inputs]]
        if loop.disturbances:
            joint.append(self._forces(padded))
        end = self.plant(torch.cat(joint, 1))
        missing = end.shape[-1] - padded.shape[-1]
        others = [padded[:, states:first_delayed], queue[:, self.inputs :]]
        kept = [part for part in others if part.shape[1]]
        return torch.cat([end, *(pad(part, (0, missing)) for part in kept)], 1) if kept else end

    def _act(self, weights: Weights, state: Tensor, noise: Tensor) -> tuple[Tensor, Tensor]:
        """Action sets: the columns that the state has too, (S, m, P, 1 + q), and private ones, (S, m, P, k)."""
        loop, count = self.task.loop, state.shape[-1]
        seen = state if loop.observation is None else _image(loop.observation, state)
        seen = seen if self.before is None else _affine(seen, *self.before)
        action = enclose_actions(weights, torch.cat([seen, noise.expand(*seen.shape[:3], -1)], -1))
        whole = torch.cat([action.terms, action.private], -1)
        whole = whole if self.after is None else _affine(whole, *self.after)
        whole = self._clipped(whole) if self.clip else whole
        return whole[..., :count], self._merged(whole[..., count:])

    def _clipped(self, action: Tensor) -> Tensor:
        """Clip every action; each error becomes a column."""
        radius = action[..., 1:].abs().sum(-1)
        lower, upper = action[..., 0] - radius, action[..., 0] + radius
        columns = [relax(kind, lower[:, i], upper[:, i]) for i, kind in enumerate(self.clip)]
        slope, offset, error = (
            torch.stack([getattr(column, name) for column in columns], 1) for name in ("slope", "offset", "error")
        )
        scaled = action * slope[..., None]
        center = scaled[..., :1] + offset[..., None]
        return torch.cat([center, scaled[..., 1:], torch.diag_embed(error.transpose(1, 2)).transpose(1, 2)], -1)

    def _merged(self, private: Tensor) -> Tensor:
        """Private columns of an action: of one action exactly one, of more the longest and a box around the rest."""
        if self.inputs == 1:
            return private.abs().sum(-1, keepdim=True)
        return _boxed(private, 0, self.action_rows)

    def _forces(self, terms: Tensor) -> Tensor:
        """Disturbances in the plant's order, (S, d, P, 1 + q): tracked ones, and fresh factors, which are last."""
        count, fresh = terms.shape[-1], len(self.varying)
        rows = []
        for i in range(len(self.force_center)):
            if i in self.constant:
                rows.append(terms[:, self.states + self.constant.index(i)])
            else:
                row = terms.new_zeros(count)
                row[0] = self.force_center[i]
                row[count - fresh + self.varying.index(i)] = self.force_radius[i]
                rows.append(row.expand(terms.shape[0], *terms.shape[2:]))
        return torch.stack(rows, 1)

    def _reduced(self, terms: Tensor, protected: int) -> Tensor:
        """Fewer generators where there are too many, and no set larger than `largest`."""
        if terms.shape[-1] - 1 > SPARE * (self.kept + protected):
            columns = _boxed(terms[..., 1:], protected, self.kept - terms.shape[1])
            terms = torch.cat([terms[..., :1], columns], -1)
        size = terms.detach().abs().sum(-1).amax(1)
        if bool((size <= self.largest).all()):
            return terms
        return terms * (self.largest / size).clamp(max=1.0)[:, None, :, None]


def _boxed(columns: Tensor, protected: int, rows: int) -> Tensor:
    """Keep the first columns and so many that a box would represent worst; a box around the rest follows.

    The score of a column is ``|g|_1 - |g|_inf``, every coordinate in units of its extent, as in
    `verify.zonotope.reduce_order`.
    """
    free = columns[..., protected:]
    dimension, count = free.shape[1], free.shape[-1]
    size = free.abs()
    if count <= rows:
        return columns
    extent = size.detach().sum(-1, keepdim=True)
    share = size.detach() / torch.where(extent > 0.0, extent, 1.0)
    order = (share.sum(1) - share.amax(1)).topk(rows).indices
    index = order[:, None].expand(-1, dimension, -1, -1)
    rest = size.sum(-1) - size.gather(-1, index).sum(-1)
    box = torch.diag_embed(rest.clamp(min=0.0).transpose(1, 2)).transpose(1, 2)
    return torch.cat([columns[..., :protected], free.gather(-1, index), box], -1)


def _matrix(affine: BoundAffine | None) -> tuple[Tensor, Tensor] | None:
    if affine is None:
        return None
    matrix = torch.from_numpy(np.array(affine.matrix, dtype=np.float64))
    return matrix, torch.tensor([float(number) for number in affine.offset], dtype=torch.float64)


def _affine(terms: Tensor, matrix: Tensor, offset: Tensor) -> Tensor:
    """``matrix @ x + offset`` of sets (S, n, P, 1 + q)."""
    image = torch.bmm(matrix.expand(terms.shape[0], -1, -1), terms.flatten(2)).unflatten(2, terms.shape[2:])
    shift = torch.zeros((len(offset), terms.shape[-1]), dtype=terms.dtype)
    shift[:, 0] = offset
    return image + shift[:, None]


def _forms(terms: Tensor) -> list[Form]:
    """One affine form per coordinate."""
    return [AffineForm(part) for part in terms.unbind(1)]


def _joined(forms: Sequence[Form], like: Tensor) -> Tensor:
    """Sets from forms, (S, n, P, 1 + q + boxes): every remainder that is not known to be zero becomes a column."""
    nothing = AffineForm(torch.zeros_like(like[:, 0]))
    whole = [shifted(nothing, form, 1.0) if isinstance(form, float) else form for form in forms]
    terms = torch.stack([form.terms for form in whole if isinstance(form, AffineForm)], 1)
    unit = torch.eye(len(whole), dtype=terms.dtype)[:, :, None]
    boxes = []
    for i, form in enumerate(whole):
        if isinstance(form, AffineForm) and not isinstance(form.remainder, float):
            boxes.append(form.remainder[:, None] * unit[i])
    return torch.cat([terms, torch.stack(boxes, -1)], -1) if boxes else terms


def _image(tape: Tape, terms: Tensor) -> Tensor:
    """Image of sets under a tape."""
    return _joined(run(tape, AffineFormAlgebra(), _forms(terms)), terms)


def _plant(task: Task, substeps: int) -> Any:
    """The function from joint sets of states, actions and disturbances to sets of the states at the period's end."""
    plant, period = task.loop.plant, float(task.loop.period)
    linear = None if plant.discrete else affine_map(plant.tape)
    if linear is not None:
        matrix, offset = (torch.from_numpy(np.ascontiguousarray(part)) for part in exact_step(*linear, period))
        return lambda joint: _affine(joint, matrix, offset)
    if plant.discrete:
        return lambda joint: _image(plant.tape, joint)
    return lambda joint: _runge_kutta(plant.tape, joint, period, substeps)


def _runge_kutta(tape: Tape, joint: Tensor, period: float, substeps: int) -> Tensor:
    """The classic method of order 4, on forms: what a stage cannot keep affine is boxed, and adds up by its weight."""
    algebra, step = AffineFormAlgebra(), period / substeps
    forms = _forms(joint)
    state, held = forms[: len(tape.outputs)], forms[len(tape.outputs) :]

    def moved(by: list[Form], factor: float) -> list[Form]:
        return [shifted(form, rate, factor) for form, rate in zip(state, by, strict=True)]

    for _ in range(substeps):
        first = run(tape, algebra, [*state, *held])
        second = run(tape, algebra, [*moved(first, step / 2), *held])
        third = run(tape, algebra, [*moved(second, step / 2), *held])
        fourth = run(tape, algebra, [*moved(third, step), *held])
        for rate, weight in ((first, 1 / 6), (second, 1 / 3), (third, 1 / 3), (fourth, 1 / 6)):
            state = moved(rate, weight * step)
    return _joined(state, joint)
