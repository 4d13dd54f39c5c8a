"""Reports for the tests of the report formats: rows of real results, and made-up ones of every kind."""

from __future__ import annotations

import hashlib
import math
from dataclasses import replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

import setrl
from setrl.models.example import POLICIES
from setrl.verify.certification.document import (
    Baseline,
    Change,
    Evidence,
    Outcome,
    RadiusFound,
    Report,
    RequirementRow,
    Row,
    Source,
    Subject,
    ValueRow,
    Why,
)
from setrl.verify.certification.reports.picture import picture_of
from setrl.verify.result import Result
from setrl.verify.wording import quantity

HOSTILE = (
    "<script>alert(1)</script>.onnx",
    "]]>",
    "--><img src=x onerror=alert(1)>",
    "a|b\\|c`d``e\n# heading\n\n| x | y |\n|---|---|",
    "](javascript:alert(1))",
    "![x](http://example.org/x.png) https://example.org www.example.org <http://example.org>",
    "- item",
    "1. item",
    "=cmd()|' /C calc'!A0",
    "+1",
    "-1",
    "@SUM(A1)",
    "\t=1",
    "\"quoted\" 'quoted' &amp; &lt;",
    "\u202egnp.\u2066exe\u200b\ufeff",
    "\x00\x07\x1b[31mred\x7f\ufffe\uffff",
    "\udc80 lone surrogate",
    "long " * 1000,
    "{{ x }} ${x} #1 @user ~~x~~ **x** $x$",
    "ε × 策略 🤖",
)
"""Texts that a file may contain and no format may take for its own signs."""


def sha(text: str) -> str:
    return hashlib.sha256(text.encode("utf-8", "surrogatepass")).hexdigest()


def subject(name: str) -> Subject:
    return Subject(name, sha(name))


def finite(value: float | None) -> float | None:
    return value if value is not None and math.isfinite(value) else None


def curves(result: Result) -> list[tuple[float | None, ...]]:
    """Smallest margin over the cells, per requirement and control period."""
    lowest = np.fmin.reduce(result.flowpipe.margins, axis=0)
    return [tuple(finite(margin) for margin in row) for row in lowest.tolist()]


def row_of(result: Result, policy: str, specification: str, epsilon: str | None = None, **more: Any) -> Row:
    """A row of a real result, judged as a manifest that expects VERIFIED does."""
    outcome, reason, value = Outcome(result.verdict.value), result.reason, result.value
    why = None
    if reason is not None:
        why = Why(
            "proof",
            reason.sentence,
            reason.requirement,
            reason.time,
            reason.source,
            reason.remedy,
            reason.verified_until,
            reason.verified_part,
        )
    evidence = None
    if result.certificate is not None or result.witness is not None:
        kind = "certificate" if result.witness is None else "witness"
        content = result.certificate or b"" if result.witness is None else result.witness.content.encode()
        detail = f"{quantity(result.leaves, 'cell')} proved again" if result.witness is None else result.witness.grade
        name = f"evidence/{Path(policy).stem}-{specification}-{epsilon or 'own'}.{kind[:4]}"
        evidence = Evidence(kind, name, hashlib.sha256(content).hexdigest(), len(content), detail)
    passed = outcome is Outcome.VERIFIED
    loop = result.loop
    row = Row(
        name=f"{policy} x {specification}" + ("" if epsilon is None else f" @ {epsilon}"),
        key=sha(policy + specification + str(epsilon)),
        policy=Subject(policy, loop.policy.digest),
        specification=Subject(specification, loop.specification.digest),
        plant=subject("") if not loop.plant.description.name else subject(loop.plant.description.name),
        epsilon=epsilon,
        outcome=outcome,
        passed=passed,
        exit_code=0 if passed else outcome.exit_code,
        objections=() if passed else (f"{outcome.value} is not allowed",),
        claim=result.claim if passed else "",
        why=why,
        requirements=tuple(
            RequirementRow(e.name, e.kind, e.proved, finite(e.margin), finite(e.time), e.line, curve)
            for e, curve in zip(result.requirements, curves(result), strict=True)
        ),
        value=None if value is None else ValueRow(finite(value.discounted), finite(value.undiscounted), value.discount),
        semantics=result.semantics,
        assumptions=("the plant's equations hold exactly", "IEEE 754 arithmetic of the checker's integers"),
        notes=result.notes,
        cells=result.cells,
        leaves=result.leaves,
        evidence=evidence,
        picture=picture_of(result),
        period=float(loop.period),
        horizon=float(loop.period * loop.periods),
        timings={**result.timings, "total": sum(result.timings.values())},
    )
    return replace(row, **more)


