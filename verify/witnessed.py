"""A simulated violation as a witness that the checker proves, in exact numbers."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement, ClosedLoop
from .checker.witness import Proof, Witness, prove, record
from .deadline import Deadline
from .evidence_files import EvidenceFiles
from .falsifier import Candidate
from .result import ProvedWitness
from .runtime_error import runtime_name
from .witness_replay import exact_runner, replay

Array = NDArray[np.float64]


def proved_witness(
    loop: ClosedLoop, candidate: Candidate, files: EvidenceFiles | str, deployed: bool, deadline: Deadline
) -> tuple[ProvedWitness | None, str]:
    """The candidate as a witness that the checker proved, and what it does not prove; or None and why not.

    Where the `deployed` network is part of the question, its runtime's own actions are recorded and proved too.
    """
    if isinstance(files, str) or deadline.expired:
        return None, files if isinstance(files, str) else "the time is up"
    requirement = next(entry for entry in loop.requirements if entry.name == candidate.requirement)
    witness = Witness(
        requirement=candidate.requirement,
        time=_exact_time(candidate.time, requirement, loop),
        initial=_clipped(candidate.initial, loop.initial),
        noise=tuple(
            _clipped(row, [(-radius, radius) for radius in loop.observation_radius]) for row in candidate.noise
        ),
        disturbances=_exact_disturbances(candidate.disturbances, loop),
        policy=files.digests["policy"],
        specification=files.digests["specification"],
        plant=files.plant,
        observation_radius=None if files.radius == loop.observation_radius else loop.observation_radius,
    )
    replayed, missing = "", ""
    if deployed:
        executed = record(
            witness,
            files.policy,
            files.specification,
            files.folder,
            run=exact_runner(loop.policy),
            runtime=runtime_name(),
            stop=lambda: deadline.expired,
        )
        if isinstance(executed, str):
            missing = executed
        elif executed.deployed is not None:
            witness, given = executed, executed.deployed
            replayed = given.runtime if replay(given.observations, given.actions, loop.policy) else ""
    found = prove(
        witness,
        files.policy,
        files.specification,
        files.folder,
        replayed=replayed,
        stop=lambda: deadline.expired,
    )
    if not isinstance(found, Proof):
        return None, found
    facts = (found.requirement, found.kind, found.time, found.grade, found.sentence, found.depth, found.radius)
    return ProvedWitness(*facts, found.precision, witness.to_json()), missing or found.objection


def _exact_time(time: float, requirement: BoundRequirement, loop: ClosedLoop) -> Fraction | None:
    """The simulation's sampling time as a fraction of the period, within the requirement's window; None for reach."""
    if requirement.kind == "reach":
        return None
    for edge in (requirement.start, requirement.end):
        if abs(time - float(edge)) <= 1e-9 * float(loop.period):  # which has no small denominator as a share
            return edge
    share = Fraction(time / float(loop.period))
    near = Fraction(round(share)) if loop.plant.discrete else share.limit_denominator(64)
    return min(max(near * loop.period, requirement.start), requirement.end)


def _clipped(values: Array, bounds: Sequence[tuple[Fraction, Fraction]]) -> tuple[Fraction, ...]:
    """Floats as exact numbers that are within their bounds, where rounding took them out."""
    return tuple(min(max(Fraction(x), low), high) for x, (low, high) in zip(values.tolist(), bounds, strict=True))


def _exact_disturbances(values: Array, loop: ClosedLoop) -> tuple[tuple[Fraction, ...], ...]:
    rows = [_clipped(row, [(entry.lower, entry.upper) for entry in loop.disturbances]) for row in values]
    constant = [entry.constant for entry in loop.disturbances]
    return tuple(
        tuple(first if held else value for value, first, held in zip(row, rows[0], constant, strict=True))
        for row in rows
    )
