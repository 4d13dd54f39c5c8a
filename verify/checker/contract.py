"""Specification and plant, read from their bytes into exact numbers and expression trees.

A reader of its own: what `specs` and `models` make of the same files plays no part. What it does not understand, it
refuses.
"""

from __future__ import annotations

import hashlib
from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

from ...specs.errors import ExpressionError, InputError, SpecificationError
from .documents import Plain, interval, load, mapping, number
from .expressions import FUNCTIONS, Expression, Name, constant, names_in, parse, substitute
from .regions import Region, read_region

PLANTS = Path(__file__).resolve().parents[2] / "models" / "plants"
MAX_PERIODS = 100_000

Bounds: TypeAlias = tuple[Fraction, Fraction]


@dataclass(frozen=True)
class Plant:
    """``x' = dynamics(x, u, d)``, or ``x+ = dynamics(x, u, d)`` where `discrete`; parameters are already put in."""

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    parameters: Mapping[str, Fraction]
    dynamics: tuple[Expression, ...]
    discrete: bool


@dataclass(frozen=True)
class AffineMap:
    """``y = matrix x + offset``."""

    matrix: tuple[tuple[Fraction, ...], ...]
    offset: tuple[Fraction, ...]


@dataclass(frozen=True)
class Disturbance:
    """Bounds; the same value in every period where `constant`."""

    bounds: Bounds
    constant: bool


@dataclass(frozen=True)
class Requirement:
    """avoid, stay or reach of a region during [start, end] in seconds."""

    kind: str
    name: str
    region: Region
    start: Fraction
    end: Fraction


@dataclass(frozen=True)
class Reward:
    """Per period ``-weights' |s - target| - penalty [s in region]``, s the state at its end."""

    weights: tuple[Fraction, ...]
    target: tuple[Fraction, ...]
    discount: Fraction
    penalty: Fraction
    region: Region


@dataclass(frozen=True)
class Contract:
    """The whole question except the network. `clip` has None where an input is not clipped."""

    plant: Plant
    period: Fraction
    periods: int
    initial: tuple[Bounds, ...]
    observe: tuple[Expression, ...]
    radius: tuple[Fraction, ...]
    before: AffineMap | None
    after: AffineMap | None
    clip: tuple[Bounds | None, ...]
    delay: int
    delayed_action: tuple[Fraction, ...]
    disturbances: tuple[Disturbance, ...]
    requirements: tuple[Requirement, ...]
    reward: Reward | None
    digest: str
    plant_digest: str


def read_contract(content: bytes, folder: Path | None = None) -> Contract:
    """Read a specification.

    Parameters
    ----------
    content : bytes
    folder : Path, optional
        Where relative paths of plant files start; without it only shipped and inline plants are read.

    Returns
    -------
    Contract
        With the sha256 of the bytes, and of the plant file's ("" where the plant is inline).

    Raises
    ------
    InputError
        Something is missing, unknown or not understood.
    """
    keys = ("setrl", "description", "plant", "controller", "horizon", "initial", "perturbation", "requirements")
    root = mapping(load(content), (*keys, "reward", "allow_unknown"), "specification")
    if root.get("setrl") != "1":
        raise SpecificationError("language version 1 is required")
    plant, plant_digest = _find_plant(_required(root, "plant"), folder)
    controls = ("period", "observe", "before", "after", "clip", "delay")
    controller = mapping(_required(root, "controller"), controls, "controller")
    period, horizon = number(_required(controller, "period")), number(_required(root, "horizon"))
    if period <= 0 or horizon <= 0 or (horizon / period).denominator != 1 or horizon / period > MAX_PERIODS:
        raise SpecificationError("the horizon is a whole multiple of the period, both positive")
    perturbation = mapping(root.get("perturbation", {}), ("observation", "disturbance"), "perturbation")
    observe, labels = _observation(controller.get("observe"), plant)
    delay, delayed = _delay(controller.get("delay"), plant)
    if delay >= horizon / period:
        raise SpecificationError("the delay is not shorter than the run")
    return Contract(
        plant=plant,
        period=period,
        periods=int(horizon / period),
        initial=_initial(_required(root, "initial"), plant),
        observe=observe,
        radius=_radius(perturbation.get("observation"), labels),
        before=_affine(controller.get("before"), len(observe)),
        after=_affine(controller.get("after"), len(plant.inputs)),
        clip=_clip(controller.get("clip"), plant),
        delay=delay,
        delayed_action=delayed,
        disturbances=_disturbances(perturbation.get("disturbance", {}), plant),
        requirements=_requirements(root.get("requirements", []), plant, period, horizon),
        reward=_reward(root.get("reward"), plant),
        digest=hashlib.sha256(content).hexdigest(),
        plant_digest=plant_digest,
    )


