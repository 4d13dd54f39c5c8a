"""Joins a specification, a plant and a policy: names become positions, every dimension is checked, numbers stay exact.

A message says the file and line of the YAML entry it is about, what was required, what was received, and the remedy.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from fractions import Fraction
from pathlib import Path
from typing import NoReturn, TypeAlias

from ..specs.errors import SpecificationError, UsageError
from ..specs.expressions import Expression, Name, names_in
from ..specs.specification import AffineMap, Bounds, PlantDescription, Region, Requirement, Specification
from .closed_loop import (
    BoundAffine,
    BoundDisturbance,
    BoundPolytope,
    BoundRequirement,
    BoundReward,
    ClosedLoop,
    FractionMatrix,
    Intervals,
    Plant,
    affine_rows,
)
from .plant import compile_plant, load_plant, parameter_values, suggestion
from .policy import Policy
from .tape import Tape, compile_tape

Radius: TypeAlias = Fraction | int | float | str


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
    return _Binder(specification, policy, plant or _plant(specification)).bind(observation_radius)


def place_of(specification: Specification, key: str) -> str | None:
    """``file:line`` of a dotted key, or of the closest entry around it that has a line."""
    parts = key.split(".")
    for count in range(len(parts), 0, -1):
        line = specification.lines.get(".".join(parts[:count]), 0)
        if line:
            return f"{specification.source}:{line}" if specification.source else f"line {line}"
    return specification.source or None


def _plant(specification: Specification) -> Plant:
    if isinstance(specification.plant, PlantDescription):
        return compile_plant(specification.plant)
    folder = Path(specification.source).parent if specification.source else None
    try:
        return load_plant(specification.plant, relative_to=folder)
    except SpecificationError as error:
        place = place_of(specification, "plant")
        raise (error.at(place) if place else error) from error


def exact_number(value: Radius) -> Fraction:
    """A number as the decimal it prints as: ``0.1`` is one tenth."""
    try:
        return Fraction(repr(value)) if isinstance(value, float) else Fraction(value)
    except (ValueError, ZeroDivisionError) as error:
        raise UsageError(f"a finite number is required, received {value!r}") from error


class _Binder:
    """One specification with one plant and one policy; each method binds one part."""

    def __init__(self, specification: Specification, policy: Policy, plant: Plant) -> None:
        self.specification = specification
        self.policy = policy
        self.plant = plant
        self.observe = specification.controller.observe
        self.names: tuple[str, ...] = tuple(self.observe) if self.observe is not None else plant.states

    def fail(self, key: str, message: str, remedy: str | None = None) -> NoReturn:
        raise SpecificationError(message, where=place_of(self.specification, key), remedy=remedy)

    def require_names(self, key: str, names: Iterable[str], known: Iterable[str], what: str) -> None:
        """Every name must be known; `what` is the singular of what they are."""
        known = tuple(known)
        for name in names:
            if name not in known:
                self.fail(f"{key}.{name}", f"{name} is no {what}", suggestion(name, known, f"the plant's {what}s"))

    def bind(self, observation_radius: Radius | Mapping[str, Radius] | None) -> ClosedLoop:
        specification, controller = self.specification, self.specification.controller
        before, after = self.before(), self.after()
        return ClosedLoop(
            plant=self.plant,
            policy=self.policy,
            period=controller.period,
            periods=self.periods(),
            initial=self.initial(),
            observation=self.observation(),
            observation_names=self.names,
            observation_radius=self.radius(observation_radius),
            before=before,
            after=after,
            clip=self.clip(),
            delay=self.delay(),
            delayed_action=self.delayed_action(),
            disturbances=self.disturbances(),
            requirements=self.requirements(),
            reward=self.reward(),
            specification=specification,
        )

    def periods(self) -> int:
        period, horizon = self.specification.controller.period, self.specification.horizon
        if period <= 0:
            self.fail("controller.period", f"the control period must be positive, received {_shown(period)}")
        if horizon <= 0:
            self.fail("horizon", f"the horizon must be positive, received {_shown(horizon)}")
        count = horizon / period
        if count.denominator != 1:
            below, above = (count.__floor__() * period, count.__ceil__() * period)
            self.fail(
                "horizon",
                f"the horizon must be a multiple of the control period {_shown(period)}, received {_shown(horizon)}",
                f"use {_shown(above)}" + (f" or {_shown(below)}" if below else ""),
            )
        return int(count)

    def initial(self) -> Intervals:
        initial, states = self.specification.initial, self.plant.states
        self.require_names("initial", initial, states, "state")
        missing = [state for state in states if state not in initial]
        if missing:
            self.fail(
                "initial",
                f"the initial set must bound every state; missing: {', '.join(missing)}",
                f"add {missing[0]}: 0, or an interval",
            )
        for state in states:
            self.require_order(f"initial.{state}", initial[state])
        return tuple((initial[state].lower, initial[state].upper) for state in states)

    def require_order(self, key: str, bounds: Bounds) -> None:
        if not bounds.lower <= bounds.upper:
            self.fail(key, f"[{_shown(bounds.lower)}, {_shown(bounds.upper)}] is empty", "write the lower bound first")

    def observation(self) -> Tape | None:
        if self.observe is None:
            return None
        parameters = parameter_values(self.plant.description)
        known = (*self.plant.states, *parameters)
        if not self.observe:
            self.fail("controller.observe", "the policy must observe something", "list the states it sees")
        for position, (label, expression) in enumerate(self.observe.items()):
            key = f"controller.observe.{label}"
            for name in sorted(names_in(expression)):
                if name not in known:
                    self.fail(
                        key if key in self.specification.lines else f"controller.observe.{position}",
                        f"an observation is made of states; {name} is none",
                        suggestion(name, known, "states and parameters"),
                    )
        expressions: list[Expression] = list(self.observe.values())
        if expressions == [Name(state) for state in self.plant.states]:
            return None
        return compile_tape(expressions, self.plant.states, parameters)

    def radius(self, override: Radius | Mapping[str, Radius] | None) -> tuple[Fraction, ...]:
        key = "perturbation.observation"
        given = self.specification.perturbation.observation
        if override is not None:
            return self.overridden_radius(override)
        if not isinstance(given, Mapping):
            if given < 0:
                self.fail(key, f"a radius is not negative, received {_shown(given)}")
            return (given,) * len(self.names)
        self.require_names(key, given, self.names, "observation")
        for name, value in given.items():
            if value < 0:
                self.fail(f"{key}.{name}", f"a radius is not negative, received {_shown(value)}")
        return tuple(given.get(name, Fraction(0)) for name in self.names)

    def overridden_radius(self, override: Radius | Mapping[str, Radius]) -> tuple[Fraction, ...]:
        values = override if isinstance(override, Mapping) else dict.fromkeys(self.names, override)
        exact = {name: exact_number(value) for name, value in values.items()}
        for name, value in exact.items():
            if name not in self.names:
                raise UsageError(f"{name} is no observation", remedy=suggestion(name, self.names, "observations"))
            if value < 0:
                raise UsageError(f"the observation radius must not be negative, received {_shown(value)}")
        return tuple(exact.get(name, Fraction(0)) for name in self.names)

    def before(self) -> BoundAffine | None:
        received, required = len(self.names), self.policy.inputs
        bound = self.affine("controller.before", self.specification.controller.before, received, "observation")
        count = len(bound.offset) if bound is not None else received
        if count != required:
            what = "controller.before returns" if bound is not None else "the observation has"
            self.fail(
                "controller.before" if bound is not None else "controller.observe",
                f"the policy {self.policy.name} takes {required} numbers, {what} {count} ({', '.join(self.names)})",
                "choose the observed states with controller.observe, or another policy",
            )
        return bound

    def after(self) -> BoundAffine | None:
        inputs = self.plant.inputs
        bound = self.affine("controller.after", self.specification.controller.after, self.policy.outputs, "output")
        count = len(bound.offset) if bound is not None else self.policy.outputs
        if count != len(inputs):
            what = "controller.after returns" if bound is not None else f"the policy {self.policy.name} returns"
            self.fail(
                "controller.after" if bound is not None else "controller",
                f"the plant has {len(inputs)} inputs ({', '.join(inputs)}), {what} {count} numbers",
                "map the network's output to the inputs with controller.after, or take another policy",
            )
        return bound

    def affine(self, key: str, given: AffineMap | None, size: int, what: str) -> BoundAffine | None:
        """Full exact matrix and offset; None for the identity."""
        if given is None:
            return None
        if given.matrix is not None:
            for row in given.matrix:
                if len(row) != size:
                    self.fail(
                        f"{key}.matrix",
                        f"every row needs {size} numbers, one per {what}; received a row of {len(row)}",
                        "a matrix has one row per output and one column per input",
                    )
            matrix: FractionMatrix = given.matrix
        else:
            scale = self.components(f"{key}.scale", given.scale, size, what)
            matrix = _diagonal(scale)
        offset = self.components(f"{key}.offset", given.offset, len(matrix), "output")
        if matrix == _diagonal((Fraction(1),) * size) and not any(offset):
            return None
        return BoundAffine(matrix, offset)

    def components(
        self, key: str, value: tuple[Fraction, ...] | Fraction, size: int, what: str
    ) -> tuple[Fraction, ...]:
        if not isinstance(value, tuple):
            return (Fraction(value),) * size
        if len(value) != size:
            self.fail(key, f"{size} numbers are required, one per {what}; received {len(value)}", "or write one number")
        return value

    def clip(self) -> Intervals | None:
        clip, inputs, key = self.specification.controller.clip, self.plant.inputs, "controller.clip"
        if clip is None:
            return None
        if isinstance(clip, Bounds):
            self.require_order(key, clip)
            return ((clip.lower, clip.upper),) * len(inputs)
        self.require_names(key, clip, inputs, "input")
        missing = [name for name in inputs if name not in clip]
        if missing:
            self.fail(
                key, f"every input needs bounds; missing: {', '.join(missing)}", "add them, or write one interval"
            )
        for name, bounds in clip.items():
            self.require_order(f"{key}.{name}", bounds)
        return tuple((clip[name].lower, clip[name].upper) for name in inputs)

    def delay(self) -> int:
        delay = self.specification.controller.delay
        if delay < 0:
            self.fail("controller.delay", f"a delay is a number of whole periods, received {delay}")
        return delay

    def delayed_action(self) -> tuple[Fraction, ...]:
        given = self.specification.controller.delayed_action
        self.require_names("controller.delay.action", given, self.plant.inputs, "input")
        return tuple(given.get(name, Fraction(0)) for name in self.plant.inputs)

    def disturbances(self) -> tuple[BoundDisturbance, ...]:
        given, key = self.specification.perturbation.disturbances, "perturbation.disturbance"
        self.require_names(key, given, self.plant.disturbances, "disturbance")
        bound = []
        for name in self.plant.disturbances:
            if name in given:
                self.require_order(f"{key}.{name}", given[name].bounds)
                bounds = given[name].bounds
                bound.append(BoundDisturbance(bounds.lower, bounds.upper, given[name].constant))
            else:
                bound.append(BoundDisturbance(Fraction(0), Fraction(0), True))
        return tuple(bound)

    def region(self, key: str, region: Region) -> tuple[BoundPolytope, ...]:
        states = self.plant.states
        for member in region.members:
            for facet in member.halfspaces:
                for name in facet.coefficients:
                    if name not in states:
                        self.fail(
                            key, f"`{facet.text}` uses {name}, which is no state", suggestion(name, states, "states")
                        )
                if not any(facet.coefficients.values()):
                    self.fail(key, f"`{facet.text}` bounds no state", "remove it")
        return tuple(
            BoundPolytope(
                normals=tuple(affine_rows(facet.coefficients, states) for facet in member.halfspaces),
                bounds=tuple(facet.bound for facet in member.halfspaces),
                facets=tuple(facet.text for facet in member.halfspaces),
            )
            for member in region.members
        )

    def requirements(self) -> tuple[BoundRequirement, ...]:
        seen: set[str] = set()
        bound = []
        for position, requirement in enumerate(self.specification.requirements):
            key = f"requirements.{position}"
            if requirement.name in seen:
                self.fail(key, f"two requirements are called {requirement.name}", "give each a name of its own")
            seen.add(requirement.name)
            self.require_window(key, requirement)
            bound.append(
                BoundRequirement(
                    kind=requirement.kind,
                    name=requirement.name,
                    region=self.region(key, requirement.region),
                    start=requirement.start,
                    end=requirement.end,
                    line=requirement.line,
                )
            )
        return tuple(bound)

    def require_window(self, key: str, requirement: Requirement) -> None:
        start, end, horizon = requirement.start, requirement.end, self.specification.horizon
        if not 0 <= start <= end <= horizon:
            self.fail(
                key,
                f"{requirement.name} holds during [{_shown(start)}, {_shown(end)}], which is not within "
                f"[0, {_shown(horizon)}]",
                "move the window or the horizon",
            )
        period = self.specification.controller.period
        if self.plant.discrete and (end / period).__floor__() * period < start:
            self.fail(
                key,
                f"no step of the discrete-time plant is in [{_shown(start)}, {_shown(end)}]",
                f"a step happens every {_shown(period)}",
            )

    def reward(self) -> BoundReward | None:
        reward, states = self.specification.reward, self.plant.states
        if reward is None:
            return None
        self.require_names("reward.weights", reward.weights, states, "state")
        self.require_names("reward.target", reward.target, states, "state")
        for name, weight in reward.weights.items():
            if weight < 0:
                self.fail(f"reward.weights.{name}", f"a weight is not negative, received {_shown(weight)}")
        if not 0 < reward.discount <= 1:
            self.fail("reward.discount", f"the discount must be in (0, 1], received {_shown(reward.discount)}")
        penalty = reward.penalty
        if penalty is not None and penalty.amount < 0:
            self.fail("reward.penalty", f"a penalty is not negative, received {_shown(penalty.amount)}")
        return BoundReward(
            weights=affine_rows(reward.weights, states),
            target=affine_rows(reward.target, states),
            discount=reward.discount,
            penalty=penalty.amount if penalty is not None else Fraction(0),
            penalty_region=self.region("reward.penalty", penalty.region) if penalty is not None else (),
        )


def _diagonal(entries: tuple[Fraction, ...]) -> FractionMatrix:
    size = len(entries)
    return tuple(tuple(entries[i] if i == j else Fraction(0) for j in range(size)) for i in range(size))


def _shown(number: Fraction) -> str:
    """A rational for a message: as a decimal where that is short."""
    short = f"{float(number):.12g}"
    return short if Fraction(short) == number else str(number)
