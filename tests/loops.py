"""Closed loops for tests, written in a few words: inline plants, small policies, regions, specifications."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np

from setrl.models.binding import bind
from setrl.models.closed_loop import ClosedLoop
from setrl.models.policy import Activation, Affine, Layer, Policy
from setrl.specs.expressions import parse_expression
from setrl.specs.specification import (
    AffineMap,
    Bounds,
    Controller,
    Disturbance,
    Halfspace,
    Perturbation,
    PlantDescription,
    Polytope,
    Region,
    Requirement,
    Specification,
)

F = Fraction


def plant_of(dynamics: Mapping[str, str], inputs: str = "u", disturbances: str = "", discrete: bool = False) -> Any:
    """A plant from a mapping of state to expression; names are separated by spaces."""
    names = [{name: "1" for name in group.split()} for group in (" ".join(dynamics), inputs, disturbances)]
    expressions = {state: parse_expression(text) for state, text in dynamics.items()}
    return PlantDescription("test", *names, {}, expressions, discrete)


def box_region(**sides: tuple[Any, Any]) -> Region:
    """A region that is one box."""
    faces = []
    for state, (low, high) in sides.items():
        faces.append(Halfspace({state: F(1)}, F(high), f"{state} <= {high}"))
        faces.append(Halfspace({state: F(-1)}, -F(low), f"{state} >= {low}"))
    return Region((Polytope(tuple(faces)),))


def gain(*rows: Sequence[float], bias: Any = None, precision: str = "float64") -> Policy:
    """A linear policy."""
    weight = np.array(rows, dtype=np.float64)
    layer = Affine(weight, np.zeros(len(weight)) if bias is None else np.array(bias, dtype=np.float64))
    return Policy((layer,), weight.shape[1], weight.shape[0], precision=precision)


def network(
    sizes: Sequence[int], kinds: Sequence[str], seed: int, scale: float = 1.0, precision: str = "float32"
) -> Policy:
    """A random network; float32 numbers, one activation kind after every affine map but those named "none"."""
    generator = np.random.default_rng(seed)
    layers: list[Layer] = []
    for rows, columns, kind in zip(sizes[1:], sizes[:-1], kinds, strict=True):
        weight = generator.normal(size=(rows, columns)) * scale / np.sqrt(columns)
        bias = 0.3 * generator.normal(size=rows)
        layers.append(Affine(weight.astype(np.float32).astype(float), bias.astype(np.float32).astype(float)))
        if kind != "none":
            layers.append(activation_of(kind))
    return Policy(tuple(layers), sizes[0], sizes[-1], precision=precision)


def activation_of(kind: str) -> Activation:
    """One of each kind."""
    return {
        "leaky_relu": Activation("leaky_relu", slope=0.125),
        "clip": Activation("clip", lower=-0.75, upper=1.0),
    }.get(kind, Activation(kind))


def specification_of(
    plant: Any,
    initial: Mapping[str, tuple[Any, Any]],
    *,
    period: Any = "0.1",
    periods: int = 3,
    observation: Any = 0,
    disturbances: Mapping[str, tuple[Any, Any, bool]] | None = None,
    requirements: Sequence[Requirement] = (),
    reward: Any = None,
    **controller: Any,
) -> Specification:
    """A specification from numbers, texts or fractions."""
    if "observe" in controller:
        controller["observe"] = {name: parse_expression(text) for name, text in controller["observe"].items()}
    given = {
        name: Disturbance(Bounds(F(low), F(high)), constant)
        for name, (low, high, constant) in (disturbances or {}).items()
    }
    return Specification(
        plant,
        Controller(F(period), **controller),
        F(period) * periods,
        {state: Bounds(F(low), F(high)) for state, (low, high) in initial.items()},
        Perturbation(F(observation), given),
        tuple(requirements),
        reward,
    )


def loop_of(policy: Policy, specification: Specification, epsilon: Any = None) -> ClosedLoop:
    """Bound closed loop."""
    return bind(specification, policy, None, epsilon)


def affine_map(matrix: Sequence[Sequence[Any]], offset: Sequence[Any]) -> AffineMap:
    """Exact affine map from texts or numbers."""
    return AffineMap(tuple(tuple(F(x) for x in row) for row in matrix), F(1), tuple(F(x) for x in offset))


def requirement(kind: Any, region: Region, start: Any, end: Any, name: str = "it") -> Requirement:
    """One requirement."""
    return Requirement(kind, name, region, F(start), F(end))


def with_requirements(specification: Specification, *requirements: Requirement) -> Specification:
    """The same specification with other requirements."""
    return replace(specification, requirements=tuple(requirements))
