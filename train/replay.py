"""Replay buffer of all seeds: one table of transitions per seed, sampled with one gather."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from numpy.typing import NDArray

from .networks import Tensor


@dataclass(frozen=True)
class Transitions:
    """A batch of transitions (x, a, r, x', terminal).

    Attributes
    ----------
    observation, following : Tensor, shape (S, B, n)
    action : Tensor, shape (S, B, m)
    reward, terminal : Tensor, shape (S, B, 1)
    columns : Tensor, shape (S, B, q, m)
        Generators of the action's set; q = 0 where points are stored.
    """

    observation: Tensor
    action: Tensor
    reward: Tensor
    following: Tensor
    terminal: Tensor
    columns: Tensor


class Replay:
    """Ring buffer; the oldest transition of a seed is overwritten first.

    Parameters
    ----------
    seeds, capacity : int
        Transitions per seed.
    inputs, actions, columns : int
        Sizes of the observation and the action, and generators of the action's set that are stored.
    dtype, device
        Of the table.
    """

    def __init__(
        self,
        seeds: int,
        capacity: int,
        inputs: int,
        actions: int,
        columns: int,
        *,
        dtype: torch.dtype = torch.float32,
        device: str = "cpu",
    ) -> None:
        self.capacity, self.inputs, self.actions, self.columns = capacity, inputs, actions, columns
        self.sizes = [inputs, actions, 1, inputs, 1, columns * actions]
        # one more row takes what a seed that has ended would store
        self.table = torch.zeros((seeds, capacity + 1, sum(self.sizes)), dtype=dtype, device=device)
        self.stored = np.zeros(seeds, dtype=np.int64)
        """Transitions that each seed ever stored."""
        self._seed = torch.arange(seeds, device=device)
        self._offset = np.arange(seeds)[:, None] * (capacity + 1)

    @property
    def count(self) -> NDArray[np.int64]:
        """Transitions that can be sampled, per seed."""
        return np.minimum(self.stored, self.capacity)

    def add(self, parts: list[Tensor], active: NDArray[np.bool_]) -> None:
        """Store one transition per active seed; `parts` are the columns of `Transitions` in order, (S, width) each."""
        place = np.where(active, self.stored % self.capacity, self.capacity)
        self.table[self._seed, torch.from_numpy(place).to(self.table.device)] = torch.cat(parts, -1)
        self.stored += active

    def sample(self, draws: NDArray[np.float64]) -> Transitions:
        """Transitions at uniform draws (S, B) in [0, 1); a seed without any gets rows of zeros."""
        rows = (draws * self.count[:, None]).astype(np.int64) + self._offset
        picked = self.table.flatten(0, 1).index_select(0, torch.from_numpy(rows.ravel()).to(self.table.device))
        parts = picked.unflatten(0, rows.shape).split(self.sizes, -1)
        observation, action, reward, following, terminal, columns = parts
        shaped = columns.unflatten(-1, (self.columns, self.actions)) if self.columns else columns[..., None]
        return Transitions(observation, action, reward, following, terminal, shaped)

    def tensors(self) -> dict[str, Tensor]:
        """What is stored: the used part of the table, and the counts."""
        used = int(self.count.max(initial=0))
        return {"table": self.table[:, :used].contiguous(), "stored": torch.from_numpy(self.stored.copy())}

    def restore(self, tensors: dict[str, Tensor]) -> None:
        """Continue from the `tensors` of a buffer of the same shape."""
        table = tensors["table"]
        self.table.zero_()
        self.table[:, : table.shape[1]] = table.to(self.table.device)
        self.stored = tensors["stored"].cpu().numpy().copy()
