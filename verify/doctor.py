"""What the engine assumes about the machine it runs on, tested and measured; and what a bug report must say."""

from __future__ import annotations

import math
import os
import platform
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from importlib import metadata
from typing import TYPE_CHECKING, Any

from . import rounding
from .report import table
from .runtime_error import RUNTIME_ERROR, RuntimeMeasurement, runtime_error, runtime_name, runtime_note
from .wording import at_most

if TYPE_CHECKING:
    from .runtime_measurement import MeasurementProgress

PACKAGES = ("numpy", "scipy", "onnx", "onnxruntime", "cvxpy", "control", "matplotlib", "python-flint", "typer", "torch")


def examine() -> dict[str, Any]:
    """Test the assumptions of `rounding` and collect versions.

    Returns
    -------
    dict
        ``setrl``, ``python``, ``platform``, ``processor``, ``cpus``, ``packages`` (name to version, None where it is
        not installed), ``blas`` (list of text), ``runtime`` (``name``, ``error``: the constants that claims use for its
        tanh and sigmoid, ``note``: what is missing, or None), ``problems`` (list of sentences; empty where nothing is
        wrong).
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
        "runtime": {"name": runtime_name(), "error": _constants(), "note": runtime_note()},
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
    runtime = facts["runtime"]
    rows += [("runtime", f"tanh and sigmoid of {runtime['name']} within {_powers(runtime['error'])}")]
    rows += [("runtime", runtime["note"])] if runtime["note"] else []
    tested = "IEEE binary64, rounding to nearest, subnormals, matrix products"
    rows += [("arithmetic", f"as the engine assumes it: {tested}")] if not facts["problems"] else []
    rows += [("arithmetic", problem) for problem in facts["problems"]]
    return table(rows)


def measurement_lines(measurement: RuntimeMeasurement) -> list[str]:
    """What `setrl doctor --runtime` measured, for people; bounds are rounded up."""
    rows = [("function", "inputs", "off by", "at", "results", "in small batches")]
    for entry in measurement.functions:
        inputs = f"{entry.inputs}, {'all finite numbers' if entry.exhaustive else 'sampled'}"
        place, results = f"{entry.place:.9g}", f"{entry.least:.10g} to {entry.most:.10g}"
        others = (
            f"{entry.different} of {entry.small} inputs differ" if entry.different else f"{entry.small} inputs alike"
        )
        rows.append((f"{entry.function} {entry.precision}", inputs, at_most(entry.distance, 3), place, results, others))
    minutes = f"{measurement.runtime}, {measurement.machine} ({measurement.processor}), {measurement.seconds:.0f} s"
    return [*table(rows), minutes, f"claims use {_powers(_constants())}"]


@contextmanager
def measurement_bar(wanted: bool) -> Iterator[Callable[[MeasurementProgress], None] | None]:
    """A callback that draws on stderr how far a measurement is; None where nobody watches.

    Parameters
    ----------
    wanted : bool
    """
    if not (wanted and sys.stderr.isatty()):
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn

    from .runtime_measurement import progress_line

    columns = (BarColumn(), TextColumn("{task.description}"))
    with Progress(*columns, console=Console(stderr=True), transient=True) as bar:
        task = bar.add_task("first inputs", total=1.0)

        def update(state: MeasurementProgress) -> None:
            bar.update(task, completed=state.done / state.total, description=progress_line(state))

        yield update


def _constants() -> dict[str, float]:
    """The constants that claims use."""
    return {precision: runtime_error(precision) for precision in RUNTIME_ERROR}


def _powers(constants: Mapping[str, float]) -> str:
    """Powers of two in words: 2^-21 in float32, 2^-48 in float64."""
    return ", ".join(f"2^{math.frexp(value)[1] - 1} in {precision}" for precision, value in constants.items())
