"""What simulations have shown so far: candidates, and which choices came closest to one."""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from ...models.closed_loop import BoundRequirement, ClosedLoop
from ...models.simulation import Trajectories, simulate
from .candidates import Candidate, magnitude, violations
from .rollout import Choices, Rollout, shares_of

Array = NDArray[np.float64]
Stop: TypeAlias = Callable[[], bool]

COARSE, FINE = (1e-7, 1e-9), (1e-11, 1e-13)
"""Relative and absolute tolerance of the simulator: for hundreds of starts, and for the few of the attack."""

DENSER = 4
"""Times as many samples per period where few trajectories are simulated."""

SHALLOW = 1e-9
"""A violation below this share of the numbers it is the difference of is at the limit of simulation."""

UNSURE = 1e-6
"""A violation below this share of the numbers it is the difference of may be the coarse simulation's error."""

SUBSTEPS = (2, 4, 8, 16)
"""Runge-Kutta steps per period that are tried until the rollout is close to the simulator."""

CLOSE = 1e-3
"""How close, as a share of the range that the states have."""


class Simulations:
    """The best candidate of every requirement so far, and what the simulations say about where to look further.

    Parameters
    ----------
    loop : ClosedLoop
    samples : int
        Per control period, where many trajectories are simulated.
    stop : callable, optional
        Says when time is up.

    Attributes
    ----------
    found : dict
        Candidates by the number of their requirement.
    solid : set of int
        Requirements whose candidate is beyond doubt.
    """

    def __init__(self, loop: ClosedLoop, samples: int, stop: Stop | None) -> None:
        self.loop, self.stop = loop, stop
        self.samples = 1 if loop.plant.discrete else samples
        self.found: dict[int, Candidate] = {}
        self.solid: set[int] = set()
        self.runs: list[tuple[Choices, Trajectories, list[Array]]] = []

    @property
    def over(self) -> bool:
        """Whether time is up."""
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
            samples_per_period=1 if self.loop.plant.discrete else shares_of(self.loop, samples).tolist(),
            stop=self.stop,
        )

    def scan(self, choices: Choices) -> None:
        """Simulate many choices; keep their amounts, and candidates where something is violated."""
        run = self.simulate(choices, COARSE, self.samples)
        amounts = []
        for number, requirement in enumerate(self.loop.requirements):
            amount, when = violations(
                requirement, run.times, run.states, run.samples_per_period, float(self.loop.period)
            )
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
        amount, when = violations(requirement, run.times, run.states, run.samples_per_period, float(self.loop.period))
        worst = int(np.argmax(amount))
        if amount[worst] > 0.0:
            self.enter(number, _candidate(requirement, run, worst, when[worst], amount[worst]))
        return number in self.solid

    def enter(self, number: int, candidate: Candidate) -> None:
        """Keep a candidate of a requirement (its number) if it is the worst so far."""
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
            if not finite.size or trace is None or self.loop.plant.discrete:
                break
            error = np.abs(trace.states[rollout.substeps :: rollout.substeps] - truth).max((0, 2))
            if (error <= CLOSE * np.ptp(truth, axis=(0, 2))).all():
                break
        return rollout


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
