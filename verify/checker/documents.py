"""YAML text to plain data, only the part of YAML in which a file can mean one thing.

One document of mappings, lists and scalars. Scalars stay text (`Plain`, or `str` where they were quoted) or are None.
Anchors, aliases, tags and duplicate keys are refused. Numbers are read here too: exact decimals.
"""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Any

import yaml

from ...specs.errors import SpecificationError

MAX_BYTES, MAX_DEPTH, MAX_NODES = 1 << 20, 32, 20_000
MAX_DIGITS, MAX_EXPONENT = 100, 300

_DECIMAL = re.compile(r"-?(?:0|[1-9][0-9]*)(?:\.[0-9]+)?(?:[eE][+-]?([0-9]+))?", re.ASCII)


class Plain(str):
    """Text that was not quoted: only this can be a number."""


def load(content: bytes) -> dict[str, Any]:
    """Read one document whose top level is a mapping; `SpecificationError` for everything else."""
    if len(content) > MAX_BYTES:
        raise SpecificationError(f"the file has more than {MAX_BYTES} bytes")
    builder = _Builder()
    try:
        for event in yaml.parse(content.decode("utf-8-sig"), Loader=yaml.SafeLoader):
            builder.take(event)
    except (yaml.YAMLError, ValueError, OverflowError) as error:
        raise SpecificationError(f"not readable as YAML: {error}") from error
    if not isinstance(builder.root, dict):
        raise SpecificationError("a mapping is required at the top level")
    return builder.root


class _Builder:
    def __init__(self) -> None:
        self.root: Any = None
        self.count = 0
        self.stack: list[Any] = []
        self.keys: list[str | None] = []

    def take(self, event: yaml.Event) -> None:
        match event:
            case yaml.AliasEvent():
                raise SpecificationError("aliases are not read")
            case yaml.DocumentStartEvent():
                if self.root is not None or event.tags:
                    raise SpecificationError("one document without directives is required")
            case yaml.ScalarEvent() | yaml.SequenceStartEvent() | yaml.MappingStartEvent():
                self.count += 1
                if event.anchor is not None or event.tag is not None:
                    raise SpecificationError("anchors and tags are not read")
                if self.count > MAX_NODES or len(self.stack) >= MAX_DEPTH:
                    raise SpecificationError("the file has too many values, or nests them too deep")
                self.add(event)
            case yaml.SequenceEndEvent() | yaml.MappingEndEvent():
                self.stack.pop()
                self.keys.pop()

    def add(self, event: yaml.NodeEvent) -> None:
        top = self.stack[-1] if self.stack else None
        if isinstance(top, dict) and self.keys[-1] is None:
            if not isinstance(event, yaml.ScalarEvent) or event.value in top or not event.value:
                raise SpecificationError(
                    f"the keys of a mapping are distinct names: {getattr(event, 'value', '')!r:.60}"
                )
            self.keys[-1] = event.value
            return
        value: Any
        if isinstance(event, yaml.ScalarEvent):
            value = _scalar(event)
        else:
            value = [] if isinstance(event, yaml.SequenceStartEvent) else {}
        if isinstance(top, dict):
            top[self.keys[-1]] = value
            self.keys[-1] = None
        elif isinstance(top, list):
            top.append(value)
        else:
            self.root = value
        if not isinstance(event, yaml.ScalarEvent):
            self.stack.append(value)
            self.keys.append(None)


def _scalar(event: yaml.ScalarEvent) -> str | None:
    if event.style is not None:
        return str(event.value)
    return None if event.value in ("", "~", "null") else Plain(event.value)


def number(value: Any) -> Fraction:
    """An exact decimal: ``0.1`` is one tenth."""
    if not isinstance(value, Plain) or len(value) > MAX_DIGITS:
        raise SpecificationError(f"a number is required, found {str(value)[:60]!r}")
    match = _DECIMAL.fullmatch(value)
    if match is None or int(match[1] or 0) > MAX_EXPONENT:
        raise SpecificationError(f"a decimal number is required, found {str(value)[:60]!r}")
    return Fraction(str(value))


def interval(value: Any) -> tuple[Fraction, Fraction]:
    """``[lower, upper]``, not empty."""
    if not isinstance(value, list) or len(value) != 2:
        raise SpecificationError("[lower, upper] is required")
    lower, upper = number(value[0]), number(value[1])
    if lower > upper:
        raise SpecificationError(f"the interval [{lower}, {upper}] is empty")
    return lower, upper


def mapping(value: Any, known: tuple[str, ...] | None, what: str) -> dict[str, Any]:
    """A mapping, whose keys are all known where that is asked for, and none of whose values is missing."""
    if not isinstance(value, dict):
        raise SpecificationError(f"{what}: a mapping is required")
    for key, entry in value.items():
        if known is not None and (key not in known or entry is None):
            raise SpecificationError(f"{what}: the key {key[:60]!r} is unknown or has no value")
    return value
