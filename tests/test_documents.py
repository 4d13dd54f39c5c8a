"""What the documentation says is run: its console lines with their exit codes, its Python blocks, its links.

A page's blocks run from top to bottom in one folder of its own, which holds the shipped policy as ``policy.onnx``.
A console line ``$ command  # exit 5`` states its exit code, 0 where nothing is said; ``console no-run`` is only read.
A yaml block that begins with ``# name.yaml`` is that file.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

import setrl.cli
from setrl.models.example import example_policy_path

ROOT = Path(__file__).resolve().parents[1]
PAGES = sorted([*ROOT.glob("*.md"), *(ROOT / "docs").glob("*.md")])
FENCE = re.compile(r"^(?P<indent> *)```(?P<info>[^\n`]*)\n(?P<body>.*?)^(?P=indent)```\s*$", re.MULTILINE | re.DOTALL)
EXIT = re.compile(r"#\s*exit (\d+)\s*$")
FILE = re.compile(r"# ([\w-]+\.yaml)\n")
LINK = re.compile(r"\]\(([^)\s#]+)(?:#[^)]*)?\)")

landed = pytest.mark.skipif(
    getattr(setrl.cli, "PLACEHOLDER", False), reason="the documentation describes commands that have not landed yet"
)


@dataclass(frozen=True)
class Block:
    """A fenced block: its language, the rest of its first line, its text and the line it starts on."""

    language: str
    flags: tuple[str, ...]
    body: str
    line: int


def blocks(text: str) -> list[Block]:
    found = []
    for match in FENCE.finditer(text):
        language, *flags = match["info"].split() or [""]
        found.append(Block(language, tuple(flags), match["body"], text.count("\n", 0, match.start()) + 1))
    return found


def commands(block: Block) -> list[tuple[str, int]]:
    """Commands of a console block with the exit codes they state; a trailing backslash continues a line."""
    lines = re.sub(r"\\\n(?:> )?", "", block.body).splitlines()
    stated = [(line[2:], EXIT.search(line)) for line in lines if line.startswith("$ ")]
    return [(command, int(code[1]) if code else 0) for command, code in stated]


def runnable(page: Path) -> list[Block]:
    return [
        block
        for block in blocks(page.read_text(encoding="utf-8"))
        if block.language in ("console", "python", "yaml") and "no-run" not in block.flags
    ]


@pytest.fixture
def folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A folder with the shipped policy, in which `setrl` is this checkout's."""
    programs, work = tmp_path / "bin", tmp_path / "work"
    programs.mkdir()
    work.mkdir()
    (programs / "setrl").write_text(f'#!/bin/sh\nexec "{sys.executable}" -m setrl "$@"\n')
    (programs / "setrl").chmod(0o755)
    shutil.copy(example_policy_path(), work / "policy.onnx")
    monkeypatch.setenv("PATH", f"{programs}{os.pathsep}{os.environ['PATH']}")
    monkeypatch.setenv("PYTHONPATH", str(ROOT / ".src"))
    monkeypatch.setenv("MPLBACKEND", "Agg")
    monkeypatch.chdir(work)
    return work


def run_command(command: str, expected: int, where: str) -> None:
    outcome = subprocess.run(["bash", "-c", command], capture_output=True, text=True, stdin=subprocess.DEVNULL)
    report = f"{where}: $ {command}\nexit {outcome.returncode}, stated {expected}\n{outcome.stdout}{outcome.stderr}"
    assert outcome.returncode == expected, report
    assert "Traceback" not in outcome.stderr, report


def run_page(page: Path) -> None:
    names: dict[str, Any] = {"__name__": "__main__"}
    for block in runnable(page):
        where = f"{page.name}:{block.line}"
        if block.language == "python":
            exec(compile("\n" * block.line + block.body, str(page), "exec"), names)  # noqa: S102
        elif name := FILE.match(block.body):
            Path(name[1]).write_text(block.body, encoding="utf-8")
        elif block.language == "console":
            for command, expected in commands(block):
                run_command(command, expected, where)


LONG = {"train.md", "witness.md", "methods.md", "sweep.md", "simulate.md", "certificate.md"}
"""Pages whose commands take ten seconds and more, and are tested one by one elsewhere too."""


@landed
@pytest.mark.parametrize(
    "page",
    [
        pytest.param(page, marks=pytest.mark.slow if page.name in LONG else (), id=page.name)
        for page in PAGES
        if runnable(page)
    ],
)
def test_a_page_does_what_it_says(page: Path, folder: Path) -> None:
    run_page(page)


@landed
@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_every_link_of_a_page_leads_somewhere(page: Path) -> None:
    text = FENCE.sub("", page.read_text(encoding="utf-8"))
    links = [link for link in LINK.findall(text) if "://" not in link]
    assert [link for link in links if not (page.parent / link).exists()] == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_console_blocks_hold_commands_of_setrl_or_are_not_run(page: Path) -> None:
    for block in runnable(page):
        if block.language == "console":
            assert commands(block), f"{page.name}:{block.line}: a console block needs a line that begins with `$ `"
            for command, _ in commands(block):
                assert command.startswith("setrl "), f"{page.name}:{block.line}: {command}"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("```console\n$ setrl --version  # exit 2\n```\n", "stated 2"),
        ("```console\n$ setrl no-such-command\n```\n", "exit 2, stated 0"),
        ("```python\nx = 1\n```\n```python\nassert x == 2\n```\n", ""),
    ],
)
def test_a_page_that_says_something_else_fails(text: str, message: str, folder: Path) -> None:
    page = folder / "page.md"
    page.write_text(text)
    with pytest.raises(AssertionError, match=message or None):
        run_page(page)


def test_a_page_that_is_right_passes(folder: Path) -> None:
    page = folder / "page.md"
    page.write_text(
        "```console\n$ setrl --version > version.txt\n$ setrl \\\n  no-such-command   # why # exit 2\n```\n"
        "```python\nimport pathlib, setrl\n```\n"
        "```python\nassert setrl.__version__ in pathlib.Path('version.txt').read_text()\n```\n"
        "```yaml\n# some.yaml\na: 1\n```\n```python\nassert pathlib.Path('some.yaml').exists()\n```\n"
        "```console no-run\n$ exit 3\n```\n"
    )
    run_page(page)
