"""`setrl check` proves evidence again, says which obligation failed, and needs nothing of what found the evidence."""

from __future__ import annotations

import hashlib
import json
import os
import struct
import subprocess
import sys
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from typing import Any

import pytest
from command_line import EXAMPLE, QUICK, contents, run
from hypothesis import given
from hypothesis import strategies as st

from setrl.specs.errors import InputError
from setrl.verify.checker import claim, recheck
from setrl.verify.checker.certificate_file import MAGIC, canonical, read_certificate
from setrl.verify.interruption import Watcher

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
FILES = ("policy.onnx", "quick.yaml")


@pytest.fixture(scope="module")
def evidence(tmp_path_factory: pytest.TempPathFactory) -> dict[str, bytes]:
    """A certificate and a witness as `setrl verify` writes them."""
    folder = tmp_path_factory.mktemp("evidence")
    (folder / "policy.onnx").write_bytes(EXAMPLE.read_bytes())
    (folder / "quick.yaml").write_text(QUICK)
    verify = [sys.executable, "-m", "setrl", "verify", "policy.onnx", "--spec", "quick.yaml", "--splits", "1"]
    for options, code in (([], 0), (["--epsilon", "5", "--witness", "witness.json"], 10)):
        outcome = subprocess.run([*verify, *options], cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
        assert outcome.returncode == code, outcome.stderr
    return {name: (folder / name).read_bytes() for name in ("policy.cert", "witness.json")}


@pytest.fixture
def folder(evidence: dict[str, bytes], tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    for name, content in {**evidence, "policy.onnx": EXAMPLE.read_bytes(), "quick.yaml": QUICK.encode()}.items():
        (tmp_path / name).write_bytes(content)
    monkeypatch.chdir(tmp_path)
    return tmp_path


def parts(certificate: bytes) -> tuple[dict[str, Any], bytes]:
    start = read_certificate(certificate).start
    return json.loads(certificate[len(MAGIC) + 8 : start]), certificate[start:]


def sealed(header: dict[str, Any], payload: bytes) -> bytes:
    """A certificate whose digest is right whatever its numbers are."""
    text = canonical({**header, "payload": hashlib.sha256(payload).hexdigest()})
    return MAGIC + struct.pack("<Q", len(text)) + text + payload


def test_a_certificate_of_verify_is_accepted_with_its_claim_and_what_it_assumes(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "check", "policy.cert", *FILES)
    assert outcome.code == 0 and outcome.out.count("\n") == 1
    for words in (
        "ACCEPTED: no trajectory of plant quadrotor1d ",
        "observations perturbed by up to 0.01, leaves `altitude` within 0.5 s",
        "exact real arithmetic and as executed in float32 by onnxruntime",
        "provided that its tanh is off by at most 4.77e-7",
        "margins: `altitude` at least 0.",
        "with discount 0.99",
    ):
        assert words in outcome.out, outcome.out
    assert "1 cell checked; written by setrl" in outcome.err


def test_the_specification_is_an_argument_or_an_option(folder: Path, capsys: Any) -> None:
    first = run(capsys, "check", "policy.cert", *FILES)
    second = run(capsys, "check", "policy.cert", "policy.onnx", "--spec", "quick.yaml")
    assert first == second and first.code == 0


def test_quiet_leaves_the_answer_only(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "check", "policy.cert", *FILES, "--quiet", "--workers", "1")
    assert outcome.code == 0 and outcome.out.startswith("ACCEPTED: ") and outcome.err == ""


def test_a_check_writes_nothing(folder: Path, capsys: Any) -> None:
    before = contents(folder)
    run(capsys, "check", "policy.cert", *FILES)
    assert contents(folder) == before


def test_without_files_evidence_is_about_the_shipped_example(folder: Path, capsys: Any) -> None:
    assert run(capsys, "verify", "--quiet").code == 0
    assert run(capsys, "check", "quadrotor1d-set.cert").code == 0
    assert run(capsys, "check", "quadrotor1d-set.cert", "policy.onnx", "quadrotor1d").code == 0
    rejected = run(capsys, "check", "policy.cert")
    assert rejected.code == 5 and "another specification" in rejected.out


def test_a_witness_is_proved_again(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "check", "witness.json", *FILES)
    assert outcome.code == 0 and outcome.out.startswith("ACCEPTED: `altitude` is left at "), outcome
    assert "proved in exact real arithmetic (" in outcome.out and "--replay" in outcome.err


def test_a_replay_proves_the_recorded_actions_too(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "check", "witness.json", *FILES, "--replay")
    assert outcome.code == 0 and "and for the actions that onnxruntime" in outcome.out, outcome


def test_json_has_the_same_keys_whatever_the_answer(folder: Path, capsys: Any) -> None:
    documents = {}
    for file, specification, code in (
        ("policy.cert", "quick.yaml", 0),
        ("witness.json", "quick.yaml", 0),
        ("policy.cert", "quadrotor1d", 5),
        ("witness.json", "quadrotor1d", 5),
    ):
        outcome = run(capsys, "check", file, "policy.onnx", specification, "--json")
        data = json.loads(outcome.out)
        assert (outcome.code, data["exit_code"], data["accepted"]) == (code, code, code == 0)
        documents[file, specification] = data
    assert len({tuple(data) for data in documents.values()}) == 1
    certificate, witness = documents["policy.cert", "quick.yaml"], documents["witness.json", "quick.yaml"]
    assert certificate["evidence"] == "certificate" and certificate["requirements"][0]["margin"] > 0.0
    assert (certificate["leaves"], certificate["semantics"]) == (1, ["real", "float32"])
    assert witness["evidence"] == "witness" and witness["witness"]["grade"] == "proved (real)"


REJECTED: dict[str, tuple[Callable[[dict[str, Any], bytes], bytes], str]] = {
    "a first set that is elsewhere": (
        lambda header, payload: sealed(header, struct.pack("<d", 1.0) + payload[8:]),
        "the first set does not contain its part of the initial set",
    ),
    "a margin that is too good": (
        lambda header, payload: sealed({**header, "requirements": [{"name": "altitude", "margin": 0.99}]}, payload),
        "the margin of 'altitude' is claimed as 0.99",
    ),
    "a return that is too good": (
        lambda header, payload: sealed({**header, "value": {"discounted": 0.0, "undiscounted": -9.0}}, payload),
        "the return is claimed to be at least 0",
    ),
    "a larger perturbation": (
        lambda header, payload: sealed({**header, "observation_radius": ["1/2", "1/2"]}, payload),
        "leaf 0: ",
    ),
    "a runtime that is better than any": (
        lambda header, payload: sealed({**header, "runtime": {"name": "r", "error": "1/4194304"}}, payload),
        "smaller error of the runtime",
    ),
}


@pytest.mark.parametrize("case", REJECTED)
def test_a_claim_that_is_not_proved_is_rejected_by_its_obligation(case: str, folder: Path, capsys: Any) -> None:
    change, words = REJECTED[case]
    header, payload = parts((folder / "policy.cert").read_bytes())
    (folder / "policy.cert").write_bytes(change(header, payload))
    outcome = run(capsys, "check", "policy.cert", *FILES)
    assert outcome.code == 5 and outcome.out.startswith("REJECTED: ") and words in outcome.out, outcome


def test_the_same_numbers_sealed_again_are_accepted(folder: Path, capsys: Any) -> None:
    content = (folder / "policy.cert").read_bytes()
    assert sealed(*parts(content)) == content


def test_evidence_about_other_files_is_rejected(folder: Path, capsys: Any) -> None:
    for file in ("policy.cert", "witness.json"):
        (folder / "quick.yaml").write_text(QUICK + "# \n")
        outcome = run(capsys, "check", file, *FILES)
        assert outcome.code == 5 and "is about another specification: the digests differ" in outcome.out
    (folder / "policy.onnx").write_bytes(EXAMPLE.read_bytes() + b"\x00")
    assert "about another policy" in run(capsys, "check", "policy.cert", *FILES).out


def changed(content: bytes, place: int) -> bytes:
    return content[:place] + bytes([content[place] ^ 1]) + content[place + 1 :]


DAMAGED: dict[str, tuple[Callable[[bytes, bytes], bytes], str]] = {
    "empty": (lambda c, w: b"", "neither a certificate nor a witness"),
    "foreign": (lambda c, w: b"\x89PNG" * 1000, "neither a certificate nor a witness"),
    "text before it": (lambda c, w: b"\n" + c, "neither a certificate nor a witness"),
    "another JSON": (lambda c, w: b'{"format": 1}', "setrl-witness"),
    "cut in its magic": (lambda c, w: c[:12], "cut off"),
    "cut in its header": (lambda c, w: c[:400], "cut off"),
    "cut in its numbers": (lambda c, w: c[:-8], "bytes"),
    "longer": (lambda c, w: c + bytes(8), "bytes"),
    "one bit in the header": (lambda c, w: changed(c, 40), "certificate's header"),
    "one bit in the numbers": (lambda c, w: changed(c, len(c) - 100), "not those its header was written for"),
    "header of another size": (lambda c, w: c[: len(MAGIC)] + b"\xff" * 8 + c[len(MAGIC) + 8 :], "cut off"),
    "another version": (lambda c, w: sealed({**parts(c)[0], "format": 99}, parts(c)[1]), "has format 99"),
    "a witness cut off": (lambda c, w: w[:-20], "no JSON document"),
    "a witness with another number": (lambda c, w: w.replace(b'"', b'"x', 4), "witness"),
}


@pytest.mark.parametrize("case", DAMAGED)
def test_a_damaged_file_is_one_line_and_exit_2(case: str, folder: Path, capsys: Any) -> None:
    change, words = DAMAGED[case]
    content = change((folder / "policy.cert").read_bytes(), (folder / "witness.json").read_bytes())
    (folder / "a file").write_bytes(content)
    outcome = run(capsys, "check", "a file", *FILES)
    assert (outcome.code, outcome.out) == (2, ""), outcome
    assert outcome.err.startswith("setrl: error: a file: ") and outcome.err.count("\n") == 1
    assert outcome.err.endswith(" (give the file as setrl verify wrote it, or write it again)\n")
    assert words in outcome.err, outcome.err


@pytest.mark.parametrize("number", [float("nan"), float("inf")])
def test_a_header_with_a_number_that_json_has_not_is_refused(number: float, evidence: dict[str, bytes]) -> None:
    header, payload = parts(evidence["policy.cert"])
    text = json.dumps({**header, "value": {"discounted": number, "undiscounted": 0.0}}).encode()
    with pytest.raises(InputError):
        read_certificate(MAGIC + struct.pack("<Q", len(text)) + text + payload)


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["missing.cert", *FILES], ["missing.cert", "no such certificate or witness"]),
        ([".", *FILES], [".", "a file is required"]),
        (["policy.cert", "missing.onnx", "quick.yaml"], ["missing.onnx", "no such policy"]),
        (["policy.cert", "policy.onnx", "missing.yaml"], ["missing.yaml"]),
        (["policy.cert", "policy.onnx"], ["SPEC", "a specification is required", "FILE POLICY.onnx SPEC.yaml"]),
        (["policy.cert", "--spec", "quick.yaml"], ["POLICY", "an ONNX file is required", "FILE POLICY.onnx SPEC.yaml"]),
        (["policy.cert", "quick.yaml", "policy.onnx"], ["POLICY", "received quick.yaml", "FILE POLICY.onnx SPEC.yaml"]),
        (["policy.cert", *FILES, "--spec", "quick.yaml"], ["--spec", "one specification"]),
        (["policy.cert", *FILES, "--workers", "0"], ["--workers", "1"]),
        (["policy.cert", *FILES, "--timeout", "0"], ["--timeout", "positive"]),
        (["policy.cert", *FILES, "--timeout", "nan"], ["--timeout", "positive"]),
    ],
    ids=" ".join,
)
def test_bad_usage_is_one_line(arguments: list[str], words: list[str], folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "check", *arguments)
    assert (outcome.code, outcome.out) == (2, ""), outcome
    assert outcome.err.count("\n") == 1 and outcome.err.endswith(")\n"), outcome.err
    assert [word for word in words if word not in outcome.err] == [], outcome.err


