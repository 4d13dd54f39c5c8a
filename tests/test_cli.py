"""What every command does, with which exit code, and where its words go."""

from __future__ import annotations

import csv
import hashlib
import io
import json
import os
import platform
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import jsonschema
import pytest
from command_line import EXAMPLE, HOPELESS, QUICK, contents, run

import setrl
from setrl.commands import exit_codes
from setrl.models.plant import shipped_plants
from setrl.specs.errors import InputError
from setrl.specs.files import write_atomically
from setrl.verify import certified, rounding, runtime_measurement, verifier
from setrl.verify import deadline as deadlines
from setrl.verify.certificate import MAGIC
from setrl.verify.result import Result
from setrl.verify.runtime_error import FunctionError, RuntimeMeasurement, measurement_path, runtime_name

ROOT = Path(__file__).resolve().parents[1]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
COMMANDS = (
    *("verify", "check", "sweep", "radius", "simulate", "certify", "export", "crosscheck", "vnnlib"),
    *("init", "inspect", "doctor", "schema"),
)


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    (tmp_path / "policy.onnx").write_bytes(EXAMPLE.read_bytes())
    (tmp_path / "quick.yaml").write_text(QUICK)
    (tmp_path / "hopeless.yaml").write_text(HOPELESS)
    monkeypatch.chdir(tmp_path)
    return tmp_path


QUICKLY = ("policy.onnx", "--spec", "quick.yaml")
HOPELESSLY = ("policy.onnx", "--spec", "hopeless.yaml", "--splits", "1")
VIOLATED = (*QUICKLY, "--epsilon", "5", "--splits", "1")


def test_verify_without_arguments_explains_itself_on_the_shipped_example(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "verify")
    assert outcome.code == 0
    assert outcome.out.startswith("VERIFIED: no trajectory of plant quadrotor1d ") and outcome.out.count("\n") == 1
    for words in ("shipped example", "setrl init", "altitude", "V(s0)", "proved", "reachability"):
        assert words in outcome.err, outcome.err


def test_a_verdict_names_the_semantics_it_covers(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "verify", *QUICKLY)
    assert "exact real arithmetic" in outcome.out and "float32" in outcome.out
    assert "exact real arithmetic, and float32" in outcome.err


def test_quiet_leaves_the_verdict_only(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "verify", *QUICKLY, "--quiet")
    assert outcome.out.startswith("VERIFIED: ") and outcome.err == ""


def test_unknown_is_exit_5_with_a_reason_and_a_remedy(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "verify", *HOPELESSLY)
    assert outcome.code == 5
    assert outcome.out.startswith("UNKNOWN: ") and "altitude" in outcome.out
    for words in ("growth", "does verify", "try", "not proved"):
        assert words in outcome.err, outcome.err


def test_json_is_one_document_with_the_same_keys_whatever_the_verdict(folder: Path, capsys: Any) -> None:
    proved = run(capsys, "verify", *QUICKLY, "--json")
    unknown = run(capsys, "verify", *HOPELESSLY, "--json")
    assert (proved.code, unknown.code) == (0, 5)
    first, second = json.loads(proved.out), json.loads(unknown.out)
    assert first.keys() == second.keys()
    assert (first["verdict"], first["exit_code"], first["reason"]) == ("VERIFIED", 0, None)
    assert (second["verdict"], second["exit_code"], second["claim"]) == ("UNKNOWN", 5, None)
    assert second["reason"]["sentence"] in run(capsys, "verify", *HOPELESSLY).out
    assert first["subject"]["specification"]["name"] == "quick.yaml"


@pytest.mark.parametrize("suffix", [".png", ".pdf", ".svg"])
def test_a_plot_is_written_whole(suffix: str, folder: Path, capsys: Any) -> None:
    before = contents(folder)
    assert run(capsys, "verify", *QUICKLY, "--plot", f"a{suffix}").code == 0
    starts = {".png": b"\x89PNG", ".pdf": b"%PDF", ".svg": b"<?xml"}
    assert (folder / f"a{suffix}").read_bytes().startswith(starts[suffix])
    assert contents(folder).keys() - before.keys() == {f"a{suffix}", "policy.cert"}


