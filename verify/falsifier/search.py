"""Where candidates come from: corners of the initial set, the verifier's own extreme factors, random points.

The perturbations are corners of their boxes or random.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import ClosedLoop
from ...models.sampling import center_state, corner_states, sample_disturbances, sample_noise, uniform_states
from ...models.simulation import simulate
from .candidates import Candidate, violations

Array = NDArray[np.float64]


def propose(
    loop: ClosedLoop,
    extremes: Array | None = None,
    random: int = 64,
    seed: int = 0,
    samples: int = 8,
    stop: Callable[[], bool] | None = None,
) -> Candidate | None:
    """Simulate candidates and return the worst violation found, or None.

    Parameters
    ----------
    loop : ClosedLoop
    extremes : array, shape (k, n), optional
        Initial states that the verifier suspects.
    random : int
        Number of uniformly drawn initial states.
    seed : int
    samples : int
        Simulated times per control period at which requirements are checked (one for a discrete-time plant).
    stop : callable, optional
        Says when time is up; what was simulated until then counts.

    Returns
    -------
    Candidate or None
    """
    generator = np.random.default_rng(seed)
    starts = [corner_states(loop, 64), center_state(loop)[None], uniform_states(loop, random, generator)]
    if extremes is not None and extremes.size:
        starts.insert(0, extremes)
    initial = np.concatenate(starts)
    attacks: list[Literal["none", "uniform", "corner"]] = ["none"]
    if any(radius > 0 for radius in loop.observation_radius) or loop.disturbances:
        attacks += ["corner", "uniform"]
    best: Candidate | None = None
    for attack in attacks:
        noise = sample_noise(loop, attack, len(initial), generator)
        disturbances = sample_disturbances(loop, attack, len(initial), generator)
        count = 1 if loop.plant.discrete else samples
        run = simulate(loop, initial, noise, disturbances, rtol=1e-7, atol=1e-9, samples_per_period=count, stop=stop)
        for requirement in loop.requirements:
            amount, when = violations(requirement, run.times, run.states, count, float(loop.period))
            worst = int(np.argmax(amount))
            if amount[worst] > 0.0 and (best is None or amount[worst] > best.violation):
                best = Candidate(
                    requirement.name,
                    float(run.times[when[worst]]),
                    float(amount[worst]),
                    initial[worst],
                    run.noise[worst],
                    run.disturbances[worst],
                    run.times,
                    run.states[worst],
                )
    return best
