"""The shipped example: a policy, and the name of the specification it is verified against."""

from __future__ import annotations

from pathlib import Path

EXAMPLE_POLICY = "quadrotor1d-example.onnx"
EXAMPLE_SPECIFICATION = "quadrotor1d"


def example_policy_path() -> Path:
    """Path of the shipped example policy, written by ``examples/fit_quadrotor1d_policy.py``."""
    return Path(__file__).parent / "policies" / EXAMPLE_POLICY
