"""`setrl schema`."""

from __future__ import annotations

from enum import StrEnum
from typing import Annotated

import typer

from .exit_codes import OK
from .output import print_json


class Kind(StrEnum):
    """Files that have a schema."""

    specification = "specification"
    plant = "plant"
    certificate = "certificate"
    certification = "certification"


def schema(
    kind: Annotated[Kind, typer.Argument(help="Kind of file.")] = Kind.specification,
) -> int:
    """Print the JSON Schema of specifications, of plants, certificates' headers or certification manifests."""
    if kind is Kind.certificate:
        from ..verify.certificate_schema import certificate_schema

        print_json(certificate_schema())
        return OK
    from ..specs.schema import json_schema

    print_json(json_schema(kind.value))
    return OK