def _required(entries: dict[str, Any], key: str) -> Any:
    if key not in entries:
        raise SpecificationError(f"the key {key} is missing")
    return entries[key]


def _find_plant(value: Any, folder: Path | None) -> tuple[Plant, str]:
    if isinstance(value, dict):
        return read_plant(value), ""
    if not isinstance(value, str):
        raise SpecificationError("a plant is a name, a path or a mapping")
    text = value.strip()
    if "/" not in text and not text.endswith((".yaml", ".yml")):
        path = PLANTS / f"{text}.yaml"
    elif folder is None and not Path(text).is_absolute():
        raise SpecificationError("a plant file needs the specification's folder")
    else:
        path = (folder or Path()) / text
    try:
        with path.open("rb") as file:
            content = file.read((1 << 20) + 1)
    except (OSError, ValueError) as error:
        raise SpecificationError(f"the plant {text[:60]!r} cannot be read") from error
    return read_plant(load(content)), hashlib.sha256(content).hexdigest()


def read_plant(document: dict[str, Any]) -> Plant:
    """A plant from the data of its file or of its place in a specification."""
    keys = ("name", "description", "states", "inputs", "disturbances", "parameters", "dynamics")
    root = mapping(document, keys, "plant")
    groups = [mapping(root.get(key, {}), None, key) for key in ("states", "inputs", "disturbances", "parameters")]
    states, inputs, disturbances, given = (tuple(group) for group in groups)
    names = [*states, *inputs, *disturbances, *given]
    if not states or not inputs or len(set(names)) != len(names):
        raise SpecificationError("a plant has states and inputs, and every name once")
    if any(name in (*FUNCTIONS, "union") or parse(name) != Name(name) for name in names):
        raise SpecificationError("a name of the plant is no identifier")
    parameters = {name: _parameter(value) for name, value in groups[3].items()}
    equations = mapping(_required(root, "dynamics"), None, "dynamics")
    discrete = all(key.endswith("+") for key in equations)
    if {key.removesuffix("+") if discrete else key for key in equations} != set(states):
        raise SpecificationError("the dynamics have one entry for every state")
    dynamics = []
    for state in states:
        tree = _expression(equations[state + "+" if discrete else state])
        if not names_in(tree) <= set(names):
            raise SpecificationError(f"the dynamics of {state} use an unknown name")
        dynamics.append(substitute(tree, parameters))
    return Plant(states, inputs, disturbances, parameters, tuple(dynamics), discrete)


def _parameter(value: Any) -> Fraction:
    if isinstance(value, dict):
        value = _required(mapping(value, ("value", "unit"), "parameter"), "value")
    if not isinstance(value, str):
        raise SpecificationError("a parameter is a number or a constant expression")
    return constant(str(value))


def _expression(value: Any) -> Expression:
    if not isinstance(value, str):
        raise SpecificationError("an expression is required")
    return parse(str(value))


def _initial(value: Any, plant: Plant) -> tuple[Bounds, ...]:
    given = mapping(value, plant.states, "initial")
    bounds = []
    for state in plant.states:
        entry = _required(given, state)
        bounds.append(interval(entry) if isinstance(entry, list) else (number(entry), number(entry)))
    return tuple(bounds)


