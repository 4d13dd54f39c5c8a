"""Two lines per neuron: one below its activation and one above, on a range.

The slopes are a choice, any numbers are sound; the offsets are proved for them.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation, activate
from . import rounding
from .relaxations import residual_bounds

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Lines:
    """Lines around an activation: ``lower_slope x + lower_offset <= f(x) <= upper_slope x + upper_offset`` on a range.

    Attributes
    ----------
    lower_slope, lower_offset, upper_slope, upper_offset : array, shape (B, n)
    """

    lower_slope: Array
    lower_offset: Array
    upper_slope: Array
    upper_offset: Array

    @property
    def steepness(self) -> Array:
        """The larger of both slopes' magnitudes, shape (B, n)."""
        return np.maximum(np.abs(self.lower_slope), np.abs(self.upper_slope))

    @property
    def height(self) -> Array:
        """The larger of both offsets' magnitudes, shape (B, n)."""
        return np.maximum(np.abs(self.lower_offset), np.abs(self.upper_offset))


def lines_with(activation: Activation, lower_slope: Array, upper_slope: Array, low: Array, high: Array) -> Lines:
    """The closest lines of given slopes on [low, high], arrays of shape (B, n)."""
    with np.errstate(invalid="ignore", over="ignore"):
        least, most = residual_bounds(activation, np.stack([lower_slope, upper_slope]), low, high)
    return Lines(lower_slope, least[0], upper_slope, most[1])


def usual_lines(activation: Activation, low: Array, high: Array) -> Lines:
    """Lines of the usual slopes [1]_: chords, tangents, and for a ReLU that bends the half with more of its range.

    Parameters
    ----------
    activation : Activation
    low, high : array, shape (B, n)
        The range, low <= high.

    Returns
    -------
    Lines
        Not finite where the range is not.

    References
    ----------
    .. [1] Zhang et al., "Efficient neural network robustness certification with general activation functions",
       NeurIPS 2018, Table 1 and 2.
    """
    with np.errstate(invalid="ignore", over="ignore"):
        below, above = usual_slopes(activation, low, high)
    return lines_with(activation, below, above, low, high)


def usual_slopes(activation: Activation, low: Array, high: Array) -> tuple[Array, Array]:
    """Slopes of `usual_lines`: of the lines below and above, shape (B, n)."""
    match activation.kind:
        case "relu" | "leaky_relu":
            return _bent_slopes(activation, low, high)
        case "clip":
            return _clip_slopes(activation, low, high)
        case "tanh":
            return _tanh_slopes(low, high)
        case "sigmoid":
            below, above = _tanh_slopes(0.5 * low, 0.5 * high)
            return 0.25 * below, 0.25 * above
    raise AssertionError(f"no lines for {activation.kind}")


def sensible_slopes(activation: Activation, low: Array, high: Array) -> tuple[tuple[Array, Array], ...]:
    """Intervals of slopes that may be of use, for the lines below and above; none is longer than a point where a
    neuron is stable.
    """
    across = chord(activation, low, high)
    below, above = usual_slopes(activation, low, high)
    choices = [[below, across], [above, across]]
    if activation.kind in ("relu", "leaky_relu"):
        flat = activation.slope if activation.kind == "leaky_relu" else 0.0
        bends = (low < 0.0) & (high > 0.0)
        choices[flat > 1.0] += [np.where(bends, flat, below), np.where(bends, 1.0, below)]
    elif activation.kind in ("tanh", "sigmoid"):
        choices[0].append(np.where(low < 0.0, _derivative(activation, low), below))
        choices[1].append(np.where(high > 0.0, _derivative(activation, high), above))
    return tuple((np.minimum.reduce(side), np.maximum.reduce(side)) for side in choices)


def _derivative(activation: Activation, x: Array) -> Array:
    scale = 1.0 if activation.kind == "tanh" else 0.5
    value = np.tanh(scale * x)
    return scale * scale * (1.0 - value) * (1.0 + value)


