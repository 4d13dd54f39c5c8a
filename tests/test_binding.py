"""A specification, a plant and a policy fit together, or the message says which line of the YAML does not."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from setrl.models.binding import bind
from setrl.models.closed_loop import BoundAffine, BoundDisturbance, ClosedLoop
from setrl.models.plant import compile_plant, load_plant
from setrl.models.policy import Affine, Policy
from setrl.specs.errors import SpecificationError, UsageError
from setrl.specs.expressions import parse_expression
from setrl.specs.reader import read_specification
from setrl.specs.specification import (
    AffineMap,
    Bounds,
    Controller,
    Disturbance,
    Halfspace,
    Penalty,
    Perturbation,
    PlantDescription,
    Polytope,
    Region,
    Requirement,
    Reward,
    Specification,
)

F = Fraction
CART = PlantDescription(
    name="cart",
    states={"p": "m", "v": "m/s"},
    inputs={"a": "N"},
    disturbances={"wind": "N", "slope": "N"},
    parameters={"m": (F(2), "kg")},
    dynamics={"p": parse_expression("v"), "v": parse_expression("(a + wind + slope)/m")},
)
LINES = {
    "plant": 2,
    "controller": 3,
    "controller.period": 4,
    "controller.observe": 5,
    "horizon": 8,
    "initial": 9,
    "initial.p": 10,
    "requirements.0": 20,
    "reward": 30,
    "reward.weights.q": 31,
}


def policy(inputs: int = 2, outputs: int = 1) -> Policy:
    return Policy((Affine(np.ones((outputs, inputs)), np.zeros(outputs)),), inputs, outputs, name="p.onnx")


def region(**coefficients: int) -> Region:
    facet = Halfspace({name: F(value) for name, value in coefficients.items()}, F(4), "p - 3*v <= 4")
    return Region((Polytope((facet,)),))


def requirement(name: str = "wall", start: Any = 0, end: Any = 2, **coefficients: int) -> Requirement:
    return Requirement("avoid", name, region(**(coefficients or {"p": 1, "v": -3})), F(start), F(end), 20)


def specification(**changes: Any) -> Specification:
    given: dict[str, Any] = {
        "plant": CART,
        "controller": Controller(period=F(1, 10)),
        "horizon": F(2),
        "initial": {"v": Bounds(F(0), F(0)), "p": Bounds(F(1, 10), F(1, 5))},
        "perturbation": Perturbation(),
        "requirements": (requirement(),),
        "source": "cart.yaml",
        "lines": LINES,
    }
    return Specification(**{**given, **changes})


def controlled(**changes: Any) -> Specification:
    return specification(controller=Controller(**{"period": F(1, 10), **changes}))


def test_names_become_positions_and_numbers_stay_exact() -> None:
    loop = bind(specification(), policy())
    assert loop.periods == 20 and loop.period == F(1, 10)
    assert loop.initial == ((F(1, 10), F(1, 5)), (F(0), F(0)))
    (bound,) = loop.requirements
    assert bound.region[0].normals == ((F(1), F(-3)),) and bound.region[0].bounds == (F(4),)
    assert bound.region[0].facets == ("p - 3*v <= 4",) and bound.line == 20
    assert (loop.observation, loop.before, loop.after, loop.clip, loop.reward) == (None,) * 5
    assert loop.observation_names == ("p", "v") and loop.observation_radius == (F(0), F(0))


def test_observations_compile_to_a_tape_over_the_states_with_the_plants_parameters() -> None:
    observe = {"speed": parse_expression("v*m"), "p": parse_expression("p")}
    given = replace(controlled(observe=observe), perturbation=Perturbation(observation={"speed": F(1, 2)}))
    loop = bind(given, policy())
    assert loop.observation is not None and loop.observation.inputs == ("p", "v")
    assert loop.observation_names == ("speed", "p") and loop.observation_radius == (F(1, 2), F(0))


def test_observing_all_states_in_order_is_observing_the_state() -> None:
    loop = bind(controlled(observe={"p": parse_expression("p"), "v": parse_expression("v")}), policy())
    assert loop.observation is None


def test_scales_and_offsets_become_exact_matrices() -> None:
    before = AffineMap(None, (F(1, 3), F(2)), F(1, 7))
    after = AffineMap(((F(1), F(2), F(3)),), F(1), (F(4),))
    loop = bind(controlled(before=before, after=after), policy(2, 3))
    assert loop.before == BoundAffine(((F(1, 3), F(0)), (F(0), F(2))), (F(1, 7), F(1, 7)))
    assert loop.after == BoundAffine(((F(1), F(2), F(3)),), (F(4),))
    assert bind(controlled(before=AffineMap(None, F(1), F(0))), policy()).before is None


def test_clip_delay_and_disturbances_are_bound_by_name() -> None:
    bounds = Bounds(F(-1), F(1))
    given = replace(
        controlled(clip={"a": bounds}, delay=2, delayed_action={"a": F(1, 2)}),
        perturbation=Perturbation(disturbances={"slope": Disturbance(bounds, constant=True)}),
    )
    loop = bind(given, policy())
    assert loop.clip == ((F(-1), F(1)),) and (loop.delay, loop.delayed_action) == (2, (F(1, 2),))
    assert loop.disturbances == (BoundDisturbance(F(0), F(0), True), BoundDisturbance(F(-1), F(1), True))
    assert bind(controlled(clip=bounds), policy()).clip == ((F(-1), F(1)),)


def test_rewards_are_bound_over_all_states() -> None:
    reward = Reward({"p": F(1)}, {"v": F(2)}, F(99, 100), Penalty(F(5), region(v=1)))
    bound = bind(specification(reward=reward), policy()).reward
    assert bound is not None
    assert (bound.weights, bound.target) == ((F(1), F(0)), (F(0), F(2)))
    assert bound.penalty == 5 and bound.penalty_region[0].normals == ((F(0), F(1)),)


@pytest.mark.parametrize("radius", [0.1, np.float64(0.1), "0.1", F(1, 10), {"p": 0.1, "v": 0.1}])
def test_a_radius_that_is_given_replaces_the_specifications(radius: Any) -> None:
    given = replace(specification(), perturbation=Perturbation(observation=F(7)))
    assert bind(given, policy(), observation_radius=radius).observation_radius == (F(1, 10), F(1, 10))


@pytest.mark.parametrize("radius", [-0.1, float("nan"), "much", {"q": 1}])
def test_a_wrong_radius_is_a_usage_error(radius: Any) -> None:
    with pytest.raises(UsageError):
        bind(specification(), policy(), observation_radius=radius)


def broken_reward(**changes: Any) -> Specification:
    return specification(reward=Reward(**{"weights": {"p": F(1)}, "target": {}, **changes}))


WRONG: dict[str, tuple[Specification, str]] = {
    "initial misses a state": (
        specification(initial={"p": Bounds(F(0), F(0))}),
        r"cart\.yaml:9: .*missing: v \(add v: 0",
    ),
    "initial has another name": (
        specification(initial={"p": Bounds(F(0), F(0)), "pp": Bounds(F(0), F(0))}),
        r"cart\.yaml:9: pp is no state \(did you mean p",
    ),
    "initial is empty": (
        specification(initial={"p": Bounds(F(1), F(0)), "v": Bounds(F(0), F(0))}),
        r"cart\.yaml:10: \[1, 0\] is empty",
    ),
    "horizon": (specification(horizon=F(1, 3)), r"cart\.yaml:8: .*multiple.*0\.1, received 1/3 \(use 0\.4 or 0\.3"),
    "period": (controlled(period=F(0)), r"cart\.yaml:4: .*positive"),
    "observed name": (
        controlled(observe={"p": parse_expression("p"), "w": parse_expression("wind")}),
        r"cart\.yaml:5: .*wind is none",
    ),
    "observation count": (
        controlled(observe={"p": parse_expression("p")}),
        r"cart\.yaml:5: the policy p\.onnx takes 2 numbers, the observation has 1 \(p\)",
    ),
    "before": (
        controlled(before=AffineMap(((F(1), F(0)),), F(1), F(0))),
        r"cart\.yaml:3: .*takes 2 numbers, controller\.before returns 1",
    ),
    "before's width": (controlled(before=AffineMap(((F(1),), (F(1),)), F(1), F(0))), r"2 numbers, one per observation"),
    "scale's length": (controlled(before=AffineMap(None, (F(1),), F(0))), r"2 numbers are required.*received 1"),
    "clip": (controlled(clip={"b": Bounds(F(0), F(1))}), r"cart\.yaml:3: b is no input"),
    "clip's order": (controlled(clip=Bounds(F(1), F(0))), r"is empty"),
    "delay": (controlled(delay=-1), r"whole periods"),
    "delayed action": (controlled(delay=1, delayed_action={"b": F(0)}), r"b is no input"),
    "disturbance": (
        replace(specification(), perturbation=Perturbation(disturbances={"wnd": Disturbance(Bounds(F(0), F(1)))})),
        r"wnd is no disturbance \(did you mean wind",
    ),
    "radius": (replace(specification(), perturbation=Perturbation(observation=F(-1))), r"not negative"),
    "radius's name": (replace(specification(), perturbation=Perturbation(observation={"q": F(1)})), r"q is no"),
    "requirement's state": (
        specification(requirements=(requirement(q=1),)),
        r"cart\.yaml:20: `p - 3\*v <= 4` uses q",
    ),
    "requirement without states": (specification(requirements=(requirement(p=0),)), r"bounds no state"),
    "requirement's window": (specification(requirements=(requirement(end=3),)), r"cart\.yaml:20: .*\[0, 3\].*\[0, 2\]"),
    "two names": (specification(requirements=(requirement(), requirement())), r"two requirements are called wall"),
    "weight's name": (broken_reward(weights={"q": F(1)}), r"cart\.yaml:31: q is no state"),
    "weight": (broken_reward(weights={"p": F(-1)}), r"cart\.yaml:30: .*not negative"),
    "discount": (broken_reward(discount=F(0)), r"cart\.yaml:30: .*\(0, 1\], received 0"),
    "discount above one": (broken_reward(discount=F(3, 2)), r"received 1\.5"),
    "penalty": (broken_reward(penalty=Penalty(F(-1), region(p=1))), r"cart\.yaml:30: .*not negative"),
    "plant": (specification(plant="unicyle"), r"cart\.yaml:2: .*did you mean unicycle"),
}


@pytest.mark.parametrize("name", WRONG)
def test_what_does_not_fit_is_said_with_its_line(name: str) -> None:
    given, message = WRONG[name]
    with pytest.raises(SpecificationError, match=message):
        bind(given, policy())


def test_a_policy_with_the_wrong_number_of_outputs_is_refused() -> None:
    message = r"cart\.yaml:3: the plant has 1 inputs \(a\), the policy p\.onnx returns 2"
    with pytest.raises(SpecificationError, match=message):
        bind(specification(), policy(2, 2))


def test_a_window_between_the_steps_of_a_discrete_plant_is_refused() -> None:
    plant = compile_plant(replace(CART, discrete=True))
    assert bind(specification(requirements=(requirement(start="0.15", end="0.2"),)), policy(), plant)
    with pytest.raises(SpecificationError, match="no sampling instant is in"):
        bind(specification(requirements=(requirement(start="0.15", end="0.19"),)), policy(), plant)


@pytest.mark.parametrize("name", ["nav", "navigation", "pendulum", "quadrotor1d", "quadrotor2d"])
def test_every_shipped_specification_binds_to_its_plant(name: str) -> None:
    given = read_specification(Path(__file__).resolve().parents[1] / "specs" / f"{name}.yaml")
    assert isinstance(given.plant, str)
    plant = load_plant(given.plant)
    loop = bind(given, policy(len(plant.states), len(plant.inputs)))
    assert isinstance(loop, ClosedLoop) and loop.plant.states == plant.states


def test_lines_of_a_file_reach_the_message(tmp_path: Path) -> None:
    path = tmp_path / "wrong.yaml"
    path.write_text(
        "setrl: 1\nplant: quadrotor1d\ncontroller: {period: 0.1}\nhorizon: 1\ninitial:\n  z: 0\n  zdt: 0\n"
        "requirements:\n  - stay: {z: [-5, 5]}\n"
    )
    with pytest.raises(SpecificationError, match=r"wrong\.yaml:7: zdt is no state \(did you mean zdot"):
        bind(read_specification(path), policy())
