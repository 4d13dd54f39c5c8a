"""JSON Schema of a certificate's header; the streams behind it have a grammar, which docs/certificate.md states.

Written by hand, and not derived from the checker's reader, which has to stay readable without it; a test holds the two
together.
"""

from __future__ import annotations

from typing import Any

RATIONAL = "^-?[0-9]{1,1200}(/[1-9][0-9]{0,1200})?$"
SHA256 = "^[0-9a-f]{64}$"


def certificate_schema() -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of the header of a certificate, the same for both versions of the format.

    Returns
    -------
    dict
        It states the shape; what relates several keys (lengths that add up, a tree that is whole) is checked when a
        certificate is read.
    """
    margin = {"type": "number", "description": "Lower bound that is claimed, in the requirement's unit; a float64."}
    properties = {
        "format": {"enum": [1, 2], "description": "Version of the format."},
        "setrl": {"type": "string", "description": "Version of the program that wrote the certificate."},
        "policy": _digest("sha256 of the ONNX file's bytes."),
        "specification": _digest("sha256 of the specification's bytes."),
        "plant": {
            "type": "string",
            "pattern": "^([0-9a-f]{64})?$",
            "description": "sha256 of the plant file's bytes; empty where the specification contains its plant.",
        },
        "observation_radius": _or_null(
            {"type": "array", "items": _rational("Radius of one component.")},
            "Radius of every component of the observation, where it is not the specification's.",
        ),
        "semantics": {
            "enum": [["real"], ["real", "float32"], ["real", "float64"]],
            "description": "Arithmetics of the network that are covered: exact, and that of the deployed network.",
        },
        "runtime": _or_null(
            _object(
                {
                    "name": {"type": "string", "description": "Name and version."},
                    "error": _rational("Error of its own tanh and sigmoid that the claim assumes."),
                }
            ),
            "Runtime of the deployed network; null where only exact arithmetic is covered.",
        ),
        "method": {"enum": ["jets", "linearization"], "description": "Flow enclosure."},
        "order": {"type": "integer", "minimum": 1, "maximum": 30, "description": "Order of the expansions in time."},
        "requirements": {
            "type": "array",
            "items": _object({"name": {"type": "string", "description": "As in the specification."}, "margin": margin}),
            "description": "All requirements, in the order of the specification.",
        },
        "value": _or_null(
            _object(
                {
                    "discounted": {"type": "number", "description": "With the specification's discount; a float64."},
                    "undiscounted": {"type": "number", "description": "With discount 1; a float64."},
                }
            ),
            "Lower bounds of every return; null without a reward.",
        ),
        "tree": {
            "type": "array",
            "minItems": 1,
            "items": {
                "anyOf": [
                    {"type": "null"},
                    {
                        "type": "array",
                        "prefixItems": [{"type": "integer", "minimum": 0}, _rational("Where the box is cut.")],
                        "items": False,
                        "minItems": 2,
                    },
                ]
            },
            "description": "The cover in preorder: [state, cut], then its lower and its upper half; null is a leaf.",
        },
        "leaves": {
            "type": "array",
            "minItems": 1,
            "items": {
                "type": "array",
                "prefixItems": [_count("Floats."), _count("Whole numbers.")],
                "items": False,
                "minItems": 2,
            },
            "description": "How many floats and whole numbers each leaf has, in the order of the tree.",
        },
        "floats": _count("Length of the stream of float64 numbers."),
        "integers": _count("Length of the stream of int32 numbers."),
        "payload": _digest("sha256 of both streams' bytes."),
    }
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": "urn:setrl:schema:certificate:1",
        "title": "setrl certificate",
        "description": "Header of a certificate.",
        **_object(properties),
    }


def _object(properties: dict[str, Any]) -> dict[str, Any]:
    """A mapping of exactly these keys."""
    return {
        "type": "object",
        "properties": properties,
        "required": sorted(properties),
        "additionalProperties": False,
    }


def _or_null(schema: dict[str, Any], description: str) -> dict[str, Any]:
    return {"anyOf": [schema, {"type": "null"}], "description": description}


def _digest(description: str) -> dict[str, Any]:
    return {"type": "string", "pattern": SHA256, "description": description}


def _rational(description: str) -> dict[str, Any]:
    return {"type": "string", "pattern": RATIONAL, "description": f"{description} An exact rational such as -3/8."}


def _count(description: str) -> dict[str, Any]:
    return {"type": "integer", "minimum": 0, "description": description}
