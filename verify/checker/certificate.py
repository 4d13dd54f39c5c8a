"""Whether a certificate proves what it says: the files it is about, the cover, every leaf, the margins, the value."""

from __future__ import annotations

import hashlib
import os
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from ...specs.errors import InputError, SetrlError
from .action import Policy
from .certificate_file import Header, read_certificate
from .contract import Contract, read_contract
from .cover import Box, leaf_boxes
from .layout import layout_of
from .leaf import read_leaf
from .network import Network, read_network
from .obligations import Found, Setting, check_leaf
from .processes import Setup, Task, check_in_processes
from .program import ball
from .question import wiring
from .rejection import Rejected

RUNTIME_ERRORS = {"float32": Fraction(1, 2**21), "float64": Fraction(1, 2**48)}
"""Least error of a runtime's own tanh and sigmoid that a claim about deployed networks may assume: measured ones."""

WORTH_PROCESSES = 1.5
"""Seconds of work that are worth starting processes."""

Progress = Callable[[int, int], None]
"""Called after every leaf: (leaves checked, leaves in all)."""


@dataclass(frozen=True)
class Accepted:
    """A certificate that proves its claim.

    Attributes
    ----------
    header : Header
    leaves : int
    margins : tuple of (name, float)
        Proved lower bounds.
    value : tuple of (discounted, undiscounted) or None
        Claimed lower bounds of the return, proved.
    """

    header: Header
    leaves: int
    margins: tuple[tuple[str, float], ...]
    value: tuple[float, float] | None


def check(
    certificate: bytes,
    policy: bytes,
    specification: bytes,
    folder: Path | None = None,
    progress: Progress | None = None,
    stop: Callable[[], bool] | None = None,
    workers: int | None = None,
) -> Accepted | str:
    """Check a certificate.

    Parameters
    ----------
    certificate, policy, specification : bytes
        Of the three files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.
    progress : callable, optional
    stop : callable, optional
        Says when time is up; asked between leaves.
    workers : int, optional
        Processes that check leaves side by side; as many as there are processors, where that is worth it.

    Returns
    -------
    Accepted or str
        Which obligation was not proved.

    Raises
    ------
    InputError
        The certificate is not of the format.
    """
    file = read_certificate(certificate)
    try:
        case = prepare(file.header, policy, specification, folder)
        boxes = leaf_boxes(file.header.tree, case.contract.initial)
        if len(boxes) != len(file.header.leaves):
            raise Rejected("the tree and the leaves of the certificate differ in number")
        found: list[Found] = []
        started = time.perf_counter()
        for number, box in enumerate(boxes):
            spent = time.perf_counter() - started
            left = len(boxes) - number
            if workers != 1 and number and spent / number * left > WORTH_PROCESSES:
                setup = Setup(file.header, policy, specification, folder)
                tasks = [(*file.bytes_of(leaf), boxes[leaf]) for leaf in range(number, len(boxes))]
                found += _by_processes(setup, tasks, number, workers, progress, stop)
                break
            found.append(_leaf(case, *file.streams(number), box, number))
            if progress is not None:
                progress(number + 1, len(boxes))
            if stop is not None and stop() and number + 1 < len(boxes):
                raise Rejected(f"the time is up after {number + 1} of {len(boxes)} leaves")
        return _conclude(file.header, case.contract, found)
    except Rejected as rejected:
        return str(rejected)


def _leaf(case: Setting, floats: Sequence[float], integers: Sequence[int], box: Box, number: int) -> Found:
    try:
        return check_leaf(case, read_leaf(case.layout, floats, integers), box)
    except (Rejected, InputError) as problem:
        raise Rejected(f"leaf {number}: {problem}") from None


def _by_processes(
    setup: Setup,
    tasks: Sequence[Task],
    first: int,
    workers: int | None,
    progress: Progress | None,
    stop: Callable[[], bool] | None,
) -> list[Found]:
    """Check leaves `first`, `first` + 1, ... in processes of their own."""
    found: list[Found] = []
    total = first + len(tasks)
    for answer in check_in_processes(setup, tasks, workers or os.cpu_count() or 1, stop):
        if isinstance(answer, str):
            raise Rejected(f"leaf {first + len(found)}: {answer}")
        found.append(answer)
        if progress is not None:
            progress(first + len(found), total)
    if len(found) < len(tasks):
        raise Rejected(f"the time is up after {first + len(found)} of {total} leaves")
    return found


def prepare(header: Header, policy: bytes, specification: bytes, folder: Path | None) -> Setting:
    """Everything that the leaves share; `Rejected` where the files are others, or do not fit."""
    for name, content, digest in (
        ("policy", policy, header.policy),
        ("specification", specification, header.specification),
    ):
        if hashlib.sha256(content).hexdigest() != digest:
            raise Rejected(f"the certificate is about another {name}: the digests differ")
    try:
        contract, network = read_contract(specification, folder), read_network(policy)
    except SetrlError as error:
        raise Rejected(f"the checker cannot read the files: {error}") from None
    if contract.plant_digest != header.plant:
        raise Rejected("the certificate is about another plant: the digests differ")
    if header.observation_radius is not None:
        contract = replace(contract, radius=header.observation_radius)
    problem = wiring(contract, network) or _meaning(header, contract, network)
    if problem:
        raise Rejected(problem)
    layout = layout_of(contract, network, header.method, header.version)
    runtime = None if header.runtime is None else ball(header.runtime[1])
    return Setting.of(contract, layout, Policy.of(contract, network, layout, runtime), header.order)


def _meaning(header: Header, contract: Contract, network: Network) -> str:
    """Why the header's claim is not one about these files, or ""."""
    if tuple(name for name, _ in header.requirements) != tuple(entry.name for entry in contract.requirements):
        return "the certificate's requirements are not those of the specification"
    if (header.value is None) != (contract.reward is None):
        return "the certificate has a value where there is no reward, or none where there is one"
    if not contract.requirements and contract.reward is None:
        return "the specification asks for nothing"
    if len(header.semantics) == 2 and header.semantics[1] != network.precision:
        return f"the network computes in {network.precision}, the certificate covers {header.semantics[1]}"
    if header.runtime is not None and not header.runtime[1] >= RUNTIME_ERRORS[network.precision]:
        return "the certificate assumes a smaller error of the runtime than was ever measured"
    clipped = [bounds is not None for bounds in contract.clip]
    if any(clipped) and not all(clipped):
        return "only some actions are clipped"
    return ""


def _conclude(header: Header, contract: Contract, found: list[Found]) -> Accepted:
    if not found:
        raise Rejected("the certificate has no leaf")
    margins = []
    for number, (name, claimed) in enumerate(header.requirements):
        margin = min(leaf.margins[number] for leaf in found)
        if not margin >= claimed or not margin > 0.0:
            raise Rejected(f"the margin of {name!r} is claimed as {claimed:.6g}, proved is {margin:.6g}")
        margins.append((name, margin))
    if header.value is not None:
        for claimed, proved in zip(
            header.value,
            (min(leaf.value for leaf in found), min(leaf.undiscounted for leaf in found)),
            strict=True,
        ):
            if not claimed <= proved:
                raise Rejected(f"the return is claimed to be at least {claimed:.9g}, proved is {proved:.9g}")
    return Accepted(header, len(found), tuple(margins), header.value)
