"""The shape of a specification file: the one source of its validation and of its JSON Schema.

What needs more than one key (multiples of the period, windows, unique names) is checked in `builder`.
"""

from __future__ import annotations

from fractions import Fraction
from typing import Annotated, Literal, TypeAlias

from pydantic import ConfigDict, PlainValidator, Tag, WithJsonSchema, model_validator

from .fields import (
    Closed,
    Comparison,
    Components,
    Discount,
    ExactNumber,
    ExpressionText,
    Flag,
    Identifier,
    Interval,
    Label,
    NonNegative,
    OpenInterval,
    Positive,
    Symmetric,
    Text,
    Version,
    Whole,
    by_kind,
    found,
    problem,
)
from .plant_document import NO_ENTRIES, AtLeastOne, Document, PlantDocument


def _varies(value: object) -> str:
    if value not in ("never", "every period"):
        raise problem(f"expected 'never' or 'every period', found {found(value)}", "write one of the two")
    return str(value)


Varies = Annotated[
    Literal["never", "every period"], PlainValidator(_varies), WithJsonSchema({"enum": ["never", "every period"]})
]


class AffineDocument(Document):
    """y = matrix @ x + offset, or y = scale * x + offset."""

    scale: Components | None = None
    """One number for all components, or one per component; excludes matrix."""
    offset: Components = Fraction(0)
    """One number for all components, or one per component."""
    matrix: Annotated[list[Annotated[list[ExactNumber], AtLeastOne]], AtLeastOne] | None = None
    """One row per component of the result."""

    @model_validator(mode="after")
    def _consistent(self) -> AffineDocument:
        if self.scale is not None and self.matrix is not None:
            raise problem("scale and matrix exclude each other", "write the scale into the matrix's diagonal")
        rows = len(self.scale) if isinstance(self.scale, tuple) else None
        if self.matrix is not None:
            rows = len(self.matrix)
            widths = {len(row) for row in self.matrix}
            if len(widths) > 1:
                raise problem("the rows of the matrix differ in length", "give every row as many numbers", "matrix")
        if rows is not None and isinstance(self.offset, tuple) and len(self.offset) != rows:
            message = f"offset has {len(self.offset)} components, the map has {rows}"
            raise problem(message, "make them equal, or write one number", "offset")
        return self


class DelayDocument(Document):
    """A delayed action."""

    periods: Whole
    """Whole periods between an observation and the action computed from it."""
    action: dict[Identifier, ExactNumber] = NO_ENTRIES
    """What acts until the first computed action does; inputs that are not named get 0."""


Delay: TypeAlias = Annotated[
    Annotated[Whole, Tag("<text>")] | Annotated[DelayDocument, Tag("<mapping>")],
    by_kind("a whole number of periods or {periods, action}", "write for example 1 or {periods: 1, action: {a: 0}}"),
]
Clip: TypeAlias = Annotated[
    Annotated[Closed, Tag("<list>")] | Annotated[dict[Identifier, Closed], AtLeastOne, Tag("<mapping>")],
    by_kind("[lower, upper] or a mapping of inputs to those", "write for example [-1, 1] or {a: [-1, 1]}"),
]
Observe: TypeAlias = Annotated[
    Annotated[list[ExpressionText], AtLeastOne, Tag("<list>")]
    | Annotated[dict[Identifier, ExpressionText], AtLeastOne, Tag("<mapping>")],
    by_kind("a list of expressions or a mapping of names to expressions", "write for example [x, y, sin(theta)]"),
]


class ControllerDocument(Document):
    """How the policy is wired to the plant: sampled every period, its action held in between."""

    period: Positive
    """Control period in seconds."""
    observe: Observe | None = None
    """What the policy sees: expressions of the states; all states in the plant's order where it is left out."""
    before: AffineDocument | None = None
    """Affine map of the observation, before the network."""
    after: AffineDocument | None = None
    """Affine map of the network's output; its result is the action."""
    clip: Clip | None = None
    """Clipping of the action, after all maps."""
    delay: Delay | None = None
    """Delay of the action in whole periods."""


class DisturbanceDocument(Document):
    """Bounds of a disturbance, and how it may change."""

    range: Symmetric
    """[lower, upper], or r for [-r, r]."""
    varies: Varies = "every period"
    """'never': one unknown constant; 'every period': a fresh value in every control period."""


DisturbanceBounds: TypeAlias = Annotated[
    Annotated[Symmetric, Tag("<text>")]
    | Annotated[Symmetric, Tag("<list>")]
    | Annotated[DisturbanceDocument, Tag("<mapping>")],
    by_kind("a radius, [lower, upper] or {range, varies}", "write for example 0.1 or {range: [-0.1, 0.2]}"),
]
ObservationRadius: TypeAlias = Annotated[
    Annotated[NonNegative, Tag("<text>")] | Annotated[dict[Label, NonNegative], Tag("<mapping>")],
    by_kind("a radius or a mapping of observations to radii", "write for example 0.1 or {x: 0.1}"),
]


class PerturbationDocument(Document):
    """Bounded perturbations; the verdict covers all of them."""

    observation: ObservationRadius = Fraction(0)
    """Radius of the box that is added to the observation, fresh in every period."""
    disturbance: dict[Identifier, DisturbanceBounds] = NO_ENTRIES
    """Bounds of the plant's disturbances; those that are not named are 0."""


