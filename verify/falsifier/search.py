"""Where candidates come from: cheap simulations first, then a gradient attack on what they did not violate.

The simulations start at corners of the initial set, at the verifier's own extreme factors and at random points; their
perturbations are corners of their boxes or random. What the attack finds is simulated again before it is proposed.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import BoundRequirement, ClosedLoop
from ...models.sampling import center_state, corner_states, sample_disturbances, sample_noise, uniform_states
from ...models.simulation import Trajectories, simulate
from .attack import Ascent, Climb
from .candidates import Candidate, magnitude, violations
from .chart import Chart
from .rollout import Choices, Rollout
from .severity import Severity

Array = NDArray[np.float64]
Stop = Callable[[], bool]

COARSE, FINE = (1e-7, 1e-9), (1e-11, 1e-13)
"""Relative and absolute tolerance of the simulator: for hundreds of starts, and for the few of the attack."""

DENSER = 4
"""Times as many samples per period where few trajectories are simulated."""

SHALLOW = 1e-9
"""A violation below this share of the numbers it is the difference of is at the limit of simulation."""

UNSURE = 1e-6
"""A violation below this share of the numbers it is the difference of may be the coarse simulation's error."""

COLUMNS, FEWEST = 128, 32
"""Columns of an attack, and columns per requirement where there are many requirements."""

ITERATIONS = 40

SUBSTEPS = (2, 4, 8, 16)
"""Runge-Kutta steps per period that are tried until the rollout is close to the simulator."""

CLOSE = 1e-3
"""How close, as a share of the range that the states have."""


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


class _Search:
    """The best candidate of every requirement so far, and what the simulations say about where to look further."""

    def __init__(self, loop: ClosedLoop, samples: int, stop: Stop | None) -> None:
        self.loop, self.stop = loop, stop
        self.samples = 1 if loop.plant.discrete else samples
        self.found: dict[int, Candidate] = {}
        self.solid: set[int] = set()
        self.runs: list[tuple[Choices, Trajectories, list[Array]]] = []

    @property
    def over(self) -> bool:
        return self.stop is not None and self.stop()

    def simulate(self, choices: Choices, tolerance: tuple[float, float], samples: int) -> Trajectories:
        """Choices through the simulator, which alone says what a candidate is."""
        noise, forces = choices.noise.transpose(2, 0, 1), choices.disturbances.transpose(2, 0, 1)
        rtol, atol = tolerance
        return simulate(
            self.loop,
            choices.initial.T,
            noise,
            forces,
            rtol=rtol,
            atol=atol,
            samples_per_period=samples,
            stop=self.stop,
        )

    def scan(self, choices: Choices) -> None:
        """Simulate many choices; keep their amounts, and candidates where something is violated."""
        run = self.simulate(choices, COARSE, self.samples)
        amounts = []
        for number, requirement in enumerate(self.loop.requirements):
            amount, when = violations(requirement, run.times, run.states, self.samples, float(self.loop.period))
            amounts.append(amount)
            worst = int(np.argmax(amount))
            if amount[worst] > UNSURE * magnitude(requirement, run.states[worst, when[worst]]):
                self.enter(number, _candidate(requirement, run, worst, when[worst], amount[worst]))
            elif amount[worst] > 0.0:
                self.confirm(number, _columns(choices, np.argsort(-amount)[:1]))
        self.runs.append((choices, run, amounts))

    def confirm(self, number: int, choices: Choices) -> bool:
        """Simulate a few choices finely; whether their requirement is now violated beyond doubt."""
        requirement = self.loop.requirements[number]
        samples = 1 if self.loop.plant.discrete else DENSER * self.samples
        run = self.simulate(choices, FINE, samples)
        amount, when = violations(requirement, run.times, run.states, samples, float(self.loop.period))
        worst = int(np.argmax(amount))
        if amount[worst] > 0.0:
            self.enter(number, _candidate(requirement, run, worst, when[worst], amount[worst]))
        return number in self.solid

    def enter(self, number: int, candidate: Candidate) -> None:
        if number in self.found and self.found[number].violation >= candidate.violation:
            return
        self.found[number] = candidate
        state = candidate.states[int(np.abs(candidate.times - candidate.time).argmin())]
        if candidate.violation > SHALLOW * magnitude(self.loop.requirements[number], state):
            self.solid.add(number)

    def worst(self, number: int, count: int) -> Choices:
        """The simulated choices that came closest to violating a requirement."""
        parts = [_columns(choices, np.argsort(-amounts[number])[:count]) for choices, _, amounts in self.runs]
        return Choices(
            np.concatenate([part.initial for part in parts], axis=-1),
            np.concatenate([part.noise for part in parts], axis=-1),
            np.concatenate([part.disturbances for part in parts], axis=-1),
        )

    def rollout(self) -> Rollout:
        """A rollout with as many steps per period as bring it close to the simulator."""
        choices, run, _ = self.runs[-1]
        finite = np.flatnonzero(np.isfinite(run.states).all((1, 2)))[:16]
        truth = run.period_ends[finite].transpose(1, 2, 0)
        few = _columns(choices, finite)
        for substeps in SUBSTEPS:
            rollout = Rollout(self.loop, substeps)
            trace = rollout.run(few, self.stop)
            if not finite.size or trace is None or rollout.substeps != substeps:
                break
            error = np.abs(trace.states[substeps::substeps] - truth).max((0, 2))
            if (error <= CLOSE * np.ptp(truth, axis=(0, 2))).all():
                break
        return rollout


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
    search = _Search(loop, samples, stop)
    for attack in attacks:
        noise = sample_noise(loop, attack, len(initial), generator)
        forces = sample_disturbances(loop, attack, len(initial), generator)
        search.scan(Choices(initial.T, noise.transpose(1, 2, 0), forces.transpose(1, 2, 0)))
    if iterations > 0 and (every or not search.solid):
        with np.errstate(all="ignore"):  # trajectories may escape
            _attack(search, extremes, iterations, every, generator)
    return sorted(search.found.values(), key=lambda candidate: -candidate.violation)


def _attack(
    search: _Search, extremes: Array | None, iterations: int, every: bool, generator: np.random.Generator
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
    size = max(COLUMNS // len(numbers), FEWEST)
    starts = [_starts(chart, size, search.worst(number, size // 16), extremes, generator) for number in numbers]
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


def _columns(choices: Choices, which: NDArray[np.intp]) -> Choices:
    return Choices(choices.initial[..., which], choices.noise[..., which], choices.disturbances[..., which])


def _candidate(requirement: BoundRequirement, run: Trajectories, row: int, when: int, amount: float) -> Candidate:
    return Candidate(
        requirement.name,
        float(run.times[when]),
        float(amount),
        run.states[row, 0],
        run.noise[row],
        run.disturbances[row],
        run.times,
        run.states[row],
    )
