"""Corrupted headers of certificates: digests, claims, cover, lengths."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

from certificate_streams import Certificate, sealed

VERSIONS = (1, 2)
EXPONENTS = (0, 1, 4, 8, 10, 12, 13, 14, 20, 30, 45, 52)
Found = tuple[str, bytes, str]
"""What was changed, the file, and why it is false whatever its numbers are ("" where they decide)."""


def corrupted_header(base: Certificate, generator: Any) -> Found | None:
    """One change of the header, or of the order of the leaves."""
    header, streams = dict(base.header), base.streams
    names = [*_CHANGES]
    name = names[generator.integers(len(names))]
    found = _CHANGES[name](header, streams, generator)
    if found is None:
        return None
    changed, false = found
    lengths = {key: changed[key] for key in ("floats", "integers", "leaves") if changed[key] != base.header[key]}
    content = sealed(changed, streams, **lengths)
    return None if content == sealed(base.header, base.streams) else (f"header: {name}", content, false)


def _digest(header: Any, streams: Any, generator: Any) -> Any:
    key = str(generator.choice(["policy", "specification", "plant"]))
    text = header[key]
    place = int(generator.integers(64))
    other = "0" * 64 if not text else text[:place] + "0123456789abcdef"[generator.integers(16)] + text[place + 1 :]
    return {**header, key: other}, "" if other == text else "another file"


def _semantics(header: Any, streams: Any, generator: Any) -> Any:
    """The deployed semantics left out (which stays true), claimed, or of another precision."""
    if len(header["semantics"]) == 1:
        runtime = {"name": "onnxruntime", "error": "1/2097152"}
        return {**header, "semantics": ["real", str(generator.choice(["float32", "float64"]))], "runtime": runtime}, ""
    if generator.integers(2):
        return {**header, "semantics": ["real"], "runtime": None}, ""
    other = {"float32": "float64", "float64": "float32"}[header["semantics"][1]]
    return {**header, "semantics": ["real", other]}, "another precision"


def _runtime(header: Any, streams: Any, generator: Any) -> Any:
    if header["runtime"] is None:
        return None
    error = Fraction(header["runtime"]["error"]) * Fraction(generator.choice([0.0, 0.5, 0.999, 1.001, 2.0, 1e6, -1.0]))
    least = Fraction(1, 2 ** (21 if header["semantics"][1] == "float32" else 48))
    false = "less than any runtime's error" if error < least else ""
    return {**header, "runtime": {**header["runtime"], "error": str(error)}}, false


def _order(header: Any, streams: Any, generator: Any) -> Any:
    return {**header, "order": int(header["order"] + generator.choice([-4, -2, -1, 1, 2, 40]))}, ""


def _scaled(x: float, generator: Any) -> float:
    power = 2.0 ** -EXPONENTS[generator.integers(len(EXPONENTS))]
    return float(generator.choice([x * (1 + power), x * (1 - power), x + power, x - power, -x, 0.0, 1e30, 2 * x]))


def _margin(header: Any, streams: Any, generator: Any) -> Any:
    given = [dict(entry) for entry in header["requirements"]]
    if not given:
        return None
    entry = given[generator.integers(len(given))]
    entry["margin"] = _scaled(entry["margin"], generator)
    return {**header, "requirements": given}, ""


def _value(header: Any, streams: Any, generator: Any) -> Any:
    if header["value"] is None:
        return {**header, "value": {"discounted": -1e9, "undiscounted": -1e9}}, "there is no reward"
    key = str(generator.choice(["discounted", "undiscounted"]))
    if generator.integers(6) == 0:
        return {**header, "value": None}, "there is a reward"
    return {**header, "value": {**header["value"], key: _scaled(header["value"][key], generator)}}, ""


def _names(header: Any, streams: Any, generator: Any) -> Any:
    given = [dict(entry) for entry in header["requirements"]]
    if not given:
        return None
    match generator.integers(3):
        case 0:
            given[-1]["name"] += " "
        case 1:
            del given[-1]
        case _:
            given.append(dict(given[-1]))
    return {**header, "requirements": given}, "other requirements"


def _radius(header: Any, streams: Any, generator: Any) -> Any:
    """Another radius of the perturbation: the question of another one, which the numbers answer or do not."""
    count = int(generator.integers(1, 7))
    radius = str(generator.choice(["0", "1/50", "1/10", "-1/50", "3"]))
    return {**header, "observation_radius": [radius] * count}, ""


def _cut(header: Any, streams: Any, generator: Any) -> Any:
    """A cut that is moved, in another state, or turned into a leaf and back."""
    tree = list(header["tree"])
    place = int(generator.integers(len(tree)))
    if tree[place] is None:
        tree[place : place + 1] = [[0, "0"], None, None]
    elif generator.integers(3) == 0:
        tree[place] = [1 - min(tree[place][0], 1), tree[place][1]]
    else:
        tree[place] = [tree[place][0], str(Fraction(tree[place][1]) + Fraction(float(generator.normal() * 0.01)))]
    return {**header, "tree": tree}, ""


def _shape(header: Any, streams: Any, generator: Any) -> Any:
    tree = list(header["tree"])
    match generator.integers(3):
        case 0:
            tree.append(None)
        case 1:
            del tree[-1]
        case _:
            tree.reverse()
    return {**header, "tree": tree}, "no tree of these leaves" if tree != header["tree"] else ""


def _leaf_order(header: Any, streams: Any, generator: Any) -> Any:
    """Leaves in another order, one twice, one left out."""
    if len(streams) > 1 and generator.integers(2):
        streams.reverse()
        return header, ""
    if generator.integers(2):
        streams.append(streams[0])
    else:
        del streams[-1]
    return header, "leaves without a place in the tree, or the other way round"


def _lengths(header: Any, streams: Any, generator: Any) -> Any:
    key = str(generator.choice(["floats", "integers", "leaves"]))
    if key == "leaves":
        counts = [list(entry) for entry in header["leaves"]]
        counts[-1][generator.integers(2)] += int(generator.choice([-1, 1, 7]))
        return {**header, "leaves": counts}, "lengths that do not add up"
    wrong = header[key] + int(generator.choice([-1, 1, 10**9]))
    return {**header, key: wrong}, "lengths that do not add up"


def _method(header: Any, streams: Any, generator: Any) -> Any:
    return {**header, "method": "jets" if header["method"] == "linearization" else "linearization"}, ""


def _format(header: Any, streams: Any, generator: Any) -> Any:
    other = int(generator.choice([0, 1, 2, 3, -1]))
    return {**header, "format": other}, "" if other in VERSIONS else "another format"


_CHANGES = {
    "digest": _digest,
    "semantics": _semantics,
    "runtime": _runtime,
    "order": _order,
    "margin": _margin,
    "value": _value,
    "requirements": _names,
    "observation radius": _radius,
    "cut": _cut,
    "shape of the tree": _shape,
    "leaves": _leaf_order,
    "lengths": _lengths,
    "method": _method,
    "format": _format,
}
