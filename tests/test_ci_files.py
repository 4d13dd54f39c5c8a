"""The files of CI say what the program does: their options exist, their scripts run, what they name is there."""

from __future__ import annotations

import json
import os
import re
import shlex
import shutil
import subprocess
import sys
from itertools import chain
from pathlib import Path
from typing import Any

import pytest
import typer.main
import yaml

import setrl.cli
from setrl.models.example import shipped_policies
from setrl.specs.manifest import read_manifest

ROOT = Path(__file__).resolve().parents[1]
EXAMPLE = ROOT / "examples" / "ci"
PAGE = ROOT / "docs" / "ci.md"
FILES = {
    "action": ROOT / "action.yml",
    "hooks": ROOT / ".pre-commit-hooks.yaml",
    "workflow": EXAMPLE / ".github" / "workflows" / "certify.yml",
    "gitlab": EXAMPLE / ".gitlab-ci.yml",
    "pre-commit": EXAMPLE / ".pre-commit-config.yaml",
}
USED = "your-organisation/setrl"
OUTCOMES = {0: "passed", 5: "unknown", 10: "falsified", 2: "error", 6: "internal", 130: "stopped", 127: "internal"}
EXPRESSION = re.compile(r"\$\{\{\s*(.*?)\s*\}\}")
BLOCK = re.compile(r"^```yaml\n(.*?)^```$", re.MULTILINE | re.DOTALL)


def read(name: str) -> Any:
    return yaml.safe_load(FILES[name].read_text(encoding="utf-8"))


def action() -> Any:
    return read("action")


def step_of(steps: Any, name: str) -> Any:
    (found,) = [step for step in steps if step.get("name") == name]
    return found


def page_blocks() -> list[Any]:
    return [yaml.safe_load(text) for text in BLOCK.findall(PAGE.read_text(encoding="utf-8"))]


def walk(data: Any) -> Any:
    """Every mapping inside."""
    if isinstance(data, dict):
        yield data
    for part in data.values() if isinstance(data, dict) else data if isinstance(data, list) else ():
        yield from walk(part)


def certify_command() -> Any:
    return typer.main.get_command(setrl.cli.app).commands["certify"]  # type: ignore[attr-defined]


def options_of_certify() -> set[str]:
    return set(chain.from_iterable(parameter.opts for parameter in certify_command().params))


def require_command(line: str) -> None:
    """The line is one of `setrl certify` with options that it has and values that it takes."""
    words = shlex.split(line)
    assert words[:2] == ["setrl", "certify"], line
    certify_command().make_context("certify", words[2:])


@pytest.mark.parametrize("name", FILES)
def test_a_file_is_yaml_and_says_nothing_to_a_shell_that_an_input_could_change(name: str) -> None:
    for mapping in walk(read(name)):
        if "run" in mapping:
            assert not EXPRESSION.search(mapping["run"]), mapping["run"]


def test_inputs_of_the_action_are_declared_and_used() -> None:
    text = FILES["action"].read_text(encoding="utf-8")
    used = set(re.findall(r"\binputs\.([\w-]+)", text))
    assert used == set(action()["inputs"])
    assert all({"description", "default"} <= set(entry) for entry in action()["inputs"].values())


def test_outputs_of_the_action_are_those_that_its_step_writes() -> None:
    script = step_of(action()["runs"]["steps"], "Certify")["run"]
    written = set(re.findall(r'echo "([\w-]+)=', script))
    text = FILES["action"].read_text(encoding="utf-8")
    assert set(re.findall(r"steps\.certify\.outputs\.([\w-]+)", text)) == written
    for name, entry in action()["outputs"].items():
        assert entry["value"] == f"${{{{ steps.certify.outputs.{name} }}}}"


def test_what_has_to_happen_after_a_failure_does() -> None:
    steps = action()["runs"]["steps"]
    after = steps[steps.index(step_of(steps, "Certify")) + 1 :]
    assert len(after) == 3 and all("always()" in step["if"] for step in after)


