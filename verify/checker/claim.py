"""What an accepted certificate claims, in a sentence made of the checker's own reading of the files."""

from __future__ import annotations

from collections.abc import Sequence
from decimal import ROUND_CEILING, ROUND_FLOOR, Context, Decimal
from fractions import Fraction

from .certificate import Accepted
from .contract import Contract, Requirement
from .documents import load
from .layers import Activation
from .layout import SMOOTH
from .network import Network

MOST_DIGITS = 40


def claim_of(accepted: Accepted, contract: Contract, network: Network, plant: str) -> str:
    """Everything that an accepted certificate proves, and under which assumption.

    Parameters
    ----------
    accepted : Accepted
    contract : Contract
        Of the specification that was checked, with the specification's own observation radius.
    network : Network
    plant : str
        See `plant_name`.

    Returns
    -------
    str
        Bounds are rounded to the side on which they hold.
    """
    header = accepted.header
    clauses = [_clause(requirement, contract) for requirement in contract.requirements]
    if not clauses:
        clauses = ["has a return below the stated one"]
    radius = contract.radius if header.observation_radius is None else header.observation_radius
    seen = _observations(radius)
    if header.observation_radius is not None and header.observation_radius != contract.radius:
        seen += ", which is not the specification's radius"
    moving = sum(1 for entry in contract.disturbances if entry.bounds[0] != entry.bounds[1])
    if moving:
        seen += f" and {moving} bounded disturbance{'s' if moving > 1 else ''}"
    sentence = (
        f"no trajectory of {plant} under this network, from this initial set, with {seen}, {' or '.join(clauses)}"
    )
    parts = [sentence, f"the network taken in {_semantics(accepted, network)}"]
    if accepted.margins:
        margins = ", ".join(f"`{name}` at least {at_least(margin)}" for name, margin in accepted.margins)
        parts.append(f"margins: {margins}")
    if accepted.value is not None and contract.reward is not None:
        discounted, undiscounted = map(at_least, accepted.value)
        discount = exact(contract.reward.discount)
        parts.append(f"every return is at least {discounted} with discount {discount}, {undiscounted} undiscounted")
    return "; ".join(parts)


def plant_name(specification: bytes) -> str:
    """How a specification names its plant."""
    value = load(specification).get("plant")
    if isinstance(value, dict):
        name = value.get("name")
        return f"plant {name.strip()}" if isinstance(name, str) else "the specification's plant"
    return f"plant {str(value).strip()}"


def _observations(radius: Sequence[Fraction]) -> str:
    if not any(radius):
        return "exact observations"
    texts = [exact(entry) for entry in radius]
    return f"observations perturbed by up to {texts[0] if len(set(texts)) == 1 else '(' + ', '.join(texts) + ')'}"


def _clause(requirement: Requirement, contract: Contract) -> str:
    start, end = exact(requirement.start), exact(requirement.end)
    when = f"at {end} s" if start == end else f"between {start} s and {end} s"
    if requirement.start == 0 and requirement.end == contract.period * contract.periods:
        when = f"within {end} s"
    verb = {"avoid": "enters", "stay": "leaves", "reach": "misses"}[requirement.kind]
    return f"{verb} `{requirement.name}` {when}"


def _semantics(accepted: Accepted, network: Network) -> str:
    header = accepted.header
    if header.runtime is None:
        return "exact real arithmetic"
    name, error = header.runtime
    text = f"exact real arithmetic and as executed in {header.semantics[1]} by {printable(name)} on a CPU"
    smooth = sorted({layer.kind for layer in network.layers if isinstance(layer, Activation)} & set(SMOOTH))
    if smooth:
        text += f", provided that its {' and '.join(smooth)} is off by at most {at_most(error)}"
    return text


def exact(value: Fraction) -> str:
    """The decimal that is this number, a fraction where there is none of `MOST_DIGITS` digits."""
    for digits in range(MOST_DIGITS):
        whole = value * 10**digits
        if whole.denominator == 1:
            text = str(abs(whole.numerator)).rjust(digits + 1, "0")
            sign = "-" if value < 0 else ""
            return sign + (f"{text[:-digits]}.{text[-digits:]}" if digits else text)
    return str(value)


def at_least(value: float) -> str:
    """Six digits that are not above a number."""
    return _plain(Context(prec=6, rounding=ROUND_FLOOR).plus(Decimal(value)))


def at_most(value: Fraction) -> str:
    """Three digits that are not below a number."""
    context = Context(prec=3, rounding=ROUND_CEILING)
    return _plain(context.divide(Decimal(value.numerator), Decimal(value.denominator)))


def printable(text: str) -> str:
    """A text that a file chose, without what a terminal or an encoding would stumble over."""
    short = text if len(text) <= 60 else text[:57] + "..."
    return short if short.isprintable() else ascii(short)


def _plain(number: Decimal) -> str:
    number = number.normalize()
    return f"{number:f}" if not number or -5 <= number.adjusted() < 16 else f"{number:e}"
