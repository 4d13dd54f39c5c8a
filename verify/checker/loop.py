"""The closed loop from one exact start under exact perturbations, enclosed in ball arithmetic.

Every number is a ball around an exact one, so the sets stay as thin as the precision lets them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any, TypeAlias

from .contract import AffineMap, Contract
from .layers import clip
from .network import Network
from .taylor import Program, Segment, ball, compile_program, evaluate, solve

Vector: TypeAlias = list[Any]
Numbers: TypeAlias = tuple[Fraction, ...]


@dataclass(frozen=True)
class Period:
    """One control period: the state at its end, and (continuous time) the parts of the solution on the way there."""

    number: int
    end: Vector
    segments: list[Segment]


def periods(
    contract: Contract,
    network: Network,
    initial: Numbers,
    noise: Sequence[Numbers],
    disturbances: Sequence[Numbers],
    until: Fraction,
) -> Iterator[Period]:
    """Enclose one period after the other, at the precision in force.

    The last one ends at the time `until`; it ends early where a solution cannot be enclosed.
    """
    plant = contract.plant
    field = compile_program(plant.dynamics, (*plant.states, *plant.inputs, *plant.disturbances))
    observe = compile_program(contract.observe, plant.states)
    state = [ball(value) for value in initial]
    pending = [[ball(value) for value in contract.delayed_action] for _ in range(contract.delay)]
    for number in range(min(contract.periods, math.ceil(until / contract.period))):
        pending.append(_action(contract, network, observe, state, noise[number]))
        held = [*pending.pop(0), *(ball(value) for value in disturbances[number])]
        if plant.discrete:
            period = Period(number, evaluate(field, [*state, *held]), [])
        else:
            solution = solve(field, state, held, min(contract.period, until - number * contract.period))
            if solution is None:
                return
            period = Period(number, solution[1], solution[0])
        if not all(bool(value.is_finite()) for value in period.end):
            return
        yield period
        state = period.end


def _action(contract: Contract, network: Network, observe: Program, state: Vector, noise: Numbers) -> Vector:
    seen = [value + ball(error) for value, error in zip(evaluate(observe, state), noise, strict=True)]
    action = _mapped(contract.after, network(_mapped(contract.before, seen)))
    bounds = [None if pair is None else (ball(pair[0]), ball(pair[1])) for pair in contract.clip]
    return [a if pair is None else clip(a, *pair) for a, pair in zip(action, bounds, strict=True)]


def _mapped(affine: AffineMap | None, values: Vector) -> Vector:
    if affine is None:
        return values
    return [
        sum((ball(entry) * value for entry, value in zip(row, values, strict=True) if entry), ball(offset))
        for row, offset in zip(affine.matrix, affine.offset, strict=True)
    ]
