"""False positives that the engine once had, in their smallest form."""

from __future__ import annotations

import numpy as np
import pytest
from loops import box_region, gain, plant_of, requirement, specification_of

from setrl import verify
from setrl.models.policy import Activation, Affine, Policy
from setrl.verify.options import Options
from setrl.verify.relaxations import relax


def test_the_delayed_action_shares_no_factor_with_this_period_s_disturbance() -> None:
    # x2 = x1 - (x0 + e) + d1 = d0 - e + d1: three independent numbers of [-1, 1]; the engine once said [-1, 1]
    plant = plant_of({"x": "x - u + d"}, disturbances="d", discrete=True)
    specification = specification_of(
        plant,
        {"x": (0, 1)},
        period=1,
        periods=2,
        observation=1,
        disturbances={"d": (-1, 1, False)},
        requirements=[requirement("stay", box_region(x=(-2, 2)), 2, 2)],
        delay=1,
    )
    result = verify(gain([1.0]), specification)
    assert not result.verdict.positive
    assert result.flowpipe.points[0, 2, 1, 0] >= 3.0


@pytest.mark.parametrize(("kind", "region"), [("avoid", (4, 6)), ("stay", (-3, 3))])
def test_the_initial_set_of_a_discrete_time_plant_is_checked(kind: str, region: tuple[int, int]) -> None:
    plant = plant_of({"x": "x/2 + u"}, discrete=True)
    specification = specification_of(
        plant, {"x": (4, 5)}, period=1, periods=2, requirements=[requirement(kind, box_region(x=region), 0, 2)]
    )
    assert not verify(gain([0.0]), specification).verdict.positive


def test_an_overflow_inside_the_network_never_becomes_a_constant() -> None:
    # the second neuron is the state z in [5, 6]; the first one's spread overflows and is multiplied by zero
    layers = (
        Affine(np.array([[1e308, 1e308, 0.0], [0.0, 0.0, 1.0]]), np.zeros(2)),
        Affine(np.array([[0.0, 1.0]]), np.zeros(1)),
        Activation("relu"),
        Affine(np.array([[1.0]]), np.zeros(1)),
    )
    plant = plant_of({"x": "x", "y": "y", "z": "u"}, discrete=True)
    specification = specification_of(
        plant,
        {"x": (-1, 1), "y": (-1, 1), "z": (5, 6)},
        period=1,
        periods=1,
        requirements=[requirement("stay", box_region(z=(-1, 1)), 1, 1)],
    )
    policy = Policy(layers, 3, 1, precision="float64")
    assert not verify(policy, specification, options=Options(deployed=False)).verdict.positive


def test_a_relaxation_without_bounds_is_not_finite() -> None:
    nan = np.array([[np.nan]])
    relaxation = relax(Activation("relu"), nan, nan)
    assert not np.isfinite(relaxation.error).any()
