"""`setrl train` and `setrl evaluate` from the command line: what they leave, and that it is what they say."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest
import torch
from command_line import QUICK, contents, run

from setrl.models.onnx_reader import read_policy
from setrl.train import checkpoints
from setrl.train.launch import evaluate_run
from setrl.train.learning_curves import read_curves
from setrl.train.networks import Layout, forward

torch.set_num_threads(1)

SHORT = ["--seeds", "2", "--episodes", "12", "--set", "hidden=8,6", "--set", "batch=16", "--set", "warmup=16"]
SHORT += ["--set", "validation_every=4", "--set", "checkpoint_every=5"]


@pytest.fixture(scope="module")
def trained(tmp_path_factory) -> Path:
    """A folder with a specification and a finished run."""
    folder = tmp_path_factory.mktemp("trained")
    (folder / "spec.yaml").write_text(QUICK)
    return folder


@pytest.fixture
def folder(trained, monkeypatch, capsys) -> Path:
    monkeypatch.chdir(trained)
    if not (trained / "runs").is_dir():
        found = run(capsys, "train", "--spec", "spec.yaml", "--algorithm", "sa-sc", *SHORT, "--name", "one")
        assert found.code == 0, found.err
        assert "runs/one/policy.onnx" in found.out
        assert "<- policy.onnx" in found.out
    return trained


def test_a_run_leaves_its_policies_with_reports_curves_and_events(folder):
    left = contents(folder / "runs" / "one")
    for name in ("policy.onnx", "summary.json", "configuration.json", "curves.csv", "curves.png", "inputs/spec.yaml"):
        assert left[name], name
    assert any(name.startswith("events/") for name in left)
    for seed in ("seed-0", "seed-1"):
        assert {f"{seed}/{name}" for name in ("policy.onnx", "report.txt", "report.json")} <= left.keys()
    summary = json.loads(left["summary.json"])
    best = f"seed-{summary['best_seed']}"
    assert left["policy.onnx"] == left[f"{best}/policy.onnx"]
    curves = read_curves(folder / "runs" / "one" / "curves.csv")
    assert curves.numbers.tolist() == list(range(1, 13))
    values = curves.columns["value"]
    assert np.isfinite(values[[3, 7, 11]]).all() and np.isnan(np.delete(values, [3, 7, 11], 0)).all()


def test_the_exported_policy_is_the_best_one_of_the_checkpoint(folder):
    place = folder / "runs" / "one"
    tensors, numbers, _ = checkpoints.load(place / "checkpoints")
    curves = read_curves(place / "curves.csv")
    layout, x = Layout((2, 8, 6, 1), True), np.random.default_rng(0).normal(size=(2, 50, 2))
    expected = forward(layout, tensors["best.actor"].double(), torch.from_numpy(x)).numpy()
    for seed in (0, 1):
        policy = read_policy(str(place / f"seed-{seed}" / "policy.onnx"))
        assert np.abs(policy(x[seed]) - expected[seed]).max() < 1e-6
        assert numbers["best"][seed][0] == np.nanmax(curves.columns["value"][:, seed])


def test_a_trained_policy_verifies_as_its_report_says(folder, capsys):
    report = json.loads((folder / "runs" / "one" / "seed-0" / "report.json").read_text())
    found = run(capsys, "verify", "runs/one/seed-0/policy.onnx", "--spec", "spec.yaml", "--no-certificate", "--json")
    assert json.loads(found.out)["verdict"] == report["verdict"]


def test_a_run_can_begin_with_anothers_policies(folder, capsys):
    before = contents(folder / "runs" / "one")
    arguments = ["--from", "runs/one", "--flowpipe", "2", "--set", "flowpipe.pairs=2", "--name", "two", "--quiet"]
    found = run(capsys, "train", "--spec", "spec.yaml", *arguments)
    assert found.code == 0, found.err
    assert contents(folder / "runs" / "one") == before
    first, second = (json.loads((folder / "runs" / name / "summary.json").read_text()) for name in ("one", "two"))
    for seed in ("0", "1"):  # what it began with is the least that it ends with
        assert second["all_values"][seed] >= first["all_values"][seed]
    refused = run(capsys, "train", "--spec", "spec.yaml", "--from", "runs/one", "--set", "hidden=4", "--name", "three")
    assert refused.code == 2 and "hidden" in refused.err


def test_until_verified_ends_with_the_verdicts_exit_code(folder, capsys):
    arguments = ["--episodes", "1", "--set", "hidden=8,6", "--set", "flowpipe.pairs=2", "--until-verified"]
    found = run(capsys, "train", "--spec", "spec.yaml", *arguments, "--name", "until", "--quiet", "--json")
    data = json.loads(found.out)
    assert found.code == 0, found.err
    assert data["seeds"][str(data["best_seed"])]["verdict"] == "VERIFIED"


def test_a_finished_run_that_is_resumed_stays_as_it_is(folder, capsys):
    place = folder / "runs" / "one"
    before = {name: (place / name).read_bytes() for name in ("policy.onnx", "curves.csv", "seed-1/policy.onnx")}
    assert run(capsys, "train", "--resume", "runs/one", "--quiet").code == 0
    assert before == {name: (place / name).read_bytes() for name in before}


def test_an_evaluation_says_what_was_measured_and_writes_it(folder, capsys):
    found = run(capsys, "evaluate", "runs/one", "--epsilon", "0:0.02:0.01", "--no-certify")
    assert found.code == 0, found.err
    assert all(word in found.out for word in ("V(s0)", "naive", "grad", "mad", "adaptive", "undisturbed"))
    table = (folder / "runs" / "one" / "evaluation.csv").read_text()
    assert (folder / "runs" / "one" / "evaluation.png").read_bytes().startswith(b"\x89PNG")
    evaluation = evaluate_run(folder / "runs" / "one", evaluation_radii(), certify=False)
    assert str(float(evaluation.verified.discounted[0, 0]))[:8] in table
    for name, returns in evaluation.attacked.items():
        assert (evaluation.verified.discounted <= returns.discounted + 1e-9).all(), name


def evaluation_radii():
    from setrl.specs.exact import decimal_range

    return decimal_range("0:0.02:0.01")
