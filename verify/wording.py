"""Sentences for people: what a verdict claims. Never the word "safe"."""

from __future__ import annotations

import math
from collections.abc import Sequence
from decimal import Context, Decimal
from fractions import Fraction

from ..models.closed_loop import BoundRequirement, ClosedLoop
from ..models.onnx_runtime import runtime_version
from ..specs.exact import signed_text


def number(value: Fraction | float) -> str:
    """Short decimal of a number."""
    return f"{float(value):.6g}"


def at_least(value: float, digits: int = 6) -> str:
    """Short decimal that is not above a number: a bound that is printed must still hold."""
    return _short(value, digits, "ROUND_FLOOR")


def at_most(value: float, digits: int = 2) -> str:
    """Short decimal that is not below a number."""
    return _short(value, digits, "ROUND_CEILING")


def _short(value: float, digits: int, rounding: str) -> str:
    if not math.isfinite(value):
        return f"{value:g}"
    rounded = Context(prec=digits, rounding=rounding).plus(Decimal(value)).normalize()
    # the decimal itself is printed: by way of a float it would be rounded once more, to nearest
    return f"{rounded:f}" if -5 <= rounded.adjusted() < 16 or not rounded else f"{rounded:e}"


def quantity(count: int, noun: str) -> str:
    """``1 cell``, ``2 cells``, ``2 trajectories``."""
    many = f"{noun[:-1]}ies" if noun.endswith("y") else f"{noun}s"
    return f"{count} {noun if count == 1 else many}"


def claim_sentence(loop: ClosedLoop, semantics: Sequence[str]) -> str:
    """What VERIFIED means for this closed loop, in one sentence.

    Parameters
    ----------
    loop : ClosedLoop
    semantics : sequence of str
        "real", and the deployed precision where it is covered.
    """
    plant = loop.plant.description.name if loop.plant.description is not None else "given"
    clauses = [requirement_clause(requirement, loop) for requirement in loop.requirements]
    if not clauses and loop.reward is not None:
        clauses = ["has a return below V(s0)"]
    noise = [signed_text(radius) for radius in loop.observation_radius]
    perturbed = "exact observations"
    if any(radius > 0 for radius in loop.observation_radius):
        radius = noise[0] if len(set(noise)) == 1 else "(" + ", ".join(noise) + ")"
        perturbed = f"observations perturbed by up to {radius}"
    moving = sum(1 for bound in loop.disturbances if bound.lower != bound.upper)
    disturbed = f" and {quantity(moving, 'bounded disturbance')}" if moving else ""
    executed = " and as executed in ".join(
        {"real": "exact real arithmetic"}.get(name, f"{name} by onnxruntime {runtime_version()} on a CPU")
        for name in semantics
    )
    return (
        f"no trajectory of plant {plant} under this network, from this initial set, with {perturbed}{disturbed}, "
        f"{' or '.join(clauses)}; the network taken in {executed}"
    )


def requirement_clause(requirement: BoundRequirement, loop: ClosedLoop) -> str:
    """What a violation of a requirement would be: "enters `obstacle` within 6 s"."""
    start, end = signed_text(requirement.start), signed_text(requirement.end)
    horizon = loop.period * loop.periods
    when = f"at {end} s" if requirement.start == requirement.end else f"between {start} s and {end} s"
    if requirement.start == 0 and requirement.end == horizon:
        when = f"within {end} s"
    verb = {"avoid": "enters", "stay": "leaves", "reach": "misses"}[requirement.kind]
    return f"{verb} `{requirement.name}` {when}"
