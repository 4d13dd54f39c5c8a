"""Margins and values that a certificate claims, against whole trajectories from the initial set, in thin balls."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb

from setrl.models.closed_loop import ClosedLoop
from setrl.models.sampling import corner_states
from setrl.models.simulation import returns, simulate
from setrl.verify.checker.loop import periods
from setrl.verify.checker.network import Network
from setrl.verify.checker.obligations import Setting
from setrl.verify.checker.program import Program, ball, compile_program

Array = Any
F = Fraction


@dataclass(frozen=True)
class Question:
    """What a certificate is about, in both readings."""

    loop: ClosedLoop
    network: Network
    setting: Setting
    seed: int = 0

    @property
    def contract(self) -> Any:
        return self.setting.contract

    @property
    def observe(self) -> Program:
        return compile_program(self.contract.observe, self.contract.plant.states)


def false_header(question: Question, header: dict[str, Any], honest: dict[str, Any] | None = None) -> str:
    """Claimed margins and values, against trajectories from the initial set; those of an honest header are true."""
    asked = ("requirements", "value", "observation_radius")
    if honest is not None and all(header[key] == honest[key] for key in asked):
        return ""
    loop, contract = question.loop, question.contract
    generator = np.random.default_rng(question.seed)
    starts = corner_states(loop, 16)
    shape = (len(starts), contract.periods)
    noise = np.sign(generator.normal(size=(*shape, len(contract.radius)))) * [float(r) for r in contract.radius]
    low, high = (np.array([float(d.bounds[side]) for d in contract.disturbances]) for side in (0, 1))
    force = np.where(generator.random((*shape, len(low))) < 0.5, low, high)
    constant = [d.constant for d in contract.disturbances]
    force[:, :, constant] = force[:, :1, constant]
    run = simulate(loop, starts, noise, force, rtol=1e-8)
    if header["value"] is not None:
        worst = int(returns(loop, run).argmin())
        thin = _thin(question, starts[worst], noise[worst], force[worst])
        for name, discount in (("discounted", contract.reward.discount), ("undiscounted", F(1))):
            total = sum((-(ball(discount) ** k) * cost for k, cost in enumerate(thin[1])), arb(0))
            if bool(total < arb(header["value"][name])):
                return f"a trajectory's {name} return is below the claimed one"
    for requirement, entry in zip(contract.requirements, header["requirements"], strict=True):
        depth = [_margin(requirement, path) for path in _at_instants(question, run.period_ends, starts, requirement)]
        worst = int(np.argmin(depth))
        states, _ = _thin(question, starts[worst], noise[worst], force[worst])
        if bool(_margin(requirement, _within(question, states, requirement)) < arb(entry["margin"])):
            return f"a trajectory's margin of {requirement.name!r} is below the claimed one"
    return ""


def _thin(question: Question, start: Array, noise: Array, force: Array) -> tuple[list[Any], list[Any]]:
    """States at the sampling instants and the periods' costs, in balls; penalties only where they are certain."""
    contract, reward = question.contract, question.contract.reward
    exact = [[tuple(map(F, row)) for row in rows.tolist()] for rows in (noise, force)]
    noise_, force_ = (
        [_clipped(row, bounds) for row in rows] for rows, bounds in zip(exact, _bounds(contract), strict=True)
    )
    initial = _clipped(tuple(map(F, start.tolist())), contract.initial)
    until = contract.period * contract.periods
    states = [[ball(x) for x in initial]]
    states += [p.end for p in periods(contract, question.network, initial, noise_, force_, until)]
    costs: list[Any] = []
    for state in states[1:] if reward is not None else ():
        pairs = zip(state, reward.weights, reward.target, strict=True)
        cost = sum((ball(w) * abs(x - ball(t)) for x, w, t in pairs if w), arb(0))
        inside = any(
            all(bool(_value(facet, state) <= ball(facet.bound)) for facet in member) for member in reward.region
        )
        costs.append(cost + (ball(reward.penalty) if inside else 0))
    return states, costs


def _bounds(contract: Any) -> tuple[Any, Any]:
    return [(-radius, radius) for radius in contract.radius], [d.bounds for d in contract.disturbances]


def _clipped(values: Sequence[Fraction], bounds: Any) -> tuple[Fraction, ...]:
    return tuple(min(max(x, low), high) for x, (low, high) in zip(values, bounds, strict=True))


def _value(facet: Any, state: Sequence[Any]) -> Any:
    return sum((ball(c) * x for c, x in zip(facet.coefficients, state, strict=True) if c), arb(0))


def _at_instants(question: Question, ends: Array, starts: Array, requirement: Any) -> list[list[Any]]:
    paths = np.concatenate([starts[:, None], ends], 1)
    return [_within(question, [[arb(float(x)) for x in state] for state in path], requirement) for path in paths]


def _within(question: Question, states: list[Any], requirement: Any) -> list[Any]:
    """States at the sampling instants of a window."""
    period = question.contract.period
    return [s for k, s in enumerate(states) if requirement.start <= k * period <= requirement.end]


def _margin(requirement: Any, states: list[Any]) -> Any:
    """Of points: how far from the region (avoid), or within it; what the sets' margin is a lower bound of."""
    found = []
    for state in states:
        away = [[_value(facet, state) - ball(facet.bound) for facet in member] for member in requirement.region]
        if requirement.kind == "avoid":
            found.append(_least(_most(facets) for facets in away))
        else:
            found.append(_most(_least(-x for x in facets) for facets in away))
    if not found:
        return arb("inf")
    return _most(found) if requirement.kind == "reach" else _least(found)


def _least(values: Any) -> Any:
    first, *others = values
    for value in others:
        first = first.min(value)
    return first


def _most(values: Any) -> Any:
    return -_least(-value for value in values)
