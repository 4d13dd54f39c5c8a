"""Witnesses: one start and one sequence of perturbations whose trajectory provably violates a requirement.

A proof has two halves: the witness is admitted by the specification (checked in rationals), and the one trajectory that
belongs to it violates the requirement (checked with comparisons of balls that hold for all their points). What is not
proved is refused with a sentence that says why.
"""

from __future__ import annotations

import hashlib
import json
import math
import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any, TypeAlias

from flint import arb, ctx

from ...specs.errors import InputError, SetrlError
from .contract import Contract, Requirement, read_contract
from .loop import periods
from .network import Network, read_network
from .regions import Polytope, Region
from .taylor import ball

Numbers: TypeAlias = tuple[Fraction, ...]
Vector: TypeAlias = list[Any]

FORMAT = "setrl-witness/1"
MAX_BYTES = 64 << 20
PRECISIONS = (160, 320, 640, 1280)
"""Bits, one after the other until the comparison is decided."""

_RATIONAL = re.compile(r"-?[0-9]{1,1200}(/[1-9][0-9]{0,1200})?", re.ASCII)


@dataclass(frozen=True)
class Witness:
    """A proposed violation, all numbers exact.

    Attributes
    ----------
    requirement : str
    time : Fraction or None
        Seconds at which an `avoid` or `stay` requirement is violated; None for `reach`, which is missed at every
        sampling instant of its window.
    initial : tuple of Fraction
        In the plant's order of states.
    noise : tuple of tuples of Fraction, periods x observations
    disturbances : tuple of tuples of Fraction, periods x disturbances
    policy, specification, plant : str
        sha256 of the files' bytes; `plant` is "" where the specification contains its plant.
    observation_radius : tuple of Fraction, optional
        Instead of the specification's, where the question was asked for other radii.
    """

    requirement: str
    time: Fraction | None
    initial: Numbers
    noise: tuple[Numbers, ...]
    disturbances: tuple[Numbers, ...]
    policy: str
    specification: str
    plant: str = ""
    observation_radius: Numbers | None = None

    def to_json(self) -> str:
        """Text of a witness file: rationals as strings, the same text for the same witness."""
        radius = self.observation_radius
        data = {
            "format": FORMAT,
            "requirement": self.requirement,
            "time": None if self.time is None else str(self.time),
            "initial": _texts(self.initial),
            "noise": [_texts(row) for row in self.noise],
            "disturbances": [_texts(row) for row in self.disturbances],
            "policy": self.policy,
            "specification": self.specification,
            "plant": self.plant,
            "observation_radius": None if radius is None else _texts(radius),
        }
        lines = [f"  {json.dumps(key)}: {json.dumps(value, ensure_ascii=False)}" for key, value in data.items()]
        return "{\n" + ",\n".join(lines) + "\n}\n"


def _texts(numbers: Numbers) -> list[str]:
    return [str(number) for number in numbers]


def read_witness(content: bytes) -> Witness:
    """Read a witness file; `InputError` where it is not exactly of the format."""
    if len(content) > MAX_BYTES:
        raise InputError(f"the witness has more than {MAX_BYTES} bytes")
    try:
        pairs = json.loads(content.decode("utf-8"), object_pairs_hook=list)
    except (ValueError, RecursionError) as error:
        raise InputError("the witness is no JSON document") from error
    names = ("format", "requirement", "time", "initial", "noise", "disturbances", "policy", "specification", "plant")
    keys = (*names, "observation_radius")
    if not isinstance(pairs, list) or [entry[0] for entry in pairs if isinstance(entry, tuple)] != list(keys):
        raise InputError(f"a witness has the keys {', '.join(keys)}, each once")
    data = dict(pairs)
    texts = [data[key] for key in ("format", "requirement", "policy", "specification", "plant")]
    if texts[0] != FORMAT or not all(isinstance(text, str) for text in texts):
        raise InputError(f"a witness of format {FORMAT} is required")
    radius = data["observation_radius"]
    return Witness(
        requirement=texts[1],
        time=None if data["time"] is None else _rational(data["time"]),
        initial=_rationals(data["initial"]),
        noise=_rows(data["noise"]),
        disturbances=_rows(data["disturbances"]),
        policy=texts[2],
        specification=texts[3],
        plant=texts[4],
        observation_radius=None if radius is None else _rationals(radius),
    )


def _rational(value: Any) -> Fraction:
    if not isinstance(value, str) or not _RATIONAL.fullmatch(value):
        raise InputError("numbers of a witness are texts such as -3/8")
    return Fraction(value)


def _rationals(value: Any) -> Numbers:
    if not isinstance(value, list):
        raise InputError("a list of numbers is required")
    return tuple(map(_rational, value))