def test_only_evidence_is_cached_never_a_report() -> None:
    steps = action()["runs"]["steps"]
    restore, save = (
        step_of(steps, name)["with"] for name in ("Restore what was proved before", "Keep what was proved")
    )
    assert restore["path"] == save["path"] and restore["key"] == save["key"]
    kept = [line.rpartition("/")[2] for line in restore["path"].split("\n") if line]
    assert kept == ["journal.jsonl", "certificates", "witnesses"]
    cached = read("gitlab")["certify"]["cache"]["paths"]
    assert [Path(path).name for path in cached] == kept


def test_every_option_in_the_action_is_one_of_certify() -> None:
    script = step_of(action()["runs"]["steps"], "Certify")["run"]
    written = set(re.findall(r"(?<=[( ])--[a-z][a-z-]*", script))
    assert written == {"--out", "--workers", "--baseline", "--tolerance", "--recheck"}
    assert written <= options_of_certify()


def test_every_line_for_a_shell_is_a_command_of_setrl() -> None:
    lines = [line for line in read("gitlab")["certify"]["script"] if line.startswith("setrl")]
    (hook,) = read("hooks")
    lines.append(" ".join([hook["entry"], *hook["args"]]))
    for block in page_blocks():
        lines += [line for mapping in walk(block) for line in mapping.get("script", []) if line.startswith("setrl")]
    console = re.findall(
        r"^\$ (?:RAY_ADDRESS=\S+ )?(setrl certify .*)$", PAGE.read_text(encoding="utf-8"), re.MULTILINE
    )
    assert len(lines) == 3 and len(console) == 5
    for line in [*lines, *console]:
        require_command(line)


def test_a_command_with_an_option_that_does_not_exist_is_found() -> None:
    with pytest.raises(Exception, match="--no-such-option"):
        require_command("setrl certify certification.yaml --no-such-option")


def test_whoever_uses_the_action_gives_inputs_and_reads_outputs_that_it_has() -> None:
    found = 0
    for data in [read("workflow"), *page_blocks()]:
        for mapping in walk(data):
            if str(mapping.get("uses", "")).startswith(USED):
                found += 1
                assert set(mapping.get("with", {})) <= set(action()["inputs"])
                words = mapping.get("with", {}).get("arguments", "")
                require_command(f"setrl certify certification.yaml {words}")
    assert found == 3
    text = FILES["workflow"].read_text(encoding="utf-8")
    assert set(re.findall(r"steps\.certify\.outputs\.([\w-]+)", text)) == set(action()["outputs"])


