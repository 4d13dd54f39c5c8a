"""What an adversary may choose as one cube: ``choice = centre + radius * b``, b in [-1, 1]^D, a column each."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import ClosedLoop
from ...models.sampling import inner_bounds
from .rollout import Choices

Array = NDArray[np.float64]


class Chart:
    """The free coordinates of a closed loop: initial states, noise per period, disturbances per period or per run.

    What has one possible value is no coordinate. A constant disturbance is one coordinate for all periods.

    Parameters
    ----------
    loop : ClosedLoop

    Attributes
    ----------
    size : int
        D.
    """

    def __init__(self, loop: ClosedLoop) -> None:
        self.periods = loop.periods
        self.initial = _sides([inner_bounds(*bounds) for bounds in loop.initial])
        self.noise = _sides([inner_bounds(-radius, radius) for radius in loop.observation_radius])
        self.forces = _sides([inner_bounds(entry.lower, entry.upper) for entry in loop.disturbances])
        constant = np.array([entry.constant for entry in loop.disturbances], dtype=bool)
        self.free_states = np.flatnonzero(self.initial[1] > self.initial[0])
        self.free_noise = np.flatnonzero(self.noise[1] > self.noise[0])
        wide = self.forces[1] > self.forces[0]
        self.varying, self.held = np.flatnonzero(wide & ~constant), np.flatnonzero(wide & constant)
        sizes = [
            self.free_states.size,
            self.periods * self.free_noise.size,
            self.periods * self.varying.size,
            self.held.size,
        ]
        self.ends = np.cumsum(sizes)
        self.size = int(self.ends[-1])

    def choices(self, b: Array) -> Choices:
        """Points of the cube as choices within their exact bounds.

        Parameters
        ----------
        b : array, shape (D, N)

        Returns
        -------
        Choices
        """
        count = b.shape[1]
        start, noise, varying, held = np.split(b, self.ends[:-1])
        initial = _middle(self.initial, (1, count))[0]
        initial[self.free_states] = _scaled(self.initial, self.free_states, start)
        shaken = _middle(self.noise, (self.periods, count))
        shaken[:, self.free_noise] = _scaled(self.noise, self.free_noise, noise.reshape(self.periods, -1, count))
        forces = _middle(self.forces, (self.periods, count))
        forces[:, self.varying] = _scaled(self.forces, self.varying, varying.reshape(self.periods, -1, count))
        forces[:, self.held] = _scaled(self.forces, self.held, held)
        return Choices(initial, shaken, forces)

    def coordinates(self, choices: Choices) -> Array:
        """The inverse of `choices`, (D, N); of a constant disturbance the first period counts."""
        count = choices.initial.shape[1]
        parts = [
            _unscaled(self.initial, self.free_states, choices.initial),
            _unscaled(self.noise, self.free_noise, choices.noise).reshape(-1, count),
            _unscaled(self.forces, self.varying, choices.disturbances).reshape(-1, count),
            _unscaled(self.forces, self.held, choices.disturbances[0]),
        ]
        return np.clip(np.concatenate(parts), -1.0, 1.0)

    def pull(self, gradient: Choices) -> Array:
        """The gradient in the choices becomes one in b, (D, N): times the radius, summed where one value is held."""
        count = gradient.initial.shape[1]
        parts = [
            _radius(self.initial, self.free_states) * gradient.initial[self.free_states],
            (_radius(self.noise, self.free_noise) * gradient.noise[:, self.free_noise]).reshape(-1, count),
            (_radius(self.forces, self.varying) * gradient.disturbances[:, self.varying]).reshape(-1, count),
            _radius(self.forces, self.held) * gradient.disturbances[:, self.held].sum(0),
        ]
        return np.concatenate(parts)


def _sides(bounds: list[tuple[float, float]]) -> Array:
    return np.array(bounds, dtype=np.float64).reshape(-1, 2).T


def _radius(sides: Array, which: NDArray[np.intp]) -> Array:
    return np.asarray(0.5 * (sides[1] - sides[0])[which, None])


def _middle(sides: Array, shape: tuple[int, int]) -> Array:
    """(periods, components, N)"""
    periods, count = shape
    return np.tile((0.5 * (sides[0] + sides[1]))[:, None], (periods, 1, count))


def _scaled(sides: Array, which: NDArray[np.intp], b: Array) -> Array:
    low, high = sides[:, which, None]
    return np.asarray(np.clip(0.5 * (low + high) + 0.5 * (high - low) * b, low, high))


def _unscaled(sides: Array, which: NDArray[np.intp], values: Array) -> Array:
    low, high = sides[:, which, None]
    return np.asarray((values[..., which, :] - 0.5 * (low + high)) / (0.5 * (high - low)))
