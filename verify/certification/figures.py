"""From a verification's result to a row's figures."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from ...specs.exact import signed_text
from ..report import distance_text
from ..result import Result, Verdict
from ..runtime_error import runtime_note
from ..wording import number
from .document import Outcome, RadiusFound, RequirementRow, ValueRow, Why
from .reports.picture import picture_of


@dataclass(frozen=True)
class Figures:
    """What a worker found out about a row.

    Attributes
    ----------
    row : dict
        The fields of `document.Row` that the verification decides.
    kind : str
        Of the evidence: "certificate", "witness" or "".
    evidence : bytes
    detail : str
        What the evidence says, in a word.
    """

    row: dict[str, Any]
    kind: str = ""
    evidence: bytes = b""
    detail: str = ""


def figures_of(result: Result) -> Figures:
    """Everything a report says about a result."""
    row: dict[str, Any] = {
        "outcome": Outcome(result.verdict.value),
        "claim": result.claim if result.verdict is Verdict.VERIFIED else "",
        "why": why_of(result),
        "requirements": _requirements(result),
        "value": _value(result),
        "semantics": result.semantics,
        "assumptions": assumptions_of(result),
        "notes": result.notes,
        "cells": result.cells,
        "leaves": result.leaves,
        "picture": picture_of(result),
        "period": float(result.loop.period),
        "horizon": float(result.loop.period * result.loop.periods),
        "timings": dict(result.timings),
    }
    if result.verdict is Verdict.VERIFIED and result.certificate is not None:
        cells = f"{result.leaves} cell{'' if result.leaves == 1 else 's'}"
        return Figures(row, "certificate", result.certificate, cells)
    if result.verdict is Verdict.FALSIFIED and result.witness is not None:
        return Figures(row, "witness", result.witness.content.encode(), result.witness.grade)
    if result.verdict is not Verdict.UNKNOWN:
        raise AssertionError(f"{result.verdict} without its evidence")
    return Figures(row)


def with_radius(figures: Figures, found: RadiusFound) -> Figures:
    """The same, with what a search for the certified radius found."""
    return Figures({**figures.row, "radius": found}, figures.kind, figures.evidence, figures.detail)


def why_of(result: Result) -> Why | None:
    """The reason of a result that is not VERIFIED."""
    reason = result.reason
    if reason is None:
        return None
    stopped = reason.stopped if result.verdict is Verdict.UNKNOWN else ""
    return Why(
        "resource" if stopped else "proof",
        reason.sentence,
        reason.requirement,
        reason.time,
        stopped or reason.source,
        reason.remedy,
        reason.verified_until,
        reason.verified_part,
    )


def assumptions_of(result: Result) -> tuple[str, ...]:
    """What the verdict rests on, a sentence each."""
    loop = result.loop
    plant = loop.plant.description.name
    held = "the plant's map is applied once per period" if loop.plant.discrete else "the action is held in between"
    sentences = [f"The plant is the text of {plant}; the policy acts every {number(loop.period)} s, {held}."]
    radii = dict(zip(loop.observation_names, loop.observation_radius, strict=True))
    if any(radii.values()):
        texts = ", ".join(f"{name} by at most {signed_text(radius)}" for name, radius in radii.items() if radius)
        sentences.append(f"Every observation may be off, afresh in every period: {texts}.")
    else:
        sentences.append("Observations are exact.")
    for name, bound in zip(loop.plant.disturbances, loop.disturbances, strict=True):
        how = "an unknown constant" if bound.constant else "afresh in every period"
        if bound.lower != bound.upper:
            sentences.append(f"Disturbance {name} is in [{number(bound.lower)}, {number(bound.upper)}], {how}.")
    deployed = [name for name in result.semantics if name != "real"]
    if deployed:
        executed = f"as executed in {deployed[0]}, {distance_text(result.deployed_error)}"
        sentences.append(f"The network is taken in exact arithmetic and {executed}.")
        note = runtime_note()
        sentences += [f"{note[0].upper()}{note[1:]}."] if note else []
    else:
        sentences.append("The network is taken in exact arithmetic; its execution in floats is not covered.")
    return tuple(sentences)


def _requirements(result: Result) -> tuple[RequirementRow, ...]:
    with np.errstate(invalid="ignore"):
        # the smallest one over the cover; NaN where no cell has one
        curves = np.fmin.reduce(result.flowpipe.margins, axis=0) if len(result.flowpipe.margins) else None
    return tuple(
        RequirementRow(
            entry.name,
            entry.kind,
            entry.proved,
            finite(entry.margin),
            entry.time,
            entry.line,
            () if curves is None else _shortened(curves[position].tolist()),
        )
        for position, entry in enumerate(result.requirements)
    )


def _shortened(curve: Sequence[float]) -> tuple[float | None, ...]:
    """Six digits are enough for a picture."""
    return tuple(float(f"{value:.6g}") if math.isfinite(value) else None for value in curve)


def _value(result: Result) -> ValueRow | None:
    value = result.value
    return None if value is None else ValueRow(finite(value.discounted), finite(value.undiscounted), value.discount)


def finite(value: float) -> float | None:
    """The number, None where it is not finite."""
    return value if math.isfinite(value) else None
