"""Runs the command line in this process; what a subprocess would add is tested with a few of them."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest

from setrl.cli import main
from setrl.models.example import example_policy_path


@dataclass(frozen=True)
class Outcome:
    code: int
    out: str
    err: str


def run(capsys: Any, *arguments: str | Path) -> Outcome:
    capsys.readouterr()
    with pytest.raises(SystemExit) as end:
        main([str(argument) for argument in arguments])
    captured = capsys.readouterr()
    assert isinstance(end.value.code, int)
    return Outcome(end.value.code, captured.out, captured.err)


def contents(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


EXAMPLE = example_policy_path()

QUICK = """\
setrl: 1
plant: quadrotor1d
controller:
  period: 0.1
horizon: 0.5
initial: {z: [-0.1, 0.1], zdot: 0}
perturbation:
  observation: 0.01
requirements:
  - stay: {z: [-1, 1]}
    name: altitude
reward:
  weights: {z: 1}
  discount: 0.99
"""
"""A specification that the example policy satisfies in a few milliseconds."""
HOPELESS = """\
setrl: 1
plant: quadrotor1d
controller: {period: 0.1}
horizon: 2.5
initial: {z: [-4.1, -3.9], zdot: [-0.1, 0.1]}
perturbation: {observation: 0.9}
requirements:
  - stay: {z: [-5, 5]}
    name: altitude
"""
"""One that no splitting proves, because the noise is too large for the enclosure, and that no simulation violates."""
