"""Start-up is quick because nothing heavy is imported; what is imported can be tested without a clock."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

import setrl

ROOT = Path(__file__).resolve().parents[1]
HEAVY = (
    "control",
    "cvxpy",
    "flint",
    "matplotlib",
    "numpy",
    "onnx",
    "onnxruntime",
    "pandas",
    "pydantic",
    "scipy",
    "torch",
)


def modules_after(statement: str) -> set[str]:
    """Top-level names in sys.modules of a fresh interpreter after one statement."""
    code = f"import sys\n{statement}\nprint(*sorted({{name.partition('.')[0] for name in sys.modules}}))"
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    output = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True, check=True)
    return set(output.stdout.splitlines()[-1].split())


@pytest.mark.parametrize(
    "statement",
    [
        "import setrl",
        "import setrl.cli",
        "import setrl; assert 'verify' in dir(setrl)",
        "from setrl.cli import main\ntry:\n    main(['--help'])\nexcept SystemExit as end:\n    assert end.code == 0",
    ],
    ids=["the package", "the command line", "dir of the package", "--help"],
)
def test_start_up_imports_no_heavy_module(statement: str) -> None:
    assert not modules_after(statement) & set(HEAVY)


def test_the_probe_sees_a_heavy_module() -> None:
    assert "numpy" in modules_after("import setrl, numpy")


def test_specs_are_read_without_a_numbers_library() -> None:
    assert not modules_after("import setrl.specs.specification") & (set(HEAVY) - {"pydantic"})


def test_every_public_name_is_found() -> None:
    assert all(getattr(setrl, name) is not None for name in setrl.__all__)


def test_a_name_that_is_not_public_is_an_attribute_error() -> None:
    with pytest.raises(AttributeError, match="no_such_name"):
        _ = setrl.no_such_name
