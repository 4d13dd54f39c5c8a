"""What the engine assumes about the machine it runs on, tested; and what a bug report must say."""

from __future__ import annotations

import os
import platform
from importlib import metadata
from typing import Any

from . import rounding
from .report import table

PACKAGES = ("numpy", "scipy", "onnx", "onnxruntime", "cvxpy", "control", "matplotlib", "python-flint", "typer", "torch")


def examine() -> dict[str, Any]:
    """Test the assumptions of `rounding` and collect versions.

    Returns
    -------
    dict
        ``setrl``, ``python``, ``platform``, ``processor``, ``cpus``, ``packages`` (name to version, None where it is
        not installed), ``blas`` (list of text), ``problems`` (list of sentences; empty where nothing is wrong).
    """
    from .. import __version__

    return {
        "setrl": __version__,
        "python": platform.python_version(),
        "platform": platform.platform(),
        "processor": platform.machine(),
        "cpus": os.cpu_count(),
        "packages": {name: _version(name) for name in PACKAGES},
        "blas": _blas(),
        "problems": rounding.self_test(),
    }


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _blas() -> list[str]:
    """Libraries that do the matrix products: as loaded where threadpoolctl can tell, else as numpy was built."""
    try:
        from threadpoolctl import threadpool_info  # type: ignore[import-not-found, unused-ignore]
    except ImportError:
        import numpy as np

        built: Any = np.show_config(mode="dicts")
        found = built.get("Build Dependencies", {}).get("blas", {})
        return [f"{found.get('name', 'unknown')} {found.get('version', '')}".strip()]
    return [
        f"{entry['internal_api']} {entry['version']}, {entry['num_threads']} threads"
        for entry in threadpool_info()
        if entry["user_api"] == "blas"
    ]


def examination_lines(facts: dict[str, Any]) -> list[str]:
    """The facts of `examine` for people."""
    rows = [(name, str(facts[name])) for name in ("setrl", "python", "platform", "processor", "cpus")]
    rows += [(name, version or "not installed") for name, version in facts["packages"].items()]
    rows += [("blas", entry) for entry in facts["blas"]]
    tested = "IEEE binary64, rounding to nearest, subnormals, matrix products"
    rows += [("arithmetic", f"as the engine assumes it: {tested}")] if not facts["problems"] else []
    rows += [("arithmetic", problem) for problem in facts["problems"]]
    return table(rows)
