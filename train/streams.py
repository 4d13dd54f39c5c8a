"""Random numbers of a training run: one independent stream per seed and purpose.

A seed draws the same numbers whatever runs beside it, and a run that is resumed goes on where it stopped.
"""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any, Literal, TypeAlias, get_args

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

Purpose: TypeAlias = Literal["weights", "start", "disturbance", "exploration", "batch", "smoothing", "attack"]
PURPOSES: tuple[Purpose, ...] = get_args(Purpose)


class Streams:
    """One `numpy.random.Generator` per seed and purpose.

    Parameters
    ----------
    seeds : sequence of int
        Not negative.
    """

    def __init__(self, seeds: Sequence[int]) -> None:
        self.seeds = tuple(seeds)
        self._generators = {
            purpose: [np.random.default_rng(np.random.SeedSequence((seed, number))) for seed in self.seeds]
            for number, purpose in enumerate(PURPOSES)
        }

    def of(self, purpose: Purpose) -> list[np.random.Generator]:
        """Generators of one purpose, one per seed."""
        return self._generators[purpose]

    def uniform(self, purpose: Purpose, shape: tuple[int, ...]) -> Array:
        """Uniform numbers of [0, 1), shape (seeds, *shape)."""
        return np.stack([generator.random(shape) for generator in self.of(purpose)])

    def normal(self, purpose: Purpose, shape: tuple[int, ...]) -> Array:
        """Standard normal numbers, shape (seeds, *shape)."""
        return np.stack([generator.standard_normal(shape) for generator in self.of(purpose)])

    def state(self) -> str:
        """Where every stream is, as JSON text."""
        return json.dumps({p: [g.bit_generator.state for g in gs] for p, gs in self._generators.items()})

    def restore(self, text: str) -> None:
        """Continue from a `state`; of the same seeds."""
        stored: dict[Purpose, list[Any]] = json.loads(text)
        for purpose, generators in self._generators.items():
            for generator, state in zip(generators, stored[purpose], strict=True):
                generator.bit_generator.state = state
