"""A specification that some trajectory violates is never VERIFIED, however narrowly it is violated."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import laws
import numpy as np
import pytest
from cases import EVERYTHING
from loops import box_region, loop_of, network, plant_of, requirement, specification_of, with_requirements

from setrl import verify
from setrl.models.onnx_reader import read_policy
from setrl.specs.reader import find_specification, read_specification
from setrl.specs.specification import Halfspace, Polytope, Region
from setrl.verify.options import Options
from setrl.verify.result import Verdict

F = Fraction
GAPS = (1e-2, 1e-3, 1e-5, 1e-7, 1e-9)


def random_loop(seed: int) -> Any:
    """A random small network on a random plant, alternately in discrete and continuous time."""
    generator = np.random.default_rng(seed)
    kinds = ["relu", "tanh", "sigmoid", "leaky_relu", "clip"]
    kind = kinds[seed % 5]
    policy = network([2, 5, 1], [kind, "none"], seed, 1.5)
    a, b, c = (f"{x:.3f}" for x in generator.uniform(0.2, 0.9, 3))
    discrete = seed % 3 != 0
    if discrete:
        plant = plant_of(
            {"x": f"{a}*x + 0.3*sin(y) + {b}*u + d", "y": f"{c}*y - 0.2*x*y + 0.1*u**2"},
            disturbances="d",
            discrete=True,
        )
    elif seed % 2:
        plant = plant_of({"x": f"y - {a}*x**3", "y": f"-sin(x) + {b}*u + d"}, disturbances="d")
    else:
        plant = EVERYTHING
    low = generator.uniform(-0.5, 0.5, 2).round(3)
    width = generator.uniform(0.01, 0.2, 2).round(3)
    boxes = {s: (f"{lo:.3f}", f"{lo + w:.3f}") for s, lo, w in zip("xy", low, width, strict=True)}
    force = ("-0.05", "0.1", bool(seed % 2))
    specification = specification_of(
        plant,
        boxes,
        period="0.2",
        periods=2 + seed % 3,
        observation=("0", "0.02", "0.1")[seed % 3 if discrete else seed % 2],
        disturbances={"d": force},
        delay=int(seed % 7 == 4),
    )
    return loop_of(policy, specification)


def violated(loop: Any, seed: int) -> Any:
    """The same loop with a halfspace that the worst trajectory found leaves by a little at the end."""
    line = np.random.default_rng(1000 + seed).choice([-1.0, -0.5, 0.5, 1.0], size=2)
    best = laws.planted_boundary(loop, line, seed)
    gap = GAPS[seed % len(GAPS)] * max(1.0, abs(best))
    facet = Halfspace({"x": F(float(line[0])), "y": F(float(line[1]))}, F(best - gap), "planted")
    end = loop.specification.horizon
    wanted = requirement("stay", Region((Polytope((facet,)),)), end if seed % 2 else 0, end)
    return loop_of(loop.policy, with_requirements(loop.specification, wanted))


@pytest.mark.parametrize("seed", range(30))
def test_a_planted_violation_is_never_proved(seed: int) -> None:
    loop = violated(random_loop(seed), seed)
    laws.law_never_verified(loop, Options(splits=16))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30, 330))
def test_hundreds_of_planted_violations_are_never_proved(seed: int) -> None:
    loop = violated(random_loop(seed), seed)
    laws.law_never_verified(loop, Options(splits=64))


def test_planted_violations_are_narrow() -> None:
    proved = 0
    for seed in range(1, 30, 2):
        loop = violated(random_loop(seed), seed)
        facet = loop.requirements[0].region[0]
        wider = replace(facet, bounds=tuple(b + F(1, 5) for b in facet.bounds))
        eased = replace(loop, requirements=(replace(loop.requirements[0], region=(wider,)),))
        try:
            laws.law_never_verified(eased, Options(splits=16))
        except AssertionError:
            proved += 1
    assert proved >= 8, "the planted boundaries are out of reach anyway: they show nothing"


# ARCH-COMP NAV ------------------------------------------------------------------------------------------------------


def navigation(folder: Path, network_name: str, *requirements: Any) -> tuple[Any, Any]:
    policy = read_policy(str(folder / f"nn-nav-{network_name}.onnx"))
    specification = read_specification(find_specification("nav"))
    return policy, replace(specification, requirements=tuple(requirements)) if requirements else specification


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("point", requirement("avoid", box_region(x=("0.9", "2.6"), y=(1, 2)), 0, 6)),
        ("set", requirement("avoid", box_region(x=(1, 2), y=(1, "2.5")), 0, 6)),
        ("point", requirement("reach", box_region(x=("-0.02", "0.02"), y=("-0.02", "0.02")), 6, 6)),
        ("set", requirement("reach", box_region(x=("-0.02", "0.02"), y=("-0.02", "0.02")), 6, 6)),
    ],
    ids=["point-obstacle", "set-obstacle", "point-goal", "set-goal"],
)
def test_violated_variants_of_nav_are_never_verified(nav_folder: Path, name: str, what: Any) -> None:
    policy, specification = navigation(nav_folder, name, what)
    with np.errstate(all="ignore"):
        result = verify(policy, specification, options=Options(splits=200))
        laws.law_never_verified(loop_of(policy, specification), Options(splits=8))
    assert not result.verdict.positive
    assert result.candidate is not None


def test_nav_set_is_verified_from_one_tight_cell(nav_folder: Path) -> None:
    result = verify(*navigation(nav_folder, "set"), options=Options(splits=1))
    assert result.verdict is Verdict.VERIFIED and result.cells == 1
    final = result.flowpipe.points[0, -1]
    radius = 0.5 * (final[1] - final[0])
    assert (radius <= 1.05 * np.array([0.091, 0.026, 0.027, 0.223])).all(), radius


@pytest.mark.slow
def test_nav_point_is_verified_by_splitting(nav_folder: Path) -> None:
    result = verify(*navigation(nav_folder, "point"))
    assert result.verdict is Verdict.VERIFIED and result.leaves > 1
