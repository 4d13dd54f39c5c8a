"""Where candidates come from: cheap simulations first, then a gradient attack on what they did not violate.

The simulations start at corners of the initial set, at the verifier's own extreme factors and at random points; their
perturbations are corners of their boxes or random. What the attack finds is simulated again before it is proposed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import ClosedLoop
from ...models.sampling import center_state, corner_states, sample_disturbances, sample_noise, uniform_states
from .attack import PATIENCE, Ascent, Climb
from .candidates import Candidate
from .chart import Chart
from .rollout import Choices
from .severity import Severity
from .simulations import Simulations, Stop

Array = NDArray[np.float64]

COLUMNS, FEWEST = 128, 32
"""Columns of an attack, and columns per requirement where there are many requirements."""

ITERATIONS = 40

MOST_NUMBERS = 32_000_000
"""Numbers that the traces of a batch keep; it has fewer columns where a horizon is long."""

MOST_OPERATIONS = 3_000_000
"""Array operations of an attack, forward and backward; it has fewer iterations where a horizon is long."""


def propose(
    loop: ClosedLoop,
    extremes: Array | None = None,
    random: int = 64,
    seed: int = 0,
    samples: int = 8,
    stop: Callable[[], bool] | None = None,
    iterations: int = ITERATIONS,
) -> Candidate | None:
    """Search until one requirement is violated, and return the worst violation found, or None.

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
    iterations : int
        Of the gradient attack; 0: simulations only.

    Returns
    -------
    Candidate or None
    """
    found = _search(loop, extremes, random, seed, samples, stop, iterations, every=False)
    return found[0] if found else None


def propose_all(
    loop: ClosedLoop,
    extremes: Array | None = None,
    random: int = 64,
    seed: int = 0,
    samples: int = 8,
    stop: Callable[[], bool] | None = None,
    iterations: int = ITERATIONS,
) -> list[Candidate]:
    """Search for a violation of every requirement.

    Parameters
    ----------
    loop, extremes, random, seed, samples, stop, iterations
        As for `propose`.

    Returns
    -------
    list of Candidate
        At most one per requirement, the largest violation first.
    """
    return _search(loop, extremes, random, seed, samples, stop, iterations, every=True)


def _search(
    loop: ClosedLoop,
    extremes: Array | None,
    random: int,
    seed: int,
    samples: int,
    stop: Stop | None,
    iterations: int,
    every: bool,
) -> list[Candidate]:
    if not loop.requirements:
        return []
    generator = np.random.default_rng(seed)
    starts = [corner_states(loop, 64), center_state(loop)[None], uniform_states(loop, random, generator)]
    if extremes is not None and extremes.size:
        starts.insert(0, extremes)
    initial = np.concatenate(starts)
    attacks: list[Literal["none", "uniform", "corner"]] = ["none"]
    if any(radius > 0 for radius in loop.observation_radius) or loop.disturbances:
        attacks += ["corner", "uniform"]
    search = Simulations(loop, samples, stop)
    for attack in attacks:
        noise = sample_noise(loop, attack, len(initial), generator)
        forces = sample_disturbances(loop, attack, len(initial), generator)
        search.scan(Choices(initial.T, noise.transpose(1, 2, 0), forces.transpose(1, 2, 0)))
    if iterations > 0 and (every or not search.solid):
        with np.errstate(all="ignore"):  # trajectories may escape
            _attack(search, extremes, iterations, every, generator)
    return sorted(search.found.values(), key=lambda candidate: -candidate.violation)


def _attack(
    search: Simulations, extremes: Array | None, iterations: int, every: bool, generator: np.random.Generator
) -> None:
    """Climb from the worst simulations, the extremes, corners and random points; confirm what comes out."""
    loop, chart = search.loop, Chart(search.loop)
    if not chart.size or search.over:
        return
    rollout = search.rollout()
    severities = {
        number: Severity(requirement, rollout.times, rollout.substeps, float(loop.period))
        for number, requirement in enumerate(loop.requirements)
        if number not in search.solid
    }
    numbers = [number for number, severity in severities.items() if severity.samples.size]
    if not numbers:
        return
    size = min(max(COLUMNS // len(numbers), FEWEST), max(MOST_NUMBERS // (rollout.operations * len(numbers)), 8))
    iterations = min(iterations, max(MOST_OPERATIONS // (3 * rollout.operations), PATIENCE))
    known = [search.worst(number, max(size // 16, 1)) for number in numbers]
    starts = [_starts(chart, size, simulated, extremes, generator) for simulated in known]
    ascent = Ascent(rollout, chart, [severities[number] for number in numbers], starts, generator)

    def over() -> bool:
        return search.over or (bool(search.solid) and not every)

    def satisfied(group: int, climb: Climb) -> bool:
        return search.confirm(numbers[group], _best(chart, climb, 4))

    ascent.run(iterations, over, satisfied)
    for number, climb in zip(numbers, ascent.climbs(), strict=True):
        if number not in search.solid and not over():
            search.confirm(number, _best(chart, climb, 8))


def _starts(
    chart: Chart, count: int, simulated: Choices, extremes: Array | None, generator: np.random.Generator
) -> Array:
    """Points of the cube, (D, count).

    The middle, the simulations given, the extremes with perturbations at corners; then equal parts of corners of
    everything, perturbations that are held in a corner, and random points.
    """
    points = generator.uniform(-1.0, 1.0, (chart.size, count))
    points[:, ::3] = np.sign(points[:, ::3])
    held = chart.choices(np.sign(points[:, 1::3]))
    held.noise[:], held.disturbances[:] = held.noise[:1], held.disturbances[:1]
    points[:, 1::3] = chart.coordinates(held)
    points[:, 0] = 0.0
    known = chart.coordinates(simulated)
    points[:, 1 : 1 + known.shape[1]] = known
    if extremes is not None and extremes.size:
        some = extremes[: count // 4].T
        place = slice(1 + known.shape[1], 1 + known.shape[1] + some.shape[1])
        corners = chart.choices(np.sign(generator.uniform(-1.0, 1.0, (chart.size, some.shape[1]))))
        points[:, place] = chart.coordinates(Choices(some, corners.noise, corners.disturbances))
    return points


def _best(chart: Chart, climb: Climb, count: int) -> Choices:
    return chart.choices(climb.points[:, np.argsort(-climb.amounts)[:count]])
