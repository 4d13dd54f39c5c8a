"""Evidence in a file, proved again: a certificate or a witness, whichever its first bytes say."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from ...specs.errors import InputError
from . import certificate_file, documents, onnx_file, witness_file
from .certificate import Accepted, Progress
from .certificate import check as check_certificate
from .certificate_file import MAGIC, Header, read_certificate
from .claim import claim_of, plant_name, printable
from .contract import read_contract
from .network import read_network
from .proof import Proof
from .witness import Recording, Stop, prove, read_witness

FORMAT = "setrl-check/1"
"""Name of the layout of `Answer.data`; it changes when a key changes its meaning or goes."""

MOST_BYTES = {"policy": onnx_file.MAX_BYTES, "specification": documents.MAX_BYTES}
"""What larger files are, the checker refuses to read."""

_NAME = MAGIC[:10]

Replay = Callable[[Recording], str]


@dataclass(frozen=True)
class Answer:
    """What the checker says about a file.

    Attributes
    ----------
    accepted : bool
    sentence : str
        The claim that is proved, or the obligation that is not.
    notes : tuple of str
        What else a person should know.
    data : dict
        The same as plain data; its keys do not depend on the answer.
    """

    accepted: bool
    sentence: str
    notes: tuple[str, ...]
    data: dict[str, Any]


def most_bytes(start: bytes) -> int:
    """How large a file that begins with `start` may be."""
    return certificate_file.MAX_BYTES if _kind(start) == "certificate" else witness_file.MAX_BYTES


def _kind(evidence: bytes) -> str:
    """What the first bytes say: a certificate has a text in front that is no JSON."""
    if evidence.startswith(_NAME):
        return "certificate"
    return "witness" if evidence.lstrip()[:1] == b"{" else ""


def recheck(
    evidence: bytes,
    policy: bytes,
    specification: bytes,
    folder: Path | None = None,
    *,
    workers: int | None = None,
    progress: Progress | None = None,
    stop: Stop | None = None,
    replay: Replay | None = None,
) -> Answer:
    """Prove a certificate or a witness again.

    Parameters
    ----------
    evidence, policy, specification : bytes
        Of the three files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.
    workers : int, optional
        Processes that check a certificate's leaves side by side.
    progress : callable, optional
        Called after every leaf: (leaves checked, leaves in all).
    stop : callable, optional
        Says when time is up.
    replay : callable, optional
        Runs a witness's recording again; the runtime's name where it returns the same bits, else "".

    Returns
    -------
    Answer

    Raises
    ------
    InputError
        The evidence is not of its format.
    """
    kind = _kind(evidence)
    if not kind:
        raise InputError("neither a certificate nor a witness of setrl")
    data: dict[str, Any] = {
        "format": FORMAT,
        "evidence": kind,
        "accepted": False,
        "sentence": "",
        "sha256": hashlib.sha256(evidence).hexdigest(),
        "policy": hashlib.sha256(policy).hexdigest(),
        "specification": hashlib.sha256(specification).hexdigest(),
        "leaves": None,
        "semantics": None,
        "runtime": None,
        "requirements": None,
        "value": None,
        "witness": None,
    }
    if kind == "witness":
        return _witness(evidence, policy, specification, folder, data, stop, replay)
    header = read_certificate(evidence).header
    data |= {"leaves": len(header.leaves), "semantics": list(header.semantics), "runtime": _runtime(header)}
    answer = check_certificate(evidence, policy, specification, folder, progress, stop, workers)
    if not isinstance(answer, Accepted):
        return _answer(False, answer, (), data)
    sentence = claim_of(answer, read_contract(specification, folder), read_network(policy), plant_name(specification))
    data["requirements"] = [{"name": name, "margin": margin} for name, margin in answer.margins]
    if answer.value is not None:
        data["value"] = {"discounted": answer.value[0], "undiscounted": answer.value[1]}
    cells = f"{answer.leaves} cell{'s' if answer.leaves != 1 else ''}"
    notes = (
        f"{cells} checked; written by setrl {printable(header.setrl)}, method {header.method}, order {header.order}",
    )
    return _answer(True, sentence, notes, data)


def _witness(
    evidence: bytes,
    policy: bytes,
    specification: bytes,
    folder: Path | None,
    data: dict[str, Any],
    stop: Stop | None,
    replay: Replay | None,
) -> Answer:
    witness = read_witness(evidence)
    replayed = replay(witness.deployed) if replay is not None and witness.deployed is not None else ""
    proof = prove(witness, policy, specification, folder, replayed=replayed, stop=stop)
    if not isinstance(proof, Proof):
        again = witness.deployed is not None and replay is None
        notes = ("it has a runtime's recorded actions, which --replay runs again",) if again else ()
        return _answer(False, proof, notes, data)
    data["witness"] = {
        "grade": proof.grade,
        "requirement": proof.requirement,
        "depth": proof.depth,
        "radius": proof.radius,
        "precision": proof.precision,
        "objection": proof.objection or None,
    }
    notes = ()
    if proof.objection:
        notes = (f"not proved for the deployed network: {proof.objection}",)
        if replay is None:
            notes = ("the recorded actions of the deployed network were not run again; --replay does",)
    return _answer(True, proof.sentence, notes, data)


def _answer(accepted: bool, sentence: str, notes: tuple[str, ...], data: dict[str, Any]) -> Answer:
    return Answer(accepted, sentence, notes, {**data, "accepted": accepted, "sentence": sentence})


def _runtime(header: Header) -> dict[str, str] | None:
    return None if header.runtime is None else {"name": header.runtime[0], "error": str(header.runtime[1])}
