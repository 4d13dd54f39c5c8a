"""Plants are text, and the shipped ones are the equations they cite."""

from __future__ import annotations

from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from setrl.models.float_algebra import FloatAlgebra
from setrl.models.plant import check_plant, compile_plant, load_plant, shipped_plants
from setrl.models.tape import run
from setrl.specs.errors import SpecificationError
from setrl.specs.expressions import parse_expression
from setrl.specs.specification import PlantDescription

G = 9.81


def unicycle(x: Any, u: Any) -> list[Any]:
    return [x[2] * np.cos(x[3]), x[2] * np.sin(x[3]), u[0], u[1]]


def navigation(x: Any, u: Any) -> list[Any]:
    return [x[3] * np.cos(x[2]), x[3] * np.sin(x[2]), u[0], u[1]]


def quadrotor1d(x: Any, u: Any) -> list[Any]:
    return [x[1], (u[0] + 1) / (2 * 0.05) - G]


def pendulum(x: Any, u: Any) -> list[Any]:
    return [x[1], G * np.sin(x[0]) + 15 * u[0]]


def quadrotor2d(x: Any, u: Any) -> list[Any]:
    m, arm, inertia = 0.027, 0.0397, 1.4e-4
    a1, a2 = (1 + u[0] / 2) * m * G / 2, (1 + u[1] / 2) * m * G / 2
    return [
        x[1],
        np.sin(x[4]) * (a1 + a2) / m,
        x[3],
        np.cos(x[4]) * (a1 + a2) / m - G,
        x[5],
        arm * (a2 - a1) / (np.sqrt(2) * inertia),
    ]


EQUATIONS = {
    "unicycle": unicycle,
    "navigation": navigation,
    "quadrotor1d": quadrotor1d,
    "pendulum": pendulum,
    "quadrotor2d": quadrotor2d,
}


def description(**changes: Any) -> PlantDescription:
    given: dict[str, Any] = {
        "name": "cart",
        "states": {"p": "m", "v": "m/s"},
        "inputs": {"a": "N"},
        "disturbances": {"wind": "N"},
        "parameters": {"m": (Fraction(2), "kg")},
        "dynamics": {"p": parse_expression("v"), "v": parse_expression("(a + wind)/m")},
        "source": "cart.yaml",
        "lines": {"p": 5, "v": 6},
    }
    return PlantDescription(**{**given, **changes})


def test_every_shipped_plant_has_its_equations_here() -> None:
    assert set(shipped_plants()) == set(EQUATIONS)


@pytest.mark.parametrize("name", sorted(EQUATIONS))
def test_shipped_plants_are_the_cited_equations(name: str) -> None:
    plant = load_plant(name)
    check_plant(plant)
    generator = np.random.default_rng(1)
    x = generator.uniform(-3, 3, size=(len(plant.states), 40))
    u = generator.uniform(-1, 1, size=(len(plant.inputs), 40))
    computed = run(plant.tape, FloatAlgebra(), [*x, *u])
    for ours, theirs in zip(computed, EQUATIONS[name](x, u), strict=True):
        np.testing.assert_allclose(np.broadcast_to(ours, 40), theirs, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("name", sorted(EQUATIONS))
def test_shipped_plants_say_units_and_sources(name: str) -> None:
    plant = load_plant(name)
    units = {**plant.description.states, **plant.description.inputs}
    assert all(units.values()) and all(unit for _, unit in plant.description.parameters.values())
    assert "Eq." in Path(plant.description.source).read_text() or name == "unicycle"


def test_the_order_of_the_unicycle_is_the_benchmarks() -> None:
    assert load_plant("unicycle").states == ("x", "y", "v", "theta")
    assert load_plant("navigation").states == ("x", "y", "theta", "v")


def test_a_plant_file_is_found_relative_to_the_specification(tmp_path: Path) -> None:
    (tmp_path / "cart.yaml").write_text("states: {p: m}\ninputs: {a: m/s}\ndynamics: {p: a}\n")
    plant = load_plant("cart.yaml", relative_to=tmp_path)
    assert plant.states == ("p",) and load_plant(str(tmp_path / "cart.yaml")).inputs == ("a",)
    with pytest.raises(SpecificationError, match=r"no plant file other\.yaml"):
        load_plant("other.yaml", relative_to=tmp_path)


def test_a_wrong_name_is_answered_with_the_closest_one() -> None:
    with pytest.raises(SpecificationError, match="did you mean unicycle"):
        load_plant("unicylce")
    with pytest.raises(SpecificationError, match="shipped plants: navigation, pendulum"):
        load_plant("helicopter")


def test_inputs_of_the_tape_are_states_inputs_disturbances() -> None:
    plant = compile_plant(description())
    check_plant(plant)
    assert plant.tape.inputs == ("p", "v", "a", "wind")
    assert run(plant.tape, FloatAlgebra(), [0.0, 3.0, 1.0, 5.0]) == [3.0, 3.0]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"dynamics": {"p": parse_expression("v")}}, r"cart\.yaml: every state needs dynamics; missing: v"),
        (
            {"dynamics": {"p": parse_expression("v"), "v": parse_expression("wnd/m")}},
            r"cart\.yaml:6: the dynamics of v use wnd.*did you mean wind",
        ),
        (
            {"dynamics": {"p": parse_expression("v"), "v": parse_expression("a"), "q": parse_expression("a")}},
            "q, which is no state",
        ),
        ({"inputs": {"p": ""}}, r"p names a state and something else \(input\)"),
        ({"parameters": {"m": (Fraction(2), ""), "wind": (Fraction(1), "")}}, "wind names a disturbance and"),
        ({"parameters": {"m": (Fraction(0), "kg")}}, r"cart\.yaml:6: the dynamics of v divide by zero"),
        ({"states": {}, "dynamics": {}}, "at least one state"),
    ],
)
def test_a_wrong_plant_is_refused_with_its_line(changes: dict[str, Any], message: str) -> None:
    with pytest.raises(SpecificationError, match=message):
        compile_plant(description(**changes))


def test_a_tape_that_is_not_the_texts_breaks_the_contract() -> None:
    from dataclasses import replace

    plant, other = load_plant("unicycle"), load_plant("navigation")
    with pytest.raises(AssertionError):
        check_plant(replace(plant, tape=other.tape))