def chord(activation: Activation, low: Array, high: Array) -> Array:
    """Slope from end to end; 0 where the range is a point."""
    return ratio(activate(activation, high) - activate(activation, low), high - low)


def ratio(rise: Array, run: Array) -> Array:
    """Rise over run; 0 where there is no run, or no number."""
    positive = run > 0.0
    slope = rise / np.where(positive, run, 1.0)
    return np.where(positive & np.isfinite(slope), slope, 0.0)


def _bent_slopes(activation: Activation, low: Array, high: Array) -> tuple[Array, Array]:
    flat = activation.slope if activation.kind == "leaky_relu" else 0.0
    stable = np.where(low >= 0.0, 1.0, flat)
    bends = (low < 0.0) & (high > 0.0)
    across = np.where(bends, chord(activation, low, high), stable)
    half = np.where(bends, np.where(high > -low, 1.0, flat), stable)
    return (half, across) if flat <= 1.0 else (across, half)


def _clip_slopes(activation: Activation, low: Array, high: Array) -> tuple[Array, Array]:
    """From an end of the range to the bend that is farther from it."""
    first, last = np.clip(low, activation.lower, activation.upper), np.clip(high, activation.lower, activation.upper)
    bottom, top = np.maximum(low, activation.lower), np.minimum(high, activation.upper)
    # with one bend only, the line on the bend's own side is the half with more of the range
    rises = (high - bottom > bottom - low) | (low >= activation.lower)
    below = np.where(rises, ratio(last - first, high - bottom), 0.0)
    rises = (top - low > high - top) | (high <= activation.upper)
    above = np.where(rises, ratio(last - first, top - low), 0.0)
    return below, above


def _tanh_slopes(low: Array, high: Array) -> tuple[Array, Array]:
    """Of the lines that leave least in the middle of the range.

    Where tanh bends one way only they are the chord and the tangent in the middle. Else it is that tangent where it is
    on its side of tanh everywhere, and where it is not, the one through the far end.
    """
    across = chord(Activation("tanh"), low, high)
    middle = 0.5 * low + 0.5 * high
    value = np.tanh(middle)
    tangent = (1.0 - value) * (1.0 + value)
    bends = (low < 0.0) & (high > 0.0)
    below = np.where(bends, _tangent_slope(-high, -low), np.where(high <= 0.0, tangent, across))
    above = np.where(bends, _tangent_slope(low, high), np.where(low >= 0.0, tangent, across))
    return (
        np.where(bends & (middle < 0.0), np.minimum(below, tangent), below),
        np.where(bends & (middle > 0.0), np.minimum(above, tangent), above),
    )


def _tangent_slope(low: Array, high: Array) -> Array:
    """Slope of the line from (low, tanh low), low < 0, that touches tanh within [0, high], or ends at high.

    It is the steepest one to any of these points; steps of Newton's kind, to the place where tanh' is the slope, from
    the one where the line would touch x - x^3/3.
    """
    place, start = np.minimum(high, -0.5 * low), np.tanh(low)
    slope = ratio(np.tanh(place) - start, place - low)
    for _ in range(4):
        root = np.sqrt(1.0 - np.clip(slope, 2.0**-50, 1.0))
        place = np.clip(np.arctanh(root), 0.0, np.maximum(high, 0.0))
        slope = np.fmax(slope, ratio(np.tanh(place) - start, place - low))
    return slope


def image(activation: Activation, low: Array, high: Array) -> tuple[Array, Array]:
    """Bounds of the activation on [low, high], rounding included; all activations are monotone."""
    ends = activate(activation, low), activate(activation, high)
    least, most = np.minimum(*ends), np.maximum(*ends)
    return (
        np.asarray(rounding.lower(least, rounding.elementary_error(1.0 + np.abs(least)))),
        np.asarray(rounding.upper(most, rounding.elementary_error(1.0 + np.abs(most)))),
    )
