"""The policy enclosures side by side: sets of actions, time, and cells that a proof needs. Prints docs/methods.md.

    SETRL_NAV=folder python benchmarks/enclosures.py

First on the same sets: those that the enclosure `zonotope` passes through with the whole initial set in one cell. Every
enclosure makes its sets of actions of them. `private` is the spread of what is not shared with the initial set, `whole`
all spread, both as a share of `zonotope`'s, means over the periods and actions. Then whole verifications, without the
checker: cells, and CPU seconds of the engine.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from engine import nav_folder

from setrl.models.binding import bind
from setrl.models.closed_loop import ClosedLoop
from setrl.models.onnx_reader import read_policy
from setrl.specs.reader import find_specification, read_specification
from setrl.verify.closed_loop import Cells, Engine
from setrl.verify.model import initial_box, observation_radius, prepare
from setrl.verify.options import Options
from setrl.verify.splitting import InitialSet
from setrl.verify.verifier import verify

ENCLOSURES: tuple[Any, ...] = ("zonotope", "crown", "best")
LIMIT = 120.0
"""Seconds for one verification."""
SHIPPED = Path(__file__).parents[1] / "models" / "policies"


def questions() -> Iterator[tuple[str, Path, str, float | None]]:
    """Name, policy, specification and observation radius."""
    nav = nav_folder()
    yield "NAV, set-trained", nav / "nn-nav-set.onnx", "nav.yaml", None
    yield "NAV, set-trained, radius 0.01", nav / "nn-nav-set.onnx", "nav.yaml", 0.01
    yield "NAV, point-trained", nav / "nn-nav-point.onnx", "nav.yaml", None
    for path in sorted(SHIPPED.glob("*-set.onnx")):
        yield path.stem, path, f"{path.stem.removesuffix('-set')}.yaml", None


def sets_of(engine: Engine, loop: ClosedLoop) -> list[Cells]:
    """The sets before every period that is enclosed, the whole initial set in one cell."""
    initial = InitialSet.of(*initial_box(loop))
    whole = np.ones((1, initial.free.size))
    cells = engine.start(*initial.cells(-whole, whole), observation_radius(loop)[None])
    found = []
    for number in range(loop.periods):
        period, after = engine.advance(number, cells)
        if not period.sound.all():
            break
        found.append(cells)
        cells = after
    return found


def engine_of(loop: ClosedLoop, enclosure: Any) -> Engine:
    model = prepare(loop)
    factors = InitialSet.of(*initial_box(loop)).free.size
    return Engine(model, Options(enclosure=enclosure), factors + model.constant.size)


def spreads(engine: Engine, sets: list[Cells]) -> tuple[np.ndarray[Any, Any], np.ndarray[Any, Any]]:
    """Private and whole spread of the actions, per set."""
    private, whole = [], []
    for cells in sets:
        period, _ = engine.advance(0, cells)
        rows = np.abs(period.computed.generators[0])
        shared = cells.tracked.generators.shape[1] + cells.tracked.dimension
        private.append(rows[shared:].sum(0))
        whole.append(rows.sum(0))
    return np.array(private), np.array(whole)


def compare(name: str, policy: Path, specification: str, radius: float | None) -> None:
    """Two lines of tables per enclosure."""
    loop = bind(read_specification(find_specification(specification)), read_policy(str(policy)), None, radius)
    with np.errstate(all="ignore"):
        sets = sets_of(engine_of(loop, "zonotope"), loop)
        reference = spreads(engine_of(loop, "zonotope"), sets)
    for enclosure in ENCLOSURES:
        with np.errstate(all="ignore"):
            found = spreads(engine_of(loop, enclosure), sets)
        shares = [float(np.nanmean(a / np.where(b > 0.0, b, np.nan))) for a, b in zip(found, reference, strict=True)]
        start = time.process_time()
        result = verify(
            str(policy),
            specification,
            epsilon=radius,
            options=Options(enclosure=enclosure, timeout=LIMIT),
            check=False,
            workers=1,
        )
        seconds = time.process_time() - start
        print(
            f"| {name} | {enclosure} | {len(sets)} of {loop.periods} | {shares[0]:.3f} | {shares[1]:.3f} "
            f"| {result.verdict.name} | {result.leaves} | {seconds:.1f} |",
            flush=True,
        )


if __name__ == "__main__":
    print("| closed loop | enclosure | periods | private | whole | verdict | cells | seconds |")
    print("|---|---|---|---|---|---|---|---|")
    for question in questions():
        compare(*question)