@cache
def real(policy: str, specification: str, epsilon: str | None = None) -> Result:
    """A verification run of a shipped policy, once per process."""
    found: Result = setrl.verify(POLICIES / f"{policy}.onnx", specification, epsilon=epsilon)
    return found


def real_row(policy: str, specification: str, epsilon: str | None = None, **more: Any) -> Row:
    return row_of(real(policy, specification, epsilon), f"policies/{policy}.onnx", specification, epsilon, **more)


def made_up(name: str, outcome: Outcome, /, **more: Any) -> Row:
    """A row of which everything is invented."""
    passed = outcome is Outcome.VERIFIED
    proved = outcome is Outcome.VERIFIED
    requirement = RequirementRow("altitude", "stay", proved, 0.5 if proved else -0.25, 1.25, 23, (0.75, 0.5, None, 0.6))
    broken = outcome in (Outcome.ERROR, Outcome.INTERNAL)
    kinds = {Outcome.ERROR: "input", Outcome.INTERNAL: "internal"}
    why = Why(
        kinds.get(outcome, "proof"),
        f"`altitude` could not be proved at 1.25 s ({outcome.value})",
        "" if broken else "altitude",
        1.25,
        "network",
        "try more splits: --splits 64",
        0.5,
        0.25,
    )
    row = Row(
        name=f"{name} x hover.yaml @ 0.1",
        key=sha(name),
        policy=subject(name),
        specification=subject("specs/hover.yaml"),
        plant=subject("quadrotor1d"),
        epsilon="0.1",
        outcome=outcome,
        passed=passed,
        exit_code=0 if passed else outcome.exit_code,
        objections=() if passed else (f"{outcome.value} is not allowed",),
        claim="no trajectory of plant quadrotor1d leaves `altitude` within 3 s" if passed else "",
        why=None if passed else why,
        requirements=() if broken else (requirement,),
        value=None if broken else ValueRow(-12.5, -13.75, 0.99),
        semantics=("real", "float32"),
        assumptions=("the plant's equations hold exactly",),
        notes=("a note",),
        cells=0 if broken else 3,
        leaves=0 if broken else 2,
        evidence=Evidence("certificate", f"evidence/{name}.cert", sha("c"), 20_500, "2 cells") if passed else None,
        period=0.0 if broken else 0.1,
        horizon=0.0 if broken else 3.0,
        timings={"load": 0.01, "reachability": 1.5, "total": 1.51},
    )
    return replace(row, **more)


def report_of(*rows: Row, baseline: Baseline | None = None) -> Report:
    versions = {"setrl": "0.1.0", "python": "3.12.3", "numpy": "2.1.0", "onnxruntime": "1.26.0"}
    worst = max((row.exit_code for row in rows), default=2)
    return Report(subject("fleet.yaml"), versions, rows, worst, baseline, 12.5)


