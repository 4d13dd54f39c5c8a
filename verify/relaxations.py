"""Linear enclosures of activations on an interval, written once for numpy (proofs) and torch (training).

For every neuron: any float slope m, then rigorous bounds d <= f(x) - m x <= D on [l, u]. The functions use only the
Python array API standard, on arrays of float64 (for proofs) or of whatever the trainer propagates.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from ..models.policy import Activation
from . import rounding


@dataclass(frozen=True)
class Relaxation:
    """Linear enclosure of an activation on an interval.

    For every x in [lower, upper]:  slope * x + offset - error <= f(x) <= slope * x + offset + error.

    Attributes
    ----------
    slope, offset, error : array, shape (..., n)
        One entry per neuron; error >= 0 and already rounded upward.

    References
    ----------
    .. [1] Singh et al., "Fast and effective robustness certification", NeurIPS 2018, Thm. 3.2.
    """

    slope: Any
    offset: Any
    error: Any


def namespace(x: Any) -> Any:
    """Array API namespace of an array."""
    if hasattr(x, "__array_namespace__"):
        return x.__array_namespace__()
    import array_api_compat

    return array_api_compat.array_namespace(x)


def _from_bounds(xp: Any, slope: Any, low: Any, high: Any) -> Relaxation:
    """Relaxation whose residual f(x) - slope x lies in [low, high]."""
    offset = 0.5 * low + 0.5 * high
    width = xp.maximum(high - offset, offset - low)
    error = rounding.enlarged(width + rounding.relative_error(offset, 2), 3)
    return Relaxation(slope, offset, xp.where((low == 0) & (high == 0), xp.zeros_like(error), error))


def _piecewise_linear(
    point: Callable[[Any], Any], breakpoints: tuple[float, ...], lower: Any, upper: Any, xp: Any
) -> Relaxation:
    """Chord slope."""
    width = upper - lower
    positive = width > 0
    safe = xp.where(positive, width, xp.ones_like(width))
    low_value, high_value = point(lower), point(upper)
    tiny = 0.5 * (lower + upper)
    flat = point(tiny + 1.0) - point(tiny)  # any float is a sound slope
    slope = xp.where(positive, (high_value - low_value) / safe, flat)
    slope = xp.where(xp.isfinite(slope), slope, xp.zeros_like(slope))
    return _from_bounds(xp, slope, *_piecewise_residual(point, breakpoints, slope, lower, upper, xp))


def _piecewise_residual(
    point: Callable[[Any], Any], breakpoints: tuple[float, ...], slope: Any, lower: Any, upper: Any, xp: Any
) -> tuple[Any, Any]:
    """Bounds of f(x) - m x: it is piecewise linear, so its extremes are at the ends and the breakpoints inside."""
    low, high = None, None
    for x in (lower, upper, *breakpoints):
        if isinstance(x, float):
            inside = (lower < x) & (x < upper)
            place = xp.where(inside, xp.full_like(lower, x), lower)
        else:
            place = x
        value = point(place)
        product = slope * place
        residual = value - product
        # f is exact at a breakpoint or rounded once; so is the product, and so is the difference
        error = (
            rounding.relative_error(value, 1)
            + rounding.relative_error(product, 1)
            + rounding.relative_error(residual, 1)
        )
        exactly = (value == product) & ((slope == 0.0) | (slope == 1.0))
        error = xp.where(exactly, xp.zeros_like(error), rounding.enlarged(error, 3))
        low = residual - error if low is None else xp.minimum(low, residual - error)
        high = residual + error if high is None else xp.maximum(high, residual + error)
    return low, high


def _tanh(lower: Any, upper: Any, xp: Any) -> Relaxation:
    """Chord slope and parallel slope min(f'(l), f'(u)); per neuron the one with the smaller error."""
    ends = xp.minimum(_tanh_slope(lower, xp), _tanh_slope(upper, xp))
    slopes = xp.stack([_chord_slope(lower, upper, xp), ends])
    both = _tanh_with_slope(slopes, lower, upper, xp)
    better = both.error[0, ...] <= both.error[1, ...]
    return Relaxation(
        xp.where(better, both.slope[0, ...], both.slope[1, ...]),
        xp.where(better, both.offset[0, ...], both.offset[1, ...]),
        xp.where(better, both.error[0, ...], both.error[1, ...]),
    )


def _between(x: Any, low: Any, high: Any, xp: Any) -> Any:
    """x clipped to [low, high]; two comparisons are several times faster than clip on small arrays."""
    return xp.minimum(xp.maximum(x, low), high)


def _tanh_slope(x: Any, xp: Any) -> Any:
    value = xp.tanh(x)
    return (1.0 - value) * (1.0 + value)


def _chord_slope(lower: Any, upper: Any, xp: Any) -> Any:
    width = upper - lower
    positive = width > 0
    safe = xp.where(positive, width, xp.ones_like(width))
    chord = (xp.tanh(upper) - xp.tanh(lower)) / safe
    return xp.where(positive, chord, _tanh_slope(lower, xp))


def _tanh_with_slope(slope: Any, lower: Any, upper: Any, xp: Any) -> Relaxation:
    """Relaxation of given slopes (a leading axis of alternatives is allowed)."""
    slope = _between(slope, xp.zeros_like(slope), xp.ones_like(slope), xp)
    return _from_bounds(xp, slope, *_tanh_residual(slope, lower, upper, xp))


def _tanh_residual(slope: Any, lower: Any, upper: Any, xp: Any) -> tuple[Any, Any]:
    """Bounds of tanh(x) - m x for given slopes (a leading axis of alternatives is allowed).

    tanh is concave for x >= 0: there the residual's minimum is at an end, and its maximum is bounded by the tangent at
    any p >= 0: ``f(x) - m x <= f(p) - m p + (f'(p) - m) (x - p)``; p near atanh(sqrt(1 - m)), where f' = m, makes the
    last term vanish, and so does an end of the interval that lies before that place. For x <= 0 the same holds for
    -tanh(-x).
    """
    # the place where f' = m, and any place is sound; for m < 2^-50 the root rounds to 1, for m > 1 there is none
    usable = slope > 2.0**-50
    one = xp.ones_like(slope)
    root = xp.sqrt(1.0 - xp.where(usable, xp.minimum(slope, one), one))
    place = xp.where(usable, xp.atanh(root), xp.full_like(root, 20.0))
    zero = xp.zeros_like(slope)
    ends = xp.stack([lower + zero, upper + zero])
    below, above = _residual(ends, slope, xp)
    low, high = xp.minimum(below[0, ...], below[1, ...]), xp.maximum(above[0, ...], above[1, ...])
    straddles = (lower < 0) & (upper > 0)
    low = xp.where(straddles, xp.minimum(low, zero), low)
    high = xp.where(straddles, xp.maximum(high, zero), high)
    # concave part, x in [max(l, 0), u]; convex part, x in [l, min(u, 0)], by symmetry
    start = xp.maximum(xp.stack([lower + zero, -upper + zero]), zero)
    stop = xp.maximum(xp.stack([upper + zero, -lower + zero]), zero)
    tangent = _tangent_bound(_between(place, start, stop, xp), slope, start, stop, xp)
    high = xp.where(upper > 0, xp.maximum(high, tangent[0, ...]), high)
    low = xp.where(lower < 0, xp.minimum(low, -tangent[1, ...]), low)
    return low, high


def _residual(x: Any, slope: Any, xp: Any) -> tuple[Any, Any]:
    """Lower and upper bound of tanh(x) - m x at a float x."""
    value = xp.tanh(x)
    product = slope * x
    residual = value - product
    error = (
        rounding.elementary_error(value) + rounding.relative_error(product, 1) + rounding.relative_error(residual, 1)
    )
    error = rounding.enlarged(error, 4)
    return residual - 2.0 * error, residual + 2.0 * error


def _tangent_bound(p: Any, slope: Any, start: Any, stop: Any, xp: Any) -> Any:
    """Upper bound of tanh(x) - m x for x in [start, stop], 0 <= start <= p <= stop, from the tangent at p."""
    value = xp.tanh(p)
    derivative = (1.0 - value) * (1.0 + value)
    # |d(1 - t^2)| <= 2 |dt|: the elementary error of tanh enters absolutely, not relative to the derivative
    mismatch, error = derivative - slope, 4.0 * rounding.elementary_error(1.0)
    zero = xp.zeros_like(mismatch)
    # where the residual still rises at p, what lies behind p is above it; where it falls, what lies before p
    beyond = xp.maximum(mismatch + error, zero) * (stop - p) + xp.maximum(error - mismatch, zero) * (p - start)
    top = _residual(p, slope, xp)[1]
    return top + rounding.enlarged(beyond, 7) + rounding.relative_error(top, 2)


def _sigmoid(lower: Any, upper: Any, xp: Any) -> Relaxation:
    """sigmoid(x) = 1/2 + tanh(x / 2) / 2: the relaxation of tanh, scaled by powers of two."""
    inner = _tanh(0.5 * lower, 0.5 * upper, xp)
    offset = 0.5 + 0.5 * inner.offset
    error = rounding.enlarged(0.5 * inner.error + rounding.relative_error(offset, 1), 2)
    return Relaxation(0.25 * inner.slope, offset, error)


def _relu(lower: Any, upper: Any, xp: Any) -> Relaxation:
    """m = u / (u - l); f - m x lies in [0, max(-m l, (1 - m) u)] for any m in [0, 1], so m needs no care."""
    crossing = (lower < 0) & (upper > 0)
    zero, one = xp.zeros_like(lower), xp.ones_like(lower)
    # bounds that are not ordered numbers give no relaxation: NaN, never a neuron that is called inactive
    stable = xp.where(lower >= 0, one, xp.where(upper <= 0, zero, xp.full_like(lower, xp.nan)))
    chord = upper / xp.where(crossing, upper - lower, one)
    slope = xp.where(crossing, _between(chord, zero, one, xp), stable)
    top = rounding.enlarged(xp.maximum(-slope * lower, (1.0 - slope) * upper), 3)
    half = xp.where(crossing, 0.5 * top, 0.0 * stable)
    return Relaxation(slope, half, half)


def relax(activation: Activation, lower: Any, upper: Any) -> Relaxation:
    """Relaxation of an activation on ``[lower, upper]``, arrays of shape (..., n).

    Parameters
    ----------
    activation : Activation
    lower, upper : array, shape (..., n)
        Pre-activation bounds, lower <= upper.

    Returns
    -------
    Relaxation
        Non-finite where the bounds are not finite.
    """
    xp = namespace(lower)
    match activation.kind:
        case "relu":
            return _relu(lower, upper, xp)
        case "tanh":
            return _tanh(lower, upper, xp)
        case "sigmoid":
            return _sigmoid(lower, upper, xp)
        case "leaky_relu" | "clip":
            return _piecewise_linear(*_pieces(activation, xp), lower, upper, xp)
    raise AssertionError(f"no relaxation for {activation.kind}")


def _pieces(activation: Activation, xp: Any) -> tuple[Callable[[Any], Any], tuple[float, ...]]:
    """A piecewise linear activation and its finite breakpoints."""
    match activation.kind:
        case "relu":
            return lambda x: xp.maximum(x, xp.zeros_like(x)), (0.0,)
        case "leaky_relu":
            return lambda x: xp.where(x >= 0, x, activation.slope * x), (0.0,)
    low, high = activation.lower, activation.upper
    return lambda x: xp.clip(x, low, high), tuple(float(b) for b in (low, high) if abs(b) != float("inf"))


def residual_bounds(activation: Activation, slope: Any, lower: Any, upper: Any) -> tuple[Any, Any]:
    """Bounds (d, D) with ``d <= f(x) - m x <= D`` for every x in [lower, upper], whatever the slopes m are.

    Rounding included: ``m x + d`` is a line below the activation on the interval, and ``m x + D`` one above.

    Parameters
    ----------
    activation : Activation
    slope : array, shape (..., n)
        Any floats; leading axes of alternatives are allowed.
    lower, upper : array, shape (..., n)
        Bounds of x, lower <= upper.

    Returns
    -------
    pair of arrays
        Of the slopes' shape; not finite where the bounds or slopes are not.
    """
    xp = namespace(lower)
    match activation.kind:
        case "tanh":
            return _tanh_residual(slope, lower, upper, xp)
        case "sigmoid":  # sigmoid(x) - m x = 1/2 + (tanh(x / 2) - 4 m x / 2) / 2
            low, high = _tanh_residual(4.0 * slope, 0.5 * lower, 0.5 * upper, xp)
            low, high = 0.5 + 0.5 * low, 0.5 + 0.5 * high
            return low - rounding.relative_error(low, 3), high + rounding.relative_error(high, 3)
        case "relu" | "leaky_relu" | "clip":
            return _piecewise_residual(*_pieces(activation, xp), slope, lower, upper, xp)
    raise AssertionError(f"no relaxation for {activation.kind}")


def estimate(activation: Activation, lower: Any, upper: Any, xp: Any) -> Relaxation:
    """What `relax` returns up to rounding, in a fraction of its time: for training, where nothing rests on it.

    Without the rounding terms, hence without the selections that keep stable neurons free of them: only arithmetic and
    comparisons that return numbers. Differentiable wherever the relaxation is.

    Parameters
    ----------
    activation : Activation
        relu or tanh, the activations of networks that are trained here.
    lower, upper : array, shape (..., n)
        Ordered and finite.
    xp : module
        Array API namespace of the bounds.

    Returns
    -------
    Relaxation
    """
    limits = xp.finfo(lower.dtype)
    tiny = float(limits.tiny)
    width = xp.clip(upper - lower, min=tiny)
    if activation.kind == "relu":
        slope = xp.clip(upper / width, min=0.0, max=1.0)
        error = xp.clip(-0.5 * slope * lower, min=0.0)  # -m l = (1 - m) u for the chord; 0 where it is stable
        return Relaxation(slope, error, error)
    assert activation.kind == "tanh", activation.kind
    low_value, high_value = xp.tanh(lower), xp.tanh(upper)
    # the chord, never worse than a slope of the ends; a point has no chord, there the derivative
    chord = (high_value - low_value) / width
    slope = xp.clip(xp.where(upper > lower, chord, 1.0 - low_value * high_value), min=0.0, max=1.0)
    # where the derivative is the slope, and at -place
    place = xp.atanh(xp.clip(xp.sqrt(1.0 - slope), max=1.0 - float(limits.eps)))
    points = xp.stack([lower, upper, _between(place, lower, upper, xp), _between(-place, lower, upper, xp)])
    residual = xp.tanh(points) - slope * points
    ends, inner = residual[:2, ...], residual[2:, ...]
    low, high = xp.minimum(ends, inner), xp.maximum(ends, inner)
    low, high = xp.minimum(low[0, ...], low[1, ...]), xp.maximum(high[0, ...], high[1, ...])
    return Relaxation(slope, 0.5 * (low + high), 0.5 * (high - low))
