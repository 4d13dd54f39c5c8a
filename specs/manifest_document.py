"""The shape of a certification manifest: the one source of its validation and of its JSON Schema."""

from __future__ import annotations

import re
from fractions import Fraction
from typing import Annotated, Literal, TypeAlias

from pydantic import PlainValidator, Tag, WithJsonSchema, model_validator

from .errors import InputError
from .exact import decimal_range, decimal_text
from .fields import ExactNumber, Flag, NonNegative, Text, Version, by_kind, found, number, problem
from .plant_document import AtLeastOne, Document

VERDICTS = ("VERIFIED", "FALSIFIED", "UNKNOWN")
_UNITS = {"KiB": 1 << 10, "MiB": 1 << 20, "GiB": 1 << 30, "kB": 10**3, "MB": 10**6, "GB": 10**9}
LEAST_MEMORY = 1 << 26
MOST_RADII = 1000
LEAST_SECONDS, MOST_SECONDS = Fraction(1, 1000), 10**8
LEAST_RADIUS, MOST_RADIUS = Fraction(1, 10**9), 10**9
"""A search doubles radii, and halves what is between two: it has to end."""


def _verdict(value: object) -> str:
    if value not in VERDICTS:
        raise problem(f"expected a verdict, found {found(value)}", f"write one of {', '.join(VERDICTS)}")
    return str(value)


def _memory(value: object) -> int:
    if not isinstance(value, str) or not re.fullmatch(_MEMORY, value):
        raise problem(f"expected an amount of memory, found {found(value)}", "write for example 2 GiB or 500 MiB")
    amount = value.rstrip("kKMGiB ")
    size = int(Fraction(amount) * _UNITS[value[len(amount) :].strip()])
    if size < LEAST_MEMORY:
        raise problem(f"expected at least 64 MiB of memory, found {found(value)}", "Python alone needs that")
    return size


def _positive(least: Fraction, most: int) -> PlainValidator:
    """A positive number that a float can hold and a search can end with."""

    def read(value: object) -> Fraction:
        result = number(value)
        if result <= 0:
            raise problem(f"expected a number greater than 0, found {found(value)}", "make it positive")
        if not least <= result <= most:
            raise problem(f"expected from {decimal_text(least)} to {most}, found {found(value)}", "change it")
        return result

    return PlainValidator(read)


def _count(least: int, most: int) -> PlainValidator:
    def read(value: object) -> int:
        result = number(value)
        if result.denominator != 1 or not least <= result <= most:
            raise problem(
                f"expected a whole number from {least} to {most}, found {found(value)}", "change it, or leave it out"
            )
        return int(result)

    return PlainValidator(read)


def _radii(value: object) -> tuple[Fraction, ...]:
    """One radius, a list of radii, or ``first:last:step``."""
    try:
        if isinstance(value, list):
            if not value:
                raise problem("expected at least one radius, found an empty list", "add one, or remove the key")
            radii = tuple(number(item) for item in value)
            if min(radii) < 0:
                raise problem("expected radii that are not negative", "remove the minus sign")
        elif isinstance(value, str):
            radii = decimal_range(value)
        else:
            raise problem(f"expected radii, found {found(value)}", "write 0.1, [0, 0.1] or 0:0.5:0.1")
    except InputError as error:
        raise problem(error.message, error.remedy or "") from None
    if len(set(radii)) < len(radii) or len(radii) > MOST_RADII:
        raise problem("a radius appears twice, or there are more than 1000", "keep one of each")
    return radii


def _one_of(*words: str) -> PlainValidator:
    shown = f"{', '.join(map(repr, words[:-1]))} or {words[-1]!r}"

    def read(value: object) -> str:
        if value not in words:
            raise problem(f"expected {shown}, found {found(value)}", "write one of them")
        return str(value)

    return PlainValidator(read)


_MEMORY = rf"[0-9]{{1,9}}(\.[0-9]{{1,6}})? ?({'|'.join(_UNITS)})"
_NUMBER_NOT_NEGATIVE = {"type": "number", "minimum": 0}

Memory = Annotated[int, PlainValidator(_memory), WithJsonSchema({"type": "string", "pattern": f"^{_MEMORY}$"})]
Seconds = Annotated[
    Fraction,
    _positive(LEAST_SECONDS, MOST_SECONDS),
    WithJsonSchema({"type": "number", "minimum": float(LEAST_SECONDS), "maximum": MOST_SECONDS}),
]
SearchedRadius = Annotated[
    Fraction,
    _positive(LEAST_RADIUS, MOST_RADIUS),
    WithJsonSchema({"type": "number", "minimum": float(LEAST_RADIUS), "maximum": MOST_RADIUS}),
]
Verdict = Annotated[str, PlainValidator(_verdict), WithJsonSchema({"enum": list(VERDICTS)})]
Radii = Annotated[
    tuple[Fraction, ...],
    PlainValidator(_radii),
    WithJsonSchema(
        {
            "anyOf": [
                _NUMBER_NOT_NEGATIVE,
                {"type": "string", "pattern": "^[0-9eE+.,: -]+$"},
                {
                    "type": "array",
                    "items": _NUMBER_NOT_NEGATIVE,
                    "minItems": 1,
                    "maxItems": MOST_RADII,
                    "uniqueItems": True,
                },
            ]
        }
    ),
]
Method = Annotated[
    Literal["jets", "linearization"],
    _one_of("jets", "linearization"),
    WithJsonSchema({"enum": ["jets", "linearization"]}),
]
Enclosure = Annotated[
    Literal["zonotope", "crown", "best"],
    _one_of("zonotope", "crown", "best"),
    WithJsonSchema({"enum": ["zonotope", "crown", "best"]}),
]
Splits = Annotated[int, _count(1, 10**7), WithJsonSchema({"type": "integer", "minimum": 1, "maximum": 10**7})]
Order = Annotated[int, _count(2, 30), WithJsonSchema({"type": "integer", "minimum": 2, "maximum": 30})]
Generators = Annotated[int, _count(2, 1000), WithJsonSchema({"type": "integer", "minimum": 2, "maximum": 1000})]
Parts = Annotated[int, _count(1, 1024), WithJsonSchema({"type": "integer", "minimum": 1, "maximum": 1024})]

