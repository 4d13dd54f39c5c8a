"""Certificates taken apart and put together: leaves to streams with a label for every number, and sealed files."""

from __future__ import annotations

import hashlib
import json
import struct
from collections.abc import Iterable, Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from functools import lru_cache
from typing import Any

import pytest

from setrl.verify.checker import certificate as checker
from setrl.verify.checker.certificate_file import MAGIC, canonical, read_certificate
from setrl.verify.checker.layout import Condition, Layout
from setrl.verify.checker.leaf import Choice, Leaf, PeriodClaim, Products, SetClaim, StepClaim, read_leaf
from setrl.verify.checker.obligations import Setting

Streams = tuple[list[float], list[int]]


@dataclass
class Writer:
    """The streams of one leaf, by the grammar of docs/certificate.md, and what every number in them is."""

    layout: Layout
    floats: list[float] = field(default_factory=list)
    integers: list[int] = field(default_factory=list)
    labels: list[tuple[str, int]] = field(default_factory=list)
    """Field and period (-1 before the first one) of every float."""
    marks: list[tuple[str, int]] = field(default_factory=list)
    """The same of every whole number."""
    period: int = -1

    def put(self, label: str, numbers: Iterable[float]) -> None:
        for number in numbers:
            self.floats.append(number)
            self.labels.append((label, self.period))

    def rows(self, label: str, rows: Iterable[Sequence[float]]) -> None:
        for row in rows:
            self.put(label, row)

    def count(self, label: str, *numbers: int) -> None:
        for number in numbers:
            self.integers.append(number)
            self.marks.append((label, self.period))

    def leaf(self, leaf: Leaf) -> Writer:
        self.count("rows of the start", len(leaf.rows))
        self.put("start center", leaf.center)
        self.rows("start rows", leaf.rows)
        self.put("start radius", leaf.radius)
        self.put("disturbance center", leaf.disturbance_center)
        self.put("disturbance spread", leaf.disturbance_spread)
        self._points(leaf.points)
        shared = len(leaf.rows) + sum(r != 0.0 for r in leaf.radius)
        for number, claim in enumerate(leaf.periods):
            self.period = number
            self._period(claim, shared)
            if claim.kept is not None and claim.radius is not None:
                shared = len(claim.kept) + sum(r != 0.0 for r in claim.radius)
        return self

    def _period(self, claim: PeriodClaim, shared: int) -> None:
        if self.layout.version > 1:
            self.count("form", claim.form)
        if claim.observation is not None:
            self._products("observation", claim.observation)
        if claim.seen is not None:
            self._set("observation", claim.seen)
        for lines in claim.lines:
            self.put("slopes", lines.slopes)
            self.put("line offsets", lines.offsets or ())
            self.put("line errors", lines.errors or ())
        for two in claim.two_lines:
            self.put("slopes", two.lower_slopes)
            self.put("line offsets", two.lower_offsets)
            self.put("slopes", two.upper_slopes)
            self.put("line offsets", two.upper_offsets)
        self.put("clip slopes", claim.clip_slopes or ())
        action = claim.action
        self.put("action center", action.center)
        self.rows("action rows", action.rows)
        self.count("private rows", len(action.origins))
        for origin in action.origins:
            self.count("origins", *origin)
        self.rows("private rows", action.private)
        self.put("action box", action.box)
        rows = joint = shared + len(action.private) + self.layout.inputs + len(self.layout.varying)
        if not self.layout.discrete:
            self.count("steps", len(claim.steps))
        for step in claim.steps:
            self._step(step, rows - joint)
            rows = len(step.end.rows) + len(step.end.fresh)
        if claim.kept is not None and claim.radius is not None:
            self._dropped("link", claim.kept, rows)
            self.put("link radius", claim.radius)
        for number, condition in enumerate(self.layout.conditions):
            self._point(condition, claim.points[number], (self.period + 1) * self.layout.period)
            for step in claim.steps:
                slabs = step.slabs[number] if step.slabs else None
                if slabs is not None:
                    self.count("slabs", slabs.count)
                    for choice in slabs.choices:
                        self._choice(condition, choice)
        if self.layout.penalty:
            self.count("clear", int(claim.clear is not None))
            self.rows("penalty weights", claim.clear or ())

    def _step(self, step: StepClaim, behind: int) -> None:
        if step.start_radius is not None:
            self._dropped("step", step.kept, behind)
            self.put("step start radius", step.start_radius)
        self.rows("prior", step.prior or ())
        if step.products is not None:
            self._products("step", step.products)
        self._set("end", step.end)

    def _set(self, what: str, claim: SetClaim) -> None:
        self.put(f"{what} center", claim.center)
        self.rows(f"{what} rows", claim.rows)
        self.rows(f"{what} products", claim.fresh)
        self.put(f"{what} radius", claim.radius)

    def _dropped(self, what: str, kept: Sequence[int], count: int) -> None:
        dropped = sorted(set(range(count)) - set(kept))
        self.count(f"{what} dropped count", len(dropped))
        self.count(f"{what} dropped", *dropped)

    def _products(self, what: str, products: Products) -> None:
        self.count(f"{what} factor count", len(products.factors))
        self.count(f"{what} factors", *products.factors)
        self.count(f"{what} pair count", len(products.pairs))
        for pair in products.pairs:
            self.count(f"{what} pairs", *pair)

    def _points(self, choices: Sequence[Choice | None]) -> None:
        for condition, choice in zip(self.layout.conditions, choices, strict=True):
            self._point(condition, choice, Fraction(0))

    def _point(self, condition: Condition, choice: Choice | None, time: Fraction) -> None:
        requirement = condition.requirement
        if condition.by_points and requirement.start <= time <= requirement.end:
            if choice is None:
                self.count("members", -1)
            self._choice(condition, choice)

    def _choice(self, condition: Condition, choice: Choice | None) -> None:
        if isinstance(choice, int):
            self.count("members", choice)
        elif choice is not None:
            self.rows("separating weights", choice)


