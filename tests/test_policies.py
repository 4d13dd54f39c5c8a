"""The shipped policies: each one belongs to a specification, and what was trained to verify does."""

from __future__ import annotations

from pathlib import Path

import pytest

import setrl
from setrl.models.example import example_policy_path, shipped_policies
from setrl.models.onnx_reader import read_policy
from setrl.specs.reader import shipped_specifications
from setrl.verify.options import Options

TRAININGS = ("point", "set", "flowpipe")
UNPROVED = ("quadrotor2d-set",)
"""Trained on sets, and not well enough; the README beside it says so."""
NAMES = [path.stem for path in shipped_policies()]


def parts(name: str) -> tuple[str, str]:
    specification, _, training = name.rpartition("-")
    return specification, training


def path_of(name: str) -> Path:
    return example_policy_path().with_name(f"{name}.onnx")


def test_every_plant_of_the_paper_has_every_training():
    plants = ("quadrotor1d", "pendulum", "navigation", "quadrotor2d")
    assert sorted(NAMES) == sorted(f"{plant}-{training}" for plant in plants for training in TRAININGS)
    assert {parts(name)[0] for name in NAMES} <= set(shipped_specifications())
    assert example_policy_path() in shipped_policies()


@pytest.mark.parametrize("name", NAMES)
def test_a_shipped_policy_is_a_small_file_of_its_own_format(name):
    assert path_of(name).stat().st_size < 20_000
    policy = read_policy(str(path_of(name)))
    assert policy.precision == "float32"


@pytest.mark.parametrize("name", [name for name in NAMES if parts(name)[1] != "point" and name not in UNPROVED])
def test_what_was_trained_on_sets_is_verified(name):
    result = setrl.verify(path_of(name), parts(name)[0], options=Options(timeout=120.0))
    assert result.verdict is setrl.Verdict.VERIFIED, result.reason


@pytest.mark.parametrize("specification", sorted({parts(name)[0] for name in NAMES}))
def test_training_on_sets_raises_what_is_verified(specification):
    values = [
        setrl.verify(path_of(f"{specification}-{training}"), specification, options=Options(timeout=120.0, splits=1))
        for training in TRAININGS
    ]
    bounds = [-float("inf") if found.value is None else found.value.discounted for found in values]
    assert bounds[0] < bounds[1] < bounds[2]
