"""Size of certificates, time to prove and to check, memory of the checker: prints a table of docs/benchmarks.md.

    SETRL_NAV=folder python benchmarks/evidence.py

NAV networks, units and machine as in benchmarks/engine.py. CPU times are of a warm process, the best of five; wall
times are of whole commands. The certificates are those that the measured runs wrote.
"""

from __future__ import annotations

import os

os.environ.setdefault("OMP_NUM_THREADS", "1")
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import platform
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np
from engine import REPEATS, best, nav_folder, reference

from setrl import verify
from setrl.specs.reader import find_specification
from setrl.verify.checker.certificate import Accepted, check


def accepted(certificate: bytes, policy: Path, specification: Path) -> None:
    """Check a certificate in this process; it has to be accepted."""
    answer = check(certificate, policy.read_bytes(), specification.read_bytes(), specification.parent, workers=1)
    if not isinstance(answer, Accepted):
        raise SystemExit(f"the benchmark's certificates are expected to be accepted: {answer}")


def command(*arguments: str) -> float:
    """Wall seconds of one whole process."""
    start = time.perf_counter()
    subprocess.run([sys.executable, "-m", "setrl", *arguments], check=True, capture_output=True)
    return time.perf_counter() - start


def main() -> None:
    """Print the table."""
    folder, specification = nav_folder(), Path(find_specification("nav"))
    networks = {name: folder / f"nn-nav-{name}.onnx" for name in ("set", "point")}
    unit = best(reference)
    rows: list[tuple[str, str, str, str]] = []

    def timed(what: str, seconds: float, limit: str) -> None:
        rows.append((what, f"{seconds:.3f} s", f"{seconds / unit:.2f}", limit))

    result = verify(networks["set"], specification)
    if result.certificate is None:
        raise SystemExit("the benchmark's networks are expected to verify")
    content = result.certificate
    rows.append(("certificate of NAV-set", f"{len(content):,} bytes", "", "150,000 bytes"))
    proved = best(lambda: verify(networks["set"], specification, check=False))
    checked = best(lambda: accepted(content, networks["set"], specification))
    timed("NAV-set, reading, proving and writing", proved, "")
    timed("NAV-set, checking", checked, "")
    timed("NAV-set, all of it", best(lambda: verify(networks["set"], specification)), "0.6 s")
    with tempfile.TemporaryDirectory() as scratch:
        path = Path(scratch) / "point.cert"
        given = (str(networks["point"]), "--spec", "nav", "--certificate", str(path), "--quiet")
        times = [command("verify", *given) for _ in range(3)]
        timed("whole command, NAV-point, proved and checked (wall)", min(times), "15 s")
        rows.append(("certificate of NAV-point", f"{path.stat().st_size:,} bytes", "", ""))
        times = [command("check", str(path), str(networks["point"]), str(specification)) for _ in range(3)]
        timed("whole command, NAV-point, checked again (wall)", min(times), "")
        one = ("check", str(path), str(networks["point"]), str(specification), "--workers", "1")
        timed("the same with one process (wall)", command(*one), "")
    # children only: this process has the engine in memory, the checker's commands have not; verify is the larger one
    peak = resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024
    rows.append(("peak memory of one process, NAV-point proved or checked", f"{peak:.0f} MiB", "", "500 MB"))
    machine = f"{platform.platform()}, Python {platform.python_version()}, numpy {np.__version__}"
    print(f"{machine}, {time.strftime('%Y-%m-%d')}; best of {REPEATS}, commands best of 3")
    print(f"one unit (fixed numpy workload): {unit:.3f} s\n")
    print("| what | measured | units | limit |\n|---|---|---|---|")
    for row in rows:
        print("| " + " | ".join(row) + " |")


if __name__ == "__main__":
    main()
