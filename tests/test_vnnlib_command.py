"""`setrl vnnlib` and the scripts of VNN-COMP: words, exit codes, counterexamples, files."""

from __future__ import annotations

import gzip
import json
import os
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import onnxruntime
import pytest
from command_line import run
from vnnlib_queries import F, Known, deep, linear, planar

from setrl.models.onnx_reader import read_policy
from setrl.specs.vnnlib_reader import parse_vnnlib
from setrl.specs.vnnlib_writer import vnnlib_1_text, vnnlib_2_text
from setrl.verify.open_loop.decide import decide

ROOT = Path(__file__).resolve().parents[1]
SCRIPTS = ROOT / "vnncomp"
ENTRY = re.compile(r"\(([XY])_([0-9]+) (-?[0-9.]+(?:[eE][+-]?[0-9]+)?)\)")


@pytest.fixture
def files(tmp_path: Path) -> Any:
    def write(known: Known, version: int = 1) -> tuple[Path, Path]:
        network, query = tmp_path / "n.onnx", tmp_path / "q.vnnlib"
        network.write_bytes(known.content)
        query.write_text(vnnlib_1_text(known.query) if version == 1 else vnnlib_2_text(known.query))
        return network, query

    return write


def is_counterexample(text: str, known: Known) -> bool:
    """Whether printed numbers are one, read as any other program would: floats in, floats out."""
    assert text.startswith("((X_0 ") and text.endswith("))")
    entries = ENTRY.findall(text)
    assert text == "(" + "\n ".join(f"({k}_{i} {v})" for k, i, v in entries) + ")"
    x = [float(v) for k, _, v in entries if k == "X"]
    y = [float(v) for k, _, v in entries if k == "Y"]
    session = onnxruntime.InferenceSession(known.content, providers=["CPUExecutionProvider"])
    computed = session.run(None, {session.get_inputs()[0].name: np.array([x], dtype=np.float32)})[0][0]
    assert [float(v) for v in computed] == y
    return any(
        all(float(b.lower) <= v <= float(b.upper) for v, b in zip(x, case.box, strict=True))
        and all(
            sum((c * F(x[i]) for i, c in k.inputs), F(0)) + sum((c * F(y[j]) for j, c in k.outputs), F(0)) <= k.bound
            for k in case.constraints
        )
        for case in known.query.cases
    )


@pytest.mark.parametrize("version", [1, 2])
def test_sat_comes_with_a_counterexample_that_others_can_replay(files: Any, capsys: Any, version: int) -> None:
    for seed in range(3):
        known = deep(seed, True)
        network, query = files(known, version)
        outcome = run(capsys, "vnnlib", network, query)
        word, _, text = outcome.out.strip().partition("\n")
        assert (outcome.code, word) == (10, "sat")
        assert is_counterexample(text, known)


def test_unsat_is_one_word_and_exit_code_0(files: Any, capsys: Any) -> None:
    network, query = files(deep(1, False))
    outcome = run(capsys, "vnnlib", network, query)
    assert (outcome.code, outcome.out) == (0, "unsat\n")
    assert "in real or in float32 arithmetic" in outcome.err
    assert run(capsys, "vnnlib", network, query, "-q").err == ""


def test_what_the_cells_or_the_time_do_not_suffice_for_is_exit_code_5(files: Any, capsys: Any) -> None:
    known = hard()
    network, query = files(known)
    outcome = run(capsys, "vnnlib", network, query, "--splits", "1")
    assert (outcome.code, outcome.out) == (5, "unknown\n") and "more splits" in outcome.err
    outcome = run(capsys, "vnnlib", network, query, "--timeout", "0.0001")
    assert (outcome.code, outcome.out) == (5, "timeout\n")


def hard() -> Known:
    """Unsatisfiable, and not to be seen without splitting."""
    queries = (planar(seed, F(-1, 100)) for seed in range(40))
    return next(q for q in queries if decide(read_policy(q.content), q.query, splits=1).word == "unknown")


def test_json_says_for_which_arithmetic_the_answer_holds(files: Any, capsys: Any, tmp_path: Path) -> None:
    known = deep(2, True)
    network, query = files(known)
    witness = tmp_path / "w.txt"
    outcome = run(capsys, "vnnlib", network, query, "--json", "-q", "--witness", witness)
    told = json.loads(outcome.out)
    assert (outcome.code, told["exit_code"], told["answer"]) == (10, 10, "sat")
    assert told["semantics"] == ["real", "float32"]
    assert is_counterexample(witness.read_text().rstrip("\n"), known)
    inputs = [F(x) for x in told["counterexample"]["inputs"]]
    assert all(b.lower <= x <= b.upper for x, b in zip(inputs, known.query.cases[0].box, strict=True))


