"""python-control systems in and out: a linear system becomes a plant's text, any plant becomes a `control` system."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import Any

import numpy as np

from ..specs.errors import SpecificationError
from ..specs.expressions import Binary, Expression, Name, Number
from ..specs.specification import PlantDescription
from .binding_controller import Radius, exact_number
from .closed_loop import Plant
from .float_algebra import FloatAlgebra
from .plant import compile_plant, suggestion
from .policy import FloatArray
from .tape import run

DIGITS = 15
"""Significant digits to which the coefficients of a system without matrices are recovered."""

PROBES = 32
"""Fixed random points on which such a system must be linear."""


def plant_from_control(system: Any, name: str | None = None) -> PlantDescription:
    """A linear python-control system as a plant.

    Parameters
    ----------
    system : control.StateSpace or control.NonlinearIOSystem
        Continuous or discrete. A system without matrices must be affine: ``f(x, u) = A x + B u + c``; that is tried
        on fixed random points, and its coefficients are recovered to `DIGITS` digits. Anything nonlinear cannot be
        read out of a Python function: write its equations as a plant file.
    name : str, optional
        The system's own name by default.

    Returns
    -------
    PlantDescription
        Every coefficient is the decimal it prints as. The output equation is not part of a plant:
        `observe_from_control` returns it. A discrete system's sampling time becomes the specification's period.

    Raises
    ------
    SpecificationError
        The system has no states or inputs, or is not affine.
    """
    import control

    if not isinstance(system, control.NonlinearIOSystem) or not system.nstates or not system.ninputs:
        raise SpecificationError(
            "a control.StateSpace or control.NonlinearIOSystem with states and inputs is required, received "
            f"{type(system).__name__}",
            remedy="convert a transfer function with control.ss first",
        )
    if isinstance(system, control.StateSpace):
        matrix, drift = np.hstack([np.asarray(system.A), np.asarray(system.B)]), np.zeros(system.nstates)
    else:
        matrix, drift = _affine_parts(system)
    states = _names(system.state_labels, "x", ())
    inputs = _names(system.input_labels, "u", states)
    variables = (*states, *inputs)
    dynamics = {state: _affine(row, variables, c) for state, row, c in zip(states, matrix, drift, strict=True)}
    return PlantDescription(
        name=name or str(system.name),
        states=dict.fromkeys(states, ""),
        inputs=dict.fromkeys(inputs, ""),
        disturbances={},
        parameters={},
        dynamics=dynamics,
        discrete=bool(system.isdtime(strict=True)),
        description="Converted from a python-control system.",
        source=f"control system {system.name}",
    )


def observe_from_control(system: Any) -> dict[str, Expression]:
    """The output equation ``y = C x`` of a `control.StateSpace`, for `specs.specification.Controller.observe`.

    Raises
    ------
    SpecificationError
        The system has a direct feedthrough: an action cannot depend on itself.
    """
    if np.any(np.asarray(system.D)):
        raise SpecificationError("the output depends on the input (D is not zero)", remedy="leave the feedthrough out")
    states = _names(system.state_labels, "x", ())
    rows = np.asarray(system.C)
    labels = _names(system.output_labels, "y", ())
    return {label: _affine(row, states, 0.0) for label, row in zip(labels, rows, strict=True)}


def plant_to_control(
    plant: Plant,
    parameters: Mapping[str, Radius] | None = None,
    *,
    period: float | None = None,
    name: str | None = None,
) -> Any:
    """A plant as a python-control system, for its simulation, linearisation and design functions.

    Parameters
    ----------
    plant : Plant
    parameters : mapping of parameter name to number, optional
        Instead of the plant's own values.
    period : float, optional
        Sampling time of a discrete-time plant in seconds; unspecified by default.
    name : str, optional

    Returns
    -------
    control.NonlinearIOSystem
        Inputs are the plant's inputs, then its disturbances; outputs are its states.
    """
    import control

    changed = _with_parameters(plant, parameters) if parameters else plant
    inputs = [*changed.inputs, *changed.disturbances]
    return control.nlsys(
        _update(changed),
        None,
        inputs=inputs,
        states=list(changed.states),
        outputs=list(changed.states),
        dt=(period or True) if changed.discrete else 0,
        name=name or changed.description.name,
    )


def _update(plant: Plant) -> Callable[[float, FloatArray, FloatArray, Mapping[str, Any]], FloatArray]:
    def update(_: float, x: FloatArray, u: FloatArray, params: Mapping[str, Any]) -> FloatArray:
        return np.array([float(value) for value in run(plant.tape, FloatAlgebra(), [*x, *np.atleast_1d(u)])])

    return update


def _with_parameters(plant: Plant, parameters: Mapping[str, Radius]) -> Plant:
    values = dict(plant.description.parameters)
    for key, value in parameters.items():
        if key not in values:
            raise SpecificationError(
                f"{key} is no parameter of {plant.description.name}", remedy=suggestion(key, values, "parameters")
            )
        values[key] = (exact_number(value), values[key][1])
    return compile_plant(replace(plant.description, parameters=values))


def _affine_parts(system: Any) -> tuple[FloatArray, FloatArray]:
    """``[A, B]`` and c of an affine system, from its values at the unit vectors; confirmed on random points."""
    n, m = system.nstates, system.ninputs

    def value(point: FloatArray) -> FloatArray:
        return np.asarray(system.dynamics(0.0, point[:n], point[n:]), dtype=np.float64)

    drift = value(np.zeros(n + m))
    columns = [value(unit) - drift for unit in np.eye(n + m)]
    matrix, drift = _to_digits(np.stack(columns, axis=1)), _to_digits(drift)
    generator = np.random.default_rng(20240301)
    for point in generator.uniform(-10.0, 10.0, size=(PROBES, n + m)):
        expected = matrix @ point + drift
        tolerance = 1e-9 * (np.abs(matrix) @ np.abs(point) + np.abs(drift) + 1.0)
        if not (np.abs(value(point) - expected) <= tolerance).all():
            raise SpecificationError(
                f"the control system {system.name} is not linear: it deviates from its linearisation at "
                f"{np.round(point, 3).tolist()}",
                remedy="write its equations as a plant file; a Python function cannot be verified",
            )
    return matrix, drift


def _to_digits(values: FloatArray) -> FloatArray:
    return np.array([float(f"{value:.{DIGITS}g}") for value in values.ravel()]).reshape(values.shape)


def _names(labels: Sequence[str], letter: str, taken: Sequence[str]) -> tuple[str, ...]:
    """Labels as identifiers: ``x[0]`` is x0; numbered letters where labels still cannot be names."""
    names = tuple(re.sub(r"[^A-Za-z0-9_]", "", label) for label in labels)
    proper = all(re.fullmatch(r"[A-Za-z][A-Za-z0-9_]*", name) for name in names)
    if proper and len({*names, *taken}) == len(names) + len(taken):
        return names
    return tuple(f"{letter}{position}" for position in range(len(labels)))


def _affine(row: FloatArray, variables: Sequence[str], constant: float) -> Expression:
    """``sum_i row_i * variable_i + constant`` with the zeros left out."""
    terms: list[Expression] = []
    for coefficient, variable in zip(row, variables, strict=True):
        exact = exact_number(float(coefficient))
        if exact == 1:
            terms.append(Name(variable))
        elif exact:
            terms.append(Binary("*", Number(exact), Name(variable)))
    drift = exact_number(float(constant))
    if drift or not terms:
        terms.append(Number(drift))
    total = terms[0]
    for term in terms[1:]:
        total = Binary("+", total, term)
    return total
