"""The closed loop as a differentiable array program over a batch: fixed Runge-Kutta steps, no error control.

Its states are close to the simulator's, close enough to say which way is worse. They are never evidence.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import ClosedLoop
from ...models.float_algebra import Floats
from .adjoint import TapeAdjoint
from .controller import Controller, Decision

Array = NDArray[np.float64]
Evaluation: TypeAlias = tuple[list[Floats], dict[int, Floats]]
"""One evaluation of the plant's tape: its slots, and the twins of sines and cosines."""


@dataclass(frozen=True)
class Choices:
    """What an adversary chooses, for N trajectories; also the gradient in all of it.

    Attributes
    ----------
    initial : array, shape (n, N)
    noise : array, shape (T, k, N)
    disturbances : array, shape (T, d, N)
    """

    initial: Array
    noise: Array
    disturbances: Array


@dataclass(frozen=True)
class Trace:
    """Trajectories of a rollout and what their gradient needs.

    Attributes
    ----------
    states : array, shape (T * substeps + 1, n, N)
    decisions : tuple of Decision, one per period
    evaluations : tuple of tuple
        Per step its evaluations of the plant's tape: four for Runge-Kutta, one for a map.
    """

    states: Array
    decisions: tuple[Decision, ...]
    evaluations: tuple[tuple[Evaluation, ...], ...]


def shares_of(loop: ClosedLoop, count: int) -> Array:
    """Shares of a period at which states are looked at: evenly spaced, and where windows begin and end.

    Parameters
    ----------
    loop : ClosedLoop
    count : int
        Evenly spaced ones.

    Returns
    -------
    array, shape (S,), S >= count
        Increasing; the last one is 1.
    """
    ends = {edge / loop.period % 1 for entry in loop.requirements for edge in (entry.start, entry.end)} - {0}
    return np.array(sorted({Fraction(i, count) for i in range(1, count + 1)} | ends), dtype=np.float64)


class Rollout:
    """A closed loop over its whole horizon.

    Parameters
    ----------
    loop : ClosedLoop
    substeps : int
        Runge-Kutta steps of fourth order per control period; 1 for a plant in discrete time.

    Attributes
    ----------
    times : array, shape (T * substeps + 1,)
        Seconds.
    operations : int
        Array operations of one forward pass, network aside; a trace keeps as many numbers per trajectory.
    """

    def __init__(self, loop: ClosedLoop, substeps: int) -> None:
        self.loop = loop
        shares = np.ones(1) if loop.plant.discrete else shares_of(loop, substeps)
        self.substeps = shares.size
        self.steps = float(loop.period) * np.diff(shares, prepend=0.0)
        ends = (np.arange(loop.periods)[:, None] + shares).ravel()
        self.times = float(loop.period) * np.concatenate([[0.0], ends])
        self.plant = TapeAdjoint(loop.plant.tape)
        evaluations = loop.periods * self.substeps * (1 if loop.plant.discrete else 4)
        self.operations = evaluations * max(len(loop.plant.tape.instructions), 1)
        self.controller = Controller(loop)
        self.delayed = np.array([[float(value)] for value in loop.delayed_action])

    def run(self, choices: Choices, stop: Callable[[], bool] | None = None) -> Trace | None:
        """Forward pass; None where `stop` said that time is up.

        Parameters
        ----------
        choices : Choices
        stop : callable, optional
            Asked once per control period.

        Returns
        -------
        Trace or None
        """
        loop, count = self.loop, choices.initial.shape[1]
        states = np.empty((self.times.size, len(loop.plant.states), count))
        states[0] = state = choices.initial
        decisions: list[Decision] = []
        evaluations: list[tuple[Evaluation, ...]] = []
        for k in range(loop.periods):
            if stop is not None and stop():
                return None
            decisions.append(self.controller.decide(state, choices.noise[k]))
            acting = k - loop.delay
            action = (
                decisions[acting].action if acting >= 0 else np.broadcast_to(self.delayed, decisions[k].action.shape)
            )
            held = [*action, *choices.disturbances[k]]
            for j in range(self.substeps):
                state, used = self._advance(state, held, self.steps[j])
                states[k * self.substeps + j + 1] = state
                evaluations.append(used)
        return Trace(states, tuple(decisions), tuple(evaluations))

    def pull(self, trace: Trace, seeds: Array) -> Choices:
        """Backward pass: the gradient of ``sum_s seeds_s . x_s``.

        Parameters
        ----------
        trace : Trace
        seeds : array, shape (T * substeps + 1, n, N)

        Returns
        -------
        Choices
        """
        loop, size = self.loop, seeds.shape[1]
        periods, inputs, count = loop.periods, len(loop.plant.inputs), seeds.shape[2]
        noise = np.zeros((periods, len(loop.observation_names), count))
        disturbances = np.zeros((periods, len(loop.disturbances), count))
        gradient = np.zeros((size, count))
        actions = np.zeros((periods, inputs, count))
        for k in reversed(range(periods)):
            held = np.zeros((inputs + len(loop.disturbances), count))
            for j in reversed(range(self.substeps)):
                index = k * self.substeps + j
                gradient = self._retreat(trace.evaluations[index], gradient + seeds[index + 1], held, self.steps[j])
            disturbances[k] = held[inputs:]
            if k >= loop.delay:
                actions[k - loop.delay] = held[:inputs]
            if k + loop.delay < periods:  # later actions never reach the plant
                seen, noise[k] = self.controller.pull(trace.decisions[k], actions[k])
                gradient = gradient + seen
        return Choices(gradient + seeds[0], noise, disturbances)

    def _advance(self, state: Array, held: list[Array], h: float) -> tuple[Array, tuple[Evaluation, ...]]:
        """One step of the plant: its map, or the classical Runge-Kutta formula."""
        first, k1 = self._evaluate(state, held)
        if self.loop.plant.discrete:
            return k1, (first,)
        second, k2 = self._evaluate(state + 0.5 * h * k1, held)
        third, k3 = self._evaluate(state + 0.5 * h * k2, held)
        fourth, k4 = self._evaluate(state + h * k3, held)
        return state + h / 6.0 * (k1 + 2.0 * (k2 + k3) + k4), (first, second, third, fourth)

    def _retreat(self, used: tuple[Evaluation, ...], gradient: Array, held: Array, h: float) -> Array:
        """Gradient in the start of a step from the one in its end; actions and disturbances are added to `held`."""
        if self.loop.plant.discrete:
            return self._pull(used[0], gradient, held)
        fourth = self._pull(used[3], h / 6.0 * gradient, held)
        third = self._pull(used[2], h / 3.0 * gradient + h * fourth, held)
        second = self._pull(used[1], h / 3.0 * gradient + 0.5 * h * third, held)
        first = self._pull(used[0], h / 6.0 * gradient + 0.5 * h * second, held)
        return gradient + first + second + third + fourth

    def _evaluate(self, state: Array, held: list[Array]) -> tuple[Evaluation, Array]:
        slots, twins = self.plant.values([*state, *held])
        result = np.empty_like(state)
        for row, slot in enumerate(self.plant.outputs):
            result[row] = slots[slot]
        return (slots, twins), result

    def _pull(self, used: Evaluation, gradient: Array, held: Array) -> Array:
        parts = self.plant.pull(*used, list(gradient))
        size = len(gradient)
        result = np.zeros_like(gradient)
        for row, part in enumerate(parts):
            if part is None:
                continue
            if row < size:
                result[row] = part
            else:
                held[row - size] += part
        return result
