"""Witnesses: one start and one sequence of perturbations whose trajectory provably violates a requirement.

A proof has two halves: the witness is admitted by the specification (checked in rationals), and the one trajectory that
belongs to it violates the requirement (checked with comparisons of balls that hold for all their points). What is not
proved is refused with a sentence that says why.

The trajectory is that of the network in exact real arithmetic, or that of a runtime's recorded actions: two proofs, of
which one is enough.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

from flint import arb, ctx

from .loop import periods
from .proof import BOTH, DEPLOYED, REAL, Proof, Shown, decimal, proof_of
from .question import Question, pose
from .recorded import Answer, deployed_action, input_floats, recorded_answer, without_controller
from .regions import Polytope, Region
from .taylor import ball
from .witness_file import Numbers, Recording, Witness, read_witness

__all__ = ["Proof", "Recording", "Witness", "prove", "read_witness", "record"]

Vector: TypeAlias = list[Any]
Stop: TypeAlias = Callable[[], bool]

PRECISIONS = (160, 320, 640, 1280)
"""Bits, one after the other until the comparison is decided."""


@dataclass(frozen=True)
class _Refusal:
    """Why nothing is shown; `cost` is how many attempts with more bits that makes hopeless, all by default."""

    reason: str
    cost: int = len(PRECISIONS)


Control: TypeAlias = Callable[[int, Vector], Vector | _Refusal]
"""The action for a period and its observation, perturbed and mapped by `before`."""


def prove(
    witness: Witness,
    policy: bytes,
    specification: bytes,
    folder: Path | None = None,
    *,
    replayed: str = "",
    stop: Stop | None = None,
) -> Proof | str:
    """Prove a witness's violation.

    Parameters
    ----------
    witness : Witness
    policy, specification : bytes
        Of the two files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.
    replayed : str, optional
        Name and version of the runtime that returned exactly the recorded actions when the caller ran it again on the
        recorded observations. Without it a recording proves nothing: it might be invented.
    stop : callable, optional
        Asked once per control period; True ends the attempt.

    Returns
    -------
    Proof or str
        Why there is none.
    """
    question = pose(witness, policy, specification, folder)
    if isinstance(question, str):
        return question
    real = _attempt(question, lambda _, observation: question.network(observation), stop)
    if witness.deployed is None:
        return real.reason if isinstance(real, _Refusal) else proof_of(question, REAL, [real], _EXACTLY)
    executed = _executed(question, witness.deployed, policy, replayed, stop)
    actions = f"for the actions that {replayed} computes"
    if isinstance(real, Shown):
        if isinstance(executed, Shown):
            return proof_of(question, BOTH, [real, executed], f"{_EXACTLY} and {actions}")
        return proof_of(question, REAL, [real], _EXACTLY, executed.reason)
    if isinstance(executed, Shown):
        return proof_of(question, DEPLOYED, [executed], f"{actions}, not {_EXACTLY} ({real.reason})")
    return f"{real.reason}; as deployed: {executed.reason}"


_EXACTLY = "in exact real arithmetic"


def _executed(
    question: Question, recording: Recording, policy: bytes, replayed: str, stop: Stop | None
) -> Shown | _Refusal:
    """What the recorded actions show."""
    if not replayed:
        return _Refusal("the recorded actions were not run again, or the runtime returns others")
    rows = (*recording.observations, *recording.actions)
    sizes = [question.network.inputs] * question.periods + [question.network.outputs] * question.periods
    if len(recording.observations) != question.periods or [len(row) for row in rows] != sizes:
        return _Refusal(f"recorded observations and actions of {question.periods} periods are required")
    return _driven(question, policy, recorded_answer(recording), stop)


def record(
    witness: Witness,
    policy: bytes,
    specification: bytes,
    folder: Path | None = None,
    *,
    run: Callable[[Numbers], Numbers | None],
    runtime: str,
    stop: Stop | None = None,
) -> Witness | str:
    """Record what a runtime does from a witness's start under its perturbations.

    The plant is enclosed as in the proof, so that every observation is the correctly rounded one.

    Parameters
    ----------
    witness : Witness
    policy, specification : bytes
    folder : Path, optional
    run : callable
        The ONNX file as the runtime executes it on one row: exact input in, exact output out, or None where the output
        is not finite.
    runtime : str
        Its name and version.
    stop : callable, optional
        As in `prove`.

    Returns
    -------
    Witness or str
        The same witness with its recording; or why the runtime's actions show no violation.
    """
    question = pose(witness, policy, specification, folder)
    if isinstance(question, str):
        return question
    rows: dict[int, tuple[Numbers, Numbers]] = {}

    def answer(period: int, entered: Numbers) -> Numbers | str:
        if period not in rows:  # with more bits every period is asked again, and rounds to the same
            returned = run(entered)
            if returned is None:
                return f"the runtime's output in period {period} is not finite"
            rows[period] = entered, returned
        return rows[period][1]

    shown = _driven(question, policy, answer, stop)
    if isinstance(shown, _Refusal):
        return shown.reason
    pairs = [rows[period] for period in range(question.periods)]
    recording = Recording(runtime, tuple(pair[0] for pair in pairs), tuple(pair[1] for pair in pairs))
    return replace(witness, deployed=recording)


def _driven(question: Question, policy: bytes, answer: Answer, stop: Stop | None) -> Shown | _Refusal:
    """What the plant shows under a runtime's actions."""
    floats, contract = input_floats(policy), question.contract
    if floats is None:
        return _Refusal("the network takes and returns numbers of two types")

    def control(period: int, observation: Vector) -> Vector | _Refusal:
        action = deployed_action(contract, floats, answer, period, observation)
        if isinstance(action, tuple):
            reason, undecided = action
            return _Refusal(reason, 1) if undecided else _Refusal(reason)
        return action

    return _attempt(replace(question, contract=without_controller(contract)), control, stop)