Box: TypeAlias = Annotated[dict[Identifier, OpenInterval], AtLeastOne]
Intersection: TypeAlias = Annotated[
    list[
        Annotated[
            Annotated[Comparison, Tag("<text>")] | Annotated[Box, Tag("<mapping>")],
            by_kind("a comparison or a box", "write for example 'x - 3*y <= 4' or {x: [1, 2]}"),
        ]
    ],
    AtLeastOne,
]
_REGION_REMEDY = "write a box {x: [1, 2]}, a comparison 'x - 3*y <= 4', a list of those, or {union: [...]}"


class UnionDocument(Document):
    """A region that consists of several parts."""

    union: Annotated[
        list[
            Annotated[
                Annotated[Comparison, Tag("<text>")]
                | Annotated[Intersection, Tag("<list>")]
                | Annotated[Box, Tag("<mapping>")],
                by_kind("a box, a comparison or a list of comparisons", "unions are not nested; list all parts"),
            ]
        ],
        AtLeastOne,
    ]
    """The parts; each a box, a comparison, or a list of them that all hold."""


def _region_kind(value: object) -> str | None:
    if isinstance(value, str):
        return "<text>"
    if isinstance(value, dict):
        return "<union>" if "union" in value else "<mapping>"
    return "<list>" if isinstance(value, list) else None


RegionDocument: TypeAlias = Annotated[
    Annotated[Comparison, Tag("<text>")]
    | Annotated[Intersection, Tag("<list>")]
    | Annotated[UnionDocument, Tag("<union>")]
    | Annotated[Box, Tag("<mapping>")],
    by_kind("a region", _REGION_REMEDY, _region_kind),
]


class RequirementDocument(Document):
    """One requirement; its polarity is the key."""

    model_config = ConfigDict(
        json_schema_extra={
            "oneOf": [{"required": ["avoid"]}, {"required": ["stay"]}, {"required": ["reach"]}],
            "not": {"required": ["at", "during"]},
        }
    )

    avoid: RegionDocument | None = None
    """No trajectory is in the region at any time of the window."""
    stay: RegionDocument | None = None
    """Every trajectory is in the region at every time of the window."""
    reach: RegionDocument | None = None
    """At some time of the window every trajectory is in the region."""
    name: Label | None = None
    """Name in messages and reports; unique."""
    at: NonNegative | None = None
    """A time point, a multiple of the period; excludes during. Default of reach: the horizon."""
    during: Closed | None = None
    """A window [t1, t2]. Default of avoid and stay: [0, horizon]."""

    @model_validator(mode="after")
    def _one_kind(self) -> RequirementDocument:
        given = [kind for kind in ("avoid", "stay", "reach") if getattr(self, kind) is not None]
        if len(given) != 1:
            message = f"expected exactly one of avoid, stay and reach, found {' and '.join(given) or 'none'}"
            raise problem(message, "write one list entry per requirement")
        if self.at is not None and self.during is not None:
            raise problem("at and during exclude each other", "keep the one that is meant", "during")
        return self


class PenaltyDocument(Document):
    """A cost for every period that ends in a region."""

    amount: NonNegative
    """Subtracted from the reward of the period."""
    inside: RegionDocument
    """The region, as in a requirement."""


class RewardDocument(Document):
    """r = - sum_i weights_i |s_i - target_i| - penalty, with s the state at the end of a period; summed, discounted."""

    weights: Annotated[dict[Identifier, NonNegative], AtLeastOne]
    """Weight of every state that counts."""
    target: dict[Identifier, ExactNumber] = NO_ENTRIES
    """Target of the weighted states; 0 where it is left out."""
    discount: Discount = Fraction(1)
    """Factor per period, in (0, 1]."""
    penalty: PenaltyDocument | None = None
    """Cost of being in a region at the end of a period."""


PlantReference: TypeAlias = Annotated[
    Annotated[Text, Tag("<text>")] | Annotated[PlantDocument, Tag("<mapping>")],
    by_kind("a plant's name, a path or a mapping", "write for example 'unicycle' or 'plants/mine.yaml'"),
]


class SpecificationDocument(Document):
    """What must hold for the closed loop of a policy and a plant."""

    model_config = ConfigDict(json_schema_extra={"anyOf": [{"required": ["requirements"]}, {"required": ["reward"]}]})

    setrl: Version
    """Version of this language."""
    description: Text | None = None
    """What the specification states and where it comes from."""
    plant: PlantReference
    """A shipped plant's name, a path to a plant file relative to this file, or an inline plant."""
    controller: ControllerDocument
    """How the policy is wired to the plant."""
    horizon: Positive
    """Length of a run in seconds; a multiple of the period."""
    initial: Annotated[dict[Identifier, Interval], AtLeastOne]
    """Every state: a number, or [lower, upper]."""
    perturbation: PerturbationDocument = PerturbationDocument.model_construct()
    """Bounded perturbations; none where it is left out."""
    requirements: Annotated[list[RequirementDocument], AtLeastOne] | None = None
    """What must hold for every trajectory."""
    reward: RewardDocument | None = None
    """Cumulative reward, whose worst case is computed."""
    allow_unknown: Flag = False
    """Whether UNKNOWN passes a gate."""

    @model_validator(mode="after")
    def _states_something(self) -> SpecificationDocument:
        if self.requirements is None and self.reward is None:
            raise problem("the specification has neither requirements nor a reward", "add at least one of the two")
        return self