@dataclass(frozen=True)
class Certificate:
    """A certificate as its header's JSON and its leaves, and the setting it is checked in."""

    header: dict[str, Any]
    leaves: tuple[Leaf, ...]
    setting: Setting

    @property
    def streams(self) -> list[Streams]:
        """Of every leaf."""
        return [(w.floats, w.integers) for w in map(self.writer, self.leaves)]

    def writer(self, leaf: Leaf) -> Writer:
        """Streams and labels of a leaf."""
        return Writer(self.setting.layout).leaf(leaf)


def reading_once(patch: pytest.MonkeyPatch) -> None:
    """Read the same policy and specification once: reading them thousands of times is most of the time otherwise."""
    for name in ("read_contract", "read_network"):
        patch.setattr(checker, name, lru_cache(maxsize=64)(getattr(checker, name)))


def opened(content: bytes, policy: bytes, specification: bytes) -> Certificate:
    """A certificate taken apart."""
    file = read_certificate(content)
    setting = checker.prepare(file.header, policy, specification, None)
    leaves = tuple(read_leaf(setting.layout, *file.streams(leaf)) for leaf in range(len(file.header.leaves)))
    return Certificate(header_of(content), leaves, setting)


def header_of(content: bytes) -> dict[str, Any]:
    """The header of a certificate as JSON."""
    (size,) = struct.unpack_from("<Q", content, len(MAGIC))
    header: dict[str, Any] = json.loads(content[len(MAGIC) + 8 : len(MAGIC) + 8 + size])
    return header


def sealed(header: dict[str, Any], streams: Sequence[Streams], **given: Any) -> bytes:
    """A file with these numbers, its lengths and digest computed anew; `given` replaces entries of the header."""
    payload = b"".join(struct.pack(f"<{len(floats)}d", *floats) for floats, _ in streams)
    payload += b"".join(struct.pack(f"<{len(integers)}i", *integers) for _, integers in streams)
    lengths = {
        "leaves": [[len(floats), len(integers)] for floats, integers in streams],
        "floats": sum(len(floats) for floats, _ in streams),
        "integers": sum(len(integers) for _, integers in streams),
        "payload": hashlib.sha256(payload).hexdigest(),
    }
    text = canonical({**header, **lengths, **given})
    return MAGIC + struct.pack("<Q", len(text)) + text + payload
