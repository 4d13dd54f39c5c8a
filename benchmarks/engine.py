"""Speed, memory and tightness of the engine: prints the table of docs/benchmarks.md.

    SETRL_NAV=folder python benchmarks/engine.py

The two ARCH-COMP 2024 NAV networks are looked up in the folder of the environment variable SETRL_NAV or in
``../shared/data/nav``. Times are CPU seconds, best of five, and ratios to a fixed numpy workload timed in the same run:
a ratio is comparable between machines, a time is not. BLAS is limited to one thread.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import platform
import resource
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from setrl.models.binding import bind
from setrl.models.closed_loop import ClosedLoop
from setrl.models.onnx_reader import read_policy
from setrl.specs.reader import find_specification, read_specification
from setrl.verify import rounding
from setrl.verify.closed_loop import Engine
from setrl.verify.deadline import Deadline
from setrl.verify.model import initial_box, observation_radius, prepare
from setrl.verify.options import Options
from setrl.verify.splitting import FAILED, PROVED, InitialSet, explore
from setrl.verify.verifier import verify

REPEATS = 5
TARGET_BOX = np.array([0.091, 0.026, 0.027, 0.223])


def nav_folder() -> Path:
    """Folder of the NAV networks."""
    folder = Path(os.environ.get("SETRL_NAV", Path(__file__).parents[2] / "shared" / "data" / "nav"))
    if not (folder / "nn-nav-set.onnx").exists():
        raise SystemExit(f"{folder} has no nn-nav-set.onnx; set SETRL_NAV to the folder of the ARCH-COMP NAV networks")
    return folder


def best(work: Callable[[], Any], repeats: int = REPEATS) -> float:
    """Best CPU time of several runs, seconds."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        work()
        times.append(time.process_time() - start)
    return min(times)


def reference() -> None:
    """The fixed workload: small array operations and matrix products, in about the engine's proportions."""
    small, matrix = np.linspace(0.0, 1.0, 100), np.linspace(-1.0, 1.0, 64 * 64).reshape(64, 64)
    for _ in range(20000):
        small + small
    for _ in range(500):
        matrix @ matrix


def run_cells(engine: Engine, count: int) -> None:
    """Move copies of the whole initial set through the horizon."""
    initial = InitialSet.of(*initial_box(engine.model.loop))
    factors = initial.free.size
    center, rows, radius = initial.cells(-np.ones((count, factors)), np.ones((count, factors)))
    observed = np.zeros((count, len(engine.model.loop.observation_names)))
    engine.run(engine.start(center, rows, radius, observed), lambda period: np.ones(period.index.size, dtype=bool))


def decide(loop: ClosedLoop) -> None:
    """The engine's part of a verdict: everything but reading, binding and simulation."""
    model = prepare(loop)
    engine = Engine(model, Options(), InitialSet.of(*initial_box(loop)).free.size)
    found = explore(engine, observation_radius(loop)[None], Deadline.after(None))
    if not (found.status[found.cells_of(0, PROVED, FAILED)] == PROVED).all():
        raise SystemExit("the benchmark's networks are expected to verify")


@contextmanager
def without_rounding() -> Iterator[None]:
    """Switch every rounding term off. Only here: nothing that is computed inside proves anything."""
    names = ("enlarged", "relative_error", "sum_error", "elementary_error", "product_factor", "product_error")
    names += ("lower", "upper", "up", "down")
    kept = {name: getattr(rounding, name) for name in names}
    rounding.enlarged = lambda x, roundings: x
    rounding.relative_error = lambda x, roundings: 0.0
    rounding.sum_error = lambda terms, magnitude: 0.0
    rounding.elementary_error = lambda value: 0.0
    rounding.product_factor = lambda terms: 0.0
    rounding.product_error = lambda terms, absolute, columns=1: 0.0 * absolute
    rounding.lower = lambda center, radius: center - radius
    rounding.upper = lambda center, radius: center + radius
    rounding.up = lambda x: x
    rounding.down = lambda x: x
    try:
        yield
    finally:
        for name, function in kept.items():
            setattr(rounding, name, function)


def command_seconds(*arguments: str) -> float:
    """Best wall time of a whole process, seconds."""
    times = []
    for _ in range(REPEATS):
        start = time.perf_counter()
        subprocess.run([sys.executable, "-m", "setrl", *arguments], check=True, capture_output=True)
        times.append(time.perf_counter() - start)
    return min(times)


def main() -> None:
    """Print the table."""
    folder = nav_folder()
    networks = {name: folder / f"nn-nav-{name}.onnx" for name in ("set", "point")}
    specification = read_specification(find_specification("nav"))
    loop = bind(specification, read_policy(networks["set"]))
    engine = Engine(prepare(loop), Options(), 2)
    unit = best(reference)
    rows: list[tuple[str, str, str, str]] = []

    def timed(what: str, seconds: float, limit: str) -> None:
        rows.append((what, f"{seconds:.3f} s", f"{seconds / unit:.2f}", limit))

    run_cells(engine, 1)
    timed("engine, NAV-set, one cell, flowpipe only", best(lambda: run_cells(engine, 1)), "")
    policies = {name: read_policy(path) for name, path in networks.items()}
    point = bind(specification, policies["point"])
    timed("engine, NAV-set, decided", best(lambda: decide(loop)), "0.1 s")
    timed("engine, NAV-point, decided by splitting", best(lambda: decide(point)), "5 s")
    timed("setrl.verify, NAV-set, not checked", best(lambda: verify(policies["set"], specification, check=False)), "")
    timed(
        "setrl.verify, NAV-point, not checked", best(lambda: verify(policies["point"], specification, check=False)), ""
    )
    peak = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    one = best(lambda: run_cells(engine, 1))
    many = best(lambda: run_cells(engine, 256), 3) / 256
    rows.append(("cost per cell, batch 256 / batch 1", f"{many / one:.3f}", "", "0.25"))
    for count in (1, 64):
        rigorous, bare = np.inf, np.inf
        for _ in range(2 * REPEATS):  # in turn, so that a machine whose speed drifts does not decide
            rigorous = min(rigorous, best(lambda count=count: run_cells(engine, count), 1))
            with without_rounding():
                bare = min(bare, best(lambda count=count: run_cells(engine, count), 1))
        rows.append((f"rounding terms, batch {count}", f"{rigorous / bare - 1:.1%}", "", "15 %"))
    timed(
        "whole command, NAV-set (wall)",
        command_seconds("verify", str(networks["set"]), "--spec", "nav", "--no-certificate"),
        "2 s",
    )
    timed("setrl --help (wall)", command_seconds("--help"), "0.3 s")
    rows.append(("peak memory after NAV-point", f"{peak:.0f} MiB", "", "1024 MiB"))
    box = verify(policies["set"], specification, options=Options(splits=1), check=False).flowpipe.points[0, -1]
    radius = (box[1] - box[0]) / 2
    rows.append(("final NAV-set box / (.091, .026, .027, .223)", f"{(radius / TARGET_BOX).max():.3f}", "", "1.05"))
    machine = f"{platform.platform()}, Python {platform.python_version()}, numpy {np.__version__}"
    print(f"{machine}, {time.strftime('%Y-%m-%d')}")
    print(f"one unit (fixed numpy workload): {unit:.3f} s\n")
    print("| what | measured | units | limit |\n|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
