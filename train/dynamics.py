"""One control period of a plant with the action held, for training: fast, differentiable, never a proof.

The dynamics are the plant's tape, run over other algebras than the verifier's; what is trained on is what is verified.
"""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from functools import partial
from typing import Any, Literal, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.closed_loop import Plant
from ..specs.errors import UsageError
from .linear_dynamics import affine_map, exact_step
from .tape_programs import Call, Program, TorchAlgebra, run_on_tensors

Array = NDArray[np.float64]
Tensor: TypeAlias = torch.Tensor
Step: TypeAlias = Callable[[Array, Array, Array], Array]

SUBSTEPS = 5
"""Runge-Kutta steps per control period.

On the shipped plants, from their start boxes and with any actions in [-1, 1], one period then differs from DOP853 at
rtol 1e-12 by less than 1e-6 of the state's magnitude (tests/test_training_environment.py).
"""


class Discretisation:
    """``x_{k+1} = f(x_k, u_k, d_k)``: the plant's state at the end of a period in which u and d are held.

    A plant that is linear in states, inputs and disturbances: the exact solution, by the matrix exponential. A
    discrete-time plant: its map. Any other: the classic Runge-Kutta method of order 4 [1]_ with `substeps` equal steps.

    Parameters
    ----------
    plant : Plant
    period : Fraction
        Seconds.
    substeps : int
        Runge-Kutta steps per period.

    Attributes
    ----------
    kind : {"linear", "map", "runge-kutta"}

    Raises
    ------
    UsageError
        `substeps` is not positive.

    References
    ----------
    .. [1] Hairer, Norsett and Wanner, "Solving Ordinary Differential Equations I", 1993, Table II.1.2.
    """

    def __init__(self, plant: Plant, period: Fraction, substeps: int = SUBSTEPS) -> None:
        if substeps < 1:
            raise UsageError(f"at least one substep is required, received {substeps}", where="substeps")
        self.plant, self.period, self.substeps = plant, float(period), substeps
        linear = None if plant.discrete else affine_map(plant.tape)
        self.kind: Literal["linear", "map", "runge-kutta"] = "map" if plant.discrete else "runge-kutta"
        self._matrix, self._offset = np.zeros((0, 0)), np.zeros(0)
        if linear is not None:
            self.kind = "linear"
            self._matrix, self._offset = exact_step(*linear, self.period)
        self._steps: dict[int, Step] = {}

    def advance(self, state: Any, action: Any, force: Any) -> Any:
        """State at the end of one period.

        Parameters
        ----------
        state : array, shape (L, n), or Tensor, shape (..., n)
        action : the same type, last axis m
            What acts on the plant, after `after`, `clip` and the delay.
        force : the same type, last axis d
            Disturbances; d may be 0.

        Returns
        -------
        array or Tensor
            Of the state's type. Lanes do not influence each other: every array operation is elementwise, so that a
            lane's numbers do not depend on how many run beside it. Tensors are differentiable, and their leading axes
            broadcast.
        """
        if isinstance(state, np.ndarray):
            lanes = len(state)
            if lanes not in self._steps:
                self._steps[lanes] = self._step(lanes)
            return self._steps[lanes](state, action, force)
        return self._on_tensors(state, action, force)

    def __getstate__(self) -> dict[str, Any]:
        # buffers and the calls on them are views of each other, which a copy would part: a copy makes its own
        return {**self.__dict__, "_steps": {}}

    def _step(self, lanes: int) -> Step:
        if self.kind == "linear":
            return _LinearStep(self._matrix, self._offset, lanes)
        if self.kind == "map":
            return _MapStep(self.plant, lanes)
        return _RungeKuttaStep(self.plant, self.period / self.substeps, self.substeps, lanes)

    def _on_tensors(self, state: Tensor, action: Tensor, force: Tensor) -> Tensor:
        if self.kind == "linear":
            matrix, offset = (torch.as_tensor(part).to(state) for part in (self._matrix, self._offset))
            size, inputs = state.shape[-1], action.shape[-1]
            moved = state @ matrix[:, :size].T + action @ matrix[:, size : size + inputs].T + offset
            return moved + force @ matrix[:, size + inputs :].T if force.shape[-1] else moved
        algebra, held = TorchAlgebra(state), [*action.unbind(-1), *force.unbind(-1)]

        def slope(x: Tensor) -> Tensor:
            return run_on_tensors(self.plant.tape, algebra, [*x.unbind(-1), *held])

        if self.kind == "map":
            return slope(state)
        h = self.period / self.substeps
        for _ in range(self.substeps):
            first = slope(state)
            second = slope(state + h / 2 * first)
            third = slope(state + h / 2 * second)
            fourth = slope(state + h * third)
            state = state + h / 6 * (first + 2 * (second + third) + fourth)
        return state


