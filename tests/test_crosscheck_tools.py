"""External verifiers are subprocesses with hard limits, and what they print is read as they mean it."""

from __future__ import annotations

import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from setrl.specs.errors import UsageError
from setrl.verify.crosscheck.installed import VARIABLE, package_version, program
from setrl.verify.crosscheck.marabou import Marabou
from setrl.verify.crosscheck.process import run_limited
from setrl.verify.crosscheck.tool import ANSWERS, Ended, QueryFiles
from setrl.verify.crosscheck.vibecheck import Vibecheck

QUERY = QueryFiles("q", Path("n.onnx"), Path("q1.vnnlib"), Path("q2.vnnlib"), ("Gemm", "Relu"), 4)
PYTHON = sys.executable
MEMORY = 1 << 30

VIBECHECK_SAT = """\
sat
X real [1,4]
-1
-1
0.5
-1e-3
Y real [1,2]
15.432038307189941
-5.6098146438598633
"""
VIBECHECK_OLD = """\
sat
((X_0 -1)
(X_1 -1)
(X_2 0.5)
(X_3 -1e-3)
(Y_0 15.432038307189941)
(Y_1 -5.6098146438598633))
"""
MARABOU_SAT = """\
\t--- Proof Certificate ---
\tNumber of leaves to delegate: 0
sat
Input assignment:
\tx0 = 1.000000
\tx1 = -1.000000
\tx2 = 0.999616
\tx3 = -1.000000

Output:
\ty0 = 1.966439
\ty1 = -1.094745
"""
RECORDED = [
    (Vibecheck(), "[vibecheck] verdict: unsat  (2.29s)\nunsat\n", 0, "unsat", ()),
    (Vibecheck(), VIBECHECK_SAT, 1, "sat", (-1.0, -1.0, 0.5, -1e-3)),
    (Vibecheck(), VIBECHECK_OLD, 1, "sat", (-1.0, -1.0, 0.5, -1e-3)),
    (Vibecheck(), "timed-out\n", 2, "timeout", ()),
    (Vibecheck(), "unknown\n", 0, "unknown", ()),
    (Marabou(), "Network: n.onnx\n\nunsat\n", 0, "unsat", ()),
    (Marabou(), MARABOU_SAT, 0, "sat", (1.0, -1.0, 0.999616, -1.0)),
    (Marabou(), "TIMEOUT\n", 0, "timeout", ()),
    (Marabou(), "UNKNOWN\n", 0, "unknown", ()),
]


@pytest.mark.parametrize(("tool", "out", "code", "answer", "witness"), RECORDED)
def test_a_recorded_answer_is_read_as_the_tool_means_it(
    tool: Any, out: str, code: int, answer: str, witness: tuple[float, ...]
) -> None:
    said = tool.interpret(Ended(code, out, "", 1.5), QUERY)
    assert (said.answer, said.witness, said.seconds) == (answer, witness, 1.5)


@pytest.mark.parametrize("tool", [Vibecheck(), Marabou()], ids=lambda tool: tool.name)
@pytest.mark.parametrize(
    "out",
    [
        "",
        "unsat?",
        "not unsat",
        "result: unsat",
        "this is unsat of course\n",
        "Traceback (most recent call last):\nboom",
    ],
)
def test_what_is_no_answer_is_never_taken_for_a_proof(tool: Any, out: str) -> None:
    said = tool.interpret(Ended(1, out, "", 0.1), QUERY)
    assert said.answer == "error" and said.detail
    assert tool.interpret(Ended(139, "unsat\n", "Segmentation fault", 0.1), QUERY).answer == "error"
    assert tool.interpret(Ended(None, "unsat\n" if not out else out, "", 0.1), QUERY).answer == "timeout"


@pytest.mark.parametrize("tool", [Vibecheck(), Marabou()], ids=lambda tool: tool.name)
def test_a_witness_of_another_length_is_no_witness(tool: Any) -> None:
    for out in (VIBECHECK_SAT.replace("0.5\n", ""), VIBECHECK_OLD.replace("(X_2 0.5)\n", ""), "sat\n"):
        assert tool.interpret(Ended(1, out, "", 0.1), QUERY).witness == ()


def test_operators_that_a_tool_does_not_take_are_named() -> None:
    query = QueryFiles("q", Path("n"), Path("a"), Path("b"), ("Gemm", "Sin", "Slice"), 1)
    assert Vibecheck().accepts(query) == "" == Marabou().accepts(QUERY)
    assert Marabou().accepts(query) == "does not take Sin, Slice"


def test_a_program_that_does_not_end_is_killed_with_everything_it_started(tmp_path: Path) -> None:
    script = tmp_path / "forever.sh"
    script.write_text(f"#!/bin/sh\nsleep 1000 &\necho $! > {tmp_path}/child\nsleep 1000\n")
    script.chmod(0o755)
    started = time.monotonic()
    ended = run_limited([str(script)], 1.0, MEMORY)
    assert ended.code is None and time.monotonic() - started < 5.0
    child = int((tmp_path / "child").read_text())
    for _ in range(50):
        state = Path(f"/proc/{child}/stat")
        if not state.exists() or state.read_text().split()[2] == "Z":
            return
        time.sleep(0.1)
    raise AssertionError("a child of the program is still there")


def test_a_program_that_ends_leaves_no_child_behind(tmp_path: Path) -> None:
    script = tmp_path / "leaves.sh"
    script.write_text("#!/bin/sh\nsleep 1000 >/dev/null 2>&1 &\necho $!\n")
    script.chmod(0o755)
    ended = run_limited([str(script)], 10.0, MEMORY)
    assert ended.code == 0
    time.sleep(0.3)
    state = Path(f"/proc/{int(ended.out)}/stat")
    assert not state.exists() or state.read_text().split()[2] == "Z"


def test_a_program_gets_no_more_memory_than_it_may_have() -> None:
    ended = run_limited([PYTHON, "-I", "-c", "b = bytearray(4 * 10**9); print('unsat')"], 30.0, MEMORY)
    assert ended.code != 0 and "unsat" not in ended.out


def test_a_program_runs_in_a_folder_of_its_own_without_the_callers_python(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PYTHONPATH", "/somewhere")
    code = "import os; print(os.getcwd() != %r, os.environ.get('PYTHONPATH'))" % os.getcwd()  # noqa: UP031
    assert run_limited([PYTHON, "-c", code], 30.0, MEMORY).out.strip() == "True None"


def test_answers_are_in_the_words_of_the_competition() -> None:
    assert {answer for _, _, _, answer, _ in RECORDED} <= set(ANSWERS)


def test_a_verifier_that_is_not_installed_is_named_with_the_remedy(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(VARIABLE, str(tmp_path))
    for ask in (lambda: program("vibecheck", "vibecheck-nn"), lambda: package_version("maraboupy"), Marabou().version):
        with pytest.raises(UsageError, match="make verifiers"):
            ask()


def test_versions_are_asked_of_the_environment_of_the_verifiers(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    subprocess.run([PYTHON, "-m", "venv", "--without-pip", str(tmp_path / "v")], check=True)
    monkeypatch.setenv(VARIABLE, str(tmp_path / "v"))
    with pytest.raises(UsageError, match="vibecheck-nn is not installed"):
        Vibecheck().version()
