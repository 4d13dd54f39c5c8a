"""One control period of a certificate as a network: the claimed set of observations in front of the controller.

The inputs are the set's own factors, each in [-1, 1]:

    b -> o = c + G b -> map before the network -> network -> map after it -> clip.

What the file computes differs from that because c, G and the specification's numbers are rounded to its precision;
`rounding` bounds by how much.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field
from fractions import Fraction
from typing import Any

from flint import arb, ctx

from ...models.onnx_writer import policy_bytes
from ..checker import layers as exact
from ..checker.image import Start
from ..checker.leaf import BOX, PERTURBATION, PRODUCT, ActionClaim, PeriodClaim
from .exact import at_least, at_most
from .sources import Source
from .written import Written, controller_layers, network_error, write_layers

TRACKED = "tracked"
KINDS = {PRODUCT: "product", BOX: "map", PERTURBATION: "perturbation"}
PRECISION = 128
"""Bits of the balls that bound roundings; more would change nothing."""


@dataclass(frozen=True)
class Factor:
    """One input of the network.

    Attributes
    ----------
    kind : {"tracked", "product", "map", "perturbation"}
        A row of the tracked set; a product of two of them; what the observation map leaves over, or the perturbation,
        of one observed component.
    position : int
        Which row, pair or component.
    row : tuple of float or Fraction
        What the factor adds to every observed component.
    """

    kind: str
    position: int
    row: tuple[exact.Number, ...]


@dataclass(frozen=True)
class Controller:
    """What all periods share: the layers behind the set of observations, exact and as they are written."""

    layers: tuple[Written, ...]
    precision: str

    @classmethod
    def of(cls, source: Source) -> Controller:
        """Prepare; the precision is the policy's own, whose weights are then written as they are."""
        precision = source.network.precision
        layers = controller_layers(source.contract, source.network.layers)
        return cls(tuple(write_layers(layers, source.layout.observations, precision)), precision)


@dataclass(frozen=True)
class PeriodNetwork:
    """A controller with a set of observations in front of it, and what is claimed about it.

    Attributes
    ----------
    center : tuple of float
        Of the observations.
    factors : tuple of Factor
        The inputs, in order; rows that move no observation are left out.
    action : ActionClaim
        The claimed set of actions.
    layers : tuple of Written
        The first one is ``c + G b``.
    precision : {"float32", "float64"}
    rounding : tuple of Fraction
        Per action, by how much the written network may differ from the exact one anywhere in the box.
    """

    center: tuple[float, ...]
    factors: tuple[Factor, ...]
    action: ActionClaim
    layers: tuple[Written, ...]
    precision: str
    rounding: tuple[Fraction, ...]
    _content: list[bytes] = field(default_factory=list, repr=False, compare=False)

    @property
    def content(self) -> bytes:
        """The bytes of the ONNX file: input (batch, factors), output (batch, actions)."""
        if not self._content:
            layers = [written.layer for written in self.layers]
            self._content.append(policy_bytes(layers, precision=self.precision, name="period"))
        return self._content[0]

    def actions(self, factors: Sequence[float]) -> list[tuple[Fraction, Fraction]]:
        """Proved bounds of what the exact network does at one point of its box.

        A point at which a verifier of the written network finds a violation is a violation of the certificate's claim
        where these bounds are beyond it.

        Parameters
        ----------
        factors : sequence of float
            One per input, in [-1, 1].

        Returns
        -------
        list of (lower, upper)
            One per action.
        """
        with ctx.workprec(PRECISION):
            point: list[Any] = [arb(float(x)) for x in factors]
            for written in self.layers:
                point = exact.apply(written.exact, point)
            return [(at_least(value), at_most(value)) for value in point]


def period_network(source: Source, controller: Controller, tracked: Start, period: PeriodClaim) -> PeriodNetwork:
    """The network of one period.

    Parameters
    ----------
    source : Source
    controller : Controller
    tracked : Start
        The tracked set at the period's start, without a box; see `tracked.tracked_sets`.
    period : PeriodClaim

    Returns
    -------
    PeriodNetwork
    """
    center, factors = _observations(source, tracked, period)
    kept = [factor for factor in factors if any(factor.row)] or factors[:1]
    size = source.layout.observations
    if not kept:  # a single point: a network needs an input all the same
        kept = [Factor(PERTURBATION_NAME, 0, (0.0,) * size)]
    matrix = tuple(tuple(factor.row[i] for factor in kept) for i in range(size))
    with ctx.workprec(PRECISION):
        front = write_layers([exact.Dense(matrix, center)], len(kept), controller.precision)
        layers = (*front, *controller.layers)
        error = network_error(layers, [arb(1)] * len(kept), [arb(0)] * len(kept))
        rounding = tuple(at_most(e) for e in error)
    return PeriodNetwork(center, tuple(kept), period.action, layers, controller.precision, rounding)


PERTURBATION_NAME = KINDS[PERTURBATION]


def _observations(source: Source, tracked: Start, period: PeriodClaim) -> tuple[tuple[float, ...], list[Factor]]:
    """The claimed set of observations, perturbation included: center and factors."""
    layout = source.layout
    size = layout.observations
    if layout.observed is not None:
        center = tuple(tracked.center[i] for i in layout.observed)
        factors = [
            Factor(TRACKED, position, tuple(row[i] for i in layout.observed))
            for position, row in enumerate(tracked.rows)
        ]
    else:
        seen = period.seen
        assert seen is not None
        center = seen.center
        factors = [Factor(TRACKED, position, row) for position, row in enumerate(seen.rows)]
        factors += [Factor(KINDS[PRODUCT], position, row) for position, row in enumerate(seen.fresh)]
        factors += _units(KINDS[BOX], seen.radius, size)
    return center, factors + _units(PERTURBATION_NAME, source.radius, size)


def _units(kind: str, lengths: Sequence[exact.Number], size: int) -> list[Factor]:
    """One factor per component, which moves it alone."""
    rows = [tuple(length if i == position else 0.0 for i in range(size)) for position, length in enumerate(lengths)]
    return [Factor(kind, position, row) for position, row in enumerate(rows)]
