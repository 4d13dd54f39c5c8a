"""Linear systems of python-control and plants of setrl say the same, in both directions."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from setrl.models.control_interop import observe_from_control, plant_from_control, plant_to_control
from setrl.models.float_algebra import FloatAlgebra
from setrl.models.plant import check_plant, compile_plant, load_plant
from setrl.models.tape import run
from setrl.specs.errors import SpecificationError
from setrl.specs.expressions import affine_form

control = pytest.importorskip("control")

A = np.array([[0.0, 1.0], [-2.5, -0.1]])
B = np.array([[0.0], [1.5]])
C = np.array([[1.0, 0.0]])


def coefficients(description: Any, state: str) -> Any:
    return affine_form(description.dynamics[state])


def test_a_state_space_becomes_a_plant_with_its_decimals() -> None:
    description = plant_from_control(control.ss(A, B, C, 0), name="spring")
    assert description.name == "spring" and not description.discrete
    first, second = description.states
    (force,) = description.inputs
    assert coefficients(description, first) == ({second: 1}, 0)
    assert coefficients(description, second) == (
        {first: Fraction(-5, 2), second: Fraction(-1, 10), force: Fraction(3, 2)},
        0,
    )
    check_plant(compile_plant(description))


def test_labels_are_kept_where_they_can_be_names() -> None:
    system = control.ss(A, B, C, 0, states=["p", "v"], inputs=["u[0]"], outputs=["p"])
    description = plant_from_control(system)
    assert (tuple(description.states), tuple(description.inputs)) == (("p", "v"), ("u0",))
    odd = control.ss(A, B, C, 0, states=["1", "2"], inputs=["force now"])
    assert tuple(plant_from_control(odd).states) == ("x0", "x1")


def test_discrete_systems_stay_discrete() -> None:
    assert plant_from_control(control.ss(A, B, C, 0, 0.1)).discrete
    assert not plant_from_control(control.ss(A, B, C, 0)).discrete


def test_the_output_equation_is_an_observation() -> None:
    system = control.ss(A, B, np.array([[2.0, -1.0]]), 0, states=["p", "v"], outputs=["mix"])
    assert {name: affine_form(e) for name, e in observe_from_control(system).items()} == {"mix": ({"p": 2, "v": -1}, 0)}
    with pytest.raises(SpecificationError, match="feedthrough|D is not zero"):
        observe_from_control(control.ss(A, B, C, 1))


def test_a_function_that_is_affine_is_read_with_its_drift() -> None:
    def update(t: float, x: Any, u: Any, params: Any) -> Any:
        return np.array([x[1], 10 * (u[0] + 1) - 9.81])

    system = control.nlsys(update, None, states=["z", "zdot"], inputs=["a"], outputs=2)
    description = plant_from_control(system)
    assert coefficients(description, "z") == ({"zdot": 1}, 0)
    assert coefficients(description, "zdot") == ({"a": 10}, Fraction(19, 100))


def test_a_nonlinear_function_is_refused() -> None:
    def update(t: float, x: Any, u: Any, params: Any) -> Any:
        return np.array([x[1], np.sin(x[0]) + u[0]])

    with pytest.raises(SpecificationError, match=r"not linear.*\(write its equations as a plant file"):
        plant_from_control(control.nlsys(update, None, states=2, inputs=1, outputs=2))
    with pytest.raises(SpecificationError, match="received dict"):
        plant_from_control({})


@pytest.mark.parametrize("name", ["unicycle", "navigation", "pendulum", "quadrotor1d", "quadrotor2d"])
def test_a_plant_as_a_control_system_has_the_same_dynamics(name: str) -> None:
    plant = load_plant(name)
    system = plant_to_control(plant)
    generator = np.random.default_rng(1)
    for _ in range(5):
        x, u = generator.normal(size=len(plant.states)), generator.normal(size=len(plant.inputs))
        ours = [float(value) for value in run(plant.tape, FloatAlgebra(), [*x, *u])]
        np.testing.assert_allclose(system.dynamics(0, x, u), ours, rtol=1e-15)
    assert tuple(system.state_labels) == plant.states and tuple(system.input_labels) == plant.inputs


def test_a_plant_can_be_linearised_and_designed_for() -> None:
    system = plant_to_control(load_plant("pendulum"))
    linear = system.linearize([0, 0], [0])
    np.testing.assert_allclose(linear.A, [[0, 1], [9.81, 0]], atol=1e-5)
    gain, _, poles = control.lqr(linear, np.eye(2), np.eye(1))
    assert gain.shape == (1, 2) and (np.real(poles) < 0).all()


def test_parameters_can_be_replaced_by_name() -> None:
    system = plant_to_control(load_plant("pendulum"), {"l": 0.5})
    np.testing.assert_allclose(system.dynamics(0, [0.3, 0.0], [0.1])[1], 9.81 / 0.5 * np.sin(0.3) + 1.5 / 0.25)
    with pytest.raises(SpecificationError, match="parameters: m, l, g, torque"):
        plant_to_control(load_plant("pendulum"), {"length": 1})


def test_there_and_back_is_the_same_plant() -> None:
    description = plant_from_control(control.ss(A, B, np.eye(2), 0, states=["p", "v"], inputs=["u"]))
    again = plant_from_control(plant_to_control(compile_plant(description)))
    for state in ("p", "v"):
        assert coefficients(again, state) == coefficients(description, state)