class _LinearStep:
    """``matrix @ [x; u; d] + offset``, column by column: a matrix product's sums depend on the number of lanes."""

    def __init__(self, matrix: Array, offset: Array, lanes: int) -> None:
        shape = (len(matrix), lanes)
        self.columns = [np.broadcast_to(column[:, None], shape).copy() for column in matrix.T]
        self.offset = np.broadcast_to(offset[:, None], shape)
        self.product = np.empty(shape)

    def __call__(self, state: Array, action: Array, force: Array) -> Array:
        total = self.offset.copy()
        for column, values in zip(self.columns, [*state.T, *action.T, *force.T], strict=True):
            np.multiply(column, values, self.product)
            np.add(total, self.product, total)
        return total.T


class _MapStep:
    """The map of a discrete-time plant."""

    def __init__(self, plant: Plant, lanes: int) -> None:
        self.varying = np.zeros((len(plant.tape.inputs), lanes))
        self.next = np.zeros((len(plant.states), lanes))
        self.program = Program(plant.tape, self.varying, np.zeros((0, lanes)), self.next)
        for call in self.program.held:
            call()

    def __call__(self, state: Array, action: Array, force: Array) -> Array:
        np.concatenate([state.T, action.T, force.T], out=self.varying)
        for call in self.program.varying:
            call()
        return self.next.T.copy()


class _RungeKuttaStep:
    """Classic Runge-Kutta steps of size h; what depends on the action only is computed once per period."""

    def __init__(self, plant: Plant, h: float, substeps: int, lanes: int) -> None:
        size = len(plant.states)
        self.held = np.zeros((len(plant.tape.inputs) - size, lanes))
        points, slopes = np.zeros((2, 4, size, lanes))
        stages = [Program(plant.tape, point, self.held, slope) for point, slope in zip(points, slopes, strict=True)]
        self.holds = [call for stage in stages for call in stage.held]
        self.state, total = points[0], np.zeros((size, lanes))
        half, whole, two, sixth = (np.full((size, lanes), number) for number in (h / 2, h, 2.0, h / 6))
        calls: list[Call] = []
        for stage, point, slope, share in zip(stages, points[1:], slopes, (half, half, whole), strict=False):
            calls += [
                *stage.varying,
                partial(np.multiply, slope, share, point),
                partial(np.add, point, self.state, point),
            ]
        calls += [
            *stages[3].varying,
            partial(np.add, slopes[1], slopes[2], total),
            partial(np.multiply, total, two, total),
            partial(np.add, total, slopes[0], total),
            partial(np.add, total, slopes[3], total),
            partial(np.multiply, total, sixth, total),
            partial(np.add, self.state, total, self.state),
        ]
        self.calls = calls * substeps

    def __call__(self, state: Array, action: Array, force: Array) -> Array:
        np.copyto(self.state, state.T)
        np.concatenate([action.T, force.T], out=self.held)
        for call in self.holds:
            call()
        for call in self.calls:
            call()
        return np.array(self.state.T)
