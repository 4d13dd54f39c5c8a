"""The JSON Schema of the files, for editors and for programs that write them."""

from __future__ import annotations

from typing import Any

from pydantic.json_schema import GenerateJsonSchema
from pydantic_core import core_schema

from .documents import SpecificationDocument
from .manifest_document import ManifestDocument
from .plant_document import Document, PlantDocument

KINDS: dict[str, tuple[type[Document], str]] = {
    "specification": (SpecificationDocument, "setrl specification"),
    "plant": (PlantDocument, "setrl plant"),
    "certification": (ManifestDocument, "setrl certification"),
}


class _Generator(GenerateJsonSchema):
    """Leaves defaults to the descriptions (they are exact numbers, which JSON has not) and closes every mapping.

    A key that may be left out is still not null where it stands.
    """

    def default_schema(self, schema: core_schema.WithDefaultSchema) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def nullable_schema(self, schema: core_schema.NullableSchema) -> dict[str, Any]:
        return self.generate_inner(schema["schema"])

    def dict_schema(self, schema: core_schema.DictSchema) -> dict[str, Any]:
        result = super().dict_schema(schema)
        if "patternProperties" in result:
            result["additionalProperties"] = False
        return result


def json_schema(kind: str) -> dict[str, Any]:
    """JSON Schema (draft 2020-12) of a kind of file.

    Parameters
    ----------
    kind : {"specification", "plant", "certification"}

    Returns
    -------
    dict
        With ``$schema``, ``$id``, ``title`` and a description for every key. It states the shape; what relates several
        keys (whole periods, windows within the horizon, names of states) is checked when a file is read.
    """
    model, title = KINDS[kind]
    body = model.model_json_schema(schema_generator=_Generator)
    body["title"] = title
    return {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": f"urn:setrl:schema:{kind}:1",
        **body,
    }
