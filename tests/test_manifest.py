"""Certification manifests: what every key means, that every mistake has its line and remedy, and what a schema says."""

from __future__ import annotations

import hashlib
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

from setrl.specs.errors import SpecificationError
from setrl.specs.manifest import MEMORY, TIMEOUT, Entry, Search, parse_manifest, read_manifest
from setrl.specs.schema import json_schema

HEAD = "setrl: 1\ncertify:\n"
ROW = "policy: a.onnx, specification: b.yaml"


def entry(more: str = "", row: str = ROW) -> str:
    """A manifest of one entry, on line 3."""
    return f"{HEAD}  - {{{row}{', ' if more else ''}{more}}}\n"


def only(text: str) -> Entry:
    (found,) = parse_manifest(text).entries
    return found


def test_what_is_not_said_has_its_default() -> None:
    assert only(entry()) == Entry(
        ("a.onnx",), ("b.yaml",), (None,), None, (), None, None, None, TIMEOUT, MEMORY, None, {}, 3
    )
    assert (TIMEOUT, MEMORY) == (300, 4 * 2**30)


EVERYTHING = """\
setrl: 1
description: every key
defaults: {timeout: 60, memory: 1 GiB, allow_unknown: true, spread: 3, options: {splits: 9, method: jets}}
certify:
  - policy: [a.onnx, "policies/*.onnx"]
    specification: [b, c.yaml]
    epsilon: [0, 0.10]
    radius: {floor: 0.05, most: 2, resolution: 0.01}
    expect: [FALSIFIED, UNKNOWN]
    require: {value: -40.5, margin: 0.1}
    timeout: 0.5
    memory: 512 MiB
    allow_unknown: false
    spread: 1
    options: {splits: 7, taylor_order: 4, generators: 20}
  - {policy: a.onnx, specification: b}
"""


def test_every_key_is_read_and_entries_override_defaults() -> None:
    first, second = parse_manifest(EVERYTHING).entries
    assert first == Entry(
        ("a.onnx", "policies/*.onnx"),
        ("b", "c.yaml"),
        (F(0), F(1, 10)),
        Search(F(2), F(1, 100), F(1, 20)),
        ("FALSIFIED", "UNKNOWN"),
        F(-81, 2),
        F(1, 10),
        False,
        F(1, 2),
        512 * 2**20,
        1,
        {"method": "jets", "splits": 7, "taylor_order": 4, "generators": 20},
        5,
    )
    assert (second.timeout, second.memory, second.allow_unknown, second.spread) == (F(60), 2**30, True, 3)
    assert (second.options, second.line) == ({"splits": 9, "method": "jets"}, 16)


@pytest.mark.parametrize(
    ("text", "radii"),
    [
        ("0.1", (F(1, 10),)),
        ("0.10", (F(1, 10),)),
        ("0", (F(0),)),
        ("[0, 0.1]", (F(0), F(1, 10))),
        ("0:0.3:0.1", (F(0), F(1, 10), F(1, 5), F(3, 10))),
        ("'0,0.25'", (F(0), F(1, 4))),
        ("1e-3", (F(1, 1000),)),
    ],
)
def test_radii_are_exact_decimals_however_they_are_written(text: str, radii: tuple[F, ...]) -> None:
    assert only(entry(f"epsilon: {text}")).radii == radii


def test_a_search_alone_has_no_row_at_a_radius_and_beside_radii_is_one_row_more() -> None:
    alone, beside = only(entry("radius: {}")), only(entry("radius: {}, epsilon: 0.1"))
    assert (alone.radii, alone.search) == ((), Search(F(10), F(1, 1000)))
    assert (beside.radii, beside.search) == ((F(1, 10),), Search(F(10), F(1, 1000)))


@pytest.mark.parametrize(
    ("text", "size"),
    [
        ("64 MiB", 64 * 2**20),
        ("64MiB", 64 * 2**20),
        ("1.5 GiB", 3 * 2**29),
        ("65536 KiB", 2**26),
        ("70000 kB", 70_000_000),
        ("100 MB", 100_000_000),
        ("2 GB", 2_000_000_000),
    ],
)
def test_memory_is_an_amount_with_its_unit(text: str, size: int) -> None:
    assert only(entry(f"memory: {text}")).memory == size


def test_a_manifest_knows_its_bytes(tmp_path: Path) -> None:
    path = tmp_path / "fleet.yaml"
    path.write_text(entry())
    manifest = read_manifest(path)
    assert (manifest.source, manifest.digest) == (str(path), hashlib.sha256(entry().encode()).hexdigest())


