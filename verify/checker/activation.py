"""What a line with a given slope leaves of an activation function on an interval.

For any slope m, whoever chose it: the range of ``f(x) - m x`` for x in [l, u]. Its extremes are among the ends, the
points where f bends, and the points inside where f' = m.
"""

from __future__ import annotations

from typing import Any

from flint import arb

from .layers import Activation, clip

HALF, ZERO = arb(1) / 2, arb(0)


def residual(activation: Activation, slope: float, low: Any, high: Any) -> tuple[Any, Any]:
    """Bounds (d, D) with ``d <= f(x) - slope x <= D`` for every x in [low, high].

    Parameters
    ----------
    activation : Activation
    slope : float
    low, high : ball
        Thin.

    Returns
    -------
    pair of balls
        d's lower end and D's upper end are the bounds.
    """
    m = arb(slope)
    match activation.kind:
        case "relu":
            if (slope == 1.0 and bool(low >= 0)) or (slope == 0.0 and bool(high <= 0)):
                return ZERO, ZERO  # the line is the function
            return _piecewise(low, high, m, (arb(0),), lambda x: x.max(arb(0)))
        case "leaky_relu":
            lesser = arb(activation.slope)
            return _piecewise(low, high, m, (arb(0),), lambda x: x.max(arb(0)) + lesser * x.min(arb(0)))
        case "clip":
            return clip_residual(arb(activation.low), arb(activation.high), m, low, high)
        case "tanh":
            return _tanh(low, high, m)
        case "sigmoid":  # sigmoid(x) = 1/2 + tanh(x / 2)/2
            below, above = _tanh(low / 2, high / 2, 4 * m)
            return (1 + below) * HALF, (1 + above) * HALF
    raise AssertionError(f"no such activation: {activation.kind}")


def clip_residual(least: Any, most: Any, m: Any, low: Any, high: Any) -> tuple[Any, Any]:
    """`residual` of ``min(max(x, least), most)`` and a slope m; bounds that are not finite are none."""
    bends = tuple(bound for bound in (least, most) if bool(bound.is_finite()))
    return _piecewise(low, high, m, bends, lambda x: clip(x, least, most))


def _piecewise(low: Any, high: Any, m: Any, bends: tuple[Any, ...], f: Any) -> tuple[Any, Any]:
    places = [low, high, *(bend for bend in bends if not (bend < low or bend > high))]
    return _range([f(x) - m * x for x in places])


def _tanh(low: Any, high: Any, m: Any) -> tuple[Any, Any]:
    """tanh(x) - m x is stationary at +-atanh(sqrt(1 - m)) only, where it is +-(sqrt(1 - m) - m atanh(sqrt(1 - m)))."""
    values = [low.tanh() - m * low, high.tanh() - m * high]
    if 0 < m < 1:
        root = (1 - m).sqrt()
        place = (1 + root).log() - m.log() / 2  # atanh(root), without 1 - root
        value = root - m * place
        values += [value] if not (place < low or place > high) else []
        values += [-value] if not (-place < low or -place > high) else []
    return _range(values)


def _range(values: list[Any]) -> tuple[Any, Any]:
    least = most = values[0]
    for value in values[1:]:
        least, most = least.min(value), most.max(value)
    return least, most
