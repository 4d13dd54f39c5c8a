"""What a witness is about: the three files, the requirement, and whether the specification admits the witness.

All of it is decided in rationals; no trajectory plays a part yet.
"""

from __future__ import annotations

import hashlib
import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from ...specs.errors import SetrlError
from .contract import Contract, Requirement, read_contract
from .network import Network, read_network
from .witness_file import Numbers, Witness


@dataclass(frozen=True)
class Question:
    """An admitted witness with the files it is about.

    Attributes
    ----------
    witness : Witness
    contract : Contract
        With the witness's radii, where it has its own.
    network : Network
    requirement : Requirement
    times : tuple of Fraction
        Increasing: where the state is read off.
    """

    witness: Witness
    contract: Contract
    network: Network
    requirement: Requirement
    times: tuple[Fraction, ...]

    @property
    def periods(self) -> int:
        """Control periods that begin before the last of the times."""
        return min(self.contract.periods, math.ceil(self.times[-1] / self.contract.period))


def pose(witness: Witness, policy: bytes, specification: bytes, folder: Path | None = None) -> Question | str:
    """Read the files and decide whether they admit a witness.

    Parameters
    ----------
    witness : Witness
    policy, specification : bytes
        Of the two files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.

    Returns
    -------
    Question or str
        Why the witness is not admitted.
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
    problem = wiring(contract, network) or _membership(contract, witness) or _timing(contract, requirement, witness)
    if problem:
        return problem
    times = _times(contract, requirement, witness)
    if not times:
        return "no sampling instant is in the requirement's window"
    return Question(witness, contract, network, requirement, times)


def wiring(contract: Contract, network: Network) -> str:
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
    """Why the specification does not admit the witness, or ""."""
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


def _times(contract: Contract, requirement: Requirement, witness: Witness) -> tuple[Fraction, ...]:
    if requirement.kind != "reach":
        return () if witness.time is None else (witness.time,)
    first, last = math.ceil(requirement.start / contract.period), math.floor(requirement.end / contract.period)
    return tuple(number * contract.period for number in range(first, last + 1))