class _Network:
    """What the loop asks for the network's output in every period; it remembers why it gave none."""

    def __init__(self, question: Question, control: Control, stop: Stop | None) -> None:
        contract = question.contract
        self.control, self.stop, self.period = control, stop, 0
        self.outputs = len(contract.plant.inputs if contract.after is None else contract.after.matrix[0])
        self.refusal: _Refusal | None = None

    def __call__(self, observation: Vector) -> Vector:
        if self.stop is not None and self.stop():
            answer: Vector | _Refusal = _Refusal("the time is up")
        else:
            answer = self.control(self.period, observation)
        self.period += 1
        if isinstance(answer, _Refusal):
            self.refusal = answer
            return [arb("nan")] * self.outputs
        return answer


def _attempt(question: Question, control: Control, stop: Stop | None) -> Shown | _Refusal:
    """The violation of one trajectory, with as many bits as it needs."""
    cost, found = 0, _Refusal("nothing was tried")
    for precision in PRECISIONS:
        with ctx.workprec(precision):
            outcome = _violation(question, _Network(question, control, stop))
        if isinstance(outcome, Shown):
            return outcome
        found = outcome
        cost += found.cost
        if cost >= len(PRECISIONS):
            break
    return found


def _violation(question: Question, network: _Network) -> Shown | _Refusal:
    requirement, waiting = question.requirement, list(question.times)
    depths, radius = [], arb(0)
    for state, time in _states(question, network):
        depth = inside(requirement.region, state) if requirement.kind == "avoid" else outside(requirement.region, state)
        waiting.pop(0)
        radius = radius.max(_extreme([value.rad() for value in state], "max"))
        if not depth > 0 and not (requirement.kind == "avoid" and depth >= 0):
            if depth < 0:
                side = "outside" if requirement.kind == "avoid" else "inside"
                return _Refusal(f"the trajectory is provably {side} the region at {decimal(time)} s")
            return _Refusal(f"the enclosure at {decimal(time)} s is too wide to decide ({ctx.prec} bits)", 1)
        depths.append(depth)
    if network.refusal is not None:
        return network.refusal
    if waiting:
        reason = f"the trajectory could not be enclosed up to {decimal(waiting[0])} s ({ctx.prec} bits)"
        return _Refusal(reason, len(PRECISIONS) // 2)
    return Shown(min(_below(depth) for depth in depths), _above(radius), ctx.prec)


def _states(question: Question, network: _Network) -> Iterator[tuple[Vector, Fraction]]:
    """The trajectory's states at the times that are asked for, as far as it could be enclosed."""
    contract, witness, waiting = question.contract, question.witness, list(question.times)
    if waiting[0] == 0:
        yield [ball(value) for value in witness.initial], waiting.pop(0)
    if not waiting:
        return
    given = (witness.initial, witness.noise, witness.disturbances)
    called: Any = network  # the loop does nothing with a network but call it
    for entry in periods(contract, called, *given, until=waiting[-1]):
        if network.refusal is not None:
            return
        if waiting[0] == min((entry.number + 1) * contract.period, waiting[-1]):
            yield entry.end, waiting.pop(0)


def inside(region: Region, state: Vector) -> Any:
    """How deep a state lies inside a union: ``max_members min_facets (bound - row x)``; inside where >= 0."""
    return _extreme([_extreme([-value for value in _excess(member, state)], "min") for member in region], "max")


def outside(region: Region, state: Vector) -> Any:
    """How far a state lies outside a union: ``min_members max_facets (row x - bound)``; outside where > 0."""
    return _extreme([_extreme(_excess(member, state), "max") for member in region], "min")


def _excess(member: Polytope, state: Vector) -> Vector:
    return [
        sum((ball(c) * x for c, x in zip(facet.coefficients, state, strict=True) if c), -ball(facet.bound))
        for facet in member
    ]


def _extreme(values: Vector, which: str) -> Any:
    result = values[0]
    for value in values[1:]:
        result = result.max(value) if which == "max" else result.min(value)
    return result


def _below(value: Any) -> float:
    """A float that is not above any point of a ball that is not negative."""
    nearest = float(value.lower())
    while not arb(nearest) <= value:
        nearest = math.nextafter(nearest, -math.inf)
    return max(0.0, nearest)


def _above(radius: Any) -> float:
    return math.nextafter(float(radius), math.inf)
