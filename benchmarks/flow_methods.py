"""The two flow methods side by side: step widths of every shipped plant, and final boxes of closed loops.

Run it from anywhere where setrl is installed:

    python benchmarks/flow_methods.py [folder with nn-nav-set.onnx]

It prints the tables of docs/methods.md as Markdown. Widths are reproducible; times depend on the machine.
"""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator
from fractions import Fraction
from pathlib import Path
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from setrl.models.closed_loop import ClosedLoop
from setrl.models.example import EXAMPLE_SPECIFICATION, example_policy_path
from setrl.models.plant import load_plant
from setrl.verify.flow import jet_step
from setrl.verify.integrator import Step
from setrl.verify.linearization import linear_step
from setrl.verify.options import Options
from setrl.verify.result import Result
from setrl.verify.verifier import verify
from setrl.verify.zonotope import Zonotope

Array = NDArray[np.float64]
ORDER, ROWS = Options().taylor_order, Options().quadratic_rows
CENTERS = {
    "pendulum": [2.0, 1.5, 0.1],
    "quadrotor1d": [-4.0, 0.5, 0.2],
    "quadrotor2d": [0.0, 0.1, 0.0, 0.2, 0.3, 0.8, 0.1, 0.12],
    "unicycle": [3.0, 3.0, 0.5, 0.7, 0.3, -0.2],
}
RADII = (0.01, 0.1)
DURATIONS = (Fraction(1, 5), Fraction(1, 10), Fraction(1, 20), Fraction(1, 40))
METHODS = ("jets", "linearization")
RUNS: tuple[tuple[Literal["jets", "linearization"], float], ...] = (
    ("jets", 0.02),
    ("linearization", 0.02),
    ("linearization", 0.005),
)
"""Method and `remainder_share`: a step is halved while shorter steps would diminish more than this share."""


def box(name: str, radius: float) -> Zonotope:
    center = np.array([CENTERS[name]])
    return Zonotope(center, radius * np.eye(center.shape[1])[None], np.zeros_like(center))


def step(method: str, name: str, radius: float, duration: Fraction) -> Step:
    tape, z = load_plant(name).tape, box(name, radius)
    if method == "jets":
        return jet_step(tape, z, duration, ORDER, ROWS * len(tape.outputs))
    return linear_step(tape, z, duration, ORDER)


def excess(taken: Step) -> float:
    """Half-width that the step added, as a percentage of the set's at the end; the largest over the states."""
    spread = taken.end.spread[:, : taken.added.shape[1]]
    return float(100.0 * (taken.added / spread).max()) if taken.sound.all() else np.nan


def step_rows() -> Iterator[str]:
    yield "| plant | radius | " + " | ".join(f"h = {float(h):g}" for h in DURATIONS) + " |"
    yield "|---|---|" + "---|" * len(DURATIONS)
    for name in CENTERS:
        for radius in RADII:
            pairs = (" / ".join(f"{excess(step(m, name, radius, h)):.2g}" for m in METHODS) for h in DURATIONS)
            yield f"| {name} | {radius:g} | " + " | ".join(pairs) + " |"


def loops(folder: Path | None) -> Iterator[tuple[str, str, str]]:
    yield "shipped example", str(example_policy_path()), EXAMPLE_SPECIFICATION
    if folder is not None:
        yield "NAV, set-trained", str(folder / "nn-nav-set.onnx"), "nav"


def final_radii(result: Result) -> Array:
    low, high = result.flowpipe.points[:, -1, 0].min(0), result.flowpipe.points[:, -1, 1].max(0)
    return 0.5 * (high - low)


def loop_rows(folder: Path | None) -> Iterator[str]:
    yield "| closed loop | method | remainder_share | verdict | states | final radius | seconds |"
    yield "|---|---|---|---|---|---|---|"
    for title, policy, specification in loops(folder):
        for method, share in RUNS:
            options = Options(method=method, splits=1, remainder_share=share)
            verify(policy, specification, options=options)
            started = time.perf_counter()
            result = verify(policy, specification, options=options)
            seconds = time.perf_counter() - started
            loop: ClosedLoop = result.loop
            radii = ", ".join(f"{r:.4f}" for r in final_radii(result))
            states = ", ".join(loop.plant.states)
            verdict = result.verdict.name
            yield f"| {title} | {method} | {share:g} | {verdict} | {states} | {radii} | {seconds:.2f} |"


def main(arguments: list[str]) -> None:
    folder = Path(arguments[0]) if arguments else None
    print("Percent of a set's radius that one step adds, jets / linearization:\n")
    print("\n".join(step_rows()), end="\n\n")
    print("Closed loops, whole initial set in one cell:\n")
    print("\n".join(loop_rows(folder)))


if __name__ == "__main__":
    main(sys.argv[1:])
