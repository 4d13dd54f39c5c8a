"""kill -9 at any moment: the resumed run ends with the weights and the files of the undisturbed one, bit for bit."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest
import torch

from setrl.train import checkpoints
from setrl.train.learning_curves import read_curves

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / ".src"), "OMP_NUM_THREADS": "1"}
SHORT = ["--seeds", "2", "--episodes", "24", "--flowpipe", "6", "--algorithm", "sa-sc", "--base", "td3", "--quiet"]
SHORT += ["--set", "hidden=8,6", "--set", "batch=16", "--set", "warmup=16", "--set", "checkpoint_every=4"]
SHORT += ["--set", "validation_every=8", "--set", "flowpipe.pairs=2", "--set", "goal_stop=0.5"]
BOUND = 900.0
"""Seconds for a run that is resumed again and again."""


def command(*arguments: str) -> list[str]:
    return [sys.executable, "-P", "-m", "setrl", "train", *arguments]


def state(run: Path) -> dict[str, torch.Tensor]:
    tensors, _, _ = checkpoints.load(run / "checkpoints")
    return tensors


def require_same(run: Path, undisturbed: Path) -> None:
    found, expected = state(run), state(undisturbed)
    assert found.keys() == expected.keys()
    for name in expected:
        assert torch.equal(found[name], expected[name]), name
    assert (run / "curves.csv").read_bytes() == (undisturbed / "curves.csv").read_bytes()
    assert (run / "flowpipe-1.csv").read_bytes() == (undisturbed / "flowpipe-1.csv").read_bytes()
    for seed in ("seed-0", "seed-1"):
        assert (run / seed / "policy.onnx").read_bytes() == (undisturbed / seed / "policy.onnx").read_bytes()
    assert (run / "policy.onnx").read_bytes() == (undisturbed / "policy.onnx").read_bytes()


def killed_and_resumed(folder: Path, name: str, moments: list[float]) -> tuple[Path, int]:
    """Start a run, kill it after every one of the moments (seconds), resume it to its end; and how often it was hit."""
    run = folder / "runs" / name
    arguments, hit, started = ["--spec", "quadrotor1d", *SHORT, "--name", name], 0, time.monotonic()
    for moment in [*moments, None]:
        process = subprocess.Popen(command(*arguments), cwd=folder, env=ENVIRONMENT, stderr=subprocess.PIPE)
        try:
            process.wait(moment if moment is not None else BOUND)
        except subprocess.TimeoutExpired:
            process.send_signal(signal.SIGKILL)
            hit += 1
        error = process.communicate()[1].decode()
        assert process.returncode in (0, -signal.SIGKILL), error
        assert time.monotonic() - started < BOUND
        if (run / "configuration.json").is_file():
            arguments = ["--resume", str(run), "--quiet"]
        if process.returncode == 0 and moment is None:
            break
    return run, hit


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory) -> tuple[Path, float]:
    folder = tmp_path_factory.mktemp("undisturbed")
    started = time.monotonic()
    subprocess.run(command("--spec", "quadrotor1d", *SHORT, "--name", "whole"), cwd=folder, env=ENVIRONMENT, check=True)
    return folder / "runs" / "whole", time.monotonic() - started


@pytest.mark.slow
@pytest.mark.timeout(1000)
@pytest.mark.parametrize("number", range(10))
def test_a_killed_run_ends_like_the_undisturbed_one(undisturbed, tmp_path, number):
    """Two moments each, twenty in all; uniform over the time that the undisturbed run took."""
    whole, seconds = undisturbed
    moments = np.random.default_rng(number).uniform(0.0, 1.0, size=2) * seconds
    run, _ = killed_and_resumed(tmp_path, "killed", moments.tolist())
    require_same(run, whole)


@pytest.mark.slow
def test_an_interrupted_run_says_how_to_go_on(undisturbed, tmp_path):
    whole, _ = undisturbed
    loud = [argument for argument in SHORT if argument != "--quiet"]
    arguments = command("--spec", "quadrotor1d", *loud, "--name", "stopped")
    process = subprocess.Popen(arguments, cwd=tmp_path, env=ENVIRONMENT, stderr=subprocess.PIPE, text=True)
    run = tmp_path / "runs" / "stopped"
    while not (run / "checkpoints").is_dir() and process.poll() is None:
        time.sleep(0.05)
    process.send_signal(signal.SIGINT)
    error = process.communicate(timeout=BOUND)[1]
    assert process.returncode == 130, error
    assert f"setrl train --resume {run.relative_to(tmp_path)}" in error
    subprocess.run(command("--resume", str(run), "--quiet"), cwd=tmp_path, env=ENVIRONMENT, check=True)
    require_same(run, whole)
    assert len(read_curves(run / "curves.csv").numbers) == 24
