"""An import points left: specs <- models <- verify <- train <- cli; torch stays in train; three islands in verify."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

pytest.importorskip("importlinter", reason="import-linter is part of the extra `dev`")

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("specs", "models", "verify", "train", "commands")
BLOCKED = "import sys; sys.modules['torch'] = sys.modules['gymnasium'] = None; import setrl"


def lint_imports(path: Path, *, root: Path = ROOT) -> subprocess.CompletedProcess[str]:
    """Run the contracts of `root`'s pyproject.toml on the setrl below `path`."""
    command = [sys.executable, "-c", "from importlinter.cli import lint_imports_command; lint_imports_command()"]
    return subprocess.run(
        [*command, "--no-logo", "--no-cache", "--config", str(root / "pyproject.toml")],
        cwd=path,
        env={**os.environ, "PYTHONPATH": str(path), "NO_COLOR": "1"},
        capture_output=True,
        text=True,
    )


@pytest.fixture
def copy(tmp_path: Path) -> Path:
    """A copy of the package's modules that may be spoilt."""
    package = tmp_path / "setrl"
    package.mkdir()
    for name in ("__init__.py", "__main__.py", "cli.py"):
        shutil.copy(ROOT / name, package)
    for room in ROOMS:
        shutil.copytree(ROOT / room, package / room, ignore=shutil.ignore_patterns("__pycache__"))
    return tmp_path


def test_every_import_points_left() -> None:
    outcome = lint_imports(ROOT / ".src")
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr


@pytest.mark.parametrize(
    ("file", "line", "contract"),
    [
        ("specs/spoilt.py", "from .. import models", "specs <- models"),
        ("models/spoilt.py", "from ..verify import rounding", "specs <- models"),
        ("verify/spoilt.py", "def f():\n    import torch", "never import torch"),
        ("specs/spoilt.py", "import numpy", "specs knows no numbers"),
        ("verify/spoilt.py", "from . import falsifier", "the engine imports no"),
        ("verify/spoilt.py", "from .checker import reader", "the engine imports no"),
        ("verify/falsifier.py", "from . import rounding", "the falsifier imports no"),
        ("verify/checker/reader.py", "from .. import rounding", "the checker imports no"),
        ("verify/checker/reader.py", "import numpy", "the checker imports no"),
    ],
)
def test_a_contract_rejects_an_import_to_the_right(copy: Path, file: str, line: str, contract: str) -> None:
    package = copy / "setrl"
    (package / "verify" / "checker").mkdir(exist_ok=True)
    for name in ("rounding.py", "falsifier.py", "checker/__init__.py", "checker/reader.py"):
        if not (package / "verify" / name).exists():
            (package / "verify" / name).write_text("")
    (package / file).write_text(line + "\n")
    outcome = lint_imports(copy)
    broken = [text for text in outcome.stdout.splitlines() if "BROKEN" in text]
    assert outcome.returncode != 0
    assert any(contract in text for text in broken), outcome.stdout + outcome.stderr


def modules_of(room: str) -> list[str]:
    files = sorted((ROOT / room).rglob("*.py"))
    names = [".".join(("setrl", *file.relative_to(ROOT).with_suffix("").parts)) for file in files]
    return [name.removesuffix(".__init__") for name in names]


@pytest.mark.parametrize("room", ["specs", "models", "verify"])
def test_a_room_is_importable_without_torch(room: str) -> None:
    statement = "; ".join([BLOCKED, *(f"import {name}" for name in modules_of(room))])
    outcome = subprocess.run(
        [sys.executable, "-c", statement],
        env={**os.environ, "PYTHONPATH": str(ROOT / ".src")},
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 0, outcome.stderr


@pytest.mark.parametrize("line", ["import verify", "from models import policy", "import specs.errors"])
def test_the_linter_bans_a_bare_room(line: str) -> None:
    pytest.importorskip("ruff", reason="ruff is part of the extra `dev`")
    outcome = subprocess.run(
        [
            sys.executable,
            "-m",
            "ruff",
            "check",
            "--no-cache",
            "--select",
            "TID251",
            "--stdin-filename",
            "tests/x.py",
            "-",
        ],
        cwd=ROOT,
        input=line + "\n",
        capture_output=True,
        text=True,
    )
    assert outcome.returncode == 1 and "TID251" in outcome.stdout
