"""The network obligation: the claimed set of actions contains what the policy computes on the claimed set of states.

The observation is o_c + the tracked set's rows and a few private ones; linear functions of it enclose the action, with
one slope per neuron (`forward`) or two lines per neuron (`backward`). What they leave between themselves and the
claimed rows, row by row, has to fit into the claimed box, together with the deployed runtime's error.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, TypeAlias

from flint import arb

from .backward import Backward
from .contract import AffineMap, Contract
from .deployment import Deployment
from .forward import Forward
from .image import Start
from .layers import Activation, Dense, Layer, apply
from .layout import Layout, observation_program
from .leaf import TWO_LINES, PeriodClaim
from .network import Network
from .observed import observe
from .program import Program, ball
from .rejection import require_within

Vector: TypeAlias = list[Any]


@dataclass(frozen=True)
class Policy:
    """Everything between the states and the action, prepared once per certificate.

    Attributes
    ----------
    layers : tuple of Layer
        The map before the network, the network, the map after it.
    observe : Program
    radius : list of balls
        Of the observation's perturbation.
    bounds : list of (low, high), balls
        Of every action where actions are clipped.
    deployment : Deployment or None
        Error bounds of the deployed semantics, where it is claimed.
    layout : Layout
    """

    layers: tuple[Layer, ...]
    observe: Program
    radius: Vector
    bounds: list[tuple[Any, Any]]
    deployment: Deployment | None
    layout: Layout

    @classmethod
    def of(cls, contract: Contract, network: Network, layout: Layout, runtime: Any) -> Policy:
        """Prepare; `runtime` is the error of the runtime's own tanh and sigmoid, None without deployed semantics."""
        before = [] if contract.before is None else [_dense(contract.before)]
        after = [] if contract.after is None else [_dense(contract.after)]
        clip = tuple(pair for pair in contract.clip if pair is not None)
        return cls(
            (*before, *network.layers, *after),
            observation_program(contract),
            [ball(radius) for radius in contract.radius],
            [(ball(low), ball(high)) for low, high in clip],
            None if runtime is None else Deployment(network.precision, runtime, clip),
            layout,
        )


def _dense(affine: AffineMap) -> Dense:
    return Dense(affine.matrix, affine.offset)


def check_action(policy: Policy, states: Start, claim: PeriodClaim, what: str) -> None:
    """Require that a period's claimed set of actions contains what the policy computes on a set of states.

    Parameters
    ----------
    policy : Policy
    states : Start
        The tracked set's states; no boxed part.
    claim : PeriodClaim
    what : str
        Where, for the message.

    Raises
    ------
    Rejected
    """
    layout, deployment = policy.layout, policy.deployment
    seen = observe(layout, policy.observe, policy.radius, states, claim.observation, claim.seen)
    form = Backward(seen, claim.two_lines) if claim.form == TWO_LINES else Forward(seen, claim.lines)
    error: Vector | None = None
    magnitude: Vector = []
    if deployment is not None:
        magnitude = _magnitude(*form.bounds())
        error = deployment.start(magnitude)
    known = True  # whether `magnitude` is the one of the layer's input
    for layer in policy.layers:
        if isinstance(layer, Activation):
            low, high = form.bounds()
            if deployment is not None and error is not None:
                error = deployment.activated(layer, low, high, error)
                magnitude, known = _range(layer, low, high), True
            form.activate(layer, low, high)
            continue
        if deployment is not None and error is not None:
            if not known:
                magnitude = _magnitude(*form.bounds())
            error = deployment.through(layer, magnitude, error)
            known = False
        form.affine(layer)
    loose = [arb(0)] * layout.inputs if error is None else error
    if claim.clip_slopes is not None:
        low, high = form.bounds()
        low = [a - e for a, e in zip(low, loose, strict=True)]
        high = [b + e for b, e in zip(high, loose, strict=True)]
        form.clip(policy.bounds, claim.clip_slopes, low, high)
        loose = [abs(arb(slope)) * e for slope, e in zip(claim.clip_slopes, loose, strict=True)]
        if deployment is not None:
            loose = [a + b for a, b in zip(loose, deployment.clip_error(), strict=True)]
    for left in form.left(claim.action):
        require_within([a + e for a, e in zip(left, loose, strict=True)], claim.action.box, what)


def _magnitude(low: Vector, high: Vector) -> Vector:
    return [abs(a).max(abs(b)) for a, b in zip(low, high, strict=True)]


def _range(activation: Activation, low: Vector, high: Vector) -> Vector:
    """Bounds of the absolute value behind an activation; all of them are monotone."""
    return _magnitude(apply(activation, low), apply(activation, high))