def test_a_file_that_does_not_end_is_not_read(folder: Path, capsys: Any) -> None:
    assert run(capsys, "check", "/dev/zero", *FILES).code == 2
    with (folder / "large").open("wb") as file:
        file.truncate(1 << 36)
    outcome = run(capsys, "check", "large", *FILES)
    assert outcome.code == 2 and "has more than" in outcome.err


def test_when_time_is_up_nothing_is_accepted(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "check", "witness.json", *FILES, "--timeout", "1e-9")
    assert outcome.code == 5 and outcome.out.startswith("REJECTED: the time is up")


def test_ctrl_c_aborts(folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    def interrupted(*_: Any, **__: Any) -> Any:
        raise KeyboardInterrupt

    monkeypatch.setattr(recheck, "recheck", interrupted)
    outcome = run(capsys, "check", "policy.cert", *FILES)
    assert (outcome.code, outcome.out, outcome.err) == (130, "", "setrl: aborted\n")


MAIN = """\
import sys
from setrl.cli import main
try:
    main(["check", *sys.argv[1:]])
except SystemExit as end:
    assert end.code == 0, end.code
print(*sorted(sys.modules))
"""
ALLOWED = {"setrl", "setrl.cli", "setrl.specs", "setrl.specs.errors", "setrl.verify"}
ROOMS = ("setrl.verify.checker", "setrl.commands")  # commands import what they need when they run
ALLOWED |= {"setrl.verify.interruption", "setrl.verify.deadline"}  # progress and time, no numbers


@pytest.mark.parametrize("file", ["policy.cert", "witness.json"])
def test_the_engine_and_numpy_play_no_part(file: str, folder: Path) -> None:
    outcome = subprocess.run(
        [sys.executable, "-c", MAIN, file, *FILES], env=ENVIRONMENT, capture_output=True, text=True
    )
    assert outcome.returncode == 0, outcome.stderr
    modules = set(outcome.stdout.splitlines()[-1].split())
    own = {name for name in modules if name.split(".")[0] == "setrl"}
    assert {name for name in own - ALLOWED if not name.startswith(ROOMS)} == set()
    assert "setrl.verify.checker.witness" in own and "flint" in modules
    assert modules & {"numpy", "scipy", "cvxpy", "onnxruntime", "matplotlib"} == set()


def test_progress_counts_leaves() -> None:
    seen = []

    class Bar:
        def update(self, task: Any, **facts: Any) -> None:
            seen.append((task, facts["completed"], facts["description"]))

    Watcher(Bar(), "task").checking(12, 48)
    assert seen == [("task", 0.25, "checking 12/48 leaves")]


@given(st.fractions(max_denominator=10**6))
def test_a_decimal_is_the_number_itself(value: Fraction) -> None:
    assert Fraction(claim.exact(value)) == value


@given(st.floats(allow_nan=False, allow_infinity=False))
def test_a_printed_bound_is_on_the_side_on_which_it_holds(value: float) -> None:
    assert Fraction(claim.at_least(value)) <= Fraction(value) <= Fraction(claim.at_most(Fraction(value)))


@pytest.mark.parametrize("text", ["\x1b[31mred", "\ud800", "a\nb", "x" * 1000])
def test_what_a_file_says_reaches_the_terminal_as_plain_text(text: str, evidence: dict[str, bytes]) -> None:
    assert claim.printable(text).isprintable() and len(claim.printable(text)) <= 80
    header, payload = parts(evidence["policy.cert"])
    runtime = {**header["runtime"], "name": text}
    content = sealed({**header, "setrl": text, "runtime": runtime}, payload)
    answer = recheck.recheck(content, EXAMPLE.read_bytes(), QUICK.encode())
    assert answer.accepted and text not in answer.sentence and text not in "".join(answer.notes)


def test_a_sentence_says_where_the_radius_is_not_the_specifications(evidence: dict[str, bytes]) -> None:
    header, payload = parts(evidence["policy.cert"])
    content = sealed({**header, "observation_radius": ["1/200", "1/100"]}, payload)
    answer = recheck.recheck(content, EXAMPLE.read_bytes(), QUICK.encode())
    assert answer.accepted
    assert "perturbed by up to (0.005, 0.01), which is not the specification's radius, leaves" in answer.sentence