WRONG: dict[str, tuple[str, int, str]] = {
    "an empty file": ("", 1, "empty"),
    "a list": ("- 1\n", 1, "mapping"),
    "no entries": ("setrl: 1\n", 1, "'certify' is missing"),
    "an empty list of entries": ("setrl: 1\ncertify: []\n", 2, "at least one"),
    "entries that are nothing": ("setrl: 1\ncertify:\n", 2, "no value"),
    "one entry without a list": ("setrl: 1\ncertify: {policy: a, specification: b}\n", 2, "expected a list"),
    "an entry that is text": ("setrl: 1\ncertify: [a.onnx]\n", 2, "mapping"),
    "another version": (entry().replace("setrl: 1", "setrl: 2"), 1, "version"),
    "no version": ("certify:\n  - {policy: a, specification: b}\n", 1, "'setrl' is missing"),
    "an unknown key at the top": (entry() + "certifi: 1\n", 4, "certifi"),
    "an unknown key of an entry": (entry("timout: 3"), 3, "did you mean timeout"),
    "an unknown option": (entry("options: {split: 3}"), 3, "did you mean splits"),
    "an unknown key of a floor": (entry("require: {values: 3}"), 3, "values"),
    "an unknown key of a search": (entry("radius: {least: 0}"), 3, "least"),
    "an unknown default": (f"setrl: 1\ndefaults: {{expect: FALSIFIED}}\n{entry()[9:]}", 2, "expect"),
    "a duplicate key": (entry("policy: c.onnx"), 3, "a second time"),
    "an anchor and its alias": (entry("options: &o {splits: 3}") + "  - {options: *o}\n", 3, "anchor"),
    "a tag": (entry("memory: !!str 1 GiB"), 3, "tag"),
    "no policy": (entry(row="specification: b.yaml"), 3, "'policy' is missing"),
    "no specification": (entry(row="policy: a.onnx"), 3, "'specification' is missing"),
    "an empty list of policies": (entry(row="policy: [], specification: b"), 3, "at least one"),
    "a policy that is blank": (entry(row="policy: ' ', specification: b"), 3, "expected text"),
    "a policy that is a mapping": (entry(row="policy: {a: b}, specification: b"), 3, "a path, a glob or a list"),
    "a list in a list": (entry(row="policy: [[a]], specification: b"), 3, "expected text"),
    "a negative radius": (entry("epsilon: -0.1"), 3, "not negative"),
    "a negative radius in a list": (entry("epsilon: [0, -0.1]"), 3, "not negative"),
    "a negative range": (entry("epsilon: -1:0:1"), 3, "not negative"),
    "the same radius twice": (entry("epsilon: [0.1, 0.10]"), 3, "twice"),
    "no radius": (entry("epsilon: []"), 3, "at least one radius"),
    "a radius that is no number": (entry("epsilon: .nan"), 3, "every number is finite"),
    "a radius in quotes in a list": (entry("epsilon: ['0.1']"), 3, "remove the quotes"),
    "half a range": (entry("epsilon: 0:1"), 3, "first:last:step"),
    "a range that never ends": (entry("epsilon: 0:1:0"), 3, "positive step"),
    "a range of too many": (entry("epsilon: 0:1:0.0001"), 3, "at most 1000"),
    "a radius with an enormous exponent": (entry("epsilon: 1e999999999"), 3, "exponent"),
    "an unknown verdict": (entry("expect: FAILED"), 3, "write one of VERIFIED, FALSIFIED, UNKNOWN"),
    "a verdict in lower case": (entry("expect: [falsified]"), 3, "expected a verdict"),
    "no expected verdict": (entry("expect: []"), 3, "at least one"),
    "expect without a row": (entry("radius: {}, expect: FALSIFIED"), 3, "certify.0.expect: expect and require"),
    "require without a row": (entry("radius: {}, require: {value: 1}"), 3, "certify.0.require: expect and require"),
    "a floor about nothing": (entry("require: {}"), 3, "value, margin or both"),
    "a floor that is infinite": (entry("require: {value: -.inf}"), 3, "finite"),
    "a negative radius as floor": (entry("radius: {floor: -1}"), 3, "not negative"),
    "a floor above all radii": (entry("radius: {floor: 3, most: 2}"), 3, "radius.floor: larger than the largest"),
    "a search up to zero": (entry("radius: {most: 0}"), 3, "greater than 0"),
    "a search without end": (entry("radius: {most: 1e300}"), 3, "to 1000000000"),
    "a resolution of zero": (entry("radius: {resolution: 0}"), 3, "greater than 0"),
    "a resolution without end": (entry("radius: {resolution: 1e-300}"), 3, "from 0.000000001"),
    "a search that is true": (entry("radius: true"), 3, "mapping"),
    "no time": (entry("timeout: 0"), 3, "greater than 0"),
    "less than no time": (entry("timeout: -1"), 3, "greater than 0"),
    "time that no float holds": (entry(f"timeout: {'9' * 90}e300"), 3, "from 0.001 to 100000000"),
    "time that is no float but zero": (entry("timeout: 1e-300"), 3, "from 0.001"),
    "memory without a unit": (entry("memory: 4"), 3, "2 GiB"),
    "memory with a unit that is none": (entry("memory: 4 GiBytes"), 3, "2 GiB"),
    "memory in lower case": (entry("memory: 4 gb"), 3, "2 GiB"),
    "negative memory": (entry("memory: -4 GiB"), 3, "2 GiB"),
    "memory with an exponent": (entry("memory: 1e3 MiB"), 3, "2 GiB"),
    "too little memory": (entry("memory: 63 MiB"), 3, "at least 64 MiB"),
    "memory in digits of another script": (entry("memory: ٤ GiB"), 3, "2 GiB"),
    "a flag in quotes": (entry("allow_unknown: 'true'"), 3, "true or false"),
    "a flag that YAML once knew": (entry("allow_unknown: yes"), 3, "true or false"),
    "no parts": (entry("spread: 0"), 3, "from 1 to 1024"),
    "half a part": (entry("spread: 1.5"), 3, "from 1 to 1024"),
    "too many parts": (entry("spread: 1025"), 3, "from 1 to 1024"),
    "an order of one": (entry("options: {taylor_order: 1}"), 3, "from 2 to 30"),
    "no cells": (entry("options: {splits: 0}"), 3, "from 1 to 10000000"),
    "another method": (entry("options: {method: euler}"), 3, "linearization"),
    "another enclosure": (entry("options: {enclosure: box}"), 3, "crown"),
    "options that are nothing": (entry("options: "), 3, "no value"),
    "a default that is wrong": (f"setrl: 1\ndefaults: {{timeout: 0}}\n{entry()[9:]}", 2, "defaults.timeout"),
    "defaults that are nothing": (f"setrl: 1\ndefaults:\n{entry()[9:]}", 2, "no value"),
    "the second entry": (entry() + "  - {policy: a, specification: b, spread: x}\n", 4, "certify.1.spread"),
}


