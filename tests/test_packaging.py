"""The wheel holds the package and its data, nothing else, and what it installs runs from any folder."""

from __future__ import annotations

import os
import subprocess
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest

import setrl
import setrl.cli

pytest.importorskip("hatchling", reason="hatchling is part of the extra `dev`")
pytest.importorskip("build", reason="build is part of the extra `dev`")

ROOT = Path(__file__).resolve().parents[1]
ROOMS = ("commands", "models", "specs", "train", "verify")
SOURCES = {"__init__.py", "__main__.py", "cli.py", "py.typed"}


@pytest.fixture(scope="module")
def wheel(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("wheel")
    command = [sys.executable, "-m", "build", "--wheel", "--no-isolation", "--outdir", str(folder), str(ROOT)]
    outcome = subprocess.run(command, cwd=folder, capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    (built,) = folder.glob("*.whl")
    return built


@pytest.fixture(scope="module")
def content(wheel: Path) -> set[str]:
    with zipfile.ZipFile(wheel) as archive:
        return set(archive.namelist())


@pytest.fixture(scope="module")
def program(wheel: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """`setrl` of a new environment, which has the wheel and borrows the dependencies of the one that runs the tests."""
    folder = tmp_path_factory.mktemp("environment")
    venv.create(folder, with_pip=False, symlinks=True)
    (python,) = (folder / "bin").glob("python")
    packages = Path(sysconfig.get_path("purelib", "venv", vars={"base": str(folder), "platbase": str(folder)}))
    command = [sys.executable, "-m", "pip", "--python", str(python), "install", "--quiet", "--no-deps", "--no-index"]
    outcome = subprocess.run([*command, str(wheel)], capture_output=True, text=True)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    # Appended to sys.path, so that the wheel comes first; as plain lines, so that .pth files there are not read and an
    # editable setrl stays out.
    (packages / "borrowed.pth").write_text(f"{sysconfig.get_path('purelib')}\n{sysconfig.get_path('platlib')}\n")
    return folder / "bin" / "setrl"


def run(program: Path, *arguments: str, folder: Path) -> subprocess.CompletedProcess[str]:
    environment = {name: value for name, value in os.environ.items() if name != "PYTHONPATH"}
    return subprocess.run([program, *arguments], cwd=folder, env=environment, capture_output=True, text=True)


def tracked(*patterns: str) -> set[str]:
    """Files of the rooms, as the checkout has them."""
    found = {path for room in ROOMS for pattern in patterns for path in (ROOT / room).rglob(pattern)}
    return {path.relative_to(ROOT).as_posix() for path in found}


def test_the_wheel_holds_every_module_and_data_file(content: set[str]) -> None:
    expected = SOURCES | tracked("*.py", "*.yaml", "*.onnx", "*.json")
    assert {f"setrl/{name}" for name in expected} <= content


def test_the_wheel_holds_nothing_but_the_package(content: set[str]) -> None:
    inside = {name for name in content if ".dist-info/" not in name}
    places = {Path(name).parts[1] for name in inside if name.startswith("setrl/")}
    assert all(name.startswith("setrl/") for name in inside)
    assert places == {*SOURCES, *ROOMS}
    assert not [name for name in inside if "__pycache__" in name]


def test_the_wheel_carries_its_licence(content: set[str]) -> None:
    assert f"setrl-{setrl.__version__}.dist-info/licenses/LICENSE" in content


def test_the_installed_program_is_the_wheel_s_and_runs_from_another_folder(program: Path, tmp_path: Path) -> None:
    outcome = run(program, "--version", folder=tmp_path)
    assert (outcome.returncode, outcome.stdout.strip()) == (0, f"setrl {setrl.__version__}"), outcome.stderr
    where = run(program.with_name("python"), "-c", "import setrl; print(setrl.__file__)", folder=tmp_path)
    assert Path(where.stdout.strip()).is_relative_to(program.parents[1])


@pytest.mark.skipif(getattr(setrl.cli, "PLACEHOLDER", False), reason="`setrl verify` has not landed yet")
def test_the_installed_program_verifies_the_shipped_example(program: Path, tmp_path: Path) -> None:
    outcome = run(program, "verify", folder=tmp_path)
    assert outcome.returncode == 0, outcome.stdout + outcome.stderr
    assert outcome.stdout.startswith("VERIFIED")


def test_an_unknown_command_is_a_usage_error(program: Path, tmp_path: Path) -> None:
    assert run(program, "no-such-command", folder=tmp_path).returncode == 2
