"""Tapes that run often: as a list of numpy calls on buffers that are made once, and over torch tensors.

A training environment runs a plant's tape some dozen times per step on a handful of lanes. There the interpretation of
the tape and the allocation of results cost more than the arithmetic; so the tape is run once over an algebra that
writes down the calls, and the calls are what is repeated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from functools import partial
from typing import Any, TypeAlias

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.tape import Tape, run

Array = NDArray[np.float64]
Tensor: TypeAlias = torch.Tensor
Call: TypeAlias = Callable[[], Any]


class _Slot:
    """A value of the program: an input (no function), or the result of a ufunc."""

    def __init__(self, function: Any, operands: tuple[_Value, ...], varies: bool) -> None:
        self.function, self.operands, self.varies = function, operands, varies


_Value: TypeAlias = "_Slot | float"


class _Recorder:
    """Operations of `models.tape.Algebra` that write down what is to be computed."""

    def __init__(self) -> None:
        self.slots: list[_Slot] = []

    def constant(self, value: Fraction) -> _Value:
        return float(value)

    def add(self, left: _Value, right: _Value) -> _Value:
        return self._record(np.add, left, right)

    def subtract(self, left: _Value, right: _Value) -> _Value:
        return self._record(np.subtract, left, right)

    def multiply(self, left: _Value, right: _Value) -> _Value:
        return self._record(np.multiply, left, right)

    def divide(self, left: _Value, right: _Value) -> _Value:
        return self._record(np.divide, left, right)

    def negate(self, operand: _Value) -> _Value:
        return self._record(np.negative, operand)

    def square(self, operand: _Value) -> _Value:
        return self._record(np.multiply, operand, operand)

    def sincos(self, operand: _Value) -> tuple[_Value, _Value]:
        return self._record(np.sin, operand), self._record(np.cos, operand)

    def exp(self, operand: _Value) -> _Value:
        return self._record(np.exp, operand)

    def log(self, operand: _Value) -> _Value:
        return self._record(np.log, operand)

    def sqrt(self, operand: _Value) -> _Value:
        return self._record(np.sqrt, operand)

    def tanh(self, operand: _Value) -> _Value:
        return self._record(np.tanh, operand)

    def _record(self, function: Any, *operands: _Value) -> _Slot:
        varies = any(isinstance(operand, _Slot) and operand.varies for operand in operands)
        self.slots.append(_Slot(function, operands, varies))
        return self.slots[-1]


class Program:
    """A tape as numpy calls on fixed buffers; not for two threads at once.

    Write the inputs' rows and make the calls in their order, those of `held` only where a held input changed: then the
    results are in the outputs' rows.

    Parameters
    ----------
    tape : Tape
    varying, held : array, shape (count, lanes)
        Buffers of the tape's inputs, first those that change often, then those that are held; read at every call.
    outputs : array, shape (results, lanes)
        Buffer that the results are written to; between the calls of `held` it is the program's.

    Attributes
    ----------
    held : list of callables
        Compute what depends on constants and held inputs only.
    varying : list of callables
        Compute the rest.
    """

    def __init__(self, tape: Tape, varying: Array, held: Array, outputs: Array) -> None:
        recorder, lanes = _Recorder(), outputs.shape[1]
        rows = [*varying, *held]
        inputs = [_Slot(None, (), position < len(varying)) for position in range(len(rows))]
        results = run(tape, recorder, [*inputs])
        buffers: dict[_Value, Array] = dict(zip(inputs, rows, strict=True))
        copied = []
        for result, row in zip(results, outputs, strict=True):
            if result in buffers or not isinstance(result, _Slot):
                copied.append((row, result))
            else:
                buffers[result] = row
        needed = _needed(results)
        self.held: list[Call] = []
        self.varying: list[Call] = []

        def buffer(value: _Value) -> Array:
            """Constants as full rows: a ufunc of two equal shapes is the quickest."""
            if value not in buffers:
                buffers[value] = np.empty(lanes) if isinstance(value, _Slot) else np.full(lanes, value)
            return buffers[value]

        for slot in recorder.slots:
            if slot in needed:
                calls = self.varying if slot.varies else self.held
                calls.append(partial(slot.function, *(buffer(operand) for operand in slot.operands), buffer(slot)))
        for row, result in copied:
            calls = self.varying if isinstance(result, _Slot) and result.varies else self.held
            calls.append(partial(np.copyto, row, buffer(result)))


def _needed(results: Sequence[_Value]) -> set[_Value]:
    """What the results are made of; a tape's sine records a cosine that nobody may ask for."""
    found: set[_Value] = set()
    waiting = list(results)
    while waiting:
        value = waiting.pop()
        if isinstance(value, _Slot) and value not in found:
            found.add(value)
            waiting.extend(value.operands)
    return found


class TorchAlgebra:
    """Operations of `models.tape.Algebra` on torch tensors: differentiable, shapes broadcast.

    Parameters
    ----------
    like : Tensor
        Constants get its type and its device.
    """

    def __init__(self, like: Tensor) -> None:
        self.like = like
        self._constants: dict[Fraction, Tensor] = {}

    def constant(self, value: Fraction) -> Tensor:
        if value not in self._constants:
            self._constants[value] = self.like.new_tensor(float(value))
        return self._constants[value]

    def add(self, left: Tensor, right: Tensor) -> Tensor:
        return left + right

    def subtract(self, left: Tensor, right: Tensor) -> Tensor:
        return left - right

    def multiply(self, left: Tensor, right: Tensor) -> Tensor:
        return left * right

    def divide(self, left: Tensor, right: Tensor) -> Tensor:
        return left / right

    def negate(self, operand: Tensor) -> Tensor:
        return -operand

    def square(self, operand: Tensor) -> Tensor:
        return operand * operand

    def sincos(self, operand: Tensor) -> tuple[Tensor, Tensor]:
        return torch.sin(operand), torch.cos(operand)

    def exp(self, operand: Tensor) -> Tensor:
        return torch.exp(operand)

    def log(self, operand: Tensor) -> Tensor:
        return torch.log(operand)

    def sqrt(self, operand: Tensor) -> Tensor:
        return torch.sqrt(operand)

    def tanh(self, operand: Tensor) -> Tensor:
        return torch.tanh(operand)


def run_on_tensors(tape: Tape, algebra: TorchAlgebra, inputs: Sequence[Tensor]) -> Tensor:
    """Run a tape and stack its results on a new last axis; leading axes of the inputs broadcast."""
    results = torch.broadcast_tensors(*run(tape, algebra, inputs), *inputs[:1])
    return torch.stack(results[: len(tape.outputs)], dim=-1)
