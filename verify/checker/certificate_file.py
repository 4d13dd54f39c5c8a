"""The container of a certificate: magic, header's length, canonical JSON header, streams of float64 and of int32.

All numbers are little-endian. Sizes and the payload's sha256 are in the header, whose bytes are the only ones that say
the same: keys sorted, no spaces. Rationals are texts such as ``-3/8``.
"""

from __future__ import annotations

import hashlib
import json
import re
import struct
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

from ...specs.errors import InputError

MAGIC = b"setrl-cert\r\n\x1a\x00\x00\x00"
VERSIONS = (1, 2)
"""Of the format. Version 2 says in every period how its policy is followed; see `leaf`."""
MAX_HEADER, MAX_BYTES = 64 << 20, 16 << 30
METHODS = ("jets", "linearization")
SEMANTICS = ("real", "float32", "float64")

_RATIONAL = re.compile(r"-?[0-9]{1,1200}(/[1-9][0-9]{0,1200})?", re.ASCII)
_KEYS = {
    "format": int,
    "setrl": str,
    "policy": str,
    "specification": str,
    "plant": str,
    "observation_radius": (list, type(None)),
    "semantics": list,
    "runtime": (dict, type(None)),
    "method": str,
    "order": int,
    "requirements": list,
    "value": (dict, type(None)),
    "tree": list,
    "leaves": list,
    "floats": int,
    "integers": int,
    "payload": str,
}


@dataclass(frozen=True)
class Header:
    """What a certificate says about itself.

    Attributes
    ----------
    version : int
        Of the format.
    setrl : str
        Version of the program that wrote it.
    policy, specification, plant : str
        sha256 of the files' bytes; `plant` is "" where the specification contains its plant.
    observation_radius : tuple of Fraction or None
        Instead of the specification's.
    semantics : tuple of str
        "real", and the network's precision where the deployed network is covered too.
    runtime : tuple of (str, Fraction) or None
        Name of the runtime and the error bound of its own tanh and sigmoid that the deployed semantics assumes.
    method : {"jets", "linearization"}
    order : int
        Order of the expansions in time.
    requirements : tuple of (name, margin)
    value : tuple of (discounted, undiscounted) or None
        Claimed lower bounds of the return.
    tree : tuple
        Preorder: (state, cut), or None for a leaf.
    leaves : tuple of (float offset, floats, integer offset, integers)
    floats, integers : int
        Lengths of the streams.
    """

    version: int
    setrl: str
    policy: str
    specification: str
    plant: str
    observation_radius: tuple[Fraction, ...] | None
    semantics: tuple[str, ...]
    runtime: tuple[str, Fraction] | None
    method: str
    order: int
    requirements: tuple[tuple[str, float], ...]
    value: tuple[float, float] | None
    tree: tuple[tuple[int, Fraction] | None, ...]
    leaves: tuple[tuple[int, int, int, int], ...]
    floats: int
    integers: int


@dataclass(frozen=True)
class CertificateFile:
    """A certificate's header and where its streams are."""

    header: Header
    content: bytes
    start: int

    def streams(self, leaf: int) -> tuple[Sequence[float], Sequence[int]]:
        """Floats and whole numbers of one leaf."""
        return unpacked(*self.bytes_of(leaf))

    def bytes_of(self, leaf: int) -> tuple[bytes, bytes]:
        """The same as bytes."""
        first, count, first_integer, integers = self.header.leaves[leaf]
        start = self.start + 8 * first
        place = self.start + 8 * self.header.floats + 4 * first_integer
        return self.content[start : start + 8 * count], self.content[place : place + 4 * integers]


def unpacked(floats: bytes, integers: bytes) -> tuple[Sequence[float], Sequence[int]]:
    """Little-endian float64 and int32 numbers."""
    return struct.unpack(f"<{len(floats) // 8}d", floats), struct.unpack(f"<{len(integers) // 4}i", integers)


def read_certificate(content: bytes) -> CertificateFile:
    """Read a certificate; `InputError` where it is not exactly of the format."""
    if content[: len(MAGIC)] != MAGIC or len(content) < len(MAGIC) + 8:
        raise InputError("not a certificate of setrl, or cut off")
    (size,) = struct.unpack_from("<Q", content, len(MAGIC))
    start = len(MAGIC) + 8 + size
    if size > MAX_HEADER or start > len(content) or start % 8:
        raise InputError("the certificate is cut off in its header")
    text = content[len(MAGIC) + 8 : start]
    header = _header(text)
    length = 8 * header.floats + 4 * header.integers
    if len(content) != start + length:
        raise InputError(f"the certificate has {len(content)} bytes, its header says {start + length}")
    if hashlib.sha256(memoryview(content)[start:]).hexdigest() != json.loads(text)["payload"]:
        raise InputError("the certificate's numbers are not those its header was written for")
    return CertificateFile(header, content, start)