def _observation(value: Any, plant: Plant) -> tuple[tuple[Expression, ...], dict[str, Expression]]:
    """What the policy sees, parameters put in; and the trees as written, by name (by position in a list)."""
    if value is None:
        trees: dict[str, Expression] = {state: Name(state) for state in plant.states}
    elif isinstance(value, list):
        trees = {f"#{position}": _expression(text) for position, text in enumerate(value)}
        if len(set(trees.values())) != len(trees):
            raise SpecificationError("an expression is observed twice")
    else:
        trees = {name: _expression(text) for name, text in mapping(value, None, "observe").items()}
        if any(name in FUNCTIONS or parse(name) != Name(name) for name in trees):
            raise SpecificationError("the name of an observation is no identifier")
    for tree in trees.values():
        if not names_in(tree) <= {*plant.states, *plant.parameters}:
            raise SpecificationError("an observation is made of states")
    if not trees:
        raise SpecificationError("nothing is observed")
    return tuple(substitute(tree, plant.parameters) for tree in trees.values()), trees


def _radius(value: Any, labels: dict[str, Expression]) -> tuple[Fraction, ...]:
    if value is None:
        return (Fraction(0),) * len(labels)
    if not isinstance(value, dict):
        radii = dict.fromkeys(labels, number(value))
    else:
        radii = {}
        for key, entry in value.items():
            label = _observed(key, labels)
            if label in radii:
                raise SpecificationError(f"two radii of the observation {key[:60]!r}")
            radii[label] = number(entry)
    if any(radius < 0 for radius in radii.values()):
        raise SpecificationError("a radius is not negative")
    return tuple(radii.get(label, Fraction(0)) for label in labels)


def _observed(key: str, labels: dict[str, Expression]) -> str:
    """The observation that a key means: its name, or (of a list) the expression it is."""
    if key in labels and not key.startswith("#"):
        return key
    try:
        tree = parse(key)
    except ExpressionError as error:
        raise SpecificationError(f"{key[:60]!r} is not observed") from error
    for label, seen in labels.items():
        if (label.startswith("#") and seen == tree) or (isinstance(tree, Name) and tree.name == label):
            return label
    raise SpecificationError(f"{key[:60]!r} is not observed")


def _affine(value: Any, size: int) -> AffineMap | None:
    """An affine map; `size` is that of its input where it only scales."""
    if value is None:
        return None
    entries = mapping(value, ("scale", "offset", "matrix"), "affine map")
    if "matrix" in entries:
        rows = entries["matrix"]
        if "scale" in entries or not isinstance(rows, list) or not rows or not all(isinstance(r, list) for r in rows):
            raise SpecificationError("a matrix is a list of rows and excludes a scale")
        matrix = tuple(tuple(number(entry) for entry in row) for row in rows)
        if len({len(row) for row in matrix}) != 1:
            raise SpecificationError("the rows of a matrix differ in length")
    else:
        scale = _components(entries.get("scale", Plain("1")), size)
        matrix = tuple(tuple(scale[i] if i == j else Fraction(0) for j in range(size)) for i in range(size))
    return AffineMap(matrix, _components(entries.get("offset", Plain("0")), len(matrix)))


def _components(value: Any, size: int) -> tuple[Fraction, ...]:
    numbers = tuple(map(number, value)) if isinstance(value, list) else (number(value),) * size
    if len(numbers) != size:
        raise SpecificationError(f"{size} numbers are required, found {len(numbers)}")
    return numbers


def _clip(value: Any, plant: Plant) -> tuple[Bounds | None, ...]:
    if value is None:
        return (None,) * len(plant.inputs)
    if isinstance(value, list):
        return (interval(value),) * len(plant.inputs)
    given = {name: interval(entry) for name, entry in mapping(value, plant.inputs, "clip").items()}
    return tuple(given.get(name) for name in plant.inputs)


def _delay(value: Any, plant: Plant) -> tuple[int, tuple[Fraction, ...]]:
    action: dict[str, Any] = {}
    if isinstance(value, dict):
        entries = mapping(value, ("periods", "action"), "delay")
        action = mapping(entries.get("action", {}), plant.inputs, "delayed action")
        value = _required(entries, "periods")
    periods = Fraction(0) if value is None else number(value)
    if periods < 0 or periods.denominator != 1:
        raise SpecificationError("a delay is a whole number of periods")
    return int(periods), tuple(number(action[name]) if name in action else Fraction(0) for name in plant.inputs)


