"""`setrl certify` that is killed at any moment: the next run ends as if nothing had happened."""

from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest
from command_line import EXAMPLE, QUICK

from setrl.models.example import shipped_policies
from setrl.verify.checker.certificate_file import MAGIC

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
ROWS = 8
VARIES = ("timings", "seconds", "source")
"""What two runs may differ in: times, and how a run knows a verdict."""


@pytest.fixture(scope="module")
def inputs(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("killed")
    for number in range(ROWS):
        (folder / f"q{number}.yaml").write_text(f"{QUICK}# {number}\n")
    policies = [path for path in shipped_policies() if path.name == "quadrotor1d-point.onnx"]
    (folder / "policy.onnx").write_bytes(EXAMPLE.read_bytes())
    (folder / "point.onnx").write_bytes(policies[0].read_bytes())
    (folder / "certification.yaml").write_text(
        "setrl: 1\ncertify:\n  - {policy: policy.onnx, specification: q*.yaml}\n"
        "  - {policy: point.onnx, specification: quadrotor1d, epsilon: 4, expect: [UNKNOWN, FALSIFIED]}\n"
    )
    return folder


def certify(folder: Path, out: Path) -> subprocess.Popen[bytes]:
    command = [
        sys.executable,
        "-m",
        "setrl",
        "certify",
        "certification.yaml",
        "--out",
        str(out),
        "--workers",
        "2",
        "-q",
    ]
    return subprocess.Popen(command, cwd=folder, env=ENVIRONMENT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE)


def without_times(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: without_times(entry) for key, entry in data.items() if key not in VARIES}
    return [without_times(entry) for entry in data] if isinstance(data, list) else data


def finished(folder: Path, out: Path) -> Any:
    process = certify(folder, out)
    _, err = process.communicate(timeout=240)
    assert process.returncode == 0, err
    return without_times(json.loads((out / "certification.json").read_text(encoding="utf-8")))


@pytest.fixture(scope="module")
def undisturbed(inputs: Path, tmp_path_factory: pytest.TempPathFactory) -> tuple[Any, float]:
    """The report of a run that nobody killed, and how long it took."""
    started = time.monotonic()
    report = finished(inputs, tmp_path_factory.mktemp("undisturbed") / "out")
    return report, time.monotonic() - started


def require_whole_files(out: Path) -> None:
    """Whatever is there is whole: evidence under its final name, JSON that parses, no temporary file that is left."""
    for path in out.rglob("*"):
        if path.suffix == ".cert":
            assert path.read_bytes().startswith(MAGIC)
        if path.suffix in (".json", ".sarif"):
            json.loads(path.read_text(encoding="utf-8"))


def check_killed(inputs: Path, out: Path, undisturbed: tuple[Any, float], generator: random.Random, kills: int) -> None:
    report, seconds = undisturbed
    for _ in range(kills):
        process = certify(inputs, out)
        time.sleep(generator.uniform(0.1, 1.0) * seconds)
        process.send_signal(signal.SIGKILL)
        process.communicate(timeout=60)
        if out.is_dir():
            require_whole_files(out)
    assert finished(inputs, out) == report
    require_whole_files(out)


@pytest.mark.slow
def test_a_killed_run_is_finished_by_the_next_one(inputs: Path, tmp_path: Path, undisturbed: tuple[Any, float]) -> None:
    check_killed(inputs, tmp_path / "out", undisturbed, random.Random(1), 1)


@pytest.mark.slow
@pytest.mark.timeout(900)
@pytest.mark.parametrize("seed", range(5))
@pytest.mark.parametrize("kills", [1, 4])
def test_a_run_that_is_killed_again_and_again_ends_like_one_that_is_not(
    inputs: Path, tmp_path: Path, undisturbed: tuple[Any, float], seed: int, kills: int
) -> None:
    check_killed(inputs, tmp_path / "out", undisturbed, random.Random(100 * kills + seed), kills)
