"""Headers of certificates that ask for much, nest deep, or have entries that are out of range."""

from __future__ import annotations

from typing import Any

DEEP = b"[" * 100_000
HUGE = b"9" * 5000
BOMBS = {
    "nested lists": DEEP,
    "nested objects": b'{"a":' * 100_000,
    "nested and closed": DEEP + b"]" * 100_000,
    "less deep": b'{"a":' + b"[" * 900 + b"]" * 900 + b"}",
    "huge whole number": b'{"format":' + HUGE + b"}",
    "huge exponent": b'{"format":1e999999999}',
    "no number": b'{"format":NaN}',
    "two formats": b'{"format":1,"format":2}',
    "byte order mark": b"\xef\xbb\xbf{}",
    "not ASCII": '{"format":"ä"}'.encode(),
    "list": b"[1]",
    "empty": b"",
    "text": b'"x"',
    "many brackets": b"[" + b"[]," * 300_000 + b"[]]",
    "long text": b'"' + b"x" * 3_000_000 + b'"',
}


def nested(depth: int) -> Any:
    value: Any = []
    for _ in range(depth):
        value = [value]
    return value


ENTRIES: list[tuple[str, Any]] = [
    ("floats", 10**9),
    ("floats", 10**30),
    ("floats", -1),
    ("integers", 10**9),
    ("integers", 2**31),
    ("floats", True),
    ("floats", 1.0),
    ("leaves", []),
    ("leaves", [[10**9, 10**9]]),
    ("leaves", [[-8, 8]]),
    ("leaves", [[0, 0]] * 100_000),
    ("leaves", nested(600)),
    ("leaves", [[float("nan"), 1]]),
    ("leaves", None),
    ("tree", []),
    ("tree", [None] * 100_000),
    ("tree", [[0, "0"]] * 20_000),
    ("tree", [[0, "1/0"], None, None]),
    ("tree", [[0, "1" * 5000], None, None]),
    ("tree", [[0, "0.5"], None, None]),
    ("tree", [[0, 0.5], None, None]),
    ("tree", [[0, "٣"], None, None]),
    ("tree", [[-1, "0"], None, None]),
    ("tree", [[10**20, "0"], None, None]),
    ("tree", nested(600)),
    ("order", 10**9),
    ("order", 0),
    ("order", 10**4000),
    ("format", 10**90),
    ("format", -1),
    ("requirements", [{"name": "x", "margin": float("nan")}]),
    ("requirements", [{"name": "x", "margin": float("inf")}]),
    ("requirements", [{"name": "x", "margin": 1}]),
    ("requirements", [{"name": "\ud800", "margin": 1.0}]),
    ("requirements", []),
    ("requirements", [[]]),
    ("value", {"discounted": float("-inf"), "undiscounted": 0.0}),
    ("value", {}),
    ("runtime", {"name": "x", "error": "-1"}),
    ("runtime", {"name": "x", "error": 0.0}),
    ("runtime", {}),
    ("semantics", []),
    ("semantics", ["float32"]),
    ("semantics", ["real", "real"]),
    ("semantics", [["real"]]),
    ("semantics", "real"),
    ("observation_radius", ["1e9"]),
    ("observation_radius", ["1"] * 100_000),
    ("observation_radius", []),
    ("observation_radius", [None]),
    ("method", "magic"),
    ("method", None),
    ("payload", ""),
    ("payload", "0" * 64),
    ("policy", ""),
    ("plant", "0" * 64),
    ("extra", 1),
]
