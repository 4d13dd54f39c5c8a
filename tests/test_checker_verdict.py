"""The front door: FALSIFIED where the checker proved the candidate, UNKNOWN with a note where it could not."""

from __future__ import annotations

import zipfile
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from command_line import run
from loops import network

from setrl import cli, verify
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import write_policy
from setrl.models.plant import load_plant
from setrl.specs.reader import find_specification, read_specification
from setrl.verify.checker.witness import Proof, prove, read_witness
from setrl.verify.contradiction import require_no_contradiction
from setrl.verify.options import Options
from setrl.verify.result import Verdict

TEXT = """
setrl: 1
plant: pendulum
controller: {period: 0.1}
horizon: 0.5
initial: {theta: [0.1, 0.2], thetadot: 0}
perturbation: {observation: 0.01}
requirements:
  - stay: {theta: [-9, BOUND]}
    name: upright
"""
ONCE = Options(splits=1)


@pytest.fixture
def files(tmp_path: Path) -> tuple[str, Path]:
    """A policy that does next to nothing, and a pendulum that falls."""
    policy, specification = tmp_path / "p.onnx", tmp_path / "s.yaml"
    write_policy(policy, network([2, 4, 1], ["tanh", "tanh"], 1, 0.01).layers)
    specification.write_text(TEXT.replace("BOUND", "0.21"))
    return str(policy), specification


def test_a_violation_is_falsified_with_a_witness_that_proves_again(files: tuple[str, Path]) -> None:
    policy, specification = files
    result = verify(policy, specification, options=ONCE)
    assert result.verdict is Verdict.FALSIFIED and result.witness is not None and result.reason is not None
    assert result.reason.sentence == result.witness.sentence
    assert (
        "`upright` is left" in result.witness.sentence and "proved in exact real arithmetic" in result.witness.sentence
    )
    witness = read_witness(result.witness.content.encode())
    assert isinstance(prove(witness, Path(policy).read_bytes(), specification.read_bytes()), Proof)
    assert isinstance(prove(witness, Path(policy).read_bytes(), specification.read_bytes() + b" "), str)


def test_another_radius_is_part_of_the_witness(files: tuple[str, Path]) -> None:
    result = verify(*files, options=ONCE, epsilon=0.05)
    assert result.verdict is Verdict.FALSIFIED and result.witness is not None
    assert read_witness(result.witness.content.encode()).observation_radius is not None
    assert result.to_json()["witness"]["file"]["observation_radius"] == ["1/20", "1/20"]


@pytest.mark.parametrize("change", ["specification", "policy", "plant", "file"])
def test_what_is_no_file_stays_unknown_with_a_note(files: tuple[str, Path], change: str) -> None:
    policy, specification = read_policy(files[0]), read_specification(files[1])
    options: dict[str, Any] = {"options": ONCE}
    if change == "specification":
        wide = replace(specification.initial["theta"], upper=specification.initial["theta"].upper * 2)
        specification = replace(specification, initial={**specification.initial, "theta": wide})
    elif change == "policy":
        policy = replace(policy, content=b"")
    elif change == "plant":
        options["plant"] = load_plant("pendulum")
    else:
        files[1].write_text(TEXT.replace("BOUND", "9"))
    result = verify(policy, specification, **options)
    assert result.verdict is Verdict.UNKNOWN and result.candidate is not None and result.witness is None
    assert any("not proved" in note for note in result.notes)


def test_the_witness_is_written_only_where_there_is_one(files: tuple[str, Path], capsys: Any, tmp_path: Path) -> None:
    target = tmp_path / "w.json"
    arguments = ("verify", files[0], "--spec", str(files[1]), "--splits", "1", "--witness", str(target))
    outcome = run(capsys, *arguments)
    assert outcome.code == 10 and outcome.out.startswith("FALSIFIED: `upright` is left at ")
    read_witness(target.read_bytes())
    target.unlink()
    files[1].write_text(TEXT.replace("BOUND", "9"))
    assert run(capsys, *arguments).code == cli.OK and not target.exists()


def test_a_proof_and_a_proved_witness_contradict_each_other_and_are_kept(
    files: tuple[str, Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    falsified = verify(*files, options=ONCE)
    files[1].write_text(TEXT.replace("BOUND", "9"))
    verified = verify(*files, options=ONCE)
    assert falsified.witness is not None and verified.verdict is Verdict.VERIFIED and verified.certificate is not None
    monkeypatch.chdir(tmp_path)
    require_no_contradiction([verified, verified])
    wider = replace(verified, loop=replace(verified.loop, observation_radius=(Fraction(-1),) * 2))
    require_no_contradiction([wider, falsified])  # proved for less than what is refuted
    assert not list(tmp_path.glob("*.zip"))
    with pytest.raises(AssertionError, match="both verified and falsified.*setrl-bug"):
        require_no_contradiction([falsified, verified])
    (bundle,) = tmp_path.glob("setrl-bug-*.zip")
    with zipfile.ZipFile(bundle) as content:
        assert content.read("certificate.cert") == verified.certificate
        assert content.read("witness.json").decode() == falsified.witness.content
        assert content.read("policy.onnx") == Path(files[0]).read_bytes()
        assert content.read("specification.yaml") == files[1].read_bytes()


@pytest.mark.parametrize(
    ("network_name", "old", "new", "requirement"),
    [
        ("set", "avoid: {x: [1, 2], y: [1, 2]}", "avoid: {x: [1, 2], y: [1, 2.5]}", "obstacle"),
        ("point", "avoid: {x: [1, 2], y: [1, 2]}", "avoid: {x: [0.9, 2.6], y: [1, 2]}", "obstacle"),
        ("set", "[-0.5, 0.5], y: [-0.5, 0.5]", "[-0.02, 0.02], y: [-0.02, 0.02]", "goal"),
    ],
)
def test_violated_variants_of_nav_are_falsified(
    nav_folder: Path, tmp_path: Path, network_name: str, old: str, new: str, requirement: str
) -> None:
    text = find_specification("nav").read_text()
    assert old in text
    changed = tmp_path / "nav.yaml"
    changed.write_text(text.replace(old, new))
    result = verify(str(nav_folder / f"nn-nav-{network_name}.onnx"), changed, options=ONCE)
    assert result.verdict is Verdict.FALSIFIED and result.witness is not None, result.notes
    assert result.witness.requirement == requirement and result.witness.radius < 1e-20
