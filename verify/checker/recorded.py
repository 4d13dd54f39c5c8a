"""The controller as it is deployed: a runtime's recorded actions drive the exact plant.

From period to period, with o the observation of the enclosed state, perturbation included:

    seen = o rounded to nearest in the network's input type      (proved: every point of the ball is rounded alike)
    x = before(seen), y = the runtime's output on x, action = clip(after(y))

x and y are recorded. `before`, `after` and `clip` are computed exactly, and count only where the runtime's arithmetic
could not have rounded them either, whatever its order of summation; otherwise nothing is claimed. That y is what the
runtime returns for x cannot be proved here: somebody has to run it again.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from fractions import Fraction
from typing import Any, TypeAlias

from .contract import AffineMap, Contract
from .taylor import ball
from .witness_file import Numbers, Recording

Vector: TypeAlias = list[Any]
Answer: TypeAlias = Callable[[int, Numbers], Numbers | str]
"""The runtime's output for a period and an input; or why there is none."""


@dataclass(frozen=True)
class Floats:
    """Binary floating-point numbers: `digits` bits, normal from ``2^lowest`` on, below ``2^top``."""

    name: str
    digits: int
    lowest: int
    top: int

    def nearest(self, value: Fraction) -> Fraction | None:
        """The number nearest to a rational, ties to even, underflow gradual; None where it overflows."""
        if not value:
            return value
        size = abs(value)
        exponent = size.numerator.bit_length() - size.denominator.bit_length()
        exponent -= size < Fraction(2) ** exponent
        step = Fraction(2) ** (max(exponent, self.lowest) - self.digits + 1)
        rounded = round(value / step) * step
        return rounded if abs(rounded) < Fraction(2) ** self.top else None

    def holds(self, *values: Fraction) -> bool:
        """Whether all values are zero or normal numbers: no conversion changes them, nor does flushing to zero."""
        return all(not x or (abs(x) >= Fraction(2) ** self.lowest and self.nearest(x) == x) for x in values)

    def adds(self, terms: list[Fraction]) -> bool:
        """Whether every sum of some of these terms is exact, in any order.

        All of them are multiples of one power of two and below `digits` bits of it, and so is every partial sum.
        """
        terms = [term for term in terms if term]
        if len(terms) <= 1:
            return self.holds(*terms)
        scale = max(term.denominator for term in terms)
        if scale & (scale - 1) or not self.holds(*terms):
            return False
        whole = [int(term * scale) for term in terms]
        unit = min(number & -number for number in whole)
        size = sum(map(abs, whole))
        return (
            size <= unit << self.digits
            and Fraction(unit, scale) >= Fraction(2) ** self.lowest
            and Fraction(size, scale) < Fraction(2) ** self.top
        )


FLOAT32, FLOAT64 = Floats("float32", 24, -126, 128), Floats("float64", 53, -1022, 1024)


def input_floats(policy: bytes) -> Floats | None:
    """Numbers that a network takes and returns; None where these are two types.

    Parameters
    ----------
    policy : bytes
        Of a file that `read_network` read.
    """
    import onnx

    graph = onnx.ModelProto.FromString(policy).graph
    constants = {tensor.name for tensor in graph.initializer}
    ends = [*(value for value in graph.input if value.name not in constants), *graph.output]
    kinds = {value.type.tensor_type.elem_type for value in ends}
    return {1: FLOAT32, 11: FLOAT64}.get(kinds.pop()) if len(kinds) == 1 else None


def rounded(value: Any, floats: Floats) -> Fraction | None:
    """The one float that every point of a ball is rounded to; None where that is not proved, or it is not finite.

    Rounding is monotone: what both ends of an interval are rounded to, all points between are.
    """
    if not value.is_finite() or not abs(value) < ball(Fraction(2) ** 1100):
        return None
    low, high = (floats.nearest(_rational(end)) for end in (value.lower(), value.upper()))
    return low if low is not None and low == high else None


def _rational(end: Any) -> Fraction:
    """The end of a ball; zero where it is so small that it is rounded to zero anyway."""
    if abs(end) < ball(Fraction(1, 2**1100)):
        return Fraction(0)
    mantissa, exponent = end.man_exp()
    return Fraction(int(mantissa)) * Fraction(2) ** int(exponent)


def without_controller(contract: Contract) -> Contract:
    """The same contract where the controller is the deployed one, whose actions already act."""
    return replace(contract, before=None, after=None, clip=(None,) * len(contract.plant.inputs))


def deployed_action(
    contract: Contract, floats: Floats, answer: Answer, period: int, observation: Vector
) -> Vector | tuple[str, bool]:
    """The action that acts on the plant.

    Parameters
    ----------
    contract : Contract
    floats : Floats
    answer : callable
        Of the runtime.
    period : int
    observation : vector of balls
        Perturbation included.

    Returns
    -------
    vector of balls, or (str, bool)
        Why there is none, and whether more digits might help.
    """
    seen = [rounded(value, floats) for value in observation]
    if any(value is None for value in seen):
        return f"what the observation of period {period} is rounded to in {floats.name} is not decided", True
    entered = _unrounded(contract.before, tuple(value for value in seen if value is not None), floats)
    if entered is None:
        return f"`before` rounds in {floats.name}", False
    returned = answer(period, entered)
    if isinstance(returned, str):
        return returned, False
    if any(floats.nearest(value) != value for value in returned):
        return f"an action of period {period} is no {floats.name} number", False
    mapped = _unrounded(contract.after, returned, floats)
    if mapped is None:
        return f"`after` rounds in {floats.name}", False
    action = []
    for value, bounds in zip(mapped, contract.clip, strict=True):
        low, high = (value, value) if bounds is None else bounds
        # a bound that is no float acts rounded, unless it does not act at all
        if not (value >= low or floats.holds(low)) or not (value <= high or floats.holds(high)):
            return f"`clip` rounds in {floats.name}", False
        action.append(ball(min(max(value, low), high)))
    return action


def _unrounded(affine: AffineMap | None, values: Numbers, floats: Floats) -> Numbers | None:
    """An affine map's value; None where the runtime's arithmetic might round it."""
    if affine is None:
        return values
    result = []
    for row, offset in zip(affine.matrix, affine.offset, strict=True):
        used = [(entry, value) for entry, value in zip(row, values, strict=True) if entry]
        terms = [*(entry * value for entry, value in used), offset]
        if not floats.holds(*row, offset, *(value for _, value in used)) or not floats.adds(terms):
            return None
        result.append(sum(terms, Fraction(0)))
    return tuple(result)


def recorded_answer(recording: Recording) -> Answer:
    """The actions of a recording, as far as its observations are the right ones."""

    def answer(period: int, entered: Numbers) -> Numbers | str:
        if entered != recording.observations[period]:
            return f"the recorded observation of period {period} is not what the network is given"
        return recording.actions[period]

    return answer
