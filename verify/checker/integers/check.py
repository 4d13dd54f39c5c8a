"""Whether a certificate's sets of actions, first sets and links are proved, by integers alone.

`certificate.check` decides about a certificate. This second opinion covers the cover of the initial set, what follows
from set to set without any flow, and the network of every period in which it is followed with one slope per neuron.
Of a nonlinear observation, the network is followed from the claimed set of observations.
"""

from __future__ import annotations

import hashlib
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path

from ....specs.errors import InputError, SetrlError
from ..certificate_file import CertificateFile, Header, read_certificate
from ..contract import Contract, read_contract
from ..layout import layout_of
from ..leaf import read_leaf
from ..network import Network, read_network
from ..rejection import Rejected
from .action import Policy
from .cover import cells
from .links import Setting, follow_leaf
from .runtime import Runtime

MEASURED = {"float32": Fraction(1, 2**21), "float64": Fraction(1, 2**48)}
"""The error of a runtime's own tanh and sigmoid is at least assumed to be what was measured."""


@dataclass(frozen=True)
class IntegerAnswer:
    """What the integer checker found.

    Attributes
    ----------
    accepted : bool
        Whether everything that is covered was proved.
    reason : str
        The first obligation that was not; "" where all were.
    periods : int
        Periods, of all leaves together, whose set of actions was proved.
    uncovered : int
        Periods whose set of actions was not looked at: the policy is followed with two lines per neuron.
    """

    accepted: bool
    reason: str
    periods: int
    uncovered: int


def check_links_and_network(
    certificate: bytes, policy: bytes, specification: bytes, folder: Path | None = None
) -> IntegerAnswer:
    """Check the cover, the first sets, the sets of actions, the starts of later steps and the links of a certificate.

    Parameters
    ----------
    certificate, policy, specification : bytes
        Of the three files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.

    Returns
    -------
    IntegerAnswer

    Raises
    ------
    InputError
        The certificate is not of the format.
    """
    file = read_certificate(certificate)
    covered = uncovered = 0
    try:
        setting = prepare(file.header, policy, specification, folder)
        boxes = cells(file.header.tree, setting.contract.initial)
        if len(boxes) != len(file.header.leaves):
            raise Rejected("the tree and the leaves of the certificate differ in number")
        for number, box in enumerate(boxes):
            found = _leaf(setting, file, number, box)
            covered += found
            uncovered += setting.layout.periods - found
    except Rejected as rejected:
        return IntegerAnswer(False, str(rejected), covered, uncovered)
    return IntegerAnswer(True, "", covered, uncovered)


def _leaf(setting: Setting, file: CertificateFile, number: int, box: list[tuple[Fraction, Fraction]]) -> int:
    try:
        return follow_leaf(setting, read_leaf(setting.layout, *file.streams(number)), box)
    except (Rejected, InputError) as problem:
        raise Rejected(f"leaf {number}: {problem}") from None


def prepare(header: Header, policy: bytes, specification: bytes, folder: Path | None) -> Setting:
    """What all leaves share; `Rejected` where the files are others than the header's, or do not fit each other."""
    found = hashlib.sha256(policy).hexdigest(), hashlib.sha256(specification).hexdigest()
    if found != (header.policy, header.specification):
        raise Rejected("the certificate is about other files: the digests differ")
    try:
        contract, network = read_contract(specification, folder), read_network(policy)
    except SetrlError as error:
        raise Rejected(f"the files cannot be read: {error}") from None
    if contract.plant_digest != header.plant:
        raise Rejected("the certificate is about another plant: the digests differ")
    if header.observation_radius is not None:
        contract = replace(contract, radius=header.observation_radius)
    _require_fit(contract, network)
    runtime = None
    if header.runtime is not None:
        runtime = Runtime(network.precision, header.runtime[1])
        if header.semantics[1:] != (network.precision,) or not runtime.own >= MEASURED[network.precision]:
            raise Rejected("the certificate's semantics is not that of a runtime of the network")
    layout = layout_of(contract, network, header.method, header.version)
    return Setting(contract, layout, Policy.of(contract, network, layout, runtime))


def _require_fit(contract: Contract, network: Network) -> None:
    """Sizes along the way from the states to the actions, the radii's signs, and all actions clipped or none."""
    size = len(contract.observe)
    for matrix in (contract.before, network, contract.after):
        if matrix is None:
            continue
        takes = matrix.inputs if isinstance(matrix, Network) else len(matrix.matrix[0])
        gives = matrix.outputs if isinstance(matrix, Network) else len(matrix.matrix)
        if takes != size:
            raise Rejected("the observation, the network and its maps do not fit each other")
        size = gives
    clipped = [bounds is not None for bounds in contract.clip]
    if size != len(contract.plant.inputs) or any(clipped) != all(clipped):
        raise Rejected("the network does not fit the plant's inputs")
    if len(contract.radius) != len(contract.observe) or not all(radius >= 0 for radius in contract.radius):
        raise Rejected("the radii of the observation do not fit")
