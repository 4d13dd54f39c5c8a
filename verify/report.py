"""Results for people and for programs: pure functions from a result to lines of text or to plain data."""

from __future__ import annotations

import hashlib
import json
import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from .options import Options
from .result import Flowpipe, ProvedWitness, Reason, RequirementResult, Result, Value, Verdict
from .wording import at_least, at_most, number, quantity

if TYPE_CHECKING:
    from .splitting import Exploration

FORMAT = "setrl-result/1"
"""Name of the layout that `result_to_json` writes; it changes when a key changes its meaning or goes."""

_LABEL = 13


def verdict_line(result: Result) -> str:
    """The one line that goes to stdout: ``VERIFIED: <claim>``, ``CLAIMED: <claim>`` or ``UNKNOWN: <reason>``."""
    text = result.claim if result.reason is None else result.reason.sentence
    return f"{result.verdict.value}: {text}"


def describe(result: Result) -> list[str]:
    """Everything else that a person wants to know, one line per fact."""
    lines = requirement_table(result.requirements)
    if result.value is not None:
        lines += ["", _labelled("V(s0)", value_text(result.value))]
    elif lines:
        lines += [""]
    lines += [_labelled("network", semantics_text(result))]
    lines += [_labelled("cover", f"{quantity(result.leaves, 'cell')} ({quantity(result.cells, 'cell')} enclosed)")]
    if result.verdict is Verdict.VERIFIED and result.certificate is not None:
        lines += [_labelled("certificate", certificate_text(result))]
    lines += [_labelled("note", note) for note in result.notes]
    if result.reason is not None:
        lines += ["", *reason_lines(result.reason, result)]
    lines += [_labelled("time", timing_text(result.timings))]
    return lines


def requirement_table(requirements: Sequence[RequirementResult]) -> list[str]:
    """One row per requirement: name, kind, margin, when it is smallest, facet, outcome."""
    if not requirements:
        return []
    rows = [("requirement", "kind", "margin", "at", "outcome")]
    for entry in requirements:
        when = "" if entry.time is None or not math.isfinite(entry.margin) else f"{number(entry.time)} s"
        outcome = "proved" if entry.proved else "not proved"
        facet = f", decided by `{entry.facet}`" if entry.facet and not entry.proved else ""
        rows.append((entry.name, entry.kind, margin_text(entry.margin), when, f"{outcome}{facet}"))
    return table(rows)


def table(rows: Sequence[Sequence[str]]) -> list[str]:
    """Columns of text, aligned."""
    widths = [max(len(row[column]) for row in rows) for column in range(len(rows[0]))]
    return ["  ".join(cell.ljust(width) for cell, width in zip(row, widths, strict=True)).rstrip() for row in rows]


def margin_text(margin: float) -> str:
    """A margin with its sign, rounded down; "none" where no set could be compared."""
    if not math.isfinite(margin):
        return "none"
    return f"+{at_least(margin, 4)}" if margin > 0.0 else at_least(margin, 4)


def value_text(value: Value) -> str:
    """Verified performance in words."""
    if value.discounted == -math.inf:
        return "no lower bound: not every period could be enclosed"
    return (
        f">= {at_least(value.discounted)} with discount {number(value.discount)}, >= {at_least(value.undiscounted)} "
        "undiscounted, whatever the initial state and the perturbations"
    )


def semantics_text(result: Result) -> str:
    """Which arithmetic of the network is covered."""
    deployed = [name for name in result.semantics if name != "real"]
    if not deployed:
        return "exact real arithmetic"
    return f"exact real arithmetic, and {deployed[0]} as executed: {distance_text(result.deployed_error)}"


def distance_text(error: float) -> str:
    """How far the deployed network is from the exact one; an enclosure that was lost bounds nothing."""
    return f"at most {at_most(error)} off on any action" if math.isfinite(error) else "how far off has no bound"