def test_verified_leaves_the_certificate_it_rests_on(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "verify", *QUICKLY, "--json")
    content = (folder / "policy.cert").read_bytes()
    assert content.startswith(MAGIC) and outcome.err.endswith("wrote policy.cert\n")
    digest = hashlib.sha256(content).hexdigest()
    facts = {"path": "policy.cert", "sha256": digest, "bytes": len(content), "leaves": 1}
    assert json.loads(outcome.out)["certificate"] == facts
    assert "accepted by the checker: 1 cell proved again" in outcome.err


def test_the_same_question_has_the_same_certificate(folder: Path, capsys: Any) -> None:
    assert run(capsys, "verify", *QUICKLY).code == 0
    assert run(capsys, "verify", *QUICKLY, "--certificate", "again.cert").code == 0
    assert (folder / "again.cert").read_bytes() == (folder / "policy.cert").read_bytes()


def test_an_earlier_certificate_is_replaced_and_nothing_else(folder: Path, capsys: Any) -> None:
    for content, code in ((MAGIC + b"of an earlier run", 0), (b"-----BEGIN CERTIFICATE-----", 2), (b"", 2)):
        (folder / "policy.cert").write_bytes(content)
        outcome = run(capsys, "verify", *QUICKLY)
        assert outcome.code == code, outcome
        assert ((folder / "policy.cert").read_bytes() == content) is (code == 2)
        if code == 2:
            assert outcome.out == "" and outcome.err.count("\n") == 1
            assert "policy.cert: the file exists and is no certificate" in outcome.err
            assert "--certificate FILE" in outcome.err and "--no-certificate" in outcome.err


def test_no_certificate_is_written_where_none_is_wanted_or_nothing_is_proved(folder: Path, capsys: Any) -> None:
    before = contents(folder)
    outcome = run(capsys, "verify", *QUICKLY, "--no-certificate", "--json")
    assert outcome.code == 0 and json.loads(outcome.out)["certificate"]["path"] is None
    assert run(capsys, "verify", *HOPELESSLY).code == 5
    assert run(capsys, "verify", *HOPELESSLY, "--certificate", "a.cert").code == 5
    assert run(capsys, "sweep", *QUICKLY, "--epsilon", "0,0.01").code == 0
    assert contents(folder) == before


def test_without_the_checker_a_proof_is_only_claimed(folder: Path, capsys: Any) -> None:
    before = contents(folder)
    outcome = run(capsys, "verify", *QUICKLY, "--no-check", "--json")
    data = json.loads(outcome.out)
    assert (outcome.code, data["verdict"], data["exit_code"], data["reason"]) == (5, "CLAIMED", 5, None)
    assert data["claim"].startswith("no trajectory") and data["certificate"]["path"] is None
    assert "not checked, as asked for" in outcome.err and contents(folder) == before
    outcome = run(capsys, "verify", *QUICKLY, "--no-check", "--certificate", "a.cert", "--quiet")
    assert outcome.code == 5 and outcome.out.startswith("CLAIMED: no trajectory") and outcome.err == ""
    assert run(capsys, "check", "a.cert", "policy.onnx", "quick.yaml").code == 0


