"""How much a second worker is worth, and an unchanged run: a manifest of forty rows over four plants.

Run on idle cores: ``python benchmarks/certification.py``. Two workers and one take turns, so that a machine whose speed
drifts does not favour either.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
import time
from datetime import date
from pathlib import Path
from typing import Any

from setrl.models.example import shipped_policies

RADII = {
    "quadrotor1d": "0:0.09:0.01",
    "pendulum": "0:0.018:0.002",
    "navigation": "0:0.018:0.002",
    "quadrotor2d": "0:0.009:0.001",
}
"""Ten perturbation radii per plant."""

VARIES = ("timings", "seconds", "source")


def manifest(folder: Path) -> Path:
    """Forty rows: the flowpipe-trained policy of every plant at ten radii."""
    policies = {path.stem: path for path in shipped_policies()}
    lines = ["setrl: 1", "defaults: {timeout: 120}", "certify:"]
    for plant, radii in RADII.items():
        lines.append(f"  - {{policy: {policies[f'{plant}-flowpipe']}, specification: {plant}, epsilon: '{radii}',")
        lines.append("     expect: [VERIFIED, UNKNOWN, FALSIFIED], options: {splits: 64}}")
    path = folder / "certification.yaml"
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def run(path: Path, workers: int, *more: str) -> tuple[float, Any]:
    """Seconds of the whole process, and its report."""
    out = path.parent / f"out-{workers}"
    command = [
        sys.executable,
        "-m",
        "setrl",
        "certify",
        str(path),
        "--out",
        str(out),
        "--workers",
        str(workers),
        "-q",
        *more,
    ]
    started = time.perf_counter()
    subprocess.run(command, check=True, stdout=subprocess.DEVNULL, env={**os.environ, "OMP_NUM_THREADS": "1"})
    seconds = time.perf_counter() - started
    return seconds, without_times(json.loads((out / "certification.json").read_text(encoding="utf-8")))


def without_times(data: Any) -> Any:
    if isinstance(data, dict):
        return {key: without_times(entry) for key, entry in data.items() if key not in VARIES}
    return [without_times(entry) for entry in data] if isinstance(data, list) else data


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--repeat", type=int, default=3, help="pairs of runs")
    repeat = parser.parse_args().repeat
    with tempfile.TemporaryDirectory() as name:
        path = manifest(Path(name))
        times: dict[int, list[float]] = {1: [], 2: []}
        reports = []
        for _ in range(repeat):
            for workers in times:
                seconds, report = run(path, workers, "--no-cache")
                times[workers].append(seconds)
                reports.append(report)
        again, report = run(path, 2)
        reports.append(report)
    ratios = [one / two for one, two in zip(times[1], times[2], strict=True)]
    verdicts: dict[str, int] = {}
    for row in reports[0]["rows"]:
        verdicts[row["outcome"]] = verdicts.get(row["outcome"], 0) + 1
    print(f"{date.today()}, {platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    print(f"{len(reports[0]['rows'])} rows: {verdicts}")
    print(f"one worker   {statistics.median(times[1]):7.1f} s   ({', '.join(f'{t:.1f}' for t in times[1])})")
    print(f"two workers  {statistics.median(times[2]):7.1f} s   ({', '.join(f'{t:.1f}' for t in times[2])})")
    print(f"ratio        {statistics.median(ratios):7.2f}     ({', '.join(f'{r:.2f}' for r in ratios)})")
    print(f"unchanged    {again:7.1f} s   ({again / statistics.median(times[2]):.1%} of two workers)")
    print(f"reports equal apart from times: {all(report == reports[0] for report in reports)}")


if __name__ == "__main__":
    main()
