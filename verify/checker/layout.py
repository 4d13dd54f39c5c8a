"""The sizes that the contract and the network give to everything in a certificate."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from .contract import Contract, Requirement
from .layers import Activation, Dense, Diagonal, Selection
from .network import Network
from .program import Program, compile_program

SMOOTH = ("tanh", "sigmoid")


@dataclass(frozen=True)
class Condition:
    """A requirement, and whether time-point sets decide it; else every time-interval set of its window does."""

    requirement: Requirement
    by_points: bool


@dataclass(frozen=True)
class Layout:
    """What the reader of a certificate's streams has to know.

    Attributes
    ----------
    states, inputs, observations : int
    constant, varying : tuple of int
        Positions of the disturbances that are constant over the run, and of those that are free in every period.
    delay, periods : int
    period : Fraction
    discrete : bool
    observed : tuple of int or None
        States that the policy sees, where it sees plain states.
    neurons : tuple of int
        Sizes of the activations in their order.
    smooth : tuple of bool
        Which of the activations are smooth (tanh, sigmoid); the others are piecewise linear.
    clipped : bool
    conditions : tuple of Condition
    penalty : tuple of int
        Numbers of facets of the penalty region's members.
    method : {"jets", "linearization"}
    version : int
        Of the certificate's format.
    """

    states: int
    inputs: int
    observations: int
    constant: tuple[int, ...]
    varying: tuple[int, ...]
    delay: int
    periods: int
    period: Fraction
    discrete: bool
    observed: tuple[int, ...] | None
    neurons: tuple[int, ...]
    smooth: tuple[bool, ...]
    clipped: bool
    conditions: tuple[Condition, ...]
    penalty: tuple[int, ...]
    method: str
    version: int = 1

    @property
    def tracked(self) -> int:
        """States, constant disturbances and delayed actions."""
        return self.states + len(self.constant) + self.delay * self.inputs


def observation_program(contract: Contract) -> Program:
    """What the policy sees, as a program of the states."""
    return compile_program(contract.observe, contract.plant.states)


def layout_of(contract: Contract, network: Network, method: str, version: int = 1) -> Layout:
    """The sizes for a contract, a network that fits it, a flow method, and a version of the format."""
    plant, outputs = contract.plant, observation_program(contract).outputs
    kinds = [entry.constant for entry in contract.disturbances]
    return Layout(
        states=len(plant.states),
        inputs=len(plant.inputs),
        observations=len(contract.observe),
        constant=tuple(i for i, constant in enumerate(kinds) if constant),
        varying=tuple(i for i, constant in enumerate(kinds) if not constant),
        delay=contract.delay,
        periods=contract.periods,
        period=contract.period,
        discrete=plant.discrete,
        observed=outputs if all(slot < len(plant.states) for slot in outputs) else None,
        neurons=_activation_sizes(network),
        smooth=tuple(layer.kind in SMOOTH for layer in network.layers if isinstance(layer, Activation)),
        clipped=any(bounds is not None for bounds in contract.clip),
        conditions=tuple(_condition(contract, requirement) for requirement in contract.requirements),
        penalty=() if contract.reward is None else tuple(len(member) for member in contract.reward.region),
        method=method,
        version=version,
    )


def _condition(contract: Contract, requirement: Requirement) -> Condition:
    instant = requirement.start == requirement.end and (requirement.start / contract.period).denominator == 1
    return Condition(requirement, contract.plant.discrete or instant or requirement.kind == "reach")


def _activation_sizes(network: Network) -> tuple[int, ...]:
    sizes, size = [], network.inputs
    for layer in network.layers:
        match layer:
            case Activation():
                sizes.append(size)
            case Selection(index):
                size = len(index)
            case Dense() | Diagonal():
                size = len(layer.offset)
    return tuple(sizes)