def test_what_the_checker_does_not_accept_is_unknown_and_leaves_no_certificate(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = contents(folder)
    monkeypatch.setattr(certified, "check_certificate", lambda *_, **__: "leaf 0: period 3: the end")
    outcome = run(capsys, "verify", *QUICKLY)
    assert outcome.code == 5 and outcome.out.startswith("UNKNOWN: ") and "leaf 0: period 3: the end" in outcome.out
    assert contents(folder) == before


def test_a_folder_that_cannot_be_written_takes_no_verdict(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(os, "access", lambda path, mode: not mode & os.W_OK)
    outcome = run(capsys, "verify", *QUICKLY)
    assert outcome.code == 0 and "no certificate was written: nothing can be written to" in outcome.err
    assert run(capsys, "verify", *QUICKLY, "--quiet").err == ""
    assert run(capsys, "verify", *QUICKLY, "--certificate", "a.cert").code == 2
    assert not (folder / "policy.cert").exists()


def test_a_default_place_that_is_a_folder_takes_no_verdict(folder: Path, capsys: Any) -> None:
    (folder / "policy.cert").mkdir()
    outcome = run(capsys, "verify", *QUICKLY)
    assert outcome.code == 0 and "no certificate was written: this is a folder" in outcome.err
    assert "--certificate FILE" in outcome.err


def test_a_certificate_that_cannot_be_written_in_the_end_does_not_take_the_verdict_with_it(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(os, "fsync", fail)
    outcome = run(capsys, "verify", *QUICKLY, "--json")
    assert outcome.code == 2 and "No space left" in outcome.err
    data = json.loads(outcome.out)
    assert data["verdict"] == "VERIFIED" and data["certificate"]["path"] is None


def test_a_witness_comes_with_its_trajectory_as_a_table_and_as_a_picture(folder: Path, capsys: Any) -> None:
    before = contents(folder)
    outcome = run(capsys, "verify", *VIOLATED, "--witness", "w.json")
    assert outcome.code == 10, outcome
    assert contents(folder).keys() - before.keys() == {"w.json", "w.csv", "w.png"}
    assert json.loads((folder / "w.json").read_text())["requirement"] == "altitude"
    assert (folder / "w.csv").read_text().startswith("# a simulation in float64")
    assert (folder / "w.png").read_bytes().startswith(b"\x89PNG")
    assert outcome.err.endswith("wrote w.json\nwrote w.csv\nwrote w.png\n")


def test_options_reach_the_engine(folder: Path, capsys: Any) -> None:
    options = ("--splits", "7", "--taylor-order", "4", "--generators", "9", "--timeout", "60", "--epsilon", "0.005")
    data = json.loads(run(capsys, "verify", *QUICKLY, "--json", *options).out)
    chosen = data["options"]
    assert (chosen["splits"], chosen["taylor_order"], chosen["generators"], chosen["timeout"]) == (7, 4, 9, 60.0)
    assert data["observation_radius"] == {"z": 0.005, "zdot": 0.005}


def test_a_time_limit_that_is_too_short_is_unknown_and_not_an_error(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "verify", *QUICKLY, "--timeout", "1e-9")
    assert outcome.code == 5 and "time limit" in outcome.out


def test_a_sweep_is_a_table_with_one_row_per_radius(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "sweep", *QUICKLY, "--epsilon", "0:0.02:0.01", "--csv", "a.csv", "--plot", "a.png")
    assert outcome.code == 0
    assert [line.split()[:2] for line in outcome.out.splitlines()[1:]] == [
        ["0", "VERIFIED"],
        ["0.01", "VERIFIED"],
        ["0.02", "VERIFIED"],
    ]
    rows = list(csv.DictReader(io.StringIO((folder / "a.csv").read_text())))
    values = [float(row["value_discounted"]) for row in rows]
    assert [row["epsilon"] for row in rows] == ["0", "0.01", "0.02"]
    assert values == sorted(values, reverse=True)
    assert (folder / "a.png").stat().st_size > 0


def test_a_sweep_is_as_bad_as_its_worst_radius(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "sweep", *QUICKLY, "--epsilon", "0,5", "--splits", "1", "--json")
    results = json.loads(outcome.out)["results"]
    assert outcome.code == 10
    assert [entry["verdict"] for entry in results] == ["VERIFIED", "FALSIFIED"]


def test_a_simulation_is_repeatable_and_stays_in_its_bounds(folder: Path, capsys: Any) -> None:
    options = ("--rollouts", "6", "--attack", "corner", "--csv", "a.csv", "--plot", "a.png")
    first = run(capsys, "simulate", *QUICKLY, *options)
    rows = (folder / "a.csv").read_text()
    assert first.code == 0 and "violated by 0 of 6" in first.out
    assert run(capsys, "simulate", *QUICKLY, *options).out == first.out
    assert (folder / "a.csv").read_text() == rows
    assert run(capsys, "simulate", *QUICKLY, *options, "--seed", "1").code == 0
    assert (folder / "a.csv").read_text() != rows
    noise = [float(row["noise z"]) for row in csv.DictReader(io.StringIO(rows)) if row["noise z"]]
    assert max(map(abs, noise)) <= 0.01 and len(set(noise)) == 2


@pytest.mark.parametrize("plant", shipped_plants())
def test_a_template_is_a_specification_of_its_plant(plant: str, folder: Path, capsys: Any) -> None:
    printed = run(capsys, "init", plant)
    written = run(capsys, "init", plant, "--out", "new.yaml")
    assert (printed.code, written.code, written.out) == (0, 0, "")
    assert (folder / "new.yaml").read_text() == printed.out
    specification = setrl.read_specification(folder / "new.yaml")
    assert specification.plant == plant
    assert tuple(specification.initial) == setrl.load_plant(plant).states


def test_a_template_of_a_plant_file_finds_it_from_its_own_folder(folder: Path, capsys: Any) -> None:
    (folder / "plants").mkdir()
    (folder / "plants" / "my cart.yaml").write_text(
        "states: {p: m, v: m/s}\ninputs: {a: m/s^2}\ndisturbances: {wind: N}\ndynamics: {p+: p + v, v+: v + a + wind}\n"
    )
    (folder / "specs").mkdir()
    assert run(capsys, "init", "plants/my cart.yaml", "--out", "specs/new.yaml").code == 0
    specification = setrl.read_specification(folder / "specs" / "new.yaml")
    assert specification.plant == "../plants/my cart.yaml"
    assert set(specification.perturbation.disturbances) == {"wind"}


def test_a_template_replaces_a_file_only_by_force(folder: Path, capsys: Any) -> None:
    assert run(capsys, "init", "unicycle", "--out", "quick.yaml").code == 2
    assert (folder / "quick.yaml").read_text() == QUICK
    assert run(capsys, "init", "unicycle", "--out", "quick.yaml", "--force").code == 0
    assert (folder / "quick.yaml").read_text() != QUICK


def test_an_inspection_lists_operators_and_sizes(folder: Path, capsys: Any) -> None:
    outcome = run(capsys, "inspect", "policy.onnx")
    assert outcome.code == 0 and "Gemm x3" in outcome.out and "2 inputs, 1 outputs" in outcome.out
    assert json.loads(run(capsys, "inspect", "policy.onnx", "--json").out)["supported"] is True


def test_the_doctor_finds_this_machine_in_order(capsys: Any) -> None:
    outcome = run(capsys, "doctor")
    assert outcome.code == 0 and "numpy" in outcome.out and "arithmetic" in outcome.out
    assert json.loads(run(capsys, "doctor", "--json").out)["problems"] == []


def test_a_violated_assumption_is_exit_2(capsys: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(rounding, "self_test", lambda: ["subnormal numbers are flushed to zero"])
    outcome = run(capsys, "doctor")
    assert outcome.code == 2 and "subnormal numbers are flushed to zero" in outcome.err


def measurement(constant: float) -> RuntimeMeasurement:
    functions = tuple(
        FunctionError(function, precision, precision == "float32", 10, 5, 0, constant / 2, 0.5, constant / 2, -1.0, 1.0)
        for precision in ("float32", "float64")
        for function in ("tanh", "sigmoid")
    )
    constants = {"float32": constant, "float64": 2.0**-50}
    return RuntimeMeasurement(
        runtime_name(), platform.machine(), "a processor", "2000-01-01", 1.0, constants, functions
    )


def test_the_doctor_measures_the_runtime_and_stores_what_claims_use(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.setattr(runtime_measurement, "measure_runtime", lambda progress: measurement(2.0**-20))
    outcome = run(capsys, "doctor", "--runtime")
    assert outcome.code == 0 and "tanh" in outcome.out and "sigmoid" in outcome.out
    assert outcome.err == f"wrote {measurement_path()}\n" and measurement_path().is_file()
    data = json.loads(run(capsys, "doctor", "--runtime", "--json").out)
    assert data["constants"]["float32"] == 2.0**-20 and len(data["functions"]) == 4
    outcome = run(capsys, "verify", *QUICKLY)
    assert outcome.code == 0
    assert "tanh is off by at most 9.54e-7;" in run(capsys, "check", "policy.cert", "policy.onnx", "quick.yaml").out


def test_a_measurement_that_could_not_be_stored_is_not_begun(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    (folder / "cache").write_text("a file")
    monkeypatch.setenv("XDG_CACHE_HOME", str(folder / "cache"))
    monkeypatch.setattr(runtime_measurement, "measure_runtime", lambda progress: pytest.fail("minutes for nothing"))
    outcome = run(capsys, "doctor", "--runtime")
    assert (outcome.code, outcome.out) == (2, "") and outcome.err.count("\n") == 1


@pytest.mark.parametrize("kind", ["specification", "plant", "certificate"])
def test_a_schema_is_a_json_schema(kind: str, capsys: Any) -> None:
    jsonschema.Draft202012Validator.check_schema(json.loads(run(capsys, "schema", kind).out))


def test_the_version_and_every_command_is_in_the_help(capsys: Any) -> None:
    assert run(capsys, "--version").out == f"setrl {setrl.__version__}\n"
    help_text = run(capsys, "--help").out
    assert all(f"  {command} " in help_text for command in COMMANDS)
    assert all("Exit codes" in run(capsys, option).out for option in ("-h", "--help"))
    assert run(capsys).code == 2


@pytest.mark.parametrize("command", COMMANDS)
def test_every_command_has_help(command: str, capsys: Any) -> None:
    outcome = run(capsys, command, "--help")
    assert outcome.code == 0 and outcome.out.startswith(f"Usage: setrl {command} ")


@pytest.mark.parametrize("error", [AssertionError("broken invariant"), ZeroDivisionError("x\ny"), MemoryError()])
def test_an_unexpected_exception_is_exit_6_with_a_line_that_asks_for_a_report(
    error: Exception, folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any, **__: Any) -> Any:
        raise error

    monkeypatch.setattr(verifier, "verify", fail)
    outcome = run(capsys, "verify", *QUICKLY)
    assert (outcome.code, outcome.out) == (6, "")
    last = outcome.err.splitlines()[-1]
    assert last.startswith(f"setrl: internal error: {type(error).__name__}") and "report" in last
    assert "Traceback" in outcome.err


def test_a_plot_that_fails_does_not_take_the_verdict_with_it(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(*_: Any) -> Any:
        raise InputError("cannot write the file: no space left", where="a.png", remedy="make room")

    monkeypatch.setattr(Result, "plot", fail)
    outcome = run(capsys, "verify", *QUICKLY, "--plot", "a.png")
    assert outcome.code == 2 and outcome.out.startswith("VERIFIED: ")
    assert outcome.err.endswith("setrl: error: a.png: cannot write the file: no space left (make room)\n")


def test_ctrl_c_before_the_search_still_gives_a_verdict(
    folder: Path, capsys: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(deadlines.Deadline, "after", classmethod(lambda cls, seconds: cls(None, interrupted=True)))
    outcome = run(capsys, "verify", *QUICKLY)
    assert outcome.code == 5 and "interrupted" in outcome.out


def wait_until_interruptible(process: int) -> None:
    """Until a process catches SIGTERM, which Python by itself does not; a loaded machine takes long to start it."""
    status = Path(f"/proc/{process}/status")
    for _ in range(600):
        if not status.exists():
            time.sleep(4.0)
            return
        caught = next(line for line in status.read_text().splitlines() if line.startswith("SigCgt:"))
        if int(caught.split()[1], 16) >> (signal.SIGTERM - 1) & 1:
            return
        time.sleep(0.1)
    pytest.fail("the process never came to its search")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_ctrl_c_leaves_a_partial_result_and_no_broken_file(number: int, folder: Path) -> None:
    before = contents(folder)
    command = [sys.executable, "-m", "setrl", "verify", "policy.onnx", "--spec", "hopeless.yaml", "--json"]
    with subprocess.Popen(
        [*command, "--splits", "1000000", "--plot", "a.png"],
        cwd=folder,
        env=ENVIRONMENT,
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    ) as process:
        wait_until_interruptible(process.pid)  # the search goes on for hours
        process.send_signal(number)
        out, err = process.communicate(timeout=60)
    assert process.returncode == 5, (out, err)
    data = json.loads(out)
    assert data["verdict"] == "UNKNOWN" and "interrupted" in data["reason"]["sentence"]
    assert "stopping with what was found" in err
    assert contents(folder).keys() - before.keys() == {"a.png"}
    assert (folder / "a.png").read_bytes().startswith(b"\x89PNG")


def test_the_second_ctrl_c_aborts() -> None:
    code = (
        "import os, signal\n"
        "from setrl.verify.interruption import interruptible\n"
        "with interruptible(None) as deadline:\n"
        "    os.kill(os.getpid(), signal.SIGINT)\n"
        "    assert deadline.interrupted and deadline.expired\n"
        "    try:\n"
        "        os.kill(os.getpid(), signal.SIGINT)\n"
        "    except KeyboardInterrupt:\n"
        "        print('aborted')\n"
        "assert signal.getsignal(signal.SIGINT) is signal.default_int_handler\n"
    )
    outcome = subprocess.run([sys.executable, "-c", code], env=ENVIRONMENT, capture_output=True, text=True)
    assert outcome.stdout == "aborted\n", outcome.stderr


def test_a_closed_pipe_is_no_crash(folder: Path) -> None:
    command = f"{sys.executable} -m setrl schema specification | head -c 1; echo ${{PIPESTATUS[0]}}"
    outcome = subprocess.run(["bash", "-c", command], env=ENVIRONMENT, capture_output=True, text=True)
    assert outcome.stdout in ("{141\n", "{0\n") and "Traceback" not in outcome.stderr, outcome


def test_the_program_ends_with_the_exit_code(folder: Path) -> None:
    for arguments, code in ((QUICKLY, 0), (HOPELESSLY, 5), (("policy.onnx",), 2)):
        command = [sys.executable, "-m", "setrl", "verify", *arguments]
        outcome = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
        assert outcome.returncode == code, outcome.stderr


def test_a_file_is_written_whole_or_not_at_all(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    target = folder / "quick.yaml"
    target.chmod(0o600)
    before = contents(folder)

    def fail(_: int) -> None:
        raise OSError(28, "No space left on device")

    with monkeypatch.context() as patched:
        patched.setattr(os, "fsync", fail)
        with pytest.raises(InputError, match="No space left"):
            write_atomically(target, b"new")
    assert contents(folder) == before
    write_atomically(target, b"new")
    assert target.read_bytes() == b"new" and target.stat().st_mode & 0o777 == 0o600


def test_a_file_behind_a_link_is_replaced_and_the_link_stays(folder: Path) -> None:
    (folder / "link.yaml").symlink_to("quick.yaml")
    write_atomically(folder / "link.yaml", b"new")
    assert (folder / "link.yaml").is_symlink() and (folder / "quick.yaml").read_bytes() == b"new"


def test_standard_output_can_be_named_as_a_file(folder: Path) -> None:
    command = [sys.executable, "-m", "setrl", "simulate", *QUICKLY, "--rollouts", "1", "--csv", "/dev/stdout", "--json"]
    outcome = subprocess.run(command, cwd=folder, env=ENVIRONMENT, capture_output=True, text=True)
    assert outcome.returncode == 0 and "trajectory,time,z,zdot" in outcome.stdout, outcome.stderr


def test_the_exit_codes_are_those_of_the_documentation() -> None:
    assert (exit_codes.OK, exit_codes.FALSIFIED, exit_codes.UNKNOWN) == (0, 10, 5)
    assert (exit_codes.BAD_INPUT, exit_codes.INTERNAL) == (2, 6)
