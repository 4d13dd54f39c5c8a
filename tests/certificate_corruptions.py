"""Corrupted certificates: one change each, of a number, of a leaf's structure or of the header, and sealed again."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from certificate_headers import corrupted_header
from certificate_streams import Certificate, sealed
from certificate_structures import STRUCTURES

EXPONENTS = (0, 1, 2, 4, 8, 12, 16, 24, 32, 40, 48, 51)
LARGEST = 2**31 - 1


@dataclass(frozen=True)
class Corruption:
    """A corrupted certificate.

    Attributes
    ----------
    kind : str
        What was changed, and how.
    content : bytes
    false : str
        Why it is false whatever its numbers are: it does not match the files. "" where the numbers decide.
    """

    kind: str
    content: bytes
    false: str = ""


def corruptions(base: Certificate, count: int, seed: int) -> Iterator[Corruption]:
    """As many corruptions of one certificate, some of every kind."""
    generator = np.random.default_rng(seed)
    makers = [_number, _number, _number, _number, _whole, _structure, _structure, _header]
    made = 0
    while made < count:
        found = makers[made % len(makers)](base, generator)
        if found is not None:
            made += 1
            yield found


# Numbers ----------------------------------------------------------------------------------------------------------


def _pick(labels: Sequence[tuple[str, int]], generator: Any) -> tuple[int, list[int]]:
    """A position, every field as likely as any other, and the positions of the same field."""
    fields = sorted({label for label, _ in labels})
    field = fields[generator.integers(len(fields))]
    places = [i for i, (label, _) in enumerate(labels) if label == field]
    return places[generator.integers(len(places))], places


def _number(base: Certificate, generator: Any) -> Corruption | None:
    """One float; of a field that is chosen first."""
    which = int(generator.integers(len(base.leaves)))
    writer = base.writer(base.leaves[which])
    place, places = _pick(writer.labels, generator)
    floats = list(writer.floats)
    x, power = floats[place], 2.0 ** -EXPONENTS[generator.integers(len(EXPONENTS))]
    how, value = [
        ("sign", -x),
        ("last bit", math.nextafter(x, math.inf)),
        ("last bit", math.nextafter(x, -math.inf)),
        ("scaled", x * (1 + power)),
        ("scaled", x * (1 - power)),
        ("scaled", x * (1 - power)),
        ("shifted", x + power * generator.choice([-1, 1])),
        ("zero", 0.0),
        ("zero", 0.0),
        ("another one's", floats[places[generator.integers(len(places))]]),
        ("swapped", math.nan),
        ("not finite", float(generator.choice([math.nan, math.inf, -math.inf]))),
    ][generator.integers(12)]
    if how == "swapped":
        other = places[generator.integers(len(places))]
        floats[place], floats[other] = floats[other], x
    else:
        floats[place] = value
    if floats == writer.floats:
        return None
    label, _ = writer.labels[place]
    streams = base.streams
    streams[which] = (floats, writer.integers)
    return Corruption(f"{label}: {how}", sealed(base.header, streams))


def _whole(base: Certificate, generator: Any) -> Corruption | None:
    """One whole number: mostly another count or position, so that everything behind it is read differently."""
    which = int(generator.integers(len(base.leaves)))
    writer = base.writer(base.leaves[which])
    if not writer.marks:
        return None
    place, places = _pick(writer.marks, generator)
    integers = list(writer.integers)
    x, other = integers[place], places[generator.integers(len(places))]
    integers[place] = [x + 1, x - 1, 0, -1, integers[other], LARGEST, -LARGEST - 1, x + 2][generator.integers(8)]
    if integers == writer.integers:
        return None
    streams = base.streams
    streams[which] = (writer.floats, integers)
    label, _ = writer.marks[place]
    return Corruption(f"{label}: whole", sealed(base.header, streams))


def _header(base: Certificate, generator: Any) -> Corruption | None:
    found = corrupted_header(base, generator)
    return None if found is None else Corruption(found[0], found[1], found[2])


# Structure --------------------------------------------------------------------------------------------------------


def _structure(base: Certificate, generator: Any) -> Corruption | None:
    """A leaf of another shape, written as that shape is written."""
    which = int(generator.integers(len(base.leaves)))
    leaf = base.leaves[which]
    name, maker = STRUCTURES[generator.integers(len(STRUCTURES))]
    found = maker(leaf, generator)
    if found is None or found == leaf:
        return None
    streams = base.streams
    writer = base.writer(found)
    streams[which] = (writer.floats, writer.integers)
    return Corruption(name, sealed(base.header, streams))
