"""Fixtures that several tests share."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]


@pytest.fixture(scope="session")
def nav_folder() -> Path:
    """Folder with the two networks of the ARCH-COMP benchmark NAV; they are public data, but not part of setrl."""
    given = os.environ.get("SETRL_NAV")
    folder = Path(given) if given else ROOT.parent / "shared" / "data" / "nav"
    missing = [name for name in ("nn-nav-point.onnx", "nn-nav-set.onnx") if not (folder / name).is_file()]
    if missing:
        pytest.skip(f"ARCH-COMP networks {', '.join(missing)} are not in {folder}; SETRL_NAV names their folder")
    return folder
