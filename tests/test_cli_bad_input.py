"""Bad input ends in exit 2 with one line that names file, place and remedy, and touches nothing."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from command_line import EXAMPLE, QUICK, contents, run
from onnx import TensorProto
from onnx_models import bytes_of, model_of, random

LAYERS = [("Gemm", ["x", "w", "b"], "h", {}), ("Tanh", ["h"], "y", {})]


def network(**constants: Any) -> bytes:
    return bytes_of(LAYERS, {"w": random(2, 1), "b": random(1), **constants}, shape=("batch", 2))


def with_external_data() -> bytes:
    model = model_of(LAYERS, {"w": random(2, 1), "b": random(1)}, shape=("batch", 2))
    tensor = model.graph.initializer[0]
    tensor.ClearField("raw_data")
    tensor.data_location = TensorProto.EXTERNAL
    entry = tensor.external_data.add()
    entry.key, entry.value = "location", "/etc/passwd"
    return bytes(model.SerializeToString())


def with_unsupported_operators() -> bytes:
    nodes = [("Erf", ["x"], "a", {}), ("Softmax", ["a"], "b", {"axis": 1}), ("Cos", ["b"], "y", {})]
    return bytes_of(nodes, shape=("batch", 2))


DEEP = "[" * 20_000 + "]" * 20_000
NESTED = "(" * 20_000 + "z" + ")" * 20_000

POLICIES: dict[str, tuple[bytes | None, list[str]]] = {
    "missing": (None, ["policy.onnx", "cannot read"]),
    "not ONNX": (b"this is no network", ["policy.onnx"]),
    "empty": (b"", ["policy.onnx"]),
    "NaN weight": (network(w=np.array([[np.nan], [1.0]], dtype=np.float32)), ["policy.onnx", "finite", "w"]),
    "infinite bias": (network(b=np.array([np.inf], dtype=np.float32)), ["policy.onnx", "finite", "b"]),
    "external data": (with_external_data(), ["policy.onnx", "external"]),
    "unsupported operators": (with_unsupported_operators(), ["policy.onnx", "Erf", "Softmax", "Cos", "supported oper"]),
    "wrong input width": (
        bytes_of(LAYERS, {"w": random(3, 1), "b": random(1)}, shape=("batch", 3)),
        ["spec.yaml:3", "3"],
    ),
    "wrong output width": (
        bytes_of(LAYERS, {"w": random(2, 2), "b": random(2)}, shape=("batch", 2)),
        ["spec.yaml:3", "a"],
    ),
}

SPECIFICATIONS: dict[str, tuple[str, str, list[str]]] = {
    "unknown key": ("horizon: 0.5", "horizont: 0.5", ["spec.yaml:5", "horizont", "horizon"]),
    "duplicate key": ("horizon: 0.5", "horizon: 0.5\nhorizon: 6", ["spec.yaml:6", "horizon", "second time"]),
    "alias": ("{z: [-1, 1]}", "*box", ["spec.yaml:10", "alias"]),
    "anchor": ("{z: [-1, 1]}", "&box {z: [-1, 1]}", ["spec.yaml:10", "anchor"]),
    "wrong dimension": ("  period: 0.1", "  period: 0.1\n  before: {scale: [1, 2, 3]}", ["spec.yaml:5", "3"]),
    "empty box": ("{z: [-1, 1]}", "{z: [1, -1]}", ["spec.yaml:10", "empty"]),
    "empty initial set": ("z: [-0.1, 0.1]", "z: [0.1, -0.1]", ["spec.yaml:6"]),
    "window outside the horizon": ("    name: altitude", "    during: [0, 7]", ["spec.yaml:1", "7"]),
    "period that does not divide the horizon": ("horizon: 0.5", "horizon: 0.55", ["spec.yaml:5", "0.55"]),
    "unknown state": ("{z: [-1, 1]}", '"altitude <= 1"', ["spec.yaml:10", "altitude"]),
    "unknown observed state": ("  period: 0.1", "  period: 0.1\n  observe: [z, sin(w)]", ["spec.yaml:5", "w"]),
    "import": ("  period: 0.1", "  period: 0.1\n  observe: [z, __import__('os')]", ["spec.yaml:5", "__import__"]),
    "attribute": ("  period: 0.1", "  period: 0.1\n  observe: [z, z.__class__]", ["spec.yaml:5"]),
    "nested YAML": ("{z: [-1, 1]}", DEEP, ["spec.yaml:10", "deep"]),
    "nested expression": ("{z: [-1, 1]}", f'"{NESTED} <= 1"', ["spec.yaml:10"]),
    "number": ("horizon: 0.5", "horizon: .nan", ["spec.yaml:5", ".nan"]),
    "unknown plant": ("quadrotor1d", "quadrotor1", ["spec.yaml:2", "quadrotor1d"]),
    "no requirement": ("    name: altitude", "    name: altitude\n    reach: {z: [0, 1]}", ["spec.yaml:10", "stay"]),
}

OPTIONS: dict[str, tuple[list[str], list[str]]] = {
    "--timeout 0": (["--timeout", "0"], ["--timeout", "positive"]),
    "--timeout nan": (["--timeout", "nan"], ["--timeout", "positive"]),
    "--timeout text": (["--timeout", "soon"], ["--timeout", "number"]),
    "--epsilon -1": (["--epsilon", "-1"], ["--epsilon", "-1"]),
    "--epsilon text": (["--epsilon", "0x1"], ["--epsilon", "0x1"]),
    "--splits 0": (["--splits", "0"], ["--splits", "0"]),
    "--method": (["--method", "euler"], ["--method", "euler", "jets"]),
    "--taylor-order 1": (["--taylor-order", "1"], ["--taylor-order"]),
    "--no-such-option": (["--no-such-option"], ["--no-such-option", "--help"]),
    "plot without a folder": (["--plot", "missing/a.png"], ["missing", "mkdir"]),
    "plot of another format": (["--plot", "a.gif"], ["a.gif", ".png", ".pdf", ".svg"]),
    "plot into a folder": (["--plot", "."], ["folder"]),
    "certificate without a folder": (["--certificate", "missing/a.cert"], ["missing", "mkdir"]),
    "certificate into a folder": (["--certificate", "."], ["folder"]),
    "certificate over a policy": (["--certificate", "policy.onnx"], ["policy.onnx", "no certificate", "--certificate"]),
    "certificate over a specification": (["--certificate", "spec.yaml"], ["spec.yaml", "no certificate"]),
    "certificate and none": (["--certificate", "a.cert", "--no-certificate"], ["--certificate", "--no-certificate"]),
    "witness of another format": (["--witness", "a.txt"], ["a.txt", ".json"]),
    "witness and plot in one place": (["--witness", "a.json", "--plot", "a.png"], ["a.png", "--witness", "--plot"]),
    "certificate and plot in one place": (["--certificate", "a.png", "--plot", "./a.png"], ["--certificate", "--plot"]),
    "--workers 0": (["--workers", "0"], ["--workers", "0"]),
}


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "policy.onnx").write_bytes(EXAMPLE.read_bytes())
    (tmp_path / "spec.yaml").write_text(QUICK)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def require_one_line(folder: Path, capsys: Any, words: list[str], *options: str) -> None:
    before = contents(folder)
    outcome = run(capsys, "verify", "policy.onnx", "--spec", "spec.yaml", *options)
    assert outcome.code == 2, outcome
    assert outcome.out == ""
    assert outcome.err.count("\n") == 1 and outcome.err.endswith(")\n"), outcome.err[:2000]
    assert len(outcome.err) < 1000
    assert [word for word in words if word not in outcome.err] == [], outcome.err
    assert contents(folder) == before


@pytest.mark.parametrize("case", POLICIES)
def test_a_bad_policy_is_one_line(case: str, folder: Path, capsys: Any) -> None:
    content, words = POLICIES[case]
    (folder / "policy.onnx").unlink()
    if content is not None:
        (folder / "policy.onnx").write_bytes(content)
    require_one_line(folder, capsys, words, "--plot", "out.png")


@pytest.mark.parametrize("case", SPECIFICATIONS)
def test_a_bad_specification_is_one_line(case: str, folder: Path, capsys: Any) -> None:
    old, new, words = SPECIFICATIONS[case]
    assert QUICK.count(old) == 1
    (folder / "spec.yaml").write_text(QUICK.replace(old, new))
    require_one_line(folder, capsys, words, "--plot", "out.png")


@pytest.mark.parametrize("case", OPTIONS)
def test_a_bad_option_is_one_line(case: str, folder: Path, capsys: Any) -> None:
    options, words = OPTIONS[case]
    require_one_line(folder, capsys, words, *options)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["verify", "policy.onnx"], ["--spec", "nav"]),
        (["verify", "--spec", "nav"], ["POLICY", "ONNX"]),
        (["verify", "policy.onnx", "--spec", "nope"], ["nope", "nav"]),
        (["verify", "policy.onnx", "--spec", "nav.yaml"], ["nav.yaml:", "policy.onnx"]),
        (["sweep", "policy.onnx", "--spec", "spec.yaml", "--epsilon", "0:1:0"], ["--epsilon", "0:0.5:0.05"]),
        (["sweep", "policy.onnx", "--spec", "spec.yaml", "--epsilon", "1:0:0.1"], ["--epsilon"]),
        (["sweep", "policy.onnx", "--spec", "spec.yaml", "--epsilon", "0:1"], ["--epsilon"]),
        (["sweep", "policy.onnx", "--spec", "spec.yaml", "--epsilon", "0:1:1e-9"], ["--epsilon", "1000"]),
        (["sweep", "policy.onnx", "--spec", "spec.yaml", "--csv", "no/a.csv"], ["no/a.csv", "mkdir"]),
        (["simulate", "policy.onnx", "--spec", "spec.yaml", "--rollouts", "0"], ["--rollouts"]),
        (["simulate", "policy.onnx", "--spec", "spec.yaml", "--seed", "-1"], ["--seed"]),
        (["simulate", "policy.onnx", "--spec", "spec.yaml", "--attack", "hard"], ["--attack", "uniform"]),
        (["init", "unicycles"], ["unicycles", "unicycle"]),
        (["init", "missing.yaml"], ["missing.yaml"]),
        (["init", "unicycle", "--out", "spec.yaml"], ["spec.yaml", "--force"]),
        (["inspect", "spec.yaml"], ["spec.yaml"]),
        (["schema", "witness"], ["witness", "certificate", "plant"]),
        (["no-such-command"], ["no-such-command"]),
    ],
    ids=" ".join,
)
def test_bad_usage_is_one_line(arguments: list[str], words: list[str], folder: Path, capsys: Any) -> None:
    before = contents(folder)
    outcome = run(capsys, *arguments)
    assert (outcome.code, outcome.out) == (2, ""), outcome
    assert outcome.err.count("\n") == 1 and outcome.err.endswith(")\n"), outcome.err
    assert [word for word in words if word not in outcome.err] == [], outcome.err
    assert contents(folder) == before


def test_an_inspection_lists_every_unsupported_operator_and_fails(folder: Path, capsys: Any) -> None:
    (folder / "policy.onnx").write_bytes(with_unsupported_operators())
    outcome = run(capsys, "inspect", "policy.onnx")
    assert outcome.code == 2
    assert all(outcome.out.count(f"problem    {name}") == 1 for name in ("Erf", "Softmax", "Cos")), outcome.out
    assert outcome.err.count("\n") == 1


def test_onnx_can_read_what_the_cases_are_made_of() -> None:
    assert onnx.load_from_string(network()).graph.node[0].op_type == "Gemm"
