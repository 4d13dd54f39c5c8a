"""Adam for a stack of independent networks, and the soft update of their targets."""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from .networks import Tensor

MEMORY = (0.9, 0.999)
SMALLEST = 1e-8
"""Added to the root of the second moment."""


class Mask:
    """Which seeds take part.

    Attributes
    ----------
    rows : array of bool, shape (S,)
    all, any : bool
    column : Tensor, shape (S, 1)
        1 and 0.
    """

    def __init__(self, rows: NDArray[np.bool_], like: Tensor) -> None:
        self.rows, self.all, self.any = rows, bool(rows.all()), bool(rows.any())
        self.column = torch.from_numpy(rows[:, None]).to(like)

    def repeated(self, times: int, like: Tensor) -> Mask:
        """The same for several networks per seed."""
        return self if times == 1 else Mask(np.tile(self.rows, times), like)


class Adam:
    """Adam [1]_ with coupled L2 decay, one step count per seed.

    Parameters
    ----------
    parameters : Tensor, shape (S, P)
        Changed in place by `step`.
    learning_rate, decay : float
        The decay's gradient ``decay * parameters`` is added to the loss's.

    References
    ----------
    .. [1] Kingma and Ba, "Adam: a method for stochastic optimization", ICLR 2015, Alg. 1.
    """

    def __init__(self, parameters: Tensor, learning_rate: float, decay: float = 0.0) -> None:
        self.parameters, self.learning_rate, self.decay = parameters, learning_rate, decay
        self.first = torch.zeros_like(parameters)
        self.second = torch.zeros_like(parameters)
        self.steps = np.zeros(len(parameters), dtype=np.int64)

    def step(self, gradient: Tensor, active: Mask) -> None:
        """Move the active seeds; the others stay as they are, moments too."""
        p = self.parameters
        if self.decay:
            gradient = gradient.add(p, alpha=self.decay)
        self.steps += active.rows
        first, second = 1.0 - MEMORY[0], 1.0 - MEMORY[1]
        steps = np.maximum(self.steps, 1)
        scales = self.learning_rate / (1.0 - MEMORY[0] ** steps), 1.0 / np.sqrt(1.0 - MEMORY[1] ** steps)
        # numbers where all seeds are alike, else columns: the same operations, rounded alike
        alike = active.all and bool((steps == steps[0]).all())
        moved: Any = 1.0 if alike else active.column
        rate, share = (float(x[0]) if alike else torch.from_numpy(x[:, None]).to(p) for x in scales)
        self.first.lerp_(gradient, first * moved)
        self.second.lerp_(gradient.square(), second * moved)
        size = self.second.sqrt().mul_(share).add_(SMALLEST)
        p.addcdiv_(self.first * (rate * moved), size, value=-1.0)

    def tensors(self) -> dict[str, Tensor]:
        """The whole state."""
        return {"first": self.first, "second": self.second, "steps": torch.from_numpy(self.steps)}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from the `tensors` of an optimiser of the same shape."""
        for name, value in self.tensors().items():
            value.copy_(tensors[name])  # the steps share their memory with the tensor


def soft_update(target: Tensor, online: Tensor, share: float, active: Mask) -> None:
    """``target <- target + share (online - target)`` for the active seeds, in place."""
    if active.all:
        target.lerp_(online, share)
    else:
        target.lerp_(online, share * active.column)
