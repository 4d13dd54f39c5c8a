"""Joins a specification, a plant and a policy: names become positions, every dimension is checked, numbers stay exact.

A message says the file and line of the YAML entry it is about, what was required, what was received, and the remedy.
"""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from pathlib import Path

from ..specs.errors import SpecificationError
from ..specs.specification import PlantDescription, Specification
from .binding_context import Context, place_of, shown
from .binding_controller import (
    Radius,
    bind_after,
    bind_before,
    bind_clip,
    bind_delay,
    bind_delayed_action,
    bind_observation,
    bind_radius,
)
from .binding_requirements import bind_requirements, bind_reward
from .closed_loop import BoundDisturbance, ClosedLoop, Intervals, Plant
from .plant import compile_plant, load_plant
from .policy import Policy


def bind(
    specification: Specification,
    policy: Policy,
    plant: Plant | None = None,
    observation_radius: Radius | Mapping[str, Radius] | None = None,
) -> ClosedLoop:
    """Bind a specification to a plant and a policy.

    Parameters
    ----------
    specification : Specification
    policy : Policy
    plant : Plant, optional
        Instead of the plant that the specification names.
    observation_radius : number, or mapping of observation name to number, optional
        Instead of the specification's perturbation of the observation. A float means the decimal it prints as.

    Returns
    -------
    ClosedLoop

    Raises
    ------
    SpecificationError
        A name is unknown or a dimension is wrong; with the file and line.
    UsageError
        `observation_radius` is negative or names what is not observed.
    """
    context = Context(specification, plant or plant_of(specification), policy)
    return ClosedLoop(
        plant=context.plant,
        policy=policy,
        period=specification.controller.period,
        periods=_periods(context),
        initial=_initial(context),
        observation=bind_observation(context),
        observation_names=context.observations,
        observation_radius=bind_radius(context, observation_radius),
        before=bind_before(context),
        after=bind_after(context),
        clip=bind_clip(context),
        delay=bind_delay(context),
        delayed_action=bind_delayed_action(context),
        disturbances=_disturbances(context),
        requirements=bind_requirements(context),
        reward=bind_reward(context),
        specification=specification,
    )


def plant_of(specification: Specification) -> Plant:
    """The plant that a specification names or holds, compiled.

    Parameters
    ----------
    specification : Specification

    Returns
    -------
    Plant

    Raises
    ------
    SpecificationError
        There is no such plant, or its file is wrong; with the line of the specification that names it.
    """
    if isinstance(specification.plant, PlantDescription):
        return compile_plant(specification.plant)
    folder = Path(specification.source).parent if specification.source else None
    try:
        return load_plant(specification.plant, relative_to=folder)
    except SpecificationError as error:
        place = place_of(specification, "plant")
        raise (error.at(place) if place else error) from error


def _periods(context: Context) -> int:
    period, horizon = context.specification.controller.period, context.specification.horizon
    if period <= 0:
        context.fail("controller.period", f"the control period must be positive, received {shown(period)}")
    if horizon <= 0:
        context.fail("horizon", f"the horizon must be positive, received {shown(horizon)}")
    count = horizon / period
    if count.denominator != 1:
        below, above = (count.__floor__() * period, count.__ceil__() * period)
        context.fail(
            "horizon",
            f"the horizon must be a multiple of the control period {shown(period)}, received {shown(horizon)}",
            f"use {shown(above)}" + (f" or {shown(below)}" if below else ""),
        )
    return int(count)


def _initial(context: Context) -> Intervals:
    initial, states = context.specification.initial, context.plant.states
    context.require_names("initial", initial, states, "state")
    missing = [state for state in states if state not in initial]
    if missing:
        context.fail(
            "initial",
            f"the initial set must bound every state; missing: {', '.join(missing)}",
            f"add {missing[0]}: 0, or an interval",
        )
    for state in states:
        context.require_order(f"initial.{state}", initial[state])
    return tuple((initial[state].lower, initial[state].upper) for state in states)


def _disturbances(context: Context) -> tuple[BoundDisturbance, ...]:
    given, key = context.specification.perturbation.disturbances, "perturbation.disturbance"
    context.require_names(key, given, context.plant.disturbances, "disturbance")
    bound = []
    for name in context.plant.disturbances:
        if name in given:
            context.require_order(f"{key}.{name}", given[name].bounds)
            bounds = given[name].bounds
            bound.append(BoundDisturbance(bounds.lower, bounds.upper, given[name].constant))
        else:
            bound.append(BoundDisturbance(Fraction(0), Fraction(0), True))
    return tuple(bound)
