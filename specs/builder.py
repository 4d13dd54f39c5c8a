"""Specification document to `Specification`: everything that relates several keys to each other is checked here."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from . import documents as doc
from .errors import ExpressionError
from .exact import shown, signed_text
from .expression_parser import suggestion
from .expressions import Expression, format_expression, parse_expression
from .plant_builder import Place, build_plant
from .plant_document import PlantDocument
from .specification import (
    AffineMap,
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

MAX_PERIODS = 100_000


def build_specification(document: doc.SpecificationDocument, place: Place, digest: str) -> Specification:
    """Check a specification document and turn it into data.

    Parameters
    ----------
    document : SpecificationDocument
    place : Place
        Its source and lines.
    digest : str
        sha256 of the bytes that were read.

    Returns
    -------
    Specification
    """
    plant: str | PlantDescription
    if isinstance(document.plant, PlantDocument):
        plant = build_plant(document.plant, "inline", Place(place.source, place.lines, "plant."))
    else:
        plant = document.plant
    controller = _controller(document.controller, place)
    period, horizon = controller.period, document.horizon
    _check_multiple(horizon, period, "horizon", place, at_least=1)
    periods = horizon / period
    if periods > MAX_PERIODS:
        place.fail("horizon", f"expected at most {MAX_PERIODS} periods, found {periods}", "use a longer period")
    if controller.delay >= periods:
        message = f"the delay of {controller.delay} periods is not shorter than the run of {periods}"
        place.fail("controller.delay", message, "shorten the delay or lengthen the horizon")
    return Specification(
        plant=plant,
        controller=controller,
        horizon=horizon,
        initial=document.initial,
        perturbation=_perturbation(document.perturbation, controller, place),
        requirements=_requirements(document.requirements or [], period, horizon, place),
        reward=_reward(document.reward, place),
        allow_unknown=document.allow_unknown,
        description=document.description or "",
        source=place.source,
        digest=digest,
        lines=place.lines,
    )


def _check_multiple(time: Fraction, period: Fraction, key: str, place: Place, at_least: int = 0) -> None:
    ratio = time / period
    if ratio.denominator == 1 and ratio >= at_least:
        return
    below = int(ratio)
    near = [signed_text(count * period) for count in (below, below + 1) if count >= at_least]
    message = f"{signed_text(time)} is not a whole multiple of the period {signed_text(period)}"
    place.fail(key, message, f"write {' or '.join(near)}")


def _controller(document: doc.ControllerDocument, place: Place) -> Controller:
    delay = document.delay
    return Controller(
        period=document.period,
        observe=_observe(document.observe, place),
        before=_affine(document.before),
        after=_affine(document.after),
        clip=document.clip,
        delay=delay.periods if isinstance(delay, doc.DelayDocument) else delay or 0,
        delayed_action=delay.action if isinstance(delay, doc.DelayDocument) else {},
    )


def _observe(observe: list[str] | dict[str, str] | None, place: Place) -> dict[str, Expression] | None:
    """Observations of a list are named by their normalised text, ``sin(theta)``."""
    if observe is None:
        return None
    if isinstance(observe, dict):
        return {name: place.expression(f"controller.observe.{name}", text) for name, text in observe.items()}
    result: dict[str, Expression] = {}
    for index, text in enumerate(observe):
        expression = place.expression(f"controller.observe.{index}", text)
        name = format_expression(expression)
        if name in result:
            place.fail(f"controller.observe.{index}", f"{shown(name)} is observed twice", "remove one, or name both")
        result[name] = expression
    return result


def _affine(document: doc.AffineDocument | None) -> AffineMap | None:
    if document is None:
        return None
    matrix = None if document.matrix is None else tuple(tuple(row) for row in document.matrix)
    scale = Fraction(1) if document.scale is None else document.scale
    return AffineMap(matrix, scale, document.offset)


def _perturbation(document: doc.PerturbationDocument, controller: Controller, place: Place) -> Perturbation:
    observation = document.observation
    if isinstance(observation, dict) and controller.observe is not None:
        radii: dict[str, Fraction] = {}
        for key, radius in observation.items():
            name = _observation_name(key, tuple(controller.observe))
            if name not in controller.observe:
                remedy = suggestion(key, tuple(controller.observe))
                place.fail(f"perturbation.observation.{key}", "the policy does not observe this", remedy)
            if name in radii:
                place.fail(f"perturbation.observation.{key}", "given twice", "keep one of the two")
            radii[name] = radius
        observation = radii
    return Perturbation(
        observation=observation,
        disturbances={
            name: Disturbance(entry.range, entry.varies == "never")
            if isinstance(entry, doc.DisturbanceDocument)
            else Disturbance(entry)
            for name, entry in document.disturbance.items()
        },
    )


def _observation_name(key: str, known: tuple[str, ...]) -> str:
    if key in known:
        return key
    try:
        return format_expression(parse_expression(key))
    except ExpressionError:
        return key


def _requirements(
    entries: list[doc.RequirementDocument], period: Fraction, horizon: Fraction, place: Place
) -> tuple[Requirement, ...]:
    result: list[Requirement] = []
    counts = {"avoid": 0, "stay": 0, "reach": 0}
    given = {entry.name for entry in entries}
    names: set[str] = set()
    for index, entry in enumerate(entries):
        key = f"requirements.{index}"
        kind = "avoid" if entry.avoid is not None else "stay" if entry.stay is not None else "reach"
        counts[kind] += 1
        name = entry.name or _default_name(kind, counts[kind], given)
        if name in names:
            place.fail(f"{key}.name", f"the name {shown(name)} is taken by an earlier requirement", "choose another")
        names.add(name)
        start, end = _window(entry, kind, key, period, horizon, place)
        region = _region(getattr(entry, kind))
        result.append(Requirement(kind, name, region, start, end, place.line(key)))  # type: ignore[arg-type]
    return tuple(result)


def _default_name(kind: str, count: int, given: set[str | None]) -> str:
    while f"{kind} {count}" in given:
        count += 1
    return f"{kind} {count}"


def _window(
    entry: doc.RequirementDocument, kind: str, key: str, period: Fraction, horizon: Fraction, place: Place
) -> tuple[Fraction, Fraction]:
    if entry.at is not None:
        _check_within(entry.at, horizon, f"{key}.at", place)
        _check_multiple(entry.at, period, f"{key}.at", place)
        return entry.at, entry.at
    if entry.during is not None:
        for bound in (entry.during.lower, entry.during.upper):
            _check_within(bound, horizon, f"{key}.during", place)
            if kind == "reach":
                _check_multiple(bound, period, f"{key}.during", place)
        return entry.during.lower, entry.during.upper
    return (horizon, horizon) if kind == "reach" else (Fraction(0), horizon)


def _check_within(time: Fraction, horizon: Fraction, key: str, place: Place) -> None:
    if not 0 <= time <= horizon:
        message = f"the time {signed_text(time)} is outside the run [0, {signed_text(horizon)}]"
        place.fail(key, message, "move it into the run, or lengthen the horizon")


def _region(value: Any) -> Region:
    if isinstance(value, doc.UnionDocument):
        return Region(tuple(_polytope(part) for part in value.union))
    return Region((_polytope(value),))


def _polytope(value: Any) -> Polytope:
    """A comparison (already halfspaces), a box, or a list of those that all hold."""
    halfspaces: list[Halfspace] = []
    for part in value if isinstance(value, list) else [value]:
        if isinstance(part, dict):
            for state, (lower, upper) in part.items():
                halfspaces.extend(_faces(state, lower, upper))
        else:
            halfspaces.extend(part)
    return Polytope(tuple(halfspaces))


def _faces(state: str, lower: Fraction | None, upper: Fraction | None) -> list[Halfspace]:
    faces = []
    if lower is not None:
        faces.append(Halfspace({state: Fraction(-1)}, -lower, f"{state} >= {signed_text(lower)}"))
    if upper is not None:
        faces.append(Halfspace({state: Fraction(1)}, upper, f"{state} <= {signed_text(upper)}"))
    return faces


def _reward(document: doc.RewardDocument | None, place: Place) -> Reward | None:
    if document is None:
        return None
    for state in document.target:
        if state not in document.weights:
            remedy = f"give it a weight; {suggestion(state, document.weights)}"
            place.fail(f"reward.target.{state}", "the target of a state without weight", remedy)
    penalty = document.penalty
    return Reward(
        weights=document.weights,
        target=document.target,
        discount=document.discount,
        penalty=None if penalty is None else Penalty(penalty.amount, _region(penalty.inside)),
    )
