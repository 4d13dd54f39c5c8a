"""Real external verifiers confirm what is claimed, and catch a claim that is wrong. Run where they are installed."""

from __future__ import annotations

import json
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
from command_line import run

from setrl.specs.errors import UsageError
from setrl.specs.queries import LinearConstraint
from setrl.specs.vnnlib_reader import parse_vnnlib
from setrl.verify.crosscheck.ask import TOOLS
from setrl.verify.export.folder import Asked, Part, write_export


def installed(name: str) -> bool:
    try:
        return bool(TOOLS[name]().version())
    except UsageError:
        return False


tools = pytest.mark.parametrize(
    "tool",
    [
        pytest.param(name, marks=pytest.mark.skipif(not installed(name), reason=f"{name}: make verifiers installs it"))
        for name in TOOLS
    ],
)


@pytest.fixture(scope="module")
def export(nav_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The claims of one period of NAV's set-trained policy."""
    from setrl.commands.export import export as write

    place = tmp_path_factory.mktemp("queries") / "export"
    policy = nav_folder / "nn-nav-set.onnx"
    assert write(policy=policy, spec="nav", out=place, periods="5:6", quiet=True) == 0
    return place


def planted(export: Path, place: Path, share: float) -> None:
    """The claim of an upper bound, moved inward to what a share of the recorded actions exceeds."""
    data = json.loads((export / "claims.json").read_text(encoding="utf-8"))
    entry = next(entry for entry in data["queries"] if entry["query"].endswith("output0-upper"))
    content = (export / entry["onnx"]).read_bytes()
    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    query = parse_vnnlib((export / entry["vnnlib"]).read_bytes())
    points = np.random.default_rng(0).uniform(-1.0, 1.0, (512, *query.inputs[1:])).astype(np.float32)
    name = session.get_inputs()[0].name
    recorded = np.sort([session.run(None, {name: point[None]})[0].ravel()[0] for point in points])
    bound = Fraction(float(recorded[int(share * len(recorded))]))
    (case,) = query.cases
    wrong = LinearConstraint((), ((0, Fraction(-1)),), -bound)
    asked = Asked("planted", replace(query, cases=(replace(case, constraints=(wrong,)),)), {"kind": "test"})
    write_export(place, [Part("n", content, {"kind": "test"}, (asked,))], {"setrl": "0"}, "a planted claim\n")


@tools
@pytest.mark.slow
def test_a_true_claim_is_confirmed(export: Path, capsys: Any, tool: str) -> None:
    outcome = run(capsys, "crosscheck", "--export", export, "--with", tool)
    assert outcome.code == 0 and "4 confirmed of 4" in outcome.out, outcome


@tools
@pytest.mark.slow
@pytest.mark.parametrize("share", [0.5, 0.98])
def test_a_wrong_claim_is_caught_and_its_counterexample_replays(
    export: Path, tmp_path: Path, capsys: Any, tool: str, share: float
) -> None:
    planted(export, tmp_path / "planted", share)
    outcome = run(capsys, "crosscheck", "--export", tmp_path / "planted", "--with", tool)
    assert outcome.code == 6 and "1 contradicted of 1" in outcome.out, outcome
    assert "exact arithmetic" in outcome.err
