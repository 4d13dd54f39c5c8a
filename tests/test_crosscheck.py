"""Claims put to external verifiers: what their answers mean, replayed exactly, and never hidden."""

from __future__ import annotations

import csv
import json
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import EXAMPLE, QUICK, run

from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine
from setrl.specs.queries import Case, LinearConstraint, Query
from setrl.specs.specification import Bounds
from setrl.verify.crosscheck.installed import VARIABLE
from setrl.verify.crosscheck.replay import replay
from setrl.verify.crosscheck.table import Agreement, Entry, exit_code
from setrl.verify.export.folder import Asked, Part, write_export

LAYERS = (
    Affine(np.array([[1.0, -1.0], [2.0, 0.5]]), np.array([0.25, 0.0])),
    Activation("relu"),
    Affine(np.array([[1.0, 1.0]]), np.array([-0.5])),
)
NETWORK = policy_bytes(LAYERS)
BOX = (Bounds(Fraction(-1), Fraction(1)),) * 2
LARGEST = Fraction(13, 4)
"""Of the network over the box, at (1, -1): relu(2.25) + relu(1.5) - 1/2."""


def above(bound: Fraction) -> Query:
    """Some output is at least the bound."""
    constraint = LinearConstraint((), ((0, Fraction(-1)),), -bound)
    return Query((1, 2), (1, 1), (Case(BOX, (constraint,)),), "a test")


TRUE, FALSE = above(LARGEST + 1), above(LARGEST - 1)
"""Violations of a claim that holds, and of one that does not."""


@pytest.mark.parametrize(
    ("query", "witness", "violates"),
    [
        (FALSE, (1.0, -1.0), True),
        (FALSE, (0.0, 0.0), False),
        (TRUE, (1.0, -1.0), False),
        (above(LARGEST), (1.0, -1.0), None),  # the bound itself: the claim holds there
        (above(LARGEST - Fraction(1, 10**30)), (1.0, -1.0), True),
        (above(LARGEST + Fraction(1, 10**30)), (1.0, -1.0), False),
        (FALSE, (1.0 + 1e-9, -1.0 - 1e-9), True),  # printed digits outside of the box are taken back
        (FALSE, (50.0, -50.0), True),  # ... from anywhere: what counts is the box
        (FALSE, (1.0,), None),
        (FALSE, (1.0, float("nan")), None),
        (FALSE, (1.0, float("inf")), None),
    ],
)
def test_a_counterexample_is_replayed_exactly(query: Query, witness: tuple[float, ...], violates: bool | None) -> None:
    found = replay(NETWORK, query, witness)
    assert (found.violates, found.exact) == (violates, True)


def test_any_case_of_a_disjunction_counts_and_all_constraints_of_a_case() -> None:
    high = LinearConstraint((), ((0, Fraction(-1)),), -(LARGEST - 1))
    left = LinearConstraint(((0, Fraction(1)),), (), Fraction(0))
    both, either = Case(BOX, (high, left)), (Case(BOX, (left, high)), Case(BOX, (high,)))
    assert replay(NETWORK, Query((1, 2), (1, 1), (both,)), (1.0, -1.0)).violates is False
    assert replay(NETWORK, Query((1, 2), (1, 1), either), (1.0, -1.0)).violates is True
    assert replay(NETWORK, Query((1, 2), (1, 1), ()), (1.0, -1.0)).violates is False


def entry(kind: Agreement) -> Entry:
    return Entry("q", "t", "", kind, 0.0)


@pytest.mark.parametrize(
    ("kinds", "code"),
    [
        ((), 5),
        ((Agreement.NOT_ASKED,), 5),
        ((Agreement.CONFIRMED,), 0),
        ((Agreement.CONFIRMED, Agreement.NOT_ASKED), 0),
        ((Agreement.CONFIRMED, Agreement.UNDECIDED), 5),
        ((Agreement.CONFIRMED, Agreement.MISTAKEN), 5),
        ((Agreement.CONFIRMED, Agreement.UNDECIDED, Agreement.CONTRADICTED), 6),
    ],
)
def test_the_exit_code_says_the_worst(kinds: tuple[Agreement, ...], code: int) -> None:
    assert exit_code([entry(kind) for kind in kinds]) == code