def _rows(value: Any) -> tuple[Numbers, ...]:
    if not isinstance(value, list):
        raise InputError("a list of lists of numbers is required")
    return tuple(map(_rationals, value))


@dataclass(frozen=True)
class Proof:
    """A violation that is proved in exact real arithmetic.

    Attributes
    ----------
    grade : str
        "proved (real)": of the network in exact real arithmetic on its stored numbers.
    sentence : str
    requirement, kind : str
    time : Fraction or None
    depth : float
        By how much at least, in the requirement's unit.
    radius : float
        Largest radius of the state's enclosure where the violation is read off, an upper bound.
    precision : int
        Bits.
    """

    grade: str
    sentence: str
    requirement: str
    kind: str
    time: Fraction | None
    depth: float
    radius: float
    precision: int


def prove(witness: Witness, policy: bytes, specification: bytes, folder: Path | None = None) -> Proof | str:
    """Prove a witness's violation.

    Parameters
    ----------
    witness : Witness
    policy, specification : bytes
        Of the two files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.

    Returns
    -------
    Proof or str
        Why there is none.
    """
    if hashlib.sha256(policy).hexdigest() != witness.policy:
        return "the witness is about another policy: the digests differ"
    if hashlib.sha256(specification).hexdigest() != witness.specification:
        return "the witness is about another specification: the digests differ"
    try:
        contract, network = read_contract(specification, folder), read_network(policy)
    except SetrlError as error:
        return f"the checker cannot read the files: {error}"
    if contract.plant_digest != witness.plant:
        return "the witness is about another plant: the digests differ"
    if witness.observation_radius is not None:
        contract = replace(contract, radius=witness.observation_radius)
    requirement = next((entry for entry in contract.requirements if entry.name == witness.requirement), None)
    if requirement is None:
        return f"the specification has no requirement {witness.requirement[:60]!r}"
    problem = _wiring(contract, network) or _membership(contract, witness) or _timing(contract, requirement, witness)
    if problem:
        return problem
    outcome, attempts = "", 0
    for precision in PRECISIONS:
        with ctx.workprec(precision):
            found = _violation(contract, network, requirement, witness)
        if isinstance(found, Proof):
            return found
        outcome, cost = found
        attempts += cost
        if attempts >= len(PRECISIONS):
            break
    return outcome


def _wiring(contract: Contract, network: Network) -> str:
    """Why the three files do not fit each other, or ""."""
    seen, actions = len(contract.observe), len(contract.plant.inputs)
    before, after = contract.before, contract.after
    if before is not None and (len(before.matrix[0]) != seen or len(before.matrix) != network.inputs):
        return "the map before the network does not fit"
    if after is not None and (len(after.matrix[0]) != network.outputs or len(after.matrix) != actions):
        return "the map after the network does not fit"
    if (before is None and seen != network.inputs) or (after is None and network.outputs != actions):
        return "the network does not fit the plant"
    if len(contract.radius) != seen or any(radius < 0 for radius in contract.radius):
        return "the observation's radii do not fit"
    return ""


def _membership(contract: Contract, witness: Witness) -> str:
    """Why the specification does not admit the witness, or "". Rationals only."""
    if not _within(witness.initial, contract.initial):
        return "the initial state is outside the initial set"
    if len(witness.noise) != contract.periods or len(witness.disturbances) != contract.periods:
        return f"perturbations of {contract.periods} periods are required"
    box = tuple((-radius, radius) for radius in contract.radius)
    bounds = tuple(entry.bounds for entry in contract.disturbances)
    for number, (noise, disturbance) in enumerate(zip(witness.noise, witness.disturbances, strict=True)):
        if not _within(noise, box):
            return f"the perturbation of the observation in period {number} is outside its radius"
        if not _within(disturbance, bounds):
            return f"a disturbance in period {number} is outside its bounds"
        held = zip(contract.disturbances, disturbance, witness.disturbances[0], strict=True)
        if any(entry.constant and value != first for entry, value, first in held):
            return f"a disturbance that never varies changes in period {number}"
    return ""


def _within(values: Numbers, bounds: Sequence[tuple[Fraction, Fraction]]) -> bool:
    return len(values) == len(bounds) and all(low <= x <= high for x, (low, high) in zip(values, bounds, strict=True))


def _timing(contract: Contract, requirement: Requirement, witness: Witness) -> str:
    if requirement.kind == "reach":
        return "" if witness.time is None else "a witness against reach has no single time"
    if witness.time is None or not requirement.start <= witness.time <= requirement.end:
        return f"the time is outside the requirement's window [{requirement.start}, {requirement.end}]"
    if contract.plant.discrete and (witness.time / contract.period).denominator != 1:
        return "a discrete-time plant has no state at this time"
    return ""


