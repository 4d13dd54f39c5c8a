"""The JSON Schema and the reader agree: what one accepts, the other does."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import jsonschema
import pytest
import yaml
from command_line import EXAMPLE, QUICK

import setrl
from setrl.specs.errors import InputError, SpecificationError
from setrl.specs.reader import parse_specification, shipped_specifications
from setrl.specs.schema import KINDS, json_schema
from setrl.verify.certificate_schema import certificate_schema
from setrl.verify.checker.certificate import check
from setrl.verify.checker.certificate_file import MAGIC, canonical, read_certificate
from setrl.verify.options import Options

ROOM = Path(setrl.specs.__file__).parent
ALL = (*KINDS, "certificate")


def schema_of(kind: str) -> dict[str, Any]:
    return certificate_schema() if kind == "certificate" else json_schema(kind)


def validator(kind: str) -> jsonschema.Draft202012Validator:
    return jsonschema.Draft202012Validator(schema_of(kind))


@pytest.mark.parametrize("kind", ALL)
def test_schema_is_valid_and_self_contained(kind: str) -> None:
    schema = schema_of(kind)
    jsonschema.Draft202012Validator.check_schema(schema)
    assert schema["$id"] == f"urn:setrl:schema:{kind}:1"
    assert schema["title"] == f"setrl {kind}"
    assert json.loads(json.dumps(schema)) == schema


def objects(schema: Any) -> list[dict[str, Any]]:
    found = [schema] if isinstance(schema, dict) and schema.get("type") == "object" else []
    children = schema.values() if isinstance(schema, dict) else schema if isinstance(schema, list) else []
    return found + [inner for child in children for inner in objects(child)]


@pytest.mark.parametrize("kind", ALL)
def test_every_key_is_described_and_every_mapping_is_closed(kind: str) -> None:
    for entry in objects(schema_of(kind)):
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


SPLIT = """\
setrl: 1
plant: {states: {x: m}, inputs: {a: m}, dynamics: {x: a}}
controller: {period: 0.1, observe: [x, x**2]}
horizon: 0.1
initial: {x: [-1, 1]}
requirements: [{avoid: x > 4}]
"""


def certificate_of(folder: Path, text: str, epsilon: str | None = None, **options: Any) -> tuple[bytes, bytes]:
    """A real certificate and the specification it is about."""
    (folder / "spec.yaml").write_text(text)
    result = setrl.verify(EXAMPLE, folder / "spec.yaml", epsilon=epsilon, options=Options(**options))
    assert result.certificate is not None, result.reason
    return result.certificate, text.encode()


def header_of(content: bytes) -> dict[str, Any]:
    data = json.loads(content[len(MAGIC) + 8 : read_certificate(content).start])
    assert isinstance(data, dict)
    return data


@pytest.fixture(scope="module")
def certificate(tmp_path_factory: pytest.TempPathFactory) -> tuple[bytes, bytes]:
    return certificate_of(tmp_path_factory.mktemp("certificate"), QUICK)


@pytest.mark.parametrize(
    ("text", "epsilon", "options"),
    [
        (QUICK, None, {}),
        (QUICK, "0.005", {}),
        (QUICK, None, {"deployed": False}),
        (SPLIT, None, {}),
    ],
    ids=["both semantics", "another radius", "real only", "an inline plant"],
)
def test_the_header_of_a_real_certificate_is_valid(
    text: str, epsilon: str | None, options: dict[str, Any], tmp_path: Path
) -> None:
    content, _ = certificate_of(tmp_path, text, epsilon, **options)
    validator("certificate").validate(header_of(content))


HEADERS: dict[str, dict[str, Any]] = {
    "another key": {"time": 1.0},
    "another format": {"format": 3},
    "a version that is no text": {"setrl": 1},
    "a digest that is none": {"policy": "0"},
    "a digest of a plant that is none": {"plant": "none"},
    "a radius as a number": {"observation_radius": [0.1, 0.1]},
    "a radius as a decimal": {"observation_radius": ["0.01", "0.01"]},
    "no semantics": {"semantics": []},
    "deployed only": {"semantics": ["float32"]},
    "a runtime without an error": {"runtime": {"name": "onnxruntime"}},
    "another method": {"method": "euler"},
    "order 0": {"order": 0},
    "order 31": {"order": 31},
    "a requirement without a margin": {"requirements": [{"name": "altitude"}]},
    "a margin as text": {"requirements": [{"name": "altitude", "margin": "1"}]},
    "half a value": {"value": {"discounted": -1.0}},
    "no tree": {"tree": []},
    "a cut without a place": {"tree": [[0], None, None]},
    "a cut with a float": {"tree": [[0, 0.0], None, None]},
    "a cut of a name": {"tree": [["z", "0"], None, None]},
    "no leaves": {"leaves": []},
    "a leaf with one length": {"leaves": [[1]]},
    "a leaf with three lengths": {"leaves": [[1, 2, 3]]},
    "a negative length": {"floats": -1},
    "a length as a float": {"integers": 1.5},
    "a payload that is no digest": {"payload": "x"},
}


@pytest.mark.parametrize("case", HEADERS)
def test_a_header_that_is_not_valid_is_not_accepted_either(case: str, certificate: tuple[bytes, bytes]) -> None:
    content, specification = certificate
    start = read_certificate(content).start
    header = {**header_of(content), **HEADERS[case]}
    assert not validator("certificate").is_valid(header)
    text = canonical(header)
    changed = MAGIC + len(text).to_bytes(8, "little") + text + content[start:]
    try:
        answer = check(changed, EXAMPLE.read_bytes(), specification)
    except InputError:
        return
    assert isinstance(answer, str)


@pytest.mark.parametrize("key", certificate_schema()["required"])
def test_no_key_of_a_header_may_be_missing(key: str, certificate: tuple[bytes, bytes]) -> None:
    content, _ = certificate
    start = read_certificate(content).start
    header = header_of(content)
    del header[key]
    assert not validator("certificate").is_valid(header)
    text = canonical(header)
    with pytest.raises(InputError):
        read_certificate(MAGIC + len(text).to_bytes(8, "little") + text + content[start:])
