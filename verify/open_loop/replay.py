"""From a float point that looks like a counterexample to one that is: exactly in the box, and replayed."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ...models.onnx_runtime import Runner
from ...models.policy import Affine, Policy
from ...specs.queries import Case
from ...specs.specification import Bounds
from .. import rounding
from .enclosure import bound_forms
from .question import Question

Array = NDArray[np.float64]

MOST_WEIGHTS = 200_000
"""A network with more of them is not evaluated in rationals."""
DIGITS = 17


@dataclass(frozen=True)
class Counterexample:
    """An input of a case's box for which all constraints of the case hold.

    Attributes
    ----------
    inputs : tuple of Fraction
        In the box, exactly; numbers of the network's own type wherever the box contains one.
    outputs : tuple of float
        What the runtime returns.
    case : Case
    semantics : tuple of str
        Where the constraints hold exactly: "real" for exact arithmetic, the precision for the runtime's outputs.
    """

    inputs: tuple[Fraction, ...]
    outputs: tuple[float, ...]
    case: Case
    semantics: tuple[str, ...]

    def text(self) -> str:
        """``((X_0 v) ... (Y_0 v) ...)``, 17 significant digits, one variable per line."""
        context = Context(prec=DIGITS)
        shown = [
            (f"X_{i}", str(context.divide(Decimal(x.numerator), Decimal(x.denominator))))
            for i, x in enumerate(self.inputs)
        ]
        shown += [(f"Y_{j}", f"{y:.{DIGITS}g}") for j, y in enumerate(self.outputs)]
        return "(" + "\n ".join(f"({name} {number})" for name, number in shown) + ")"


def inside(x: float, bounds: Bounds, precision: str) -> Fraction:
    """The number nearest to x, approximately, that is in an interval: of a precision, else a float64, else an end."""
    x = min(max(x, float(bounds.lower)), float(bounds.upper))
    if not math.isfinite(x):
        return bounds.lower
    for kind in (np.dtype(precision), np.dtype(np.float64)):
        value = np.asarray(x).astype(kind)
        for number in (value, np.nextafter(value, kind.type(-np.inf)), np.nextafter(value, kind.type(np.inf))):
            if np.isfinite(number) and bounds.lower <= Fraction(float(number)) <= bounds.upper:
                return Fraction(float(number))
    return bounds.lower


def clamped(x: float, bounds: Bounds) -> Fraction:
    """The number of an interval that is nearest to x, exactly."""
    return min(max(Fraction(x), bounds.lower), bounds.upper) if math.isfinite(x) else bounds.lower


def cast(x: Fraction, precision: str) -> float:
    """The number of a precision nearest to a rational, which is what the runtime is given."""
    value = np.asarray(float(x)).astype(precision)
    around = [value, np.nextafter(value, value.dtype.type(-np.inf)), np.nextafter(value, value.dtype.type(np.inf))]
    finite = [float(number) for number in around if np.isfinite(number)]
    return min(finite, key=lambda number: abs(Fraction(number) - x)) if finite else math.nan


def replay(policy: Policy, runner: Runner, question: Question, case: int, point: Array) -> Counterexample | None:
    """Try a point on one case of a question.

    Parameters
    ----------
    policy : Policy
    runner : callable
        The network as the runtime runs it.
    question : Question
    case : int
    point : array, shape (n,)

    Returns
    -------
    Counterexample or None
        None where neither arithmetic is known to violate.
    """
    bounds = question.cases[case].box
    with np.errstate(all="ignore"):
        rounded = tuple(inside(float(v), ends, policy.precision) for v, ends in zip(point, bounds, strict=True))
        # what violates only on a face of the box needs the face itself, which may be no float
        exact = tuple(clamped(float(v), ends) for v, ends in zip(point, bounds, strict=True))
        found = _tried(policy, runner, question, case, rounded)
        return found if found is not None or exact == rounded else _tried(policy, runner, question, case, exact)


def _tried(
    policy: Policy, runner: Runner, question: Question, case: int, x: tuple[Fraction, ...]
) -> Counterexample | None:
    asked = question.cases[case]
    outputs = runner(np.array([[cast(value, policy.precision) for value in x]]))[0]
    found = []
    if _violates_really(policy, question, case, x):
        found.append("real")
    if np.isfinite(outputs).all() and holds(asked, x, [Fraction(float(y)) for y in outputs]):
        found.append(policy.precision)
    if not found:
        return None
    return Counterexample(x, tuple(float(y) for y in outputs), asked, tuple(found))


def holds(case: Case, x: Sequence[Fraction], y: Sequence[Fraction]) -> bool:
    """Whether x is in the box and all constraints hold, exactly."""
    inside_box = all(bounds.lower <= value <= bounds.upper for value, bounds in zip(x, case.box, strict=True))
    return inside_box and all(
        sum((c * x[i] for i, c in constraint.inputs), Fraction(0))
        + sum((c * y[j] for j, c in constraint.outputs), Fraction(0))
        <= constraint.bound
        for constraint in case.constraints
    )


def _violates_really(policy: Policy, question: Question, case: int, x: tuple[Fraction, ...]) -> bool:
    """Whether exact arithmetic is known to violate at x: by an enclosure of the point, else in rationals."""
    if not question.rows.size:
        return True
    low = np.array([[rounding.float_below(value) for value in x]])
    high = np.array([[rounding.float_above(value) for value in x]])
    bounds = bound_forms(policy, question, low, high, backward=False)
    rows = question.rows[question.starts[case] :][: len(question.cases[case].constraints)]
    if (bounds.upper[0, rows] <= 0.0).all():
        return True
    if (bounds.lower[0, rows] > 0.0).any():
        return False
    y = exact_outputs(policy, x)
    return y is not None and holds(question.cases[case], x, y)


def exact_outputs(policy: Policy, x: Sequence[Fraction]) -> tuple[Fraction, ...] | None:
    """The network in rationals; None where an activation has no rational values or the network is too large.

    Parameters
    ----------
    policy : Policy
    x : sequence of Fraction

    Returns
    -------
    tuple of Fraction or None
    """
    values = list(x)
    if sum(layer.weight.size for layer in policy.layers if isinstance(layer, Affine)) > MOST_WEIGHTS:
        return None
    for layer in policy.layers:
        if isinstance(layer, Affine):
            if layer.weight_error is not None or layer.bias_error is not None:
                return None
            values = [
                sum((Fraction(float(w)) * v for w, v in zip(row, values, strict=True) if w), Fraction(float(b)))
                for row, b in zip(layer.weight, layer.bias, strict=True)
            ]
        elif layer.kind == "relu":
            values = [max(v, Fraction(0)) for v in values]
        elif layer.kind == "leaky_relu":
            slope = Fraction(layer.slope)
            values = [v if v >= 0 else slope * v for v in values]
        elif layer.kind == "clip":
            values = [_clipped(v, layer.lower, layer.upper) for v in values]
        else:
            return None
    return tuple(values)


def _clipped(value: Fraction, lower: float, upper: float) -> Fraction:
    above = value if lower == -math.inf else max(value, Fraction(lower))
    return above if upper == math.inf else min(above, Fraction(upper))
