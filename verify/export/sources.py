"""What an export is made of: an accepted certificate and the two files it is about, as the checker reads them."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction
from pathlib import Path

from ...specs.errors import InputError
from ..checker.certificate import prepare
from ..checker.certificate_file import CertificateFile, read_certificate
from ..checker.contract import Contract
from ..checker.cover import Box, leaf_boxes
from ..checker.layout import Layout
from ..checker.leaf import Leaf, read_leaf
from ..checker.network import Network, read_network
from ..checker.obligations import Setting
from ..checker.rejection import Rejected


@dataclass(frozen=True)
class Source:
    """A certificate with what it is about.

    Attributes
    ----------
    file : CertificateFile
    setting : Setting
        Contract, sizes, dynamics; the observation's radius is the certificate's.
    network : Network
        The policy.
    boxes : tuple of Box
        The part of the initial set that each leaf is responsible for, exact.
    """

    file: CertificateFile
    setting: Setting
    network: Network
    boxes: tuple[Box, ...]

    @property
    def contract(self) -> Contract:
        """The specification."""
        return self.setting.contract

    @property
    def layout(self) -> Layout:
        """Sizes."""
        return self.setting.layout

    @property
    def radius(self) -> tuple[Fraction, ...]:
        """Radius of the perturbation of every observed component."""
        return self.contract.radius

    def leaf(self, number: int) -> Leaf:
        """What is claimed about one leaf."""
        return read_leaf(self.layout, *self.file.streams(number))


def read_source(certificate: bytes, policy: bytes, specification: bytes, folder: Path | None = None) -> Source:
    """Read what an export is made of. Nothing is proved here: the checker has to accept the certificate first.

    Parameters
    ----------
    certificate, policy, specification : bytes
        Of the three files.
    folder : Path, optional
        Of the specification, where relative paths of plant files start.

    Returns
    -------
    Source

    Raises
    ------
    InputError
        The certificate is not of the format, or about other files.
    """
    file = read_certificate(certificate)
    try:
        setting = prepare(file.header, policy, specification, folder)
    except Rejected as rejected:
        raise InputError(str(rejected), remedy="give the files that the certificate was written for") from None
    boxes = tuple(leaf_boxes(file.header.tree, setting.contract.initial))
    if len(boxes) != len(file.header.leaves):
        raise InputError("the tree and the leaves of the certificate differ in number")
    return Source(file, setting, read_network(policy), boxes)