Patterns: TypeAlias = Annotated[
    Annotated[Text, Tag("<text>")] | Annotated[list[Text], AtLeastOne, Tag("<list>")],
    by_kind("a path, a glob or a list of those", "write for example policies/*.onnx"),
]
Verdicts: TypeAlias = Annotated[
    Annotated[Verdict, Tag("<text>")] | Annotated[list[Verdict], AtLeastOne, Tag("<list>")],
    by_kind("a verdict or a list of verdicts", "write for example FALSIFIED or [VERIFIED, UNKNOWN]"),
]


class OptionsDocument(Document):
    """Numerical options; they are not needed for a right verdict, only for a faster or a tighter one."""

    method: Method | None = None
    """Flow enclosure."""
    enclosure: Enclosure | None = None
    """Policy enclosure."""
    taylor_order: Order | None = None
    """Time order of the flow enclosure."""
    generators: Generators | None = None
    """Generators kept per state dimension."""
    splits: Splits | None = None
    """Most cells of the initial set; 1 is no splitting."""


class SettingsDocument(Document):
    """What an entry may say, and `defaults` for all of them."""

    timeout: Seconds | None = None
    """Seconds a row may take; 300 where nothing is said."""
    memory: Memory | None = None
    """Memory a row's process may use, with its unit; 4 GiB where nothing is said."""
    allow_unknown: Flag | None = None
    """Whether UNKNOWN passes the gate; as the specification says where nothing is said here."""
    options: OptionsDocument | None = None
    """Numerical options."""
    spread: Parts | None = None
    """A row that is not decided by its first cells is cut into so many parts, which run side by side; 1 is none."""


class FloorDocument(Document):
    """What has to be proved beyond the requirements."""

    value: ExactNumber | None = None
    """V(s0), discounted as the specification says, is proved to be at least this."""
    margin: ExactNumber | None = None
    """Every requirement's margin is proved to be at least this."""

    @model_validator(mode="after")
    def _states_something(self) -> FloorDocument:
        if self.value is None and self.margin is None:
            raise problem("nothing is required", "write value, margin or both, or remove the key")
        return self


class RadiusDocument(Document):
    """Search the certified radius: the largest perturbation radius that is VERIFIED."""

    floor: NonNegative | None = None
    """The row fails where the certified radius is smaller."""
    most: SearchedRadius = Fraction(10)
    """Larger radii are not tried."""
    resolution: SearchedRadius = Fraction(1, 1000)
    """The search ends when two radii that are known are this close."""

    @model_validator(mode="after")
    def _reachable(self) -> RadiusDocument:
        if self.floor is not None and self.floor > self.most:
            raise problem("larger than the largest radius that is tried", "raise most, or lower the floor", "floor")
        return self


class EntryDocument(SettingsDocument):
    """Policies times specifications, times radii."""

    policy: Patterns
    """ONNX files: paths or globs, relative to the manifest."""
    specification: Patterns
    """Specifications: paths or globs relative to the manifest, or names of shipped ones."""
    epsilon: Radii | None = None
    """Perturbation radii instead of the specification's own; one row each."""
    radius: RadiusDocument | None = None
    """One row more, which searches the certified radius."""
    expect: Verdicts | None = None
    """Verdicts that pass the gate instead of VERIFIED; a policy that is known to fail is FALSIFIED as expected."""
    require: FloorDocument | None = None
    """Floors that have to be proved too."""

    @model_validator(mode="after")
    def _consistent(self) -> EntryDocument:
        if self.radius is not None and self.epsilon is None and (self.expect or self.require):
            raise problem(
                "expect and require are about rows at a radius, of which there are none",
                "write a floor into radius, or give epsilon too",
                "expect" if self.expect else "require",
            )
        return self


class ManifestDocument(Document):
    """A table of policies and specifications, and what has to hold for its rows."""

    setrl: Version
    """Version of this language."""
    description: Text | None = None
    """What the table is about."""
    defaults: SettingsDocument = SettingsDocument.model_construct()
    """For all entries that do not say otherwise."""
    certify: Annotated[list[EntryDocument], AtLeastOne]
    """The table's entries."""