def every_outcome() -> Report:
    """One row of each kind, changes against a baseline, a search, an expected violation, an allowed UNKNOWN."""
    verified = made_up("good.onnx", Outcome.VERIFIED)
    found = RadiusFound(
        "0.2", "0.8", "0.05", (("0.1", "VERIFIED"), ("0.2", "VERIFIED"), ("0.4", "UNKNOWN"), ("0.8", "FALSIFIED"))
    )
    rows = (
        verified,
        made_up("allowed.onnx", Outcome.UNKNOWN, passed=True, exit_code=0, objections=(), allow_unknown=True),
        made_up("unknown.onnx", Outcome.UNKNOWN),
        made_up("wrong.onnx", Outcome.FALSIFIED),
        made_up("expected.onnx", Outcome.FALSIFIED, passed=True, exit_code=0, objections=(), expected=("FALSIFIED",)),
        made_up("missing.onnx", Outcome.ERROR),
        made_up("crash.onnx", Outcome.INTERNAL),
        made_up("search.onnx", Outcome.VERIFIED, search=True, epsilon=None, radius=found, source=Source.RECHECKED),
        made_up("reward.onnx", Outcome.VERIFIED, requirements=(), source=Source.JOURNAL),
        made_up(
            "worse.onnx",
            Outcome.VERIFIED,
            passed=False,
            exit_code=5,
            objections=("V(s0) >= -10 is required, -12.5 is proved", "V(s0) fell from -9.5 to -12.5"),
            change=Change(value=(-9.5, -12.5), margin=(0.6, 0.5), regressions=("V(s0) fell by 3",)),
        ),
        made_up("better.onnx", Outcome.VERIFIED, change=Change(verdict=("UNKNOWN", "VERIFIED"), radius=(None, "0.1"))),
        made_up("unchanged.onnx", Outcome.VERIFIED, change=Change()),
    )
    base = Baseline(
        "main/certification.json", sha("base"), "0.01", ("gone.onnx x hover.yaml",), ("good.onnx x hover.yaml",)
    )
    return report_of(*rows, baseline=base)


def hostile(text: str) -> Report:
    """A report in which every string that a file can determine is the given text."""
    requirement = RequirementRow(text, "avoid", False, -1.0, 0.5, 3, (1.0, -1.0))
    named = Subject(text, sha("x"))
    rows = [
        made_up(
            f"p{number}.onnx",
            outcome,
            name=f"{number} {text}",
            policy=named,
            specification=named,
            plant=named,
            epsilon=text,
            claim=text,
            why=Why("proof", text, text, 0.5, text, text),
            requirements=(requirement,),
            semantics=(text,),
            assumptions=(text,),
            notes=(text,),
            objections=(text,),
            expected=(text,),
            evidence=Evidence("witness", text, sha("w"), 10, text),
            options={text: text},
            picture=hostile_picture(text),
            radius=RadiusFound(text, text, text, ((text, text), ("0.1", text))) if number % 2 else None,
            search=bool(number % 2),
            change=Change(verdict=(text, text), radius=(text, text), regressions=(text,)),
        )
        for number, outcome in enumerate(Outcome)
    ]
    base = Baseline(text, text, text, (text,), (text,))
    return Report(Subject(text, text), {text: text, "setrl": text}, tuple(rows), 10, base, 1.0)


def hostile_picture(text: str) -> dict[str, Any]:
    corners = [[0.0, 0.0], [1.0, 0.0], [1.0, 1.0]]
    region = {"kind": "avoid", "name": text, "window": text, "shadow": True, "polygons": [corners]}
    return {
        "kind": "plane",
        "axes": [{"name": text, "unit": text}, {"name": text, "unit": text}],
        "equal": True,
        "view": [[0.0, 1.0], [0.0, 1.0]],
        "regions": [region],
        "boxes": [[0.1, 0.1, 0.2, 0.2]],
        "points": [],
        "initial": [0.1, 0.1, 0.2, 0.2],
        "clock": [[1.0, 0.5, 0.5]],
        "witness": None,
        "truncated_at": None,
        "cells": 1,
    }


def many(count: int) -> Report:
    """A large batch, of which every tenth row does not pass."""
    outcomes = (Outcome.UNKNOWN, Outcome.FALSIFIED)
    rows = [
        made_up(f"fleet/policy-{number:04}.onnx", outcomes[number // 10 % 2] if number % 10 == 9 else Outcome.VERIFIED)
        for number in range(count)
    ]
    return report_of(*rows)
