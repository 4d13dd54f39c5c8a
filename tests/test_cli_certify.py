"""`setrl certify` as it is typed: reports, exit codes, the journal, and workers that are lost."""

from __future__ import annotations

import json
import os
import signal
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest
from command_line import EXAMPLE, HOPELESS, QUICK, contents, run

from setrl.specs.manifest import read_manifest
from setrl.verify.certification import batch
from setrl.verify.certification.certify import certify
from setrl.verify.certification.document import Outcome, Source, report_from_json
from setrl.verify.executors.local import LocalExecutor
from setrl.verify.executors.task import Task

ROOT = Path(__file__).resolve().parents[1]
VIOLATED = QUICK.replace("stay: {z: [-1, 1]}", "stay: {z: [-0.05, 0.05]}")
REPORTS = {
    "certification.json",
    "junit.xml",
    "certification.sarif",
    "summary.md",
    "index.html",
    "results.csv",
    "journal.jsonl",
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with three specifications and one policy, the current one."""
    (tmp_path / "quick.yaml").write_text(QUICK)
    (tmp_path / "hopeless.yaml").write_text(HOPELESS)
    (tmp_path / "violated.yaml").write_text(VIOLATED)
    (tmp_path / "broken.yaml").write_text("setrl: 1\nplant: nothing\n")
    (tmp_path / "policy.onnx").write_bytes(EXAMPLE.read_bytes())
    (tmp_path / "broken.onnx").write_bytes(b"this is no network")
    monkeypatch.chdir(tmp_path)
    return tmp_path


def write(text: str, name: str = "certification.yaml") -> Path:
    path = Path(name)
    path.write_text(f"setrl: 1\n{text}")
    return path


def entry(policy: str = "policy.onnx", specification: str = "quick.yaml", more: str = "") -> str:
    return f"  - {{policy: {policy}, specification: {specification}{more}}}\n"


def report() -> Any:
    return report_from_json(json.loads(Path("certification/certification.json").read_text(encoding="utf-8")))


@pytest.mark.parametrize(
    ("rows", "code", "word"),
    [
        (entry(), 0, "1 of 1 rows pass: 1 VERIFIED"),
        (entry() + entry(specification="hopeless.yaml", more=", options: {splits: 1}"), 5, "1 of 2 rows pass"),
        (entry(specification="hopeless.yaml", more=", options: {splits: 1}, allow_unknown: true"), 0, "1 UNKNOWN"),
        (entry() + entry(specification="violated.yaml"), 10, "1 FALSIFIED"),
        (entry(specification="violated.yaml", more=", expect: FALSIFIED"), 0, "1 FALSIFIED"),
        (entry(specification="violated.yaml") + entry("broken.onnx"), 2, "1 ERROR"),
        (entry(specification="[quick.yaml, broken.yaml]"), 2, "1 ERROR"),
        (entry(more=", require: {value: 1}"), 5, "1 VERIFIED"),
        (entry(more=", expect: UNKNOWN"), 5, "1 VERIFIED"),
    ],
    ids=["verified", "unknown", "allowed", "falsified", "expected", "no policy", "no specification", "floor", "better"],
)
def test_the_exit_code_is_that_of_the_worst_row(folder: Path, capsys: Any, rows: str, code: int, word: str) -> None:
    outcome = run(capsys, "certify", write(f"certify:\n{rows}"), "--workers", "1")
    assert (outcome.code, word in outcome.out.splitlines()[-1]) == (code, True), outcome
    assert set(contents(Path("certification"))) >= REPORTS
    assert report().exit_code == code


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("certify: []\n", ("certify", "at least one")),
        ("", ("certify", "missing")),
        (f"certify:\n{entry('policies/*.onnx')}", ("certification.yaml:3", "no policy matches")),
        (f"certify:\n{entry('gone.onnx')}", ("certification.yaml:3", "does not exist")),
        (f"certify:\n{entry(specification='gone.yaml')}", ("certification.yaml:3", "does not exist")),
        (f"certify:\n{entry()}{entry()}", ("certification.yaml:4", "appears twice")),
        (f"certify:\n{entry(more=', timeout: 0')}", ("timeout", "greater than 0")),
        (f"certify:\n{entry(more=', memory: 3')}", ("memory", "2 GiB")),
        (f"certify:\n{entry(more=', epsilon: [0.1, 0.10]')}", ("epsilon", "twice")),
        (f"certify:\n{entry(more=', epsilom: 0.1')}", ("epsilom", "did you mean")),
    ],
    ids=["empty", "nothing", "glob", "policy", "specification", "twice", "timeout", "memory", "radius", "key"],
)
def test_a_wrong_manifest_is_one_line_and_nothing_is_written(
    folder: Path, capsys: Any, text: str, words: tuple[str, ...]
) -> None:
    path = write(text)
    before = contents(folder)
    outcome = run(capsys, "certify", path)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1)
    assert all(word in outcome.err for word in words), outcome.err
    assert contents(folder) == before


@pytest.mark.parametrize(
    "arguments",
    [
        ["--recheck", "--no-cache"],
        ["--tolerance", "0.1"],
        ["--baseline", "gone.json"],
        ["--baseline", "quick.yaml"],
        ["--workers", "0"],
        ["--spread", "0"],
        ["--executor", "threads"],
        ["--out", "quick.yaml"],
    ],
    ids=lambda given: given[0] + given[-1],
)
def test_wrong_options_are_one_line_and_nothing_is_written(folder: Path, capsys: Any, arguments: list[str]) -> None:
    path = write(f"certify:\n{entry()}")
    before = contents(folder)
    outcome = run(capsys, "certify", path, *arguments)
    assert (outcome.code, outcome.out, outcome.err.count("\n")) == (2, "", 1), outcome
    assert contents(folder) == before


def test_unchanged_rows_keep_their_verdict_until_something_changes(folder: Path, capsys: Any) -> None:
    path = write(f"certify:\n{entry(more=', epsilon: [0, 0.01]')}")
    assert run(capsys, "certify", path, "--workers", "1").code == 0
    first = report()
    assert run(capsys, "certify", path, "--workers", "1").code == 0
    again = report()
    assert {row.source for row in first.rows} == {Source.DECIDED}
    assert {row.source for row in again.rows} == {Source.JOURNAL}
    assert [replace(row, source=Source.DECIDED) for row in again.rows] == list(first.rows)
    assert run(capsys, "certify", path, "--workers", "1", "--recheck").code == 0
    assert {row.source for row in report().rows} == {Source.RECHECKED}
    assert run(capsys, "certify", path, "--workers", "1", "--no-cache").code == 0
    assert {row.source for row in report().rows} == {Source.DECIDED}
    (folder / "quick.yaml").write_text(QUICK + "# another byte\n")
    assert run(capsys, "certify", path, "--workers", "1").code == 0
    assert {row.source for row in report().rows} == {Source.DECIDED}


def test_certificates_and_witnesses_of_a_batch_are_accepted_by_the_checker(folder: Path, capsys: Any) -> None:
    run(capsys, "certify", write(f"certify:\n{entry(specification='[quick.yaml, violated.yaml]')}"), "--workers", "1")
    for row in report().rows:
        evidence = Path("certification") / row.evidence.path
        assert run(capsys, "check", evidence, "policy.onnx", row.specification.name).code == 0


def test_what_got_worse_than_the_baseline_fails(folder: Path, capsys: Any) -> None:
    path = write(f"certify:\n{entry()}")
    assert run(capsys, "certify", path, "--workers", "1", "--quiet").code == 0
    before = Path("certification/certification.json").read_bytes()
    Path("before.json").write_bytes(before)
    (folder / "quick.yaml").write_text(QUICK.replace("stay: {z: [-1, 1]}", "stay: {z: [-0.9, 0.9]}"))
    outcome = run(capsys, "certify", path, "--workers", "1", "--baseline", "before.json")
    assert outcome.code == 5 and "the margin was" in outcome.out
    assert run(capsys, "certify", path, "--workers", "1", "--baseline", "before.json", "--tolerance", "0.2").code == 0
    assert report().baseline.tolerance == "0.2" and report().rows[0].change.margin is not None


def test_json_on_stdout_is_the_report(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "certify", write(f"certify:\n{entry()}"), "--json", "--quiet", "--workers", "1")
    assert outcome.err == ""
    assert report_from_json(json.loads(outcome.out)) == report()


class Sabotaged(LocalExecutor):
    """Some rows do something else in their worker."""

    def __init__(self, workers: int, sabotage: dict[str, tuple[str, Any]]) -> None:
        super().__init__(workers, path=[str(ROOT / "tests")])
        self.sabotage = sabotage

    def submit(self, task: Task) -> int:
        for name, (function, argument) in self.sabotage.items():
            if task.name.startswith(name):
                task = replace(task, function=f"executor_tasks:{function}", argument=argument)
        return super().submit(task)


def test_lost_workers_make_their_rows_unknown_and_touch_no_other(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(batch, "HARD_LIMIT", (1.0, 1.0))
    sabotage = {
        "memory": ("hold", 100_000),
        "forever": ("sleep", 1000.0),
        "killed": ("killed", int(signal.SIGSEGV)),
    }
    names = ["first", "memory", "second", "forever", "third", "killed", "fourth"]
    for name in names:
        (folder / f"{name}.onnx").write_bytes(EXAMPLE.read_bytes())
        (folder / f"{name}.yaml").write_text(f"{QUICK}# {name}\n")  # a question of its own
    rows = "".join(
        entry(f"{name}.onnx", f"{name}.yaml", f", memory: 1 GiB, timeout: {1 if name == 'forever' else 30}")
        for name in names
    )
    manifest = read_manifest(write(f"certify:\n{rows}"))
    found = certify(manifest, folder / "out", Sabotaged(2, sabotage))
    assert found is not None
    for name, row in zip(names, found.rows, strict=True):
        if name not in sabotage:
            assert row.outcome is Outcome.VERIFIED and row.passed, row
            continue
        assert row.outcome is Outcome.UNKNOWN and not row.passed and row.why is not None
        assert row.why.kind == "resource"
    sentences = {row.policy.name: row.why.sentence for row in found.rows if row.why is not None}
    assert "needed more than 1.0 GiB of memory" in sentences["memory.onnx"]
    assert "did not end within" in sentences["forever.onnx"]
    assert "SIGSEGV" in sentences["killed.onnx"]
    # whole again: what was limited keeps its word, what was lost is tried again
    again = certify(manifest, folder / "out", LocalExecutor(2))
    assert again is not None
    assert [row.source is Source.DECIDED for row in again.rows] == [name == "killed" for name in names]
    assert {row.policy.name for row in again.rows if not row.passed} == {"memory.onnx", "forever.onnx"}


def test_ctrl_c_stops_and_the_next_run_goes_on(folder: Path, tmp_path: Path) -> None:
    for number in range(12):
        (folder / f"q{number:02}.yaml").write_text(f"{QUICK}# {number}\n")
    write(f"certify:\n{entry(specification='q*.yaml')}")
    command = [sys.executable, "-m", "setrl", "certify", "certification.yaml", "--workers", "1"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    process = subprocess.Popen(command, stderr=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=environment)
    assert process.stderr is not None
    for line in process.stderr:
        if line.startswith("[ 3/"):
            process.send_signal(signal.SIGINT)
            break
    started = time.monotonic()
    out, err = process.communicate(timeout=60)
    assert process.returncode == 130 and out == "" and "go on with: setrl certify certification.yaml" in err
    assert time.monotonic() - started < 20.0
    assert set(contents(folder / "certification")).isdisjoint(REPORTS - {"journal.jsonl"})
    again = subprocess.run(command, capture_output=True, text=True, env=environment)
    assert again.returncode == 0, again.stderr
    sources = [row.source for row in report().rows]
    assert sources.count(Source.JOURNAL) >= 3 and sources.count(Source.DECIDED) >= 1
