"""What must hold, as data: initial set, horizon, perturbations, requirements, reward.

Every number is an exact rational (`fractions.Fraction`): ``0.1`` in a file is one tenth, not the float nearest to it.
Nothing here knows a plant's dimensions; `models.binding` joins a specification to a plant and a policy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Literal

from .expressions import Expression


@dataclass(frozen=True)
class Bounds:
    """A closed interval of exact numbers, ``lower <= upper``."""

    lower: Fraction
    upper: Fraction


@dataclass(frozen=True)
class Halfspace:
    """The points with ``sum_i coefficients[i] * state_i <= bound``.

    Attributes
    ----------
    coefficients : mapping of state name to Fraction
        States that are not named have coefficient zero.
    bound : Fraction
    text : str
        As the user wrote it, for messages.
    """

    coefficients: Mapping[str, Fraction]
    bound: Fraction
    text: str


@dataclass(frozen=True)
class Polytope:
    """Intersection of halfspaces. A box is the polytope of its faces; unnamed states are free."""

    halfspaces: tuple[Halfspace, ...]


@dataclass(frozen=True)
class Region:
    """Union of polytopes, closed."""

    members: tuple[Polytope, ...]


@dataclass(frozen=True)
class Requirement:
    """One clause of a specification.

    avoid: no trajectory is in `region` at any time of the window.
    stay: every trajectory is in `region` at every time of the window.
    reach: at some time of the window every trajectory is in `region` (a single time unless a window is given).

    Attributes
    ----------
    kind : {"avoid", "stay", "reach"}
    name : str
        Unique within the specification.
    region : Region
    start, end : Fraction
        The window in seconds (or steps of a discrete-time plant times the period); ``start == end`` is a time point.
    line : int
        Line in the YAML file, 0 where there is none.
    """

    kind: Literal["avoid", "stay", "reach"]
    name: str
    region: Region
    start: Fraction
    end: Fraction
    line: int = 0


@dataclass(frozen=True)
class AffineMap:
    """``y = matrix @ x + offset`` in exact numbers; a scale is a diagonal matrix."""

    matrix: tuple[tuple[Fraction, ...], ...] | None
    """Full matrix, one tuple per output, or None where `scale` is used."""
    scale: tuple[Fraction, ...] | Fraction
    """Per component, or one number for all; ignored where `matrix` is given."""
    offset: tuple[Fraction, ...] | Fraction


@dataclass(frozen=True)
class Controller:
    """How the policy is wired to the plant.

    Attributes
    ----------
    period : Fraction
        Control period in seconds; the action is held constant for one period (zero-order hold).
    observe : mapping of observation name to Expression, or None
        What the policy sees, in this order; None is all states in the plant's order.
    before, after : AffineMap or None
        Applied to the (perturbed) observation before, and to the network's output after the network.
    clip : mapping of input name to Bounds, Bounds for all inputs, or None
        Clipping of the action, after `after`.
    delay : int
        The action that is computed from the observation at period k acts from period k + delay on.
    delayed_action : mapping of input name to Fraction
        What acts during the first `delay` periods; inputs that are not named get 0.
    """

    period: Fraction
    observe: Mapping[str, Expression] | None = None
    before: AffineMap | None = None
    after: AffineMap | None = None
    clip: Mapping[str, Bounds] | Bounds | None = None
    delay: int = 0
    delayed_action: Mapping[str, Fraction] = field(default_factory=dict)


@dataclass(frozen=True)
class Disturbance:
    """Bounds of one disturbance; constant over the whole run, or free in every control period (held within it)."""

    bounds: Bounds
    constant: bool = False


@dataclass(frozen=True)
class Perturbation:
    """Bounded perturbations.

    Attributes
    ----------
    observation : Fraction or mapping of observation name to Fraction
        Radius of the box added to what the policy sees, fresh in every period. Names that are missing have radius 0.
    disturbances : mapping of disturbance name to Disturbance
        Disturbances of the plant that are not named are 0.
    """

    observation: Mapping[str, Fraction] | Fraction = Fraction(0)
    disturbances: Mapping[str, Disturbance] = field(default_factory=dict)


@dataclass(frozen=True)
class Penalty:
    """``amount`` is charged for every period at whose end the state is in `region`."""

    amount: Fraction
    region: Region


@dataclass(frozen=True)
class Reward:
    """``r = -weights' |s_next - target| - penalty [s_next in region]``, discounted; weights are not negative."""

    weights: Mapping[str, Fraction]
    target: Mapping[str, Fraction]
    discount: Fraction = Fraction(1)
    penalty: Penalty | None = None


@dataclass(frozen=True)
class PlantDescription:
    """A plant as its text states it, parsed but not yet compiled.

    Attributes
    ----------
    name : str
    states, inputs, disturbances : mapping of name to unit
        In order; the unit is documentation.
    parameters : mapping of name to (Fraction, unit)
    dynamics : mapping of state name to Expression
        Time derivative, or (`discrete`) the next state.
    discrete : bool
        True where the file writes ``x+`` for the keys of `dynamics`.
    description : str
    lines : mapping of state name to line of its dynamics, for messages
    """

    name: str
    states: Mapping[str, str]
    inputs: Mapping[str, str]
    disturbances: Mapping[str, str]
    parameters: Mapping[str, tuple[Fraction, str]]
    dynamics: Mapping[str, Expression]
    discrete: bool = False
    description: str = ""
    source: str = ""
    """File it came from, for messages."""
    lines: Mapping[str, int] = field(default_factory=dict)


@dataclass(frozen=True)
class Specification:
    """The whole question, except the policy.

    Attributes
    ----------
    plant : str or PlantDescription
        A shipped plant's name, a path (relative to the specification's folder), or an inline plant.
    initial : mapping of state name to Bounds
        Every state of the plant.
    source : str
        File it was read from, for messages.
    digest : str
        sha256 of the bytes that were read.
    lines : mapping of dotted key ("initial.x", "requirements.0") to line
    """

    plant: str | PlantDescription
    controller: Controller
    horizon: Fraction
    initial: Mapping[str, Bounds]
    perturbation: Perturbation
    requirements: tuple[Requirement, ...]
    reward: Reward | None = None
    allow_unknown: bool = False
    description: str = ""
    source: str = ""
    digest: str = ""
    lines: Mapping[str, int] = field(default_factory=dict)