@pytest.mark.parametrize("name", WRONG)
def test_every_mistake_has_its_line_and_a_remedy(name: str) -> None:
    text, line, words = WRONG[name]
    with pytest.raises(SpecificationError) as caught:
        parse_manifest(text, "fleet.yaml")
    error = caught.value
    assert error.where == f"fleet.yaml:{line}"
    assert error.remedy
    assert words in str(error)
    assert "\n" not in str(error)


def test_a_manifest_that_cannot_be_read_is_an_error_with_its_path(tmp_path: Path) -> None:
    for path in (tmp_path, tmp_path / "gone.yaml"):
        with pytest.raises(SpecificationError, match="cannot read the file") as caught:
            read_manifest(path)
        assert caught.value.where == str(path)


RIGHT = {
    "the least": entry(),
    "every key": EVERYTHING,
    "a glob": entry(row="policy: '*.onnx', specification: [b, 'specs/**/*.yaml']"),
    "a range": entry("epsilon: '0:0.5:0.1'"),
    "a list of radii": entry("epsilon: [0, 0.1, 1]"),
    "a text of radii": entry("epsilon: '0, 0.1'"),
    "a search": entry("radius: {}"),
    "a floor as large as the largest": entry("radius: {floor: 10}"),
    "one verdict": entry("expect: UNKNOWN"),
    "a small amount of memory": entry("memory: 64 MiB"),
    "an amount of memory without a space": entry("memory: 0.5GB"),
    "empty defaults": f"setrl: 1\ndefaults: {{}}\n{entry()[9:]}",
    "the shortest time": entry("timeout: 0.001"),
    "the longest time": entry("timeout: 100000000"),
}
BEYOND_A_SCHEMA = {
    # YAML's own traps, which are gone when the text has become data
    *("a duplicate key", "an anchor and its alias", "a tag", "a flag that YAML once knew"),
    "a radius with an enormous exponent",
    # relations of numbers and texts
    *("half a range", "a range that never ends", "a range of too many", "a negative range", "a floor above all radii"),
    *("too little memory", "a policy that is blank", "a floor about nothing"),
    *("expect without a row", "require without a row"),
    # JSON has neither infinities nor NaN
    *("a floor that is infinite", "a radius that is no number", "time that no float holds"),
}


@pytest.fixture(scope="module")
def validator() -> Any:
    schema = json_schema("certification")
    jsonschema.Draft202012Validator.check_schema(schema)
    return jsonschema.Draft202012Validator(schema)


@pytest.mark.parametrize("name", RIGHT)
def test_the_schema_accepts_what_the_reader_accepts(name: str, validator: Any) -> None:
    parse_manifest(RIGHT[name])
    validator.validate(yaml.safe_load(RIGHT[name]))


def test_what_is_called_beyond_a_schema_is_a_mistake() -> None:
    assert set(WRONG) > BEYOND_A_SCHEMA


@pytest.mark.parametrize("name", sorted(set(WRONG) - BEYOND_A_SCHEMA))
def test_the_schema_refuses_what_the_reader_refuses_where_a_schema_can(name: str, validator: Any) -> None:
    assert not validator.is_valid(yaml.safe_load(WRONG[name][0]))
