"""Tables for people and for spreadsheets: sweeps and simulations as aligned text and as comma-separated values."""

from __future__ import annotations

import csv
import io
from collections.abc import Mapping, Sequence
from fractions import Fraction
from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import ClosedLoop
from ..models.simulation import Trajectories
from ..specs.exact import signed_text
from .report import json_data, margin_text, result_to_json, table
from .result import Result
from .wording import at_least, number

Array = NDArray[np.float64]

SWEEP_FORMAT = "setrl-sweep/1"
SIMULATION_FORMAT = "setrl-simulation/1"


def sweep_table(radii: Sequence[Fraction], results: Sequence[Result]) -> list[str]:
    """One row per perturbation radius, bounds rounded to the safe side."""
    names = [entry.name for entry in results[0].requirements]
    rows = [("epsilon", "verdict", "V(s0)", "V(s0) undiscounted", *(f"margin {name}" for name in names))]
    for radius, result in zip(radii, results, strict=True):
        value = result.value
        bounds = ("-", "-") if value is None else (at_least(value.discounted), at_least(value.undiscounted))
        margins = [margin_text(entry.margin) for entry in result.requirements]
        rows.append((signed_text(radius), result.verdict.value, *bounds, *margins))
    return table(rows)


def sweep_csv(radii: Sequence[Fraction], results: Sequence[Result]) -> str:
    """The same with all digits; ``-inf`` is no bound."""
    names = [entry.name for entry in results[0].requirements]
    rows: list[list[Any]] = [["epsilon", "verdict", "value_discounted", "value_undiscounted"]]
    rows[0] += [f"margin_{name}" for name in names]
    for radius, result in zip(radii, results, strict=True):
        value = result.value
        bounds = ["", ""] if value is None else [value.discounted, value.undiscounted]
        margins = [entry.margin for entry in result.requirements]
        rows.append([signed_text(radius), result.verdict.value, *bounds, *margins])
    return comma_separated(rows)


def sweep_to_json(radii: Sequence[Fraction], results: Sequence[Result]) -> dict[str, Any]:
    """The same as plain data, with everything that `report.result_to_json` says about each radius."""
    entries = [
        {"epsilon": float(radius), **result_to_json(result)} for radius, result in zip(radii, results, strict=True)
    ]
    return {"format": SWEEP_FORMAT, "results": entries}


def simulation_to_json(
    loop: ClosedLoop, trajectories: Trajectories, returns: Array | None, violations: Mapping[str, Array]
) -> dict[str, Any]:
    """Summary of simulated trajectories as plain data.

    Parameters
    ----------
    loop : ClosedLoop
    trajectories : Trajectories
    returns : array, shape (N,), or None
        Discounted return of every trajectory.
    violations : mapping of requirement name to array, shape (N,)
        How much every trajectory violates it; not positive where it does not.
    """
    final = trajectories.states[:, -1]
    complete = np.isfinite(final).all(axis=1)
    bounds = (final[complete].min(axis=0), final[complete].max(axis=0)) if complete.any() else None
    data = {
        "format": SIMULATION_FORMAT,
        "trajectories": len(final),
        "diverged": int((~complete).sum()),
        "requirements": [
            {"name": name, "violated_by": int((amount > 0.0).sum()), "worst_violation": float(amount.max())}
            for name, amount in violations.items()
        ],
        "returns": None if returns is None else {"least": float(returns.min()), "mean": float(returns.mean())},
        "final": None if bounds is None else dict(zip(loop.plant.states, np.stack(bounds, 1).tolist(), strict=True)),
    }
    return dict(json_data(data))


def simulation_table(summary: Mapping[str, Any]) -> list[str]:
    """The summary that `simulation_to_json` makes, for people."""
    count = summary["trajectories"]
    rows = [("simulated", f"{count} trajectories, {summary['diverged']} diverged; a simulation proves nothing")]
    for entry in summary["requirements"]:
        worst = entry["worst_violation"]
        by = "" if worst is None else f"by {number(worst)}" if worst > 0.0 else f"closest {number(-worst)}"
        rows.append((entry["name"], f"violated by {entry['violated_by']} of {count}, {by}".rstrip(", ")))
    returns = summary["returns"]
    if returns is not None:
        least, mean = (returns[key] for key in ("least", "mean"))
        shown = "a trajectory diverged" if least is None else f"least {number(least)}, mean {number(mean)}"
        rows.append(("return", shown))
    for state, (low, high) in (summary["final"] or {}).items():
        rows.append((f"final {state}", f"[{number(low)}, {number(high)}]"))
    return table(rows)


def trajectories_csv(loop: ClosedLoop, trajectories: Trajectories) -> str:
    """Every sample of every trajectory; actions and noise are those of the period that begins at the sample."""
    plant = loop.plant
    header = ["trajectory", "time", *plant.states, *plant.inputs]
    header += [f"noise {name}" for name in loop.observation_names] + list(plant.disturbances)
    rows: list[list[Any]] = [header]
    held = np.concatenate([trajectories.actions, trajectories.noise, trajectories.disturbances], axis=2)
    blank = [""] * held.shape[2]
    for run, states in enumerate(trajectories.states):
        for sample, (time, state) in enumerate(zip(trajectories.times.tolist(), states.tolist(), strict=True)):
            period = sample // trajectories.samples_per_period
            rows.append([run, time, *state, *(held[run, period].tolist() if period < held.shape[1] else blank)])
    return comma_separated(rows)


def comma_separated(rows: Sequence[Sequence[Any]]) -> str:
    """Rows as CSV; numbers with all digits."""
    buffer = io.StringIO()
    csv.writer(buffer, lineterminator="\n").writerows(rows)
    return buffer.getvalue()
