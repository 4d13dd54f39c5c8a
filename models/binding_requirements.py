"""Binding of what must hold and what it is worth: regions, requirements, reward, over all states of the plant."""

from __future__ import annotations

from fractions import Fraction

from ..specs.specification import Region, Requirement
from .binding_context import Context, shown
from .closed_loop import BoundPolytope, BoundRequirement, BoundReward, affine_rows
from .plant import suggestion


def bind_requirements(context: Context) -> tuple[BoundRequirement, ...]:
    """Requirements over the plant's states."""
    seen: set[str] = set()
    bound = []
    for position, requirement in enumerate(context.specification.requirements):
        key = f"requirements.{position}"
        if requirement.name in seen:
            context.fail(key, f"two requirements are called {requirement.name}", "give each a name of its own")
        seen.add(requirement.name)
        _require_window(context, key, requirement)
        bound.append(
            BoundRequirement(
                kind=requirement.kind,
                name=requirement.name,
                region=_region(context, key, requirement.region),
                start=requirement.start,
                end=requirement.end,
                line=requirement.line,
            )
        )
    return tuple(bound)


def _require_window(context: Context, key: str, requirement: Requirement) -> None:
    start, end, horizon = requirement.start, requirement.end, context.specification.horizon
    if not 0 <= start <= end <= horizon:
        context.fail(
            key,
            f"{requirement.name} holds during [{shown(start)}, {shown(end)}], which is not within "
            f"[0, {shown(horizon)}]",
            "move the window or the horizon",
        )
    period = context.specification.controller.period
    if (context.plant.discrete or requirement.kind == "reach") and (end / period).__floor__() * period < start:
        context.fail(
            key,
            f"no sampling instant is in [{shown(start)}, {shown(end)}]",
            f"one comes every {shown(period)}",
        )


def _region(context: Context, key: str, region: Region) -> tuple[BoundPolytope, ...]:
    states = context.plant.states
    for member in region.members:
        for facet in member.halfspaces:
            for name in facet.coefficients:
                if name not in states:
                    context.fail(
                        key, f"`{facet.text}` uses {name}, which is no state", suggestion(name, states, "states")
                    )
            if not any(facet.coefficients.values()):
                context.fail(key, f"`{facet.text}` bounds no state", "remove it")
    return tuple(
        BoundPolytope(
            normals=tuple(affine_rows(facet.coefficients, states) for facet in member.halfspaces),
            bounds=tuple(facet.bound for facet in member.halfspaces),
            facets=tuple(facet.text for facet in member.halfspaces),
        )
        for member in region.members
    )


def bind_reward(context: Context) -> BoundReward | None:
    """The reward over all states, or None."""
    reward, states = context.specification.reward, context.plant.states
    if reward is None:
        return None
    context.require_names("reward.weights", reward.weights, states, "state")
    context.require_names("reward.target", reward.target, states, "state")
    for name, weight in reward.weights.items():
        if weight < 0:
            context.fail(f"reward.weights.{name}", f"a weight is not negative, received {shown(weight)}")
    if not 0 < reward.discount <= 1:
        context.fail("reward.discount", f"the discount must be in (0, 1], received {shown(reward.discount)}")
    penalty = reward.penalty
    if penalty is not None and penalty.amount < 0:
        context.fail("reward.penalty", f"a penalty is not negative, received {shown(penalty.amount)}")
    return BoundReward(
        weights=affine_rows(reward.weights, states),
        target=affine_rows(reward.target, states),
        discount=reward.discount,
        penalty=penalty.amount if penalty is not None else Fraction(0),
        penalty_region=_region(context, "reward.penalty", penalty.region) if penalty is not None else (),
    )
