"""The JSON Schema and the reader are one source: what one accepts, the other does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml

import setrl.specs
from setrl.specs.errors import SpecificationError
from setrl.specs.reader import parse_specification, shipped_specifications
from setrl.specs.schema import KINDS, json_schema

ROOM = Path(setrl.specs.__file__).parent


def validator(kind: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(json_schema(kind))


@pytest.mark.parametrize("kind", KINDS)
def test_schema_is_valid_and_self_contained(kind: str) -> None:
    schema = json_schema(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$id"] == f"urn:setrl:schema:{kind}:1"
    assert schema["title"] == f"setrl {kind}"
    assert json.loads(json.dumps(schema)) == schema


def objects(schema: Any) -> list[dict[str, Any]]:
    found = [schema] if isinstance(schema, dict) and schema.get("type") == "object" else []
    children = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else []
    return found + [inner for child in children for inner in objects(child)]


@pytest.mark.parametrize("kind", KINDS)
def test_every_key_is_described_and_every_mapping_is_closed(kind: str) -> None:
    for entry in objects(json_schema(kind)):
        assert entry["additionalProperties"] is not True
        for key, value in entry.get("properties", {}).items():
            assert value.get("description"), key


@pytest.mark.parametrize("name", shipped_specifications())
def test_shipped_specification_is_valid(name: str) -> None:
    validator("specification").validate(yaml.safe_load((ROOM / f"{name}.yaml").read_text()))


@pytest.mark.parametrize("path", sorted((ROOM.parent / "models" / "plants").glob("*.yaml")), ids=lambda path: path.stem)
def test_shipped_plant_is_valid(path: Path) -> None:
    validator("plant").validate(yaml.safe_load(path.read_text()))


HEAD = "setrl: 1\nplant: p\ncontroller: {period: 0.5}\nhorizon: 1\ninitial: {x: 0}\n"
REWARD = "reward: {weights: {x: 1}}\n"


@pytest.mark.parametrize(
    ("text", "accepted"),
    [
        (HEAD + REWARD, True),
        (HEAD, False),
        (HEAD + REWARD + "typo: 1\n", False),
        (HEAD + REWARD + "requirements: []\n", False),
        (HEAD + "requirements: [{avoid: x > 1}]\n", True),
        (HEAD + "requirements: [{avoid: x > 1, stay: x < 1}]\n", False),
        (HEAD + "requirements: [{avoid: x > 1, at: 1, during: [0, 1]}]\n", False),
        (HEAD + "requirements: [{avoid: {x: [1, null]}}]\n", True),
        (HEAD + "requirements: [{avoid: {x: 1}}]\n", False),
        (HEAD + "requirements: [{avoid: {union: [x > 1, [x > 1, {y: [1, 2]}]]}}]\n", True),
        (HEAD + REWARD + "perturbation: {observation: {x: 0.1}, disturbance: {w: {range: 1, varies: never}}}\n", True),
        (HEAD + REWARD + "perturbation: {observation: -1}\n", False),
        (HEAD + REWARD + "perturbation: {disturbance: {w: {range: 1, varies: daily}}}\n", False),
        (HEAD + REWARD + "allow_unknown: true\n", True),
        (HEAD + REWARD + "allow_unknown: 'true'\n", False),
        (HEAD.replace("setrl: 1", "setrl: 2") + REWARD, False),
        (HEAD.replace("x: 0", "x: '0'") + REWARD, False),
        (HEAD.replace("x: 0", "2x: 0") + REWARD, False),
        (HEAD.replace("x: 0", "x: [0, 1]") + REWARD, True),
        (HEAD.replace("0.5}", "0.5, clip: [-1, 1], delay: 1, before: {scale: [1, 2]}}") + REWARD, True),
        (HEAD.replace("0.5}", "0.5, clip: {a: [-1, 1]}, delay: {periods: 1, action: {a: 0}}}") + REWARD, True),
        (HEAD.replace("0.5}", "0.5, observe: [x, sin(x)], after: {matrix: [[1]]}}") + REWARD, True),
        (HEAD.replace("plant: p", "plant: {states: {x: m}, inputs: {a: }, dynamics: {x: a}}") + REWARD, True),
        (HEAD.replace("plant: p", "plant: {states: {x: m}, dynamics: {x: 0}}") + REWARD, False),
    ],
)
def test_schema_and_reader_agree(text: str, accepted: bool) -> None:
    assert validator("specification").is_valid(yaml.safe_load(text)) is accepted
    try:
        parse_specification(text)
    except SpecificationError:
        assert not accepted
    else:
        assert accepted
