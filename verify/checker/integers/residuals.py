"""What a line of a given slope leaves of an activation function on an interval, and the function's own range there.

For any slope m: bounds of ``f(x) - m x`` for x in [low, high]. A piecewise linear f has its extremes at the ends and at
the bends inside. For tanh, ``f'(x) = m`` with 0 < m < 1 only at ``x = +-p``, ``tanh p = root = sqrt(1 - m)``,

    p = atanh root = log(1 + root) - (log m)/2,    f(p) - m p = root - m p,

so that no difference of nearly equal numbers is formed. ``sigmoid(x) = 1/2 + tanh(x/2)/2``.
"""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from ..layers import Activation
from .elementary import logarithm, square_root, tanh
from .fixed import Factor, Interval, enclosure, shifted_up


def residual(activation: Activation, slope: Factor, low: int, high: int, bits: int) -> Interval:
    """Bounds (d, D) with ``d <= f(x) - slope x <= D`` for every x in [low, high].

    With slope 0 that is the range of f.

    Parameters
    ----------
    activation : Activation
    slope : Factor
        Exact.
    low, high : int
        At `bits`.
    bits : int

    Returns
    -------
    pair of int
        At `bits`.
    """
    match activation.kind:
        case "relu" | "leaky_relu":
            values = [(0, 0)] if low <= 0 <= high else []
            for x in (low, high):
                value = Factor.of(activation.slope).times((x, x)) if x < 0 else (x, x)
                values.append(_minus(value, slope.times((x, x))))
            return _hull(values)
        case "clip":
            return clip_residual((activation.low, activation.high), slope, low, high, bits)
        case "tanh":
            return _tanh(slope, low, high, bits)
        case "sigmoid":  # tanh(y) - 4 m y for y = x/2, which is x at one more bit
            below, above = _tanh(Factor(4 * slope.n, slope.scale), low, high, bits + 1)
            one = 2 << bits
            return one + below >> 2, shifted_up(one + above, 2)
    raise AssertionError(f"no such activation: {activation.kind}")


def clip_residual(
    bounds: tuple[float | Fraction, float | Fraction], slope: Factor, low: int, high: int, bits: int
) -> Interval:
    """`residual` of ``min(max(x, bounds[0]), bounds[1])``; infinite bounds are none."""
    least, most = (None if abs(bound) == float("inf") else enclosure(bound, bits) for bound in bounds)
    bends = [bend for bend in (least, most) if bend is not None]
    places = [(low, low), (high, high), *(bend for bend in bends if bend[1] >= low and bend[0] <= high)]
    values = []
    for place in places:
        value = place
        if least is not None:
            value = max(value[0], least[0]), max(value[1], least[1])
        if most is not None:
            value = min(value[0], most[0]), min(value[1], most[1])
        values.append(_minus(value, slope.times(place)))
    return _hull(values)


def _tanh(slope: Factor, low: int, high: int, bits: int) -> Interval:
    values = [_minus(tanh(x, bits), slope.times((x, x))) for x in (low, high)]
    if 0 < slope.n < 1 << slope.scale:
        root = square_root((1 << slope.scale) - slope.n, slope.scale, bits)
        logs = [logarithm((1 << bits) + end, bits, bits) for end in root]
        log = logarithm(slope.n, slope.scale, bits)
        place = logs[0][0] - shifted_up(log[1], 1), logs[1][1] - (log[0] >> 1)
        value = _minus(root, slope.times(place))
        if place[1] >= low and place[0] <= high:
            values.append(value)
        if -place[0] >= low and -place[1] <= high:
            values.append((-value[1], -value[0]))
    return _hull(values)


def _minus(x: Interval, y: Interval) -> Interval:
    return x[0] - y[1], x[1] - y[0]


def _hull(values: Sequence[Interval]) -> Interval:
    return min(low for low, _ in values), max(high for _, high in values)