def test_a_witness_is_written_for_sat_only(files: Any, capsys: Any, tmp_path: Path) -> None:
    network, query = files(deep(1, False))
    run(capsys, "vnnlib", network, query, "--witness", tmp_path / "w.txt")
    assert not (tmp_path / "w.txt").exists()


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("(assert", "never closed"),
        ("(declare-const X_0 Real)(declare-const Y_0 Real)(assert (<= Y_0 0.0))", "input 0 has no lower bound"),
        (
            "(declare-const X_0 Real)(declare-const Y_0 Real)(assert (and (<= X_0 0.0) (>= X_0 0.0) (<= Y_0 0.0)))",
            "the query is about a network with 1 inputs, this one has 3",
        ),
    ],
)
def test_a_bad_query_is_bad_input_and_no_answer(
    files: Any, capsys: Any, tmp_path: Path, text: str, message: str
) -> None:
    network, query = files(deep(1, False))
    query.write_text(text)
    outcome = run(capsys, "vnnlib", network, query)
    assert (outcome.code, outcome.out) == (2, "") and message in outcome.err


def test_missing_files_and_wrong_options_are_bad_input(files: Any, capsys: Any, tmp_path: Path) -> None:
    network, query = files(deep(1, False))
    for arguments in (
        (network, tmp_path / "none.vnnlib"),
        (tmp_path / "none.onnx", query),
        (network, tmp_path),
        (network, query, "--timeout", "0"),
        (network, query, "--splits", "0"),
        (network, query, "--witness", tmp_path / "no" / "w.txt"),
    ):
        outcome = run(capsys, "vnnlib", *arguments)
        assert (outcome.code, outcome.out) == (2, ""), arguments


def script(name: str, *arguments: str | Path) -> subprocess.CompletedProcess[str]:
    environment = os.environ | {"SETRL": f"{sys.executable} -m setrl", "PYTHONPATH": str(ROOT / ".src")}
    command = ["bash", str(SCRIPTS / name), *map(str, arguments)]
    return subprocess.run(command, env=environment, capture_output=True, text=True, timeout=120, check=False)


def test_an_instance_runs_in_the_convention_of_vnn_comp(files: Any, tmp_path: Path) -> None:
    results = tmp_path / "results folder" / "out.txt"
    results.parent.mkdir()
    known = deep(0, True)
    network, query = files(known)
    assert script("prepare_instance.sh", "v1", "cat", network, query).returncode == 0
    assert script("run_instance.sh", "v1", "cat", network, query, results, "60").returncode == 0
    word, _, text = results.read_text().strip().partition("\n")
    assert word == "sat" and is_counterexample(text, known)
    network, query = files(deep(0, False))
    for file in (network, query):
        file.with_name(file.name + ".gz").write_bytes(gzip.compress(file.read_bytes()))
        file.unlink()
    assert script("prepare_instance.sh", "v1", "cat", network, query).returncode == 0
    assert script("run_instance.sh", "v1", "cat", network, query, results, "60").returncode == 0
    assert results.read_text() == "unsat\n"
    assert [path.name for path in results.parent.iterdir()] == ["out.txt"]


def test_an_instance_that_cannot_be_read_is_an_error_and_never_unsat(files: Any, tmp_path: Path) -> None:
    network, query = files(deep(0, False))
    query.write_text(query.read_text()[:-4])
    results = tmp_path / "out.txt"
    assert script("run_instance.sh", "v1", "cat", network, query, results, "60").returncode == 0
    assert results.read_text() == "error\n"
    missing = tmp_path / "none.onnx"
    assert script("prepare_instance.sh", "v1", "cat", missing, query).returncode == 1
    assert script("run_instance.sh", "v2", "cat", network, query, results, "60").returncode == 1
    assert script("run_instance.sh", "v1", "cat", network, query).returncode == 1
    assert script("install_tool.sh", "v0").returncode == 1


def test_what_is_asked_stays_asked_on_the_way_through_a_file(files: Any) -> None:
    known = linear(1, F(1, 1000))
    _, query = files(known)
    assert parse_vnnlib(query.read_bytes()).cases[0].box == known.query.cases[0].box
