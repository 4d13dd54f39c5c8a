"""The shape of a plant file, and the base of all documents: the one source of validation and of the JSON Schema."""

from __future__ import annotations

from typing import Annotated, Any, TypeAlias

from pydantic import BaseModel, ConfigDict, Field, Tag, model_validator

from .exact import shown
from .expression_parser import suggestion
from .fields import Constant, DynamicsKey, ExpressionText, Identifier, Label, Text, Unit, by_kind, found, problem

AtLeastOne = Field(min_length=1)
NO_ENTRIES: Any = Field(default_factory=dict)


class Document(BaseModel):
    """A mapping with a fixed set of keys; anything else is an error that lists them."""

    model_config = ConfigDict(extra="forbid", frozen=True, arbitrary_types_allowed=True, use_attribute_docstrings=True)

    @model_validator(mode="before")
    @classmethod
    def _known_keys(cls, value: Any) -> Any:
        if not isinstance(value, dict):
            keys = ", ".join(cls.model_fields)
            raise problem(f"expected a mapping, found {found(value)}", f"write key: value lines; keys: {keys}")
        for key, entry in value.items():
            if key not in cls.model_fields:
                raise problem(f"unknown key {shown(key)}", suggestion(key, cls.model_fields), key)
            if entry is None:
                raise problem("the key has no value", "give it a value, or remove it", key)
        return value


class PlantParameter(Document):
    """A parameter with its unit."""

    value: Constant
    """A number, or a constant expression such as 1/3; exact."""
    unit: Unit = ""
    """Documentation."""


Parameter: TypeAlias = Annotated[
    Annotated[Constant, Tag("<text>")] | Annotated[PlantParameter, Tag("<mapping>")],
    by_kind("a number or {value, unit}", "write for example 0.05 or {value: 0.05, unit: kg}"),
]


class PlantDocument(Document):
    """The controlled system: names with their units, and one expression per state."""

    name: Label | None = None
    """Name in messages; the file's name where it is left out."""
    description: Text | None = None
    """What the plant is and where its equations come from."""
    states: Annotated[dict[Identifier, Unit], AtLeastOne]
    """Unit of every state, in order."""
    inputs: Annotated[dict[Identifier, Unit], AtLeastOne]
    """Unit of every input, in order; the action of the policy."""
    disturbances: dict[Identifier, Unit] = NO_ENTRIES
    """Unit of every disturbance, in order."""
    parameters: dict[Identifier, Parameter] = NO_ENTRIES
    """Constants of the dynamics."""
    dynamics: Annotated[dict[DynamicsKey, ExpressionText], AtLeastOne]
    """Time derivative of every state; with keys written 'x+', the next state of a discrete-time plant."""