def certificate_text(result: Result) -> str:
    """What the checker did, and how large the evidence is."""
    size = -(-len(result.certificate or b"") // 1000)
    return f"{size} kB, accepted by the checker: {quantity(result.leaves, 'cell')} proved again"


def reason_lines(reason: Reason, result: Result) -> list[str]:
    """Why not, what made the sets grow, what does verify, what to try."""
    lines = []
    shares = [f"{source} {100.0 * share:.0f} %" for source, share in reason.shares.items() if share >= 0.005]
    if shares:
        lines.append(_labelled("growth", ", ".join(shares)))
    horizon = float(result.loop.period) * result.loop.periods
    proved = []
    if 0.0 < reason.verified_until < horizon:
        proved.append(f"the whole initial set up to {number(reason.verified_until)} s")
    if reason.verified_part > 0.0:
        proved.append(f"{_percent(reason.verified_part)} of the initial set up to the end")
    if reason.largest_box:
        proved.append(f"its largest part {_box_text(reason.largest_box)}")
    lines.append(_labelled("does verify", "; ".join(proved) or "nothing that was tried"))
    if reason.remedy:
        lines.append(_labelled("try", reason.remedy))
    return lines


def _percent(share: float) -> str:
    """A share that never rounds up to everything."""
    return f"{min(100.0 * share, 99.99):.4g} %"


def _box_text(box: Mapping[str, tuple[float, float]]) -> str:
    parts = [
        f"{state} = {number(low)}" if number(low) == number(high) else f"{state} in [{number(low)}, {number(high)}]"
        for state, (low, high) in box.items()
    ]
    return ", ".join(parts)


def timing_text(timings: Mapping[str, float]) -> str:
    """``load 0.02 s, reachability 0.3 s``."""
    return ", ".join(f"{phase} {seconds:.2f} s" for phase, seconds in timings.items())


def _labelled(label: str, text: str) -> str:
    return f"{label:<{_LABEL}}{text}"


def result_to_json(
    result: Result, options: Options | None = None, certificate_path: str | None = None
) -> dict[str, Any]:
    """A result as plain data: the same keys whatever the outcome, and null for every number that is not finite.

    Parameters
    ----------
    result : Result
    options : Options, optional
        Numerical options of the run; null in the data where they are not given.
    certificate_path : str, optional
        Where the certificate was written.
    """
    from .. import __version__

    loop = result.loop
    data = json_data(
        {
            "format": FORMAT,
            "setrl": __version__,
            "verdict": result.verdict.value,
            "exit_code": result.verdict.exit_code,
            "claim": result.claim if result.reason is None else None,
            "reason": None if result.reason is None else _reason_data(result.reason),
            "requirements": [asdict(entry) for entry in result.requirements],
            "value": None if result.value is None else asdict(result.value),
            "subject": {
                "policy": {"name": loop.policy.name, "sha256": loop.policy.digest},
                "specification": {"name": Path(loop.specification.source).name, "sha256": loop.specification.digest},
                "plant": loop.plant.description.name,
            },
            "observation_radius": dict(zip(loop.observation_names, result.observation_radius, strict=True)),
            "semantics": list(result.semantics),
            "deployed_error": result.deployed_error,
            "cells": result.cells,
            "leaves": result.leaves,
            "candidate": None if result.candidate is None else _candidate_data(result, result.candidate),
            "witness": None if result.witness is None else _witness_data(result.witness),
            "certificate": _certificate_data(result, certificate_path),
            "flowpipe": flowpipe_to_json(result.flowpipe),
            "notes": list(result.notes),
            "options": None if options is None else asdict(options),
            "timings": dict(result.timings),
        }
    )
    return dict(data)


def _reason_data(reason: Reason) -> dict[str, Any]:
    box = reason.largest_box
    return {
        **asdict(reason),
        "largest_box": None if box is None else {state: list(bounds) for state, bounds in box.items()},
    }


def _candidate_data(result: Result, candidate: Any) -> dict[str, Any]:
    states = result.loop.plant.states
    return {
        "requirement": candidate.requirement,
        "time": candidate.time,
        "violation": candidate.violation,
        "initial": dict(zip(states, candidate.initial.tolist(), strict=True)),
        "noise": candidate.noise.tolist(),
        "disturbances": candidate.disturbances.tolist(),
    }


def _witness_data(witness: ProvedWitness) -> dict[str, Any]:
    """What was proved, and the witness itself as its file has it: exact numbers as text."""
    return {
        "grade": witness.grade,
        "depth": witness.depth,
        "radius": witness.radius,
        "precision": witness.precision,
        "file": json.loads(witness.content),
    }


def _certificate_data(result: Result, path: str | None) -> dict[str, Any] | None:
    content = result.certificate
    if content is None:
        return None
    digest = hashlib.sha256(content).hexdigest()
    return {"path": path, "sha256": digest, "bytes": len(content), "leaves": result.leaves}


def flowpipe_to_json(flowpipe: Flowpipe) -> dict[str, Any]:
    """Hull over all cells: bounds at the periods' ends, and between them (null for discrete-time plants)."""
    return {
        "states": list(flowpipe.states),
        "period": flowpipe.period,
        "points": _hull(flowpipe.points),
        "intervals": _hull(flowpipe.intervals),
    }


def _hull(bounds: NDArray[np.float64]) -> dict[str, Any]:
    """Bounds (cells, T, 2, n) as lists (T, n); NaN in any cell is NaN in the hull: there is no bound."""
    if not len(bounds):
        return {"lower": [], "upper": []}
    return {"lower": bounds[:, :, 0].min(axis=0).tolist(), "upper": bounds[:, :, 1].max(axis=0).tolist()}


def json_data(data: Any) -> Any:
    """Plain data without NaN and infinities, which JSON has not: they become null."""
    if isinstance(data, float):
        return data if math.isfinite(data) else None
    if isinstance(data, dict):
        return {key: json_data(entry) for key, entry in data.items()}
    if isinstance(data, list | tuple):
        return [json_data(entry) for entry in data]
    return data


def policy_lines(description: Mapping[str, Any]) -> list[str]:
    """What `models.onnx_reader.describe_policy` found, for people."""
    operators = ", ".join(f"{name} x{count}" if count > 1 else name for name, count in description["operators"].items())
    outputs = "unknown" if description["outputs"] is None else description["outputs"]
    rows = [
        ("file", f"{description['name']}, {description['bytes']} bytes, sha256 {description['digest']}"),
        ("format", f"opset {description['opset']}, {description['precision']}, {description['batch']} batch"),
        ("size", f"{description['inputs']} inputs, {outputs} outputs, {description['parameters']} parameters"),
        ("operators", operators),
        *(("layer" if position else "layers", layer) for position, layer in enumerate(description["layers"])),
        *(("problem", problem) for problem in description["problems"]),
        ("supported", "yes" if description["supported"] else "no"),
    ]
    return table([("" if label == "layer" else label, text) for label, text in rows])


def decided_share(lower: NDArray[np.float64], upper: NDArray[np.float64]) -> float:
    """Volume of cells ``[lower, upper]`` of [-1, 1]^p as a share of the whole."""
    return float(((upper - lower) / 2.0).prod(1).sum())


def search_progress(found: Exploration) -> tuple[float, str]:
    """Decided share of the initial sets, and a phrase, for a progress bar."""
    from .splitting import FAILED, OPEN, PROVED

    problems = int(found.tree.problem.max()) + 1
    leaves = np.isin(found.status, (PROVED, FAILED))
    share = decided_share(found.tree.lower[leaves], found.tree.upper[leaves]) / problems
    waiting, proved = int((found.status == OPEN).sum()), int((found.status == PROVED).sum())
    return share, f"{quantity(proved, 'cell')} proved, {waiting} waiting"