def _header(text: bytes) -> Header:
    try:
        data = json.loads(text.decode("ascii"))
        spelled = canonical(data)
    except (ValueError, RecursionError) as error:  # also numbers that are not finite
        raise InputError("the certificate's header is no JSON document") from error
    if not isinstance(data, dict) or type(data.get("format")) is not int:
        raise InputError("the certificate's header has no format")
    if data["format"] not in VERSIONS:
        known = " and ".join(map(str, VERSIONS))
        raise InputError(f"the certificate has format {data['format']}; this program reads format {known}")
    if set(data) != set(_KEYS) or not all(_is(data[key], kind) for key, kind in _KEYS.items()):
        raise InputError("the certificate's header has not exactly the keys of its format")
    if spelled != text:
        raise InputError("the certificate's header is not in canonical form")
    radius, runtime, value = data["observation_radius"], data["runtime"], data["value"]
    semantics = tuple(data["semantics"])
    covered = semantics[:1] == ("real",) and semantics[1:] in ((), ("float32",), ("float64",))
    if not covered or (len(semantics) == 2) != (runtime is not None) or data["method"] not in METHODS:
        raise InputError("the certificate's semantics or method is unknown")
    if not 1 <= data["order"] <= 30 or min(data["floats"], data["integers"]) < 0:
        raise InputError("the certificate's header has a number that is out of range")
    if max(data["floats"], data["integers"]) > MAX_BYTES // 8:
        raise InputError("the certificate's header has a number that is out of range")
    return Header(
        data["format"],
        data["setrl"],
        data["policy"],
        data["specification"],
        data["plant"],
        None if radius is None else tuple(map(_rational, radius)),
        semantics,
        None if runtime is None else _runtime(runtime),
        data["method"],
        data["order"],
        tuple(map(_requirement, data["requirements"])),
        None if value is None else _value(value),
        tuple(None if node is None else _node(node) for node in data["tree"]),
        _leaves(data["leaves"], data["floats"], data["integers"]),
        data["floats"],
        data["integers"],
    )


def _is(value: Any, kind: Any) -> bool:
    return isinstance(value, kind) and not isinstance(value, bool)


def canonical(data: dict[str, Any]) -> bytes:
    """The bytes of a header: JSON with sorted keys and no spaces, padded with spaces so that the payload is aligned."""
    text = json.dumps(data, sort_keys=True, separators=(",", ":"), ensure_ascii=True, allow_nan=False).encode()
    return text + b" " * (-(len(MAGIC) + 8 + len(text)) % 8)


def _rational(value: Any) -> Fraction:
    if not isinstance(value, str) or not _RATIONAL.fullmatch(value):
        raise InputError("rationals of a certificate are texts such as -3/8")
    return Fraction(value)


def _runtime(value: dict[str, Any]) -> tuple[str, Fraction]:
    if set(value) != {"name", "error"} or not isinstance(value["name"], str):
        raise InputError("a certificate's runtime has a name and an error")
    return value["name"], _rational(value["error"])


def _requirement(value: Any) -> tuple[str, float]:
    if not isinstance(value, dict) or set(value) != {"name", "margin"} or not isinstance(value["name"], str):
        raise InputError("a certificate's requirements have a name and a margin")
    return value["name"], _float(value["margin"])


def _value(value: dict[str, Any]) -> tuple[float, float]:
    if set(value) != {"discounted", "undiscounted"}:
        raise InputError("a certificate's value is discounted and undiscounted")
    return _float(value["discounted"]), _float(value["undiscounted"])


def _float(value: Any) -> float:
    if type(value) is not float or value - value != 0.0:
        raise InputError("a certificate's margins and values are finite floats")
    return value


def _node(value: Any) -> tuple[int, Fraction]:
    if not isinstance(value, list) or len(value) != 2 or not _is(value[0], int):
        raise InputError("a node of a certificate's tree is a state and a cut, or null")
    return value[0], _rational(value[1])


def _leaves(value: list[Any], floats: int, integers: int) -> tuple[tuple[int, int, int, int], ...]:
    """Where the streams of each leaf are: one behind the other, nothing between them."""
    found, first, first_integer = [], 0, 0
    for entry in value:
        if not isinstance(entry, list) or len(entry) != 2 or not all(_is(x, int) and x >= 0 for x in entry):
            raise InputError("a leaf of a certificate is two lengths")
        found.append((first, entry[0], first_integer, entry[1]))
        first, first_integer = first + entry[0], first_integer + entry[1]
    if first != floats or first_integer != integers:
        raise InputError("the lengths of a certificate's leaves do not add up")
    return tuple(found)