@pytest.fixture
def tools(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An environment whose programs print what a test writes into `said`; their versions are known."""
    programs = tmp_path / "tools" / "bin"
    programs.mkdir(parents=True)
    answer = tmp_path / "said"
    scripts = {"vibecheck": f"cat {answer}", "Marabou": f"cat {answer}", "python": "echo 9.9"}
    for name, line in scripts.items():
        (programs / name).write_text(f"#!/bin/sh\n{line}\n")
        (programs / name).chmod(0o755)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "tools"))
    monkeypatch.chdir(tmp_path)
    asked = tuple(Asked(name, query, {"kind": "test"}) for name, query in (("true", TRUE), ("false", FALSE)))
    write_export(tmp_path / "export", [Part("n", NETWORK, {"kind": "test"}, asked)], {"setrl": "0"}, "a test\n")
    return answer


SAT = "sat\n((X_0 1.0)\n(X_1 -1.0)\n(Y_0 3.25))\n"
LOST = "sat\n((X_0 0.0)\n(X_1 0.0)\n(Y_0 9.0))\n"


@pytest.mark.parametrize(
    ("said", "code", "kinds"),
    [
        ("unsat\n", 0, ["confirmed", "confirmed"]),
        ("unknown\n", 5, ["undecided", "undecided"]),
        (SAT, 6, ["mistaken", "contradicted"]),
        (LOST, 5, ["mistaken", "mistaken"]),
        ("sat\n", 5, ["undecided", "undecided"]),
        ("boom\n", 5, ["undecided", "undecided"]),
    ],
)
def test_every_answer_is_in_the_table_for_what_it_is(
    tools: Path, capsys: Any, said: str, code: int, kinds: list[str]
) -> None:
    tools.write_text(said)
    outcome = run(capsys, "crosscheck", "--export", "export", "--with", "vibecheck", "--csv", "table.csv")
    assert outcome.code == code, outcome
    rows = list(csv.DictReader(Path("table.csv").read_text(encoding="utf-8").splitlines()))
    assert [row["agreement"] for row in rows] == kinds
    assert {row["version"] for row in rows} == {"vibecheck-nn 9.9"} and {row["claim"] for row in rows} == {"unsat"}
    counts = outcome.out.split(": ")[1]
    assert all(f"{kinds.count(kind)} {kind}" in counts for kind in kinds)


def test_all_installed_tools_are_asked_by_default(tools: Path, capsys: Any) -> None:
    tools.write_text("unsat\n")
    outcome = run(capsys, "crosscheck", "--export", "export", "--json", "-q")
    data = json.loads(outcome.out)
    assert outcome.code == 0 and data["tools"] == {"vibecheck": "vibecheck-nn 9.9", "marabou": "maraboupy 9.9"}
    assert len(data["entries"]) == 4


def test_a_policy_is_verified_exported_and_asked_about_and_json_stays_alone(tools: Path, capsys: Any) -> None:
    tools.write_text("unsat\n")
    Path("quick.yaml").write_text(QUICK)
    arguments = ["crosscheck", EXAMPLE, "--spec", "quick.yaml", "--periods", "0:2", "--with", "marabou", "--json", "-q"]
    outcome = run(capsys, *arguments)
    data = json.loads(outcome.out)
    assert outcome.code == 0 and len(data["entries"]) == 4
    assert {entry["agreement"] for entry in data["entries"]} == {"confirmed"}


def test_a_tool_that_does_not_end_is_a_timeout(tools: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("setrl.verify.crosscheck.ask.MORE_SECONDS", 0.0)
    program = Path("tools/bin/vibecheck")
    program.write_text("#!/bin/sh\nsleep 1000\n")
    from setrl.verify.crosscheck import ask
    from setrl.verify.crosscheck.crosscheck import read_queries

    query = read_queries(Path("export"))[0]
    found = ask.ask(ask.Asked("vibecheck", query, 0.5, 1 << 30))
    assert (found.answer, found.agreement) == ("timeout", Agreement.UNDECIDED)


@pytest.mark.parametrize("change", ["network", "query", "missing", "claims", "nothing"])
def test_an_export_that_was_changed_is_not_asked(tools: Path, capsys: Any, change: str) -> None:
    tools.write_text("unsat\n")
    victim = {"network": "onnx/n.onnx", "query": "vnnlib2/true.vnnlib", "missing": "vnnlib/false.vnnlib"}.get(change)
    if change == "claims":
        Path("export/claims.json").write_text("{}")
    elif change == "missing":
        Path("export/vnnlib/false.vnnlib").unlink()
    elif victim is not None:
        path = Path("export") / victim
        path.write_bytes(path.read_bytes() + b"\n")
    place = "gone" if change == "nothing" else "export"
    outcome = run(capsys, "crosscheck", "--export", place, "--with", "vibecheck")
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome


@pytest.mark.parametrize(
    "arguments",
    [
        ["--export", "export", "--with", "alpha"],
        ["--export", "export", "--timeout", "0"],
        ["--export", "export", "policy.onnx"],
        ["--export", "export", "--csv", "no/such/table.csv"],
        ["--export", "export", "--workers", "0"],
    ],
)
def test_wrong_options_are_one_line(tools: Path, capsys: Any, arguments: list[str]) -> None:
    tools.write_text("unsat\n")
    outcome = run(capsys, "crosscheck", *arguments)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome


def test_without_a_verifier_the_remedy_is_named(tools: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(VARIABLE, "nowhere")
    outcome = run(capsys, "crosscheck", "--export", "export")
    assert outcome.code == 2 and "make verifiers" in outcome.err
