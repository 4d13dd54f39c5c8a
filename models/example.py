"""The policies that travel with the package, and the one that is the example."""

from __future__ import annotations

from pathlib import Path

EXAMPLE_POLICY = "quadrotor1d-set.onnx"
EXAMPLE_SPECIFICATION = "quadrotor1d"
POLICIES = Path(__file__).parent / "policies"
"""``<specification>-<training>.onnx``: point, set, flowpipe. Its README has the commands that made them."""


def example_policy_path() -> Path:
    """Path of the example: a policy of the 1D quadrotor that was trained on sets."""
    return POLICIES / EXAMPLE_POLICY


def shipped_policies() -> tuple[Path, ...]:
    """Paths of all shipped policies, sorted by name."""
    return tuple(sorted(POLICIES.glob("*.onnx")))