def test_the_page_lists_every_input_with_its_default_and_every_output() -> None:
    rows = re.findall(r"^\| ((?:`[\w-]+`(?:, )?)+) \|(.*)\|$", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    listed = {name: rest.split("|")[0].strip() for names, rest in rows for name in re.findall(r"`([\w-]+)`", names)}
    for name, entry in action()["inputs"].items():
        assert listed[name] == (f"`{entry['default']}`" if entry["default"] else ""), name
    assert set(action()["outputs"]) <= set(listed)
    said = PAGE.read_text(encoding="utf-8")
    assert all(f"`{outcome}`" in said for outcome in OUTCOMES.values())


def test_the_page_shows_the_job_of_the_example() -> None:
    (shown,) = [block["certify"] for block in page_blocks() if "script" in block.get("certify", {})]
    kept = read("gitlab")["certify"]
    assert {key: shown[key] for key in shown if key != "script"} == {key: kept[key] for key in kept if key != "script"}


def test_hooks_that_are_used_exist_and_run_for_policies_and_specifications() -> None:
    (hook,) = read("hooks")
    used = [entry["id"] for repository in read("pre-commit")["repos"] for entry in repository["hooks"]]
    assert used == [hook["id"]] and hook["language"] == "python" and hook["pass_filenames"] is False
    chosen = [
        name for name in ("a/p.onnx", "s.yaml", "s.yml", "README.md", "onnx.py") if re.search(hook["files"], name)
    ]
    assert chosen == ["a/p.onnx", "s.yaml", "s.yml"]


def test_what_the_files_name_is_there() -> None:
    manifest = read_manifest(EXAMPLE / "certification.yaml")
    for entry in manifest.entries:
        assert all(list(EXAMPLE.glob(pattern)) for pattern in (*entry.policies, *entry.specifications))
    rows = re.findall(r"^\| `([^`]+)` \|", (EXAMPLE / "README.md").read_text(encoding="utf-8"), re.MULTILINE)
    assert len(rows) == 7 and all((EXAMPLE / name).exists() for name in rows)
    assert (ROOT / "constraints.txt").is_file()  # of the action's installation
    assert action()["inputs"]["manifest"]["default"] == read("hooks")[0]["args"][0] == "certification.yaml"
    ignored = (EXAMPLE / ".gitignore").read_text(encoding="utf-8").split()
    assert f"{action()['inputs']['out']['default']}/" in ignored


def test_policies_of_the_example_are_shipped_ones() -> None:
    shipped = {path.name: path.read_bytes() for path in shipped_policies()}
    policies = sorted((EXAMPLE / "policies").iterdir())
    assert policies and all(path.read_bytes() == shipped[path.name] for path in policies)


def run_script(script: str, folder: Path, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    """A step of a workflow, as the runner calls bash; fake programs come first."""
    path = f"{folder / 'bin'}{os.pathsep}{os.environ['PATH']}"
    command = ["bash", "--noprofile", "--norc", "-eo", "pipefail", "-c", script]
    files = {"GITHUB_OUTPUT": str(folder / "output"), "GITHUB_STEP_SUMMARY": str(folder / "summary")}
    return subprocess.run(
        command, cwd=folder, env={"PATH": path, **files, **environment}, capture_output=True, text=True
    )


def program(folder: Path, name: str, body: str) -> None:
    """A program that notes its arguments, one a line, and then does what `body` says."""
    (folder / "bin").mkdir(exist_ok=True)
    file = folder / "bin" / name
    file.write_text(f'#!/bin/bash\nprintf "%s\\n" "$@" >> "{folder / "called"}"\n{body}\n')
    file.chmod(0o755)


def environment_of(step: Any, **given: str) -> dict[str, str]:
    """A step's `env` with the action's defaults, and inputs of one's own by name."""
    inputs = {name: str(entry["default"]) for name, entry in action()["inputs"].items()} | given
    values = {f"inputs.{name}": value for name, value in inputs.items()} | {"github.action_path": "/the action"}
    return {key: values[EXPRESSION.fullmatch(text)[1]] for key, text in step["env"].items()}  # type: ignore[index]


def certify(folder: Path, code: int, writes: str = "", **given: str) -> tuple[int, dict[str, str], list[str], str]:
    """Exit code, outputs, arguments of setrl, and summary of the action's step where setrl ends with a code."""
    step = step_of(action()["runs"]["steps"], "Certify")
    program(folder, "setrl", f"{writes}\nexit {code}")
    ended = run_script(step["run"], folder, environment_of(step, **given))
    lines = (folder / "output").read_text().splitlines()
    summary = folder / "summary"
    outputs = dict(line.split("=", 1) for line in lines)
    called = (folder / "called").read_text().splitlines()
    return ended.returncode, outputs, called, summary.read_text() if summary.exists() else ""


REPORTS = """mkdir -p certification
echo '## report' > certification/summary.md
touch certification/{certification.json,certification.sarif,alerts.sarif}"""


@pytest.mark.parametrize("code", OUTCOMES)
def test_the_step_ends_as_certify_ended_and_says_so(code: int, tmp_path: Path) -> None:
    (tmp_path / "summary").write_text("of an earlier step\n")
    ended, outputs, called, summary = certify(tmp_path, code, REPORTS)
    assert ended == code
    assert outputs == {
        "exit-code": str(code),
        "outcome": OUTCOMES[code],
        "report": "certification/certification.json",
        "sarif": "certification/alerts.sarif",
    }
    assert called == ["certify", "--out", "certification", "--", "certification.yaml"]
    assert summary == "of an earlier step\n## report\n"


def test_without_reports_there_is_none_to_show(tmp_path: Path) -> None:
    ended, outputs, _, summary = certify(tmp_path, 2)
    assert (ended, outputs, summary) == (2, {"exit-code": "2", "outcome": "error"}, "")


def test_inputs_become_the_arguments_of_certify(tmp_path: Path) -> None:
    given = {"workers": "3", "baseline": "old report.json", "tolerance": "0.01", "recheck": "true"}
    _, _, called, _ = certify(
        tmp_path, 0, manifest="the manifest.yaml", out="a folder", arguments=" --executor ray  --spread 4 ", **given
    )
    expected = [
        "certify",
        "--out",
        "a folder",
        "--workers",
        "3",
        "--baseline",
        "old report.json",
        "--tolerance",
        "0.01",
    ]
    assert called == [*expected, "--recheck", "--executor", "ray", "--spread", "4", "--", "the manifest.yaml"]


def test_no_input_becomes_a_command_or_an_option(tmp_path: Path) -> None:
    attack = '"; touch broken; $(touch broken) `touch broken` *'
    names = ("manifest", "out", "workers", "baseline", "tolerance", "arguments")
    _, _, called, _ = certify(tmp_path, 0, recheck="yes", **dict.fromkeys(names, attack))
    assert not (tmp_path / "broken").exists()
    assert called[:9] == ["certify", "--out", attack, "--workers", attack, "--baseline", attack, "--tolerance", attack]
    assert called[9:] == [*attack.split(), "--", attack]
    assert "--recheck" not in called
    (tmp_path / "called").unlink()
    assert certify(tmp_path, 0, manifest="--json")[2][-2:] == ["--", "--json"]


@pytest.mark.parametrize(("extras", "expected"), [("", "/the action"), ("ray", "/the action[ray]")])
def test_the_action_installs_its_own_files(extras: str, expected: str, tmp_path: Path) -> None:
    step = step_of(action()["runs"]["steps"], "Install setrl")
    program(tmp_path, "python", "")
    assert run_script(step["run"], tmp_path, environment_of(step, extras=extras)).returncode == 0
    called = (tmp_path / "called").read_text().splitlines()
    assert called[:3] == ["-m", "pip", "install"] and called[-3:] == ["-c", "/the action/constraints.txt", expected]


@pytest.mark.parametrize(
    ("run", "downloads", "expected"), [("", 0, ""), ("7", 1, ""), ("7", 0, "report=baseline/certification.json\n")]
)
def test_a_pull_request_is_compared_where_the_main_branch_has_a_report(
    run: str, downloads: int, expected: str, tmp_path: Path
) -> None:
    step = step_of(read("workflow")["jobs"]["certify"]["steps"], "Report of the main branch")
    program(tmp_path, "gh", f'if [ "$2" = list ]; then echo "{run}"; else exit {downloads}; fi')
    (tmp_path / "output").touch()
    ended = run_script(step["run"], tmp_path, {"BRANCH": "main", "GH_TOKEN": "none"})
    assert ended.returncode == 0, ended.stderr
    assert (tmp_path / "output").read_text() == expected


def test_the_example_passes_and_writes_only_what_git_ignores(tmp_path: Path) -> None:
    folder = tmp_path / "repository"
    shutil.copytree(EXAMPLE, folder, ignore=shutil.ignore_patterns("certification"))
    before = {path.name for path in folder.iterdir()}
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    command = [sys.executable, "-m", "setrl", "certify", "certification.yaml"]
    ended = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True)
    assert ended.returncode == 0, ended.stdout + ended.stderr
    report = json.loads((folder / "certification" / "certification.json").read_text(encoding="utf-8"))
    assert len(report["rows"]) == 4 and all(row["outcome"] == "VERIFIED" and row["passed"] for row in report["rows"])
    assert {path.name for path in folder.iterdir()} - before == {"certification"}
    shown = re.findall(r"^\| `([\w.]+)`", PAGE.read_text(encoding="utf-8"), re.MULTILINE)
    reports = {
        name for name in shown if Path(name).suffix in (".md", ".xml", ".sarif", ".html", ".json", ".csv", ".jsonl")
    }
    assert len(reports) == 8 and all((folder / "certification" / name).is_file() for name in reports)
