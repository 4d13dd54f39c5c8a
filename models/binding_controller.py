"""Binding of the controller: what the policy sees, the maps around it, clipping, delay."""

from __future__ import annotations

from collections.abc import Mapping
from fractions import Fraction
from typing import TypeAlias

from ..specs.errors import UsageError
from ..specs.expressions import Expression, Name, names_in
from ..specs.specification import AffineMap, Bounds
from .binding_context import Context, shown
from .closed_loop import BoundAffine, FractionMatrix, Intervals
from .plant import parameter_values, suggestion
from .tape import Tape, compile_tape

Radius: TypeAlias = Fraction | int | float | str
"""A number as a caller gives it; a float means the decimal it prints as."""


def exact_number(value: Radius) -> Fraction:
    """A number as the decimal it prints as: ``0.1`` is one tenth."""
    try:
        return Fraction(repr(float(value))) if isinstance(value, float) else Fraction(value)
    except (ValueError, ZeroDivisionError) as error:
        raise UsageError(f"a finite number is required, received {value!r}") from error


def bind_observation(context: Context) -> Tape | None:
    """The observation as a tape over the states; None where the policy sees all states in order."""
    observe = context.specification.controller.observe
    if observe is None:
        return None
    parameters = parameter_values(context.plant.description)
    known = (*context.plant.states, *parameters)
    if not observe:
        context.fail("controller.observe", "the policy must observe something", "list the states it sees")
    for position, (label, expression) in enumerate(observe.items()):
        key = f"controller.observe.{label}"
        for name in sorted(names_in(expression)):
            if name not in known:
                context.fail(
                    key if key in context.specification.lines else f"controller.observe.{position}",
                    f"an observation is made of states; {name} is none",
                    suggestion(name, known, "states and parameters"),
                )
    expressions: list[Expression] = list(observe.values())
    if expressions == [Name(state) for state in context.plant.states]:
        return None
    return compile_tape(expressions, context.plant.states, parameters)


def bind_radius(context: Context, override: Radius | Mapping[str, Radius] | None) -> tuple[Fraction, ...]:
    """Radius of the observation's perturbation per component; `override` replaces the specification's."""
    key = "perturbation.observation"
    given = context.specification.perturbation.observation
    if override is not None:
        return _overridden_radius(context, override)
    if not isinstance(given, Mapping):
        if given < 0:
            context.fail(key, f"a radius is not negative, received {shown(given)}")
        return (given,) * len(context.observations)
    context.require_names(key, given, context.observations, "observation")
    for name, value in given.items():
        if value < 0:
            context.fail(f"{key}.{name}", f"a radius is not negative, received {shown(value)}")
    return tuple(given.get(name, Fraction(0)) for name in context.observations)


def _overridden_radius(context: Context, override: Radius | Mapping[str, Radius]) -> tuple[Fraction, ...]:
    values = override if isinstance(override, Mapping) else dict.fromkeys(context.observations, override)
    exact = {name: exact_number(value) for name, value in values.items()}
    for name, value in exact.items():
        if name not in context.observations:
            raise UsageError(f"{name} is no observation", remedy=suggestion(name, context.observations, "observations"))
        if value < 0:
            raise UsageError(f"the observation radius must not be negative, received {shown(value)}")
    return tuple(exact.get(name, Fraction(0)) for name in context.observations)


def bind_before(context: Context) -> BoundAffine | None:
    """Map of the observation; its result must be what the policy takes."""
    received, required = len(context.observations), context.policy.inputs
    bound = _affine(context, "controller.before", context.specification.controller.before, received, "observation")
    count = len(bound.offset) if bound is not None else received
    if count != required:
        what = "controller.before returns" if bound is not None else "the observation has"
        context.fail(
            "controller.before" if bound is not None else "controller.observe",
            f"the policy {context.policy.name} takes {required} numbers, {what} {count} "
            f"({', '.join(context.observations)})",
            "choose the observed states with controller.observe, or another policy",
        )
    return bound


def bind_after(context: Context) -> BoundAffine | None:
    """Map of the network's output; its result must be the plant's inputs."""
    inputs = context.plant.inputs
    bound = _affine(
        context, "controller.after", context.specification.controller.after, context.policy.outputs, "output"
    )
    count = len(bound.offset) if bound is not None else context.policy.outputs
    if count != len(inputs):
        what = "controller.after returns" if bound is not None else f"the policy {context.policy.name} returns"
        context.fail(
            "controller.after" if bound is not None else "controller",
            f"the plant has {len(inputs)} inputs ({', '.join(inputs)}), {what} {count} numbers",
            "map the network's output to the inputs with controller.after, or take another policy",
        )
    return bound


def _affine(context: Context, key: str, given: AffineMap | None, size: int, what: str) -> BoundAffine | None:
    """Full exact matrix and offset; None for the identity."""
    if given is None:
        return None
    if given.matrix is not None:
        for row in given.matrix:
            if len(row) != size:
                context.fail(
                    f"{key}.matrix",
                    f"every row needs {size} numbers, one per {what}; received a row of {len(row)}",
                    "a matrix has one row per output and one column per input",
                )
        matrix: FractionMatrix = given.matrix
    else:
        scale = _components(context, f"{key}.scale", given.scale, size, what)
        matrix = _diagonal(scale)
    offset = _components(context, f"{key}.offset", given.offset, len(matrix), "output")
    if matrix == _diagonal((Fraction(1),) * size) and not any(offset):
        return None
    return BoundAffine(matrix, offset)


def _components(
    context: Context, key: str, value: tuple[Fraction, ...] | Fraction, size: int, what: str
) -> tuple[Fraction, ...]:
    if not isinstance(value, tuple):
        return (Fraction(value),) * size
    if len(value) != size:
        context.fail(key, f"{size} numbers are required, one per {what}; received {len(value)}", "or write one number")
    return value


def bind_clip(context: Context) -> Intervals | None:
    """Bounds of every input, or None."""
    clip, inputs, key = context.specification.controller.clip, context.plant.inputs, "controller.clip"
    if clip is None:
        return None
    if isinstance(clip, Bounds):
        context.require_order(key, clip)
        return ((clip.lower, clip.upper),) * len(inputs)
    context.require_names(key, clip, inputs, "input")
    missing = [name for name in inputs if name not in clip]
    if missing:
        context.fail(key, f"every input needs bounds; missing: {', '.join(missing)}", "add them, or write one interval")
    for name, bounds in clip.items():
        context.require_order(f"{key}.{name}", bounds)
    return tuple((clip[name].lower, clip[name].upper) for name in inputs)


def bind_delay(context: Context) -> int:
    """Delay of the action in whole periods."""
    delay = context.specification.controller.delay
    if delay < 0:
        context.fail("controller.delay", f"a delay is a number of whole periods, received {delay}")
    return delay


def bind_delayed_action(context: Context) -> tuple[Fraction, ...]:
    """What acts until the first computed action does, per input."""
    given = context.specification.controller.delayed_action
    context.require_names("controller.delay.action", given, context.plant.inputs, "input")
    return tuple(given.get(name, Fraction(0)) for name in context.plant.inputs)


def _diagonal(entries: tuple[Fraction, ...]) -> FractionMatrix:
    size = len(entries)
    return tuple(tuple(entries[i] if i == j else Fraction(0) for j in range(size)) for i in range(size))
