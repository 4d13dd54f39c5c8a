"""What a proof of a violation says, as data and as a sentence."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from decimal import ROUND_FLOOR, Context, Decimal
from fractions import Fraction

from .question import Question

REAL, DEPLOYED, BOTH = "proved (real)", "proved (deployed)", "proved (real and deployed)"


@dataclass(frozen=True)
class Proof:
    """A violation that is proved.

    Attributes
    ----------
    grade : str
        "proved (real)": of the network in exact real arithmetic on its stored numbers. "proved (deployed)": of the
        actions that a runtime computed. "proved (real and deployed)": of both.
    sentence : str
    requirement, kind : str
    time : Fraction or None
    depth : float
        By how much at least, in the requirement's unit; of the smaller violation, where there are two.
    radius : float
        Largest radius of the state's enclosure where the violation is read off, an upper bound.
    precision : int
        Bits.
    objection : str
        Why the recorded actions prove nothing; "" where they do, or there are none.
    """

    grade: str
    sentence: str
    requirement: str
    kind: str
    time: Fraction | None
    depth: float
    radius: float
    precision: int
    objection: str = ""


@dataclass(frozen=True)
class Shown:
    """What one trajectory shows: a violation of at least `depth`, within enclosures of `radius`, at so many bits."""

    depth: float
    radius: float
    precision: int


def proof_of(question: Question, grade: str, shown: Sequence[Shown], semantics: str, objection: str = "") -> Proof:
    """A proof with its sentence.

    Parameters
    ----------
    question : Question
    grade : str
    shown : sequence of Shown
        Of one trajectory or two.
    semantics : str
        In which sense it is proved, after the word "proved".
    objection : str
    """
    requirement, witness, times = question.requirement, question.witness, question.times
    depth, radius = min(entry.depth for entry in shown), max(entry.radius for entry in shown)
    verb = {"avoid": "entered", "stay": "left", "reach": "missed"}[requirement.kind]
    when = f"at {decimal(times[0])} s"
    if len(times) > 1:
        when = f"at every sampling instant from {decimal(times[0])} s to {decimal(times[-1])} s"
    start = ", ".join(
        f"{name} = {decimal(value)}"
        for name, value in zip(question.contract.plant.states, witness.initial, strict=True)
    )
    if witness.observation_radius is not None:
        radii = ", ".join(map(decimal, witness.observation_radius))
        start += f" with observation radius ({radii}), which is not the specification's"
    sentence = (
        f"`{requirement.name}` is {verb} {when} by {_floor(depth)} from {start}; "
        f"proved {semantics} (enclosure radius {radius:.1g})"
    )
    precision = max(entry.precision for entry in shown)
    return Proof(grade, sentence, requirement.name, requirement.kind, witness.time, depth, radius, precision, objection)


def decimal(value: Fraction) -> str:
    """A number in six digits, for words."""
    if abs(value) < 10**300:
        return f"{float(value):.6g}"
    return f"{Context(prec=6).divide(Decimal(value.numerator), Decimal(value.denominator)):e}"


def _floor(depth: float) -> str:
    """Three digits that are not above a number that is not negative."""
    shown = Context(prec=3, rounding=ROUND_FLOOR).plus(Decimal(depth)).normalize()
    return f"{shown:f}" if not shown or -5 <= shown.adjusted() < 16 else f"{shown:e}"
