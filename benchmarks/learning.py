"""What training achieves: point, set and flowpipe agents on fresh seeds, V(s0) over radii, paired tests.

    OMP_NUM_THREADS=1 python benchmarks/learning.py [--specifications quadrotor1d pendulum] [--runs runs/learning]

Seeds 10 to 19, 2000 episodes, the tuned weights of train/tuned, which were chosen on seeds 0 to 4. A run that is there
is taken as it is and one that was stopped goes on. benchmarks/results/learning-<specification>.csv has every seed; what
is printed is the table of docs/training-results.md.
"""

from __future__ import annotations

import argparse
import os
import platform
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

from setrl.specs.files import write_atomically
from setrl.train.evaluation import Evaluation
from setrl.train.evaluation_report import comparison_lines, evaluation_csv, evaluation_lines
from setrl.train.launch import evaluate_run

SEEDS, FIRST_SEED, EPISODES, STEPS = 10, 10, 2000, 300
RESULTS = Path(__file__).parent / "results"


def train(specification: str, algorithm: str, runs: Path) -> Path:
    """One run by the command that a user types; finished when it returns."""
    run = runs / f"{specification}-{algorithm}"
    if (run / "summary.json").is_file():
        return run
    command = [sys.executable, "-P", "-m", "setrl", "train"]
    if (run / "configuration.json").is_file():
        command += ["--resume", str(run)]
    else:
        command += ["--spec", specification, "--name", run.name, "--runs", str(runs)]
        if algorithm == "flowpipe":
            command += ["--from", str(runs / f"{specification}-sa-pc"), "--flowpipe", str(STEPS)]
        else:
            command += ["--algorithm", algorithm, "--episodes", str(EPISODES)]
            command += ["--seeds", str(SEEDS), "--first-seed", str(FIRST_SEED)]
    started = time.perf_counter()
    subprocess.run(command, check=True, env={**os.environ, "OMP_NUM_THREADS": "1"})
    print(f"# {' '.join(command[3:])}: {time.perf_counter() - started:.0f} s", file=sys.stderr)
    return run


def merged(found: dict[str, Evaluation]) -> str:
    """One table of all algorithms, one row per seed, radius and quantity."""
    lines: list[str] = []
    for algorithm, evaluation in found.items():
        header, *rows = evaluation_csv(evaluation).splitlines()
        if not lines:
            lines.append(f"algorithm,{header}")
        lines += [f"{algorithm},{row}" for row in rows]
    return "\n".join(lines) + "\n"


def report(specification: str, runs: Path, algorithms: list[str]) -> None:
    """Train what is missing, evaluate, compare and write."""
    found = {name: evaluate_run(train(specification, name, runs), certify=False) for name in algorithms}
    for name, evaluation in found.items():
        print(f"\n## {specification}, {name}\n")
        print("\n".join(evaluation_lines(evaluation)))
    for better, worse in zip(reversed(algorithms), list(reversed(algorithms))[1:], strict=False):
        print(f"\n## {specification}, {better} against {worse}\n")
        print("\n".join(comparison_lines(found[better], found[worse], (better, worse))))
    for name, evaluation in found.items():
        print(f"# {specification} {name}: median undisturbed {np.median(evaluation.nominal.discounted):.2f}")
    RESULTS.mkdir(exist_ok=True)
    write_atomically(RESULTS / f"learning-{specification}.csv", merged(found).encode())


def main() -> None:
    """Do it."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("--specifications", nargs="+", default=["quadrotor1d", "pendulum"])
    parser.add_argument("--algorithms", nargs="+", default=["pa-pc", "sa-pc", "flowpipe"])
    parser.add_argument("--runs", type=Path, default=Path("runs/learning"))
    arguments = parser.parse_args()
    print(f"# {platform.machine()}, Python {platform.python_version()}")
    for specification in arguments.specifications:
        report(specification, arguments.runs, arguments.algorithms)


if __name__ == "__main__":
    main()
