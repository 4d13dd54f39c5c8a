"""What is trained: a specification bound to its plant, where episodes start, and which directions are perturbed."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.binding import bind, plant_of
from ..models.binding_context import place_of, shown
from ..models.binding_controller import Radius, exact_number
from ..models.closed_loop import ClosedLoop, Intervals, Plant
from ..models.perturbation import proportions, radii_by_name
from ..models.plant import suggestion
from ..models.policy import Activation, Affine, Policy
from ..models.sampling import inner_bounds
from ..models.simulation import act, derivative, observe
from ..specs.errors import SpecificationError, UsageError
from ..specs.specification import Bounds, Specification
from .dynamics import SUBSTEPS, Discretisation
from .streams import Streams

Array = NDArray[np.float64]

START_TRIALS = 64
"""States of the start box from which one period is tried before a training begins."""

RESOLVED = 1e-3
"""Largest difference between a period and the same with twice as many steps, as a share of the largest state."""


@dataclass(frozen=True, eq=False)
class Task:
    """A specification, ready to be trained for.

    Attributes
    ----------
    loop : ClosedLoop
        Bound to a placeholder, ``tanh(0 x + 0)``, of the policy's dimensions.
    start : tuple of (lower, upper), one per state
        Exact box of initial states of training episodes.
    inputs : int
        Numbers that the policy network takes, after `observe` and `before`.
    actions : int
        Numbers that it returns, before `after` and `clip`; the network ends in tanh, so they are in [-1, 1].
    horizon : int
        Control periods of an episode.
    perturbation : array, shape (q, inputs)
        Generator rows of the set of perturbed network inputs at radius 1: at radius eps it is ``x + eps beta @
        perturbation``, beta in [-1, 1]^q. ``diag(direction) @ before.matrix.T`` without its zero rows, ``direction =
        radii / max(radii)``; ones where the specification perturbs nothing.
    discount : float
        Of the specification's reward.
    epsilon : float
        Largest observation radius of the specification.
    """

    loop: ClosedLoop
    start: Intervals
    inputs: int
    actions: int
    horizon: int
    perturbation: Array
    discount: float
    epsilon: float

    def bound(self, policy: Policy, epsilon: Radius | None = None) -> ClosedLoop:
        """Ask the same about a real policy.

        Parameters
        ----------
        policy : Policy
        epsilon : number, optional
            Largest observation radius; the components keep the specification's proportions. A float means the decimal
            it prints as, so that 0.1 is one tenth. The specification's radii by default.

        Returns
        -------
        ClosedLoop
            From the specification's initial set, which is not the box where training episodes start.

        Raises
        ------
        SetrlError
            The dimensions do not fit, or the radius is negative or not finite.
        """
        if epsilon is None:
            return bind(self.loop.specification, policy, self.loop.plant)
        radii = radii_by_name(self.loop, exact_number(epsilon))
        return bind(self.loop.specification, policy, self.loop.plant, radii)


def task_of(
    specification: Specification, start: Mapping[str, Bounds] | None = None, plant: Plant | None = None
) -> Task:
    """Bind a specification for training.

    Parameters
    ----------
    specification : Specification
        With a reward.
    start : mapping of state name to Bounds, optional
        Box of initial states of training episodes, every state; the specification's initial set by default.
    plant : Plant, optional
        Instead of the plant that the specification names.

    Returns
    -------
    Task

    Raises
    ------
    SpecificationError
        There is no reward or it is zero everywhere, or from the start box the plant or the observation has no
        finite value, or moves too fast for its control period.
    UsageError
        The start box names what is no state, leaves a state out, or is empty.
    """
    if specification.reward is None:
        raise SpecificationError(
            "the specification has no reward, so there is nothing to learn",
            where=specification.source or None,
            remedy="add reward: {weights: {STATE: 1}, discount: 0.99}",
        )
    used = plant_of(specification) if plant is None else plant
    inputs, actions = _dimensions(specification, used)
    loop = bind(specification, _placeholder(inputs, actions), used)
    _require_reward(loop)
    box = loop.initial if start is None else _start_box(start, used.states)
    _require_trainable(loop, box, actions)
    radii = loop.observation_radius
    rows = np.diag([float(share) for share in proportions(radii)])
    if loop.before is not None:
        rows = rows @ np.array(loop.before.matrix, dtype=np.float64).T
    assert loop.reward is not None
    return Task(
        loop=loop,
        start=box,
        inputs=inputs,
        actions=actions,
        horizon=loop.periods,
        perturbation=rows[rows.any(axis=1)],
        discount=float(loop.reward.discount),
        epsilon=float(max(radii)),
    )


def start_bounds(values: Mapping[str, Any]) -> dict[str, Bounds]:
    """Read a start box from plain data such as ``{"z": [-4, 4], "zdot": 0}``.

    Parameters
    ----------
    values : mapping of state name to a number or a pair of numbers
        int, float or Fraction. A float means the decimal it prints as.

    Returns
    -------
    dict of state name to Bounds

    Raises
    ------
    UsageError
        A value is neither a finite number nor a pair of them.
    """
    box = {}
    for name, value in values.items():
        sides = value if isinstance(value, list | tuple) else (value, value)
        if len(sides) != 2 or not all(_is_number(side) for side in sides):
            raise UsageError(
                f"expected a number or [lower, upper], received {value!r}",
                where=f"start.{name}",
                remedy="write for example 0 or [-4, 4]",
            )
        box[name] = Bounds(*(exact_number(side) for side in sides))
    return box


def starts_at(task: Task, shares: Array) -> Array:
    """Points of the start box at shares (..., states) of its sides: 0 is the lower bound, 1 the upper one."""
    return _between(np.array([inner_bounds(*bounds) for bounds in task.start]), shares)


def forces_at(task: Task, shares: Array) -> Array:
    """Disturbances at shares (..., horizon, d) of their bounds; a constant one keeps its first over the episode."""
    disturbances = task.loop.disturbances
    bounds = np.array([inner_bounds(entry.lower, entry.upper) for entry in disturbances]).reshape(-1, 2)
    forces = _between(bounds, shares)
    constant = [entry.constant for entry in disturbances]
    forces[..., constant] = forces[..., :1, constant]
    return forces


def sample_starts(task: Task, streams: Streams) -> Array:
    """Initial states of one episode per seed, uniform in the start box: (S, states), from the stream "start"."""
    return starts_at(task, streams.uniform("start", (len(task.start),)))


def sample_forces(task: Task, streams: Streams) -> Array:
    """Disturbances of one episode per seed, uniform: (S, horizon, d), from the stream "disturbance"."""
    return forces_at(task, streams.uniform("disturbance", (task.horizon, len(task.loop.disturbances))))


def _between(bounds: Array, shares: Array) -> Array:
    lower, upper = bounds.T
    return np.asarray(np.clip(lower + shares * (upper - lower), lower, upper))


def _dimensions(specification: Specification, plant: Plant) -> tuple[int, int]:
    """Numbers that a policy takes and returns; `bind` checks that the maps around it fit."""
    controller = specification.controller
    if not plant.inputs:
        raise SpecificationError(
            "the plant has no inputs, so there is no policy to train",
            where=place_of(specification, "plant"),
            remedy="give it an input",
        )
    inputs = len(controller.observe) if controller.observe is not None else len(plant.states)
    actions = len(plant.inputs)
    if controller.before is not None and controller.before.matrix is not None:
        inputs = len(controller.before.matrix)
    if controller.after is not None and controller.after.matrix:
        actions = len(controller.after.matrix[0])
    return inputs, actions


def _placeholder(inputs: int, actions: int) -> Policy:
    layer = Affine(np.zeros((actions, inputs)), np.zeros(actions))
    return Policy((layer, Activation("tanh")), inputs, actions, name="to be trained")


def _require_reward(loop: ClosedLoop) -> None:
    reward = loop.reward
    assert reward is not None
    if not any(reward.weights) and not (reward.penalty and reward.penalty_region):
        raise SpecificationError(
            "every weight of the reward is zero and there is no penalty, so there is nothing to learn",
            where=place_of(loop.specification, "reward"),
            remedy="give a state a positive weight",
        )


def _start_box(start: Mapping[str, Bounds], states: tuple[str, ...]) -> Intervals:
    for name, bounds in start.items():
        if name not in states:
            remedy = suggestion(name, states, "the plant's states")
            raise UsageError(f"{name} is no state", where=f"start.{name}", remedy=remedy)
        if not bounds.lower <= bounds.upper:
            text = f"[{shown(bounds.lower)}, {shown(bounds.upper)}]"
            raise UsageError(f"{text} is empty", where=f"start.{name}", remedy="write the lower bound first")
    missing = [state for state in states if state not in start]
    if missing:
        raise UsageError(
            f"the start box must bound every state; missing: {', '.join(missing)}",
            where="start",
            remedy=f"add {missing[0]}: 0, or an interval",
        )
    return tuple((start[state].lower, start[state].upper) for state in states)


def _require_trainable(loop: ClosedLoop, box: Intervals, actions: int) -> None:
    """Try one control period from the middle and from corners of the start box, under extreme actions.

    A state must have a next one, an observation, and a period that `dynamics.SUBSTEPS` Runge-Kutta steps resolve.
    """
    generator = np.random.default_rng(0)
    corners = generator.choice([0.0, 1.0], (START_TRIALS, len(box)))
    corners[:3] = np.array([[0.5], [0.0], [1.0]])
    states = _between(np.array([inner_bounds(*bounds) for bounds in box]), corners)
    outputs = generator.choice([-1.0, 1.0], (START_TRIALS, actions))
    outputs[:3] = 0.0
    forces = np.tile([float((entry.lower + entry.upper) / 2) for entry in loop.disturbances], (START_TRIALS, 1))
    with np.errstate(all="ignore"):
        acting = act(loop, observe(loop, states), lambda _: outputs)
        moved, finer = (
            Discretisation(loop.plant, loop.period, factor * SUBSTEPS).advance(states, acting, forces)
            for factor in (1, 2)
        )
        resolved = np.abs(moved - finer) <= RESOLVED * np.abs(finer[np.isfinite(finer)]).max(initial=0.0)
        checks = (
            ("the vector field has no finite value", "plant", np.isfinite(derivative(loop, states, acting, forces))),
            ("the observation has no finite value", "controller.observe", np.isfinite(observe(loop, states))),
            (f"{SUBSTEPS} Runge-Kutta steps per period do not resolve its motion", "controller.period", resolved),
        )
    for what, key, holds in checks:
        wrong = np.flatnonzero(~holds.all(axis=1))
        if wrong.size:
            place = ", ".join(f"{n} = {x:g}" for n, x in zip(loop.plant.states, states[wrong[0]], strict=True))
            remedy = "shorten the control period, or " if key == "controller.period" else ""
            raise SpecificationError(
                f"the plant cannot be trained: {what} at {place}",
                where=place_of(loop.specification, key),
                remedy=f"{remedy}start episodes elsewhere: give another start box",
            )


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | Fraction) and not isinstance(value, bool) and math.isfinite(value)
