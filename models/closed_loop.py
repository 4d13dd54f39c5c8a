"""A specification bound to a plant and a policy: names became positions, dimensions agree, numbers are still exact."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from fractions import Fraction
from typing import TypeAlias

from ..specs.specification import PlantDescription, Specification
from .policy import Policy
from .tape import Tape

FractionMatrix: TypeAlias = tuple[tuple[Fraction, ...], ...]
Intervals: TypeAlias = tuple[tuple[Fraction, Fraction], ...]


@dataclass(frozen=True)
class Plant:
    """A compiled plant.

    Attributes
    ----------
    states, inputs, disturbances : tuple of str
    tape : Tape
        Inputs: states, inputs, disturbances, in this order. Outputs: one per state, the time derivative or (`discrete`)
        the next state.
    discrete : bool
    description : PlantDescription
        The text it came from.
    """

    states: tuple[str, ...]
    inputs: tuple[str, ...]
    disturbances: tuple[str, ...]
    tape: Tape
    discrete: bool
    description: PlantDescription


@dataclass(frozen=True)
class BoundAffine:
    """``y = matrix @ x + offset``, exact; `matrix` is (outputs, inputs), full."""

    matrix: FractionMatrix
    offset: tuple[Fraction, ...]


@dataclass(frozen=True)
class BoundPolytope:
    """``{x : normals @ x <= bounds}`` over the plant's states, exact.

    Attributes
    ----------
    normals : (facets, states) tuples of Fraction
    bounds : (facets,) tuple of Fraction
    facets : tuple of str
        The user's text of each facet, for messages.
    """

    normals: FractionMatrix
    bounds: tuple[Fraction, ...]
    facets: tuple[str, ...]


@dataclass(frozen=True)
class BoundRequirement:
    """One requirement; `region` is a union of polytopes; kind and window as in `specs.specification.Requirement`."""

    kind: str
    name: str
    region: tuple[BoundPolytope, ...]
    start: Fraction
    end: Fraction
    line: int


@dataclass(frozen=True)
class BoundReward:
    """``r = -weights' |s_next - target| - penalty [s_next in penalty_region]``; tuples over all states."""

    weights: tuple[Fraction, ...]
    target: tuple[Fraction, ...]
    discount: Fraction
    penalty: Fraction
    penalty_region: tuple[BoundPolytope, ...]


@dataclass(frozen=True)
class BoundDisturbance:
    """Bounds of one disturbance; `constant` over the run or free in every period."""

    lower: Fraction
    upper: Fraction
    constant: bool


@dataclass(frozen=True)
class ClosedLoop:
    """Everything a verifier, a falsifier or a simulator needs to know.

    Attributes
    ----------
    plant : Plant
    policy : Policy
    period : Fraction
    periods : int
        horizon / period.
    initial : tuple of (lower, upper), one per state
    observation : Tape or None
        Inputs: the states; outputs: the observation's components. None: the policy sees all states.
    observation_names : tuple of str
    observation_radius : tuple of Fraction, one per component
    before, after : BoundAffine or None
    clip : tuple of (lower, upper) per input, or None
    delay : int
    delayed_action : tuple of Fraction, one per input
    disturbances : tuple of BoundDisturbance, one per disturbance of the plant
    requirements : tuple of BoundRequirement
    reward : BoundReward or None
    specification : Specification
        The source of all this.
    """

    plant: Plant
    policy: Policy
    period: Fraction
    periods: int
    initial: Intervals
    observation: Tape | None
    observation_names: tuple[str, ...]
    observation_radius: tuple[Fraction, ...]
    before: BoundAffine | None
    after: BoundAffine | None
    clip: Intervals | None
    delay: int
    delayed_action: tuple[Fraction, ...]
    disturbances: tuple[BoundDisturbance, ...]
    requirements: tuple[BoundRequirement, ...]
    reward: BoundReward | None
    specification: Specification


def affine_rows(region: Mapping[str, Fraction], states: tuple[str, ...]) -> tuple[Fraction, ...]:
    """Coefficients by state name as a row over all states, zero where a state is not named."""
    return tuple(region.get(state, Fraction(0)) for state in states)