def _disturbances(value: Any, plant: Plant) -> tuple[Disturbance, ...]:
    given = mapping(value, plant.disturbances, "disturbance")
    nothing = Disturbance((Fraction(0), Fraction(0)), True)
    return tuple(_disturbance(given[name]) if name in given else nothing for name in plant.disturbances)


def _disturbance(value: Any) -> Disturbance:
    varies = "every period"
    if isinstance(value, dict):
        entries = mapping(value, ("range", "varies"), "disturbance")
        value, varies = _required(entries, "range"), entries.get("varies", varies)
    if varies not in ("never", "every period"):
        raise SpecificationError("a disturbance varies never or every period")
    bounds = interval(value) if isinstance(value, list) else (-number(value), number(value))
    if bounds[0] > bounds[1]:
        raise SpecificationError("the range of a disturbance is empty")
    return Disturbance(bounds, varies == "never")


def _requirements(value: Any, plant: Plant, period: Fraction, horizon: Fraction) -> tuple[Requirement, ...]:
    if not isinstance(value, list):
        raise SpecificationError("requirements are a list")
    entries = [mapping(entry, ("avoid", "stay", "reach", "name", "at", "during"), "requirement") for entry in value]
    if not all(isinstance(entry.get("name", ""), str) for entry in entries):
        raise SpecificationError("the name of a requirement is text")
    taken = {str(entry["name"]).strip() for entry in entries if "name" in entry}
    counts = {"avoid": 0, "stay": 0, "reach": 0}
    found: list[Requirement] = []
    for entry in entries:
        kinds = [kind for kind in counts if kind in entry]
        if len(kinds) != 1 or ("at" in entry and "during" in entry):
            raise SpecificationError("a requirement has one kind, and one time or one window")
        counts[kinds[0]] += 1
        name = str(entry["name"]).strip() if "name" in entry else _default_name(kinds[0], counts[kinds[0]], taken)
        start, end = _window(entry, kinds[0], period, horizon)
        found.append(Requirement(kinds[0], name, read_region(entry[kinds[0]], plant.states), start, end))
    if len({requirement.name for requirement in found}) != len(found):
        raise SpecificationError("two requirements have the same name")
    return tuple(found)


def _default_name(kind: str, count: int, taken: set[str]) -> str:
    while f"{kind} {count}" in taken:
        count += 1
    return f"{kind} {count}"


def _window(entry: dict[str, Any], kind: str, period: Fraction, horizon: Fraction) -> Bounds:
    start, end = (horizon, horizon) if kind == "reach" else (Fraction(0), horizon)
    if "at" in entry:
        start = end = number(entry["at"])
    elif "during" in entry:
        start, end = interval(entry["during"])
    aligned = kind == "reach" or "at" in entry
    if not 0 <= start <= end <= horizon or (aligned and any((time / period).denominator != 1 for time in (start, end))):
        raise InputError("a window lies within the run; a time point, and a window to reach, on the sampling instants")
    return start, end


def _reward(value: Any, plant: Plant) -> Reward | None:
    if value is None:
        return None
    entries = mapping(value, ("weights", "target", "discount", "penalty"), "reward")
    groups = (_required(entries, "weights"), entries.get("target", {}))
    weights, target = (
        {name: number(entry) for name, entry in mapping(group, plant.states, "reward").items()} for group in groups
    )
    discount, amount = number(entries.get("discount", Plain("1"))), Fraction(0)
    region: Region = ()
    if "penalty" in entries:
        penalty = mapping(entries["penalty"], ("inside", "amount"), "penalty")
        region = read_region(_required(penalty, "inside"), plant.states)
        amount = number(_required(penalty, "amount"))
    if not weights or not set(target) <= set(weights) or any(weight < 0 for weight in weights.values()):
        raise SpecificationError("a reward has weights that are not negative, and targets of weighted states only")
    if not 0 < discount <= 1 or amount < 0:
        raise SpecificationError("a discount is in (0, 1], a penalty is not negative")
    rows = [tuple(group.get(state, Fraction(0)) for state in plant.states) for group in (weights, target)]
    return Reward(rows[0], rows[1], discount, amount, region)
