"""The trajectory of a witness as numbers to look at: simulated once more, in float64.

Nothing here proves anything; the proof is in the witness file.
"""

from __future__ import annotations

import csv
import io
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import BoundRequirement, ClosedLoop
from ..models.simulation import Trajectories, simulate
from ..specs.files import write_atomically

if TYPE_CHECKING:
    from .falsifier import Candidate

Array = NDArray[np.float64]

SAMPLES = 8
"""States per control period of a continuous-time plant."""

COMMENT = "# a simulation in float64, for looking at; what is proved is in the witness file"


def trajectory_of(loop: ClosedLoop, candidate: Candidate) -> Trajectories:
    """Simulate the trajectory of a candidate once more, `SAMPLES` states per period.

    Parameters
    ----------
    loop : ClosedLoop
    candidate : Candidate

    Returns
    -------
    Trajectories
        With N = 1.
    """
    return simulate(
        loop,
        candidate.initial,
        candidate.noise[None],
        candidate.disturbances[None],
        samples_per_period=1 if loop.plant.discrete else SAMPLES,
    )


def violated_requirement(loop: ClosedLoop, candidate: Candidate) -> BoundRequirement:
    """The requirement that a candidate violates."""
    return next(requirement for requirement in loop.requirements if requirement.name == candidate.requirement)


def margins(requirement: BoundRequirement, states: Array) -> Array:
    """Signed distance of states to a requirement, in its unit: > 0 where it holds, < 0 where it is violated.

    ``max_members min_facets (bound - normal x)`` for `stay` and `reach`, its negative for `avoid`; times play no part.

    Parameters
    ----------
    requirement : BoundRequirement
    states : array, shape (S, n)

    Returns
    -------
    array, shape (S,)
    """
    depth = np.full(len(states), -np.inf)
    for member in requirement.region:
        normals, bounds = np.array(member.normals, dtype=np.float64), np.array(member.bounds, dtype=np.float64)
        depth = np.maximum(depth, (bounds - states @ normals.T).min(axis=1))
    return -depth if requirement.kind == "avoid" else depth


def trajectory_rows(loop: ClosedLoop, candidate: Candidate) -> list[list[str]]:
    """The simulated trajectory as a table of texts, header first.

    Columns: time, the states, the actions that act on the plant, the perturbation of every component of the
    observation, the disturbances, and the signed distance to the violated requirement (< 0: violated). What is held
    over a period is that of the period that begins at the row's time or before; the last row, the end of the run,
    has none. Numbers have all digits.

    Parameters
    ----------
    loop : ClosedLoop
    candidate : Candidate

    Returns
    -------
    list of list of str
    """
    plant, run = loop.plant, trajectory_of(loop, candidate)
    requirement = violated_requirement(loop, candidate)
    units = plant.description
    header = ["time (s)", *(_with_unit(name, units.states) for name in plant.states)]
    header += [_with_unit(name, units.inputs) for name in plant.inputs]
    header += [f"perturbation of {name}" for name in loop.observation_names]
    header += [_with_unit(name, units.disturbances) for name in plant.disturbances]
    header += [f"distance to {requirement.name}"]
    held = np.concatenate([run.actions[0], run.noise[0], run.disturbances[0]], axis=1)
    blank = [""] * held.shape[1]
    rows = [header]
    samples = zip(run.times.tolist(), run.states[0].tolist(), margins(requirement, run.states[0]).tolist(), strict=True)
    for sample, (time, state, margin) in enumerate(samples):
        period = sample // run.samples_per_period
        values = [repr(value) for value in held[period].tolist()] if period < len(held) else blank
        rows.append([repr(time), *map(repr, state), *values, repr(margin)])
    return rows


def _with_unit(name: str, units: Any) -> str:
    unit = units.get(name, "")
    return f"{name} ({unit})" if unit and unit != "1" else name


def trajectory_csv(loop: ClosedLoop, candidate: Candidate) -> str:
    """`trajectory_rows` as comma-separated values below a comment that says what they are."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(trajectory_rows(loop, candidate))
    return f"{COMMENT}\n{buffer.getvalue()}"


def write_trajectory(path: str, loop: ClosedLoop, candidate: Candidate) -> None:
    """Write `trajectory_csv` to a file, whole or not at all.

    Parameters
    ----------
    path : str
    loop : ClosedLoop
    candidate : Candidate

    Raises
    ------
    InputError
        The file cannot be written.
    """
    write_atomically(path, trajectory_csv(loop, candidate).encode("utf-8"))
