"""Random rollouts of a closed loop: starts, perturbations and disturbances within their bounds. They prove nothing."""

from __future__ import annotations

import numpy as np

from .closed_loop import ClosedLoop
from .sampling import Attack, corner_states, sample_disturbances, sample_noise, uniform_states
from .simulation import Trajectories, simulate

SAMPLES = 8
"""States per control period that are kept of a continuous-time plant's trajectory."""


def roll_out(loop: ClosedLoop, count: int, attack: Attack, generator: np.random.Generator) -> Trajectories:
    """Simulate trajectories from random initial states.

    Parameters
    ----------
    loop : ClosedLoop
    count : int
    attack : {"none", "uniform", "corner"}
        Of perturbations and disturbances; with "corner" half of the trajectories start at corners of the initial set.
    generator : numpy.random.Generator

    Returns
    -------
    Trajectories
    """
    corners = corner_states(loop, count // 2) if attack == "corner" else np.zeros((0, len(loop.plant.states)))
    starts = np.concatenate([corners, uniform_states(loop, count - len(corners), generator)])
    noise = sample_noise(loop, attack, count, generator)
    forces = sample_disturbances(loop, attack, count, generator)
    return simulate(loop, starts, noise, forces, samples_per_period=1 if loop.plant.discrete else SAMPLES)
