"""Examples run and end in the verdict that they assert."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLES = sorted((ROOT / "examples").glob("verify_*.py"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.stem)
def test_an_example_ends_with_its_verdict(example: Path, tmp_path: Path) -> None:
    assert "assert " in example.read_text(encoding="utf-8")
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    command = [sys.executable, "-W", "error", str(example), str(tmp_path)]
    outcome = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stderr
    assert "VERIFIED" in outcome.stdout
    assert {path.name for path in tmp_path.iterdir()} == {"flowpipe.png", "sweep.png"}


def test_there_are_examples() -> None:
    assert EXAMPLES


def test_the_hopper_example_trains_any_environment_of_gymnasium() -> None:
    """Pendulum-v1 stands for Hopper, which needs MuJoCo."""
    command = [sys.executable, "-W", "error", str(ROOT / "examples" / "train_hopper.py"), "1", "sa-pc", "Pendulum-v1"]
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    outcome = subprocess.run(command, env=environment, capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stderr
    assert "episode 1: 200 steps" in outcome.stdout
    assert "mad: worst of" in outcome.stdout
