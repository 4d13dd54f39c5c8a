"""A certificate's bytes from what the engine found; see docs/certificate.md for the format."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Sequence
from fractions import Fraction
from typing import Any

import numpy as np

from ..models.closed_loop import ClosedLoop
from . import rounding
from .evidence import LeafEvidence
from .model import initial_box
from .options import Options
from .splitting import Exploration, InitialSet

MAGIC = b"setrl-cert\r\n\x1a\x00\x00\x00"
VERSIONS = {"zonotope": 1, "crown": 2, "best": 2}
"""Version of the format by the enclosure of the policy: the second one says for every period which form it has."""


def certificate_of(
    found: Exploration,
    problem: int,
    options: Options,
    digests: dict[str, str],
    loop: ClosedLoop,
    observation_radius: tuple[Fraction, ...] | None,
    runtime: tuple[str, float] | None,
) -> bytes:
    """The certificate of one problem all of whose leaves were proved.

    Parameters
    ----------
    found : Exploration
    problem : int
    options : Options
    digests : dict
        ``policy``, ``specification``, ``plant``.
    loop : ClosedLoop
    observation_radius : tuple of Fraction, optional
        Where it is not the specification's.
    runtime : (name, error), optional
        What the deployed semantics assumes; None where only exact arithmetic is covered.

    Returns
    -------
    bytes
        The same for the same inputs, options and version.
    """
    from .. import __version__

    tree, leaves = cover_of(found, problem, loop)
    evidence = [found.evidence[leaf] for leaf in leaves]
    margins = [float(found.margins[leaves, number].min()) for number in range(len(loop.requirements))]
    value = None
    if loop.reward is not None:
        value = {
            "discounted": float(found.value[leaves].min()),
            "undiscounted": float(found.undiscounted[leaves].min()),
        }
    payload = _payload(evidence)
    header = {
        "format": VERSIONS[options.enclosure],
        "setrl": __version__,
        **digests,
        "observation_radius": None if observation_radius is None else [str(radius) for radius in observation_radius],
        "semantics": ["real"] if runtime is None else ["real", loop.policy.precision],
        "runtime": None if runtime is None else {"name": runtime[0], "error": str(Fraction(runtime[1]))},
        "method": options.method,
        "order": options.taylor_order,
        "requirements": [
            {"name": requirement.name, "margin": rounding.with_room(margin)}
            for requirement, margin in zip(loop.requirements, margins, strict=True)
        ],
        "value": value,
        "tree": tree,
        "leaves": [[leaf.floats.size, leaf.integers.size] for leaf in evidence],
        "floats": sum(leaf.floats.size for leaf in evidence),
        "integers": sum(leaf.integers.size for leaf in evidence),
        "payload": hashlib.sha256(payload).hexdigest(),
    }
    return _file(header, payload)


def join_certificates(tree: Sequence[Any], parts: Sequence[bytes]) -> bytes:
    """One certificate from those of the parts of an initial set.

    Parameters
    ----------
    tree : sequence
        How the initial set was cut, in preorder: ``[state, cut]``, None where a part is.
    parts : sequence of bytes
        What `certificate_of` wrote for every part, in that order.

    Returns
    -------
    bytes

    Raises
    ------
    ValueError
        The parts are not about the same question.
    """
    read = [_read(content) for content in parts]
    first = read[0][0]
    own = {"requirements", "value", "tree", "leaves", "floats", "integers", "payload"}
    for header, _, _ in read:
        if any(header[key] != first[key] for key in first.keys() - own):
            raise ValueError("the parts differ in what they claim")
    waiting = iter([header["tree"] for header, _, _ in read])
    nodes: list[Any] = []
    for node in tree:
        nodes += next(waiting) if node is None else [node]
    headers = [header for header, _, _ in read]
    value = None
    if first["value"] is not None:
        value = {key: min(header["value"][key] for header in headers) for key in first["value"]}
    payload = b"".join(floats for _, floats, _ in read) + b"".join(integers for _, _, integers in read)
    joined = {
        **first,
        "requirements": [
            {"name": entry["name"], "margin": min(header["requirements"][number]["margin"] for header in headers)}
            for number, entry in enumerate(first["requirements"])
        ],
        "value": value,
        "tree": nodes,
        "leaves": [leaf for header in headers for leaf in header["leaves"]],
        "floats": sum(header["floats"] for header in headers),
        "integers": sum(header["integers"] for header in headers),
        "payload": hashlib.sha256(payload).hexdigest(),
    }
    return _file(joined, payload)


def _file(header: dict[str, Any], payload: bytes) -> bytes:
    text = json.dumps(header, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()
    text += b" " * (-(len(MAGIC) + 8 + len(text)) % 8)
    return MAGIC + struct.pack("<Q", len(text)) + text + payload


def _read(content: bytes) -> tuple[dict[str, Any], bytes, bytes]:
    """Header, floats and whole numbers of a certificate that this program has just written."""
    (length,) = struct.unpack_from("<Q", content, len(MAGIC))
    begin = len(MAGIC) + 8 + length
    header = json.loads(content[len(MAGIC) + 8 : begin])
    middle = begin + 8 * header["floats"]
    return header, content[begin:middle], content[middle:]


def _payload(evidence: list[LeafEvidence]) -> bytes:
    floats = b"".join(leaf.floats.astype("<f8").tobytes() for leaf in evidence)
    return floats + b"".join(leaf.integers.astype("<i4").tobytes() for leaf in evidence)


def cover_of(found: Exploration, problem: int, loop: ClosedLoop) -> tuple[list[Any], list[int]]:
    """The cover in preorder, ``[state, cut]`` or None for a leaf, cuts as exact text; and its leaves in that order."""
    tree = found.tree
    initial = InitialSet.of(*initial_box(loop))
    children: dict[int, list[int]] = {}
    for cell in np.flatnonzero(tree.problem == problem).tolist():
        children.setdefault(int(tree.parent[cell]), []).append(cell)
    (root,) = children[-1]
    nodes: list[Any] = []
    leaves: list[int] = []
    waiting = [root]
    while waiting:
        cell = waiting.pop()
        if cell not in children:
            nodes.append(None)
            leaves.append(cell)
            continue
        first, second = sorted(children[cell], key=lambda child: tuple(tree.lower[child]))
        (factor,) = np.flatnonzero(tree.upper[first] != tree.upper[cell])
        state = int(initial.free[factor])
        cut = Fraction(initial.center[state]) + Fraction(initial.radius[state]) * Fraction(tree.upper[first, factor])
        low, high = loop.initial[state]
        nodes.append([state, str(min(max(cut, low), high))])
        waiting += [second, first]
    return nodes, leaves