def _violation(
    contract: Contract, network: Network, requirement: Requirement, witness: Witness
) -> Proof | tuple[str, int]:
    """A proof; or why there is none, and how many precisions that costs: all where none could change the answer."""
    period = contract.period
    if requirement.kind == "reach":
        first, last = math.ceil(requirement.start / period), math.floor(requirement.end / period)
        times = [number * period for number in range(first, last + 1)]
    else:
        times = [] if witness.time is None else [witness.time]
    waiting = list(times)
    if not waiting:
        return "no sampling instant is in the requirement's window", len(PRECISIONS)
    depths, radius = [], arb(0)
    for state, time in _states(contract, network, witness, times):
        depth = inside(requirement.region, state) if requirement.kind == "avoid" else outside(requirement.region, state)
        waiting.pop(0)
        radius = radius.max(_radius(state))
        if not depth > 0 and not (requirement.kind == "avoid" and depth >= 0):
            if depth < 0:
                side = "outside" if requirement.kind == "avoid" else "inside"
                return f"the trajectory is provably {side} the region at {_decimal(time)} s", len(PRECISIONS)
            return f"the enclosure at {_decimal(time)} s is too wide to decide ({ctx.prec} bits)", 1
        depths.append(depth)
    if waiting:
        return f"the trajectory could not be enclosed up to {_decimal(waiting[0])} s ({ctx.prec} bits)", len(
            PRECISIONS
        ) // 2
    return _proof(contract, requirement, witness, times, min(_below(depth) for depth in depths), radius)


def _states(contract: Contract, network: Network, witness: Witness, times: list[Fraction]) -> Any:
    """The trajectory's states at increasing times, as far as it could be enclosed."""
    waiting = list(times)
    state = [ball(value) for value in witness.initial]
    if waiting[0] == 0:
        yield state, waiting.pop(0)
    if not waiting:
        return
    given = (witness.initial, witness.noise, witness.disturbances)
    for entry in periods(contract, network, *given, until=times[-1]):
        if waiting[0] == min((entry.number + 1) * contract.period, times[-1]):
            yield entry.end, waiting.pop(0)


def inside(region: Region, state: Vector) -> Any:
    """How deep a state lies inside a union: ``max_members min_facets (bound - row x)``; inside where >= 0."""
    return _extreme([_extreme([-value for value in _excess(member, state)], "min") for member in region], "max")


def outside(region: Region, state: Vector) -> Any:
    """How far a state lies outside a union: ``min_members max_facets (row x - bound)``; outside where > 0."""
    return _extreme([_extreme(_excess(member, state), "max") for member in region], "min")


def _excess(member: Polytope, state: Vector) -> Vector:
    return [
        sum((ball(c) * x for c, x in zip(facet.coefficients, state, strict=True) if c), -ball(facet.bound))
        for facet in member
    ]


def _extreme(values: Vector, which: str) -> Any:
    result = values[0]
    for value in values[1:]:
        result = result.max(value) if which == "max" else result.min(value)
    return result


def _radius(state: Vector) -> Any:
    return _extreme([value.rad() for value in state], "max")


def _proof(
    contract: Contract, requirement: Requirement, witness: Witness, times: list[Fraction], depth: float, radius: Any
) -> Proof:
    start = ", ".join(
        f"{name} = {_decimal(value)}" for name, value in zip(contract.plant.states, witness.initial, strict=True)
    )
    when = f"at {_decimal(times[0])} s"
    if len(times) > 1:
        when = f"at every sampling instant from {_decimal(times[0])} s to {_decimal(times[-1])} s"
    verb = {"avoid": "entered", "stay": "left", "reach": "missed"}[requirement.kind]
    wide = _above(radius)
    sentence = (
        f"`{requirement.name}` is {verb} {when} by {_floor(depth)} from {start}; "
        f"proved in exact real arithmetic (enclosure radius {wide:.1g})"
    )
    real = "proved (real)"
    return Proof(real, sentence, requirement.name, requirement.kind, witness.time, depth, wide, ctx.prec)


def _decimal(value: Fraction) -> str:
    return f"{float(value):.6g}"


def _floor(depth: float) -> str:
    """Three digits that are not above a number that is not negative."""
    text = f"{depth:.3g}"
    if Fraction(text) > Fraction(depth):
        text = f"{depth - 0.01 * depth:.3g}"
    return text


def _below(value: Any) -> float:
    """A float that is not above any point of a ball that is not negative."""
    nearest = float(value.lower())
    while not arb(nearest) <= value:
        nearest = math.nextafter(nearest, -math.inf)
    return max(0.0, nearest)


def _above(radius: Any) -> float:
    return math.nextafter(float(radius), math.inf)
