"""Verify the shipped policy of the 1D quadrotor, find out how much sensor noise it stands, and draw both.

    python examples/verify_quadrotor1d.py [folder]

With a folder, the pictures are written there.
"""

from __future__ import annotations

import sys
from pathlib import Path

import setrl
from setrl.models.example import example_policy_path
from setrl.verify.plot import plot_sweep

RADII = ["0", "0.1", "0.2", "0.3"]  # of the noise on altitude (m) and climb rate (m/s); text is read as exact decimals


def main(folder: Path | None = None) -> None:
    """Verify, sweep, draw."""
    policy = example_policy_path()
    result = setrl.verify(policy, "quadrotor1d.yaml")
    print(f"{result.verdict.value}: {result.claim}")
    for requirement in result.requirements:
        print(f"{requirement.kind} {requirement.name}: margin {requirement.margin:.4f} at {requirement.time} s")

    sweep = setrl.verify_radii(policy, "quadrotor1d.yaml", RADII)
    for radius, entry in zip(RADII, sweep, strict=True):
        print(f"noise {radius}: {entry.verdict.value}, V(s0) >= {entry.value.discounted:.2f}")
    if folder is not None:
        result.plot(str(folder / "flowpipe.png"))
        plot_sweep([float(radius) for radius in RADII], sweep, str(folder / "sweep.png"))

    assert result.verdict == setrl.Verdict.VERIFIED, result.reason
    assert all(requirement.margin > 0.0 for requirement in result.requirements)
    values = [entry.value.discounted for entry in sweep]
    assert values == sorted(values, reverse=True), "more noise never improves the worst reward"


if __name__ == "__main__":
    main(Path(sys.argv[1]) if len(sys.argv) > 1 else None)
