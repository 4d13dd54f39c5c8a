"""One integrator step of a batch of joint sets: what every flow method returns, and how batches are cut and joined."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction
from typing import Any, ClassVar, Self

import numpy as np
from numpy.typing import NDArray

from . import balls
from .balls import Ball
from .zonotope import Zonotope, stack_cells

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]


@dataclass(frozen=True, kw_only=True)
class Step(ABC):
    """One integrator step of a batch of joint sets (states first, then what is constant over the step).

    Attributes
    ----------
    start, end : Zonotope, shape (B, d)
        The rows of `start` are the first ones of `end`.
    duration : Fraction
    added : array, shape (B, n)
        Half-width that this step added in all.
    truncation : array, shape (B, n)
        Estimate of the part of it that shorter steps would diminish.
    sound : array of bool, shape (B,)
        Whether the a-priori enclosure was proved and everything is finite; elsewhere the step means nothing.
    rate : array, shape (2, B, n)
        Growth of the a-priori box per second: a guess for the next step, not a bound.
    prior : Ball, shape (B, d)
        The a-priori enclosure: what a checker has to prove first.
    slabs : dict of int to list of Zonotope
        Time-interval sets that were already asked for.
    """

    CELL_AXES: ClassVar[dict[str, int]] = {"start": 0, "end": 0, "added": 0, "truncation": 0, "sound": 0, "rate": 1}
    """Fields that have one entry per cell, and their axis; a subclass adds its own."""
    EVIDENCE: ClassVar[tuple[str, ...]] = ("prior",)
    """Fields for the certificate of one step, cells first; joined steps are only looked at, and do not have them."""

    start: Zonotope
    duration: Fraction
    end: Zonotope
    added: Array
    truncation: Array
    sound: Bools
    rate: Array
    prior: Ball | None
    slabs: dict[int, list[Zonotope]] = field(default_factory=dict, repr=False, compare=False)

    def select(self, cells: Any) -> Self:
        """The same step of some cells."""
        chosen = {name: _take(getattr(self, name), cells, axis) for name, axis in self.CELL_AXES.items()}
        for name in self.EVIDENCE:
            value = getattr(self, name)
            chosen[name] = None if value is None else value[cells]
        return replace(self, slabs={}, **chosen)

    @classmethod
    def join(cls, steps: Sequence[Self]) -> Self:
        """Steps of equal duration as one batch, cells one after the other."""
        joined = {name: _joined([getattr(step, name) for step in steps], axis) for name, axis in cls.CELL_AXES.items()}
        nothing: dict[str, Any] = dict.fromkeys(cls.EVIDENCE)
        return replace(steps[0], slabs={}, **joined, **nothing)

    def time_intervals(self, slabs: int) -> list[Zonotope]:
        """Sets that contain the states at every time of each of `slabs` equal parts; the last generator is time."""
        if slabs not in self.slabs:
            self.slabs[slabs] = self.enclose_intervals(slabs)
        return self.slabs[slabs]

    @abstractmethod
    def enclose_intervals(self, slabs: int) -> list[Zonotope]:
        """Compute `time_intervals`."""


def _take(value: Any, cells: Any, axis: int) -> Any:
    return value[cells] if axis == 0 else value[:, cells]


def _joined(values: Sequence[Any], axis: int) -> Any:
    if isinstance(values[0], Zonotope):
        return stack_cells(values)
    if isinstance(values[0], Ball):
        return balls.concatenate(values, axis)
    return np.concatenate(values, axis)
