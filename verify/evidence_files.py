"""The bytes that evidence is about: what the checker reads, as the engine read it."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from ..models.closed_loop import ClosedLoop, Plant
from ..specs.errors import SetrlError
from ..specs.reader import digest, parse_specification
from .checker.contract import read_contract


@dataclass(frozen=True)
class EvidenceFiles:
    """The bytes that evidence is about, as they were read."""

    policy: bytes
    specification: bytes
    folder: Path
    plant: str
    radius: tuple[Fraction, ...]

    @property
    def digests(self) -> dict[str, str]:
        """sha256 of each, "" for a plant inside the specification."""
        return {"policy": digest(self.policy), "specification": digest(self.specification), "plant": self.plant}


def evidence_files(loop: ClosedLoop, plant: Plant | None) -> EvidenceFiles | str:
    """The files of a closed loop, for the checker; or why there are none.

    Evidence is about files, so what was given as an object has to be what its file says.
    """
    specification, policy = loop.specification, loop.policy.content
    if plant is not None or not policy:
        return "the checker needs the policy and the plant as files"
    source = Path(specification.source)
    content = source.read_bytes() if source.is_file() else b""
    if digest(content) != specification.digest:
        return "the checker needs the specification as a file, with the bytes that were read"
    if parse_specification(content, specification.source) != specification:
        return "the specification was changed after it was read"
    try:
        contract = read_contract(content, source.parent)
    except SetrlError as error:
        return f"the checker cannot read the specification: {error}"
    return EvidenceFiles(policy, content, source.parent, contract.plant_digest, contract.radius)
