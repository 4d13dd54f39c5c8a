"""Table 1 of the paper, rebuilt: how long it takes to verify navigation agents, and who confirms what.

    SETRL_NAV=FOLDER SETRL_VERIFIERS=FOLDER python benchmarks/table1.py --leaves 1

FOLDER of SETRL_NAV has the two networks of the ARCH-COMP benchmark NAV, ``nn-nav-point.onnx`` (standard training)
and ``nn-nav-set.onnx`` (set-based training). Seconds are wall time of whole processes in one run. Verifiers of networks
do not verify a closed loop; they are asked the certificate's claims about the network, four per period and part
of the initial set. The published figures are other machines'.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import subprocess
import sys
import tempfile
import time
from collections import Counter
from datetime import date
from pathlib import Path
from typing import Any

from setrl.models.example import shipped_policies

PUBLISHED = {"CORA": (423.45, 1.99), "CROWN-Reach": (130.12, 20.65), "JuliaReach": (None, 4.49), "NNV": (None, 1903.24)}
"""Seconds of Table 1: standard agent, set-based agent; None: not able to verify."""


def agents() -> dict[str, tuple[Path, str]]:
    """Name to policy and specification; those of the benchmark where they are given."""
    found: dict[str, tuple[Path, str]] = {}
    folder = os.environ.get("SETRL_NAV")
    if folder:
        found["NAV, standard"] = Path(folder) / "nn-nav-point.onnx", "nav"
        found["NAV, set-based"] = Path(folder) / "nn-nav-set.onnx", "nav"
    shipped = {path.stem: path for path in shipped_policies()}
    found["ours, standard"] = shipped["navigation-point"], "navigation"
    found["ours, set-based"] = shipped["navigation-set"], "navigation"
    return found


def verified(policy: Path, specification: str, certificate: Path, timeout: float) -> tuple[str, float, dict[str, Any]]:
    """Verdict, seconds of the process, and its JSON."""
    command = [sys.executable, "-m", "setrl", "verify", str(policy), "--spec", specification, "--json", "-q"]
    command += ["--certificate", str(certificate), "--timeout", str(timeout)]
    started = time.perf_counter()
    ended = subprocess.run(command, capture_output=True, text=True)
    seconds = time.perf_counter() - started
    data = json.loads(ended.stdout)
    return data["verdict"], seconds, data


def confirmed(tool: str, policy: Path, specification: str, certificate: Path, leaves: int) -> str:
    """``120 of 120 confirmed, 14.2 s``."""
    command = [sys.executable, "-m", "setrl", "crosscheck", str(policy), "--spec", specification, "--json", "-q"]
    with tempfile.TemporaryDirectory() as folder:
        command += ["--certificate", str(certificate), "--leaves", str(leaves), "--with", tool, "--out", f"{folder}/q"]
        ended = subprocess.run(command, capture_output=True, text=True)
    if not ended.stdout.startswith("{"):
        return ended.stderr.strip().splitlines()[-1] if ended.stderr.strip() else "no answer"
    entries = json.loads(ended.stdout)["entries"]
    counts = Counter(entry["agreement"] for entry in entries)
    seconds = sum(entry["seconds"] for entry in entries)
    return f"{', '.join(f'{count} {kind}' for kind, count in counts.items())} of {len(entries)}, {seconds:.1f} s"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--leaves", type=int, default=1, help="parts of the initial set whose claims are asked")
    parser.add_argument("--timeout", type=float, default=300.0, help="seconds for a verdict")
    parser.add_argument("--tools", nargs="*", default=["marabou", "vibecheck"])
    given = parser.parse_args()
    print(f"{date.today()}, {platform.machine()}, {os.cpu_count()} processors, Python {platform.python_version()}")
    for name, (policy, specification) in agents().items():
        with tempfile.TemporaryDirectory() as folder:
            certificate = Path(folder) / "policy.cert"
            verdict, seconds, data = verified(policy, specification, certificate, given.timeout)
            print(f"{name}: setrl {verdict} in {seconds:.2f} s, {data['leaves']} cells", flush=True)
            for tool in given.tools if verdict == "VERIFIED" else ():
                print(f"  {tool}: {confirmed(tool, policy, specification, certificate, given.leaves)}", flush=True)
    for tool, (standard, set_based) in PUBLISHED.items():
        shown = [f"{x:g} s" if x is not None else "not able" for x in (standard, set_based)]
        print(f"published, {tool}: standard {shown[0]}, set-based {shown[1]}")


if __name__ == "__main__":
    main()
