"""How far the deployed runtime's arithmetic can be from exact real arithmetic on the same weights.

|N_f32(x) - N_real(x)| <= e_L for every x of the enclosed observation set, whatever the summation order, with or without
fused multiply-add: with u = 2^-24 and g_k = k u / (1 - k u),

    e_0 = u |x| (the cast of the observation),
    affine: e = |W| e + g_(k+1) (|W| (mag + e) + |b|) + (k + 1) 2^-126 (underflow, flushed or not),
    ReLU, LeakyReLU and Clip are 1-Lipschitz (LeakyReLU: times the slope, plus its rounding),
    tanh, sigmoid: e max f' + the runtime's own error.

A float64 network uses u = 2^-53 in the same formulas.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation, Affine, Layer
from . import rounding
from .network import LayerBounds

Array = NDArray[np.float64]

PRECISIONS = {"float32": (2.0**-24, 2.0**-126, 2.0**-149), "float64": (2.0**-53, 2.0**-1022, 2.0**-1074)}
RUNTIME_ERROR = {"float32": 2.0**-21, "float64": 2.0**-50}
"""Absolute error of the runtime's own tanh and sigmoid: measured on onnxruntime 1.31; the claim names that version."""


def deployed_error(layers: Sequence[Layer], bounds: Sequence[LayerBounds], precision: str) -> Array:
    """Bound e_L of the difference between deployed and exact outputs.

    Parameters
    ----------
    layers : sequence of Affine and Activation
    bounds : sequence of LayerBounds
        Input interval of every layer in exact arithmetic, shape (B, n) each.
    precision : {"float32", "float64"}

    Returns
    -------
    array, shape (B, outputs)
    """
    unit, smallest, subnormal = PRECISIONS[precision]
    first = _magnitude(bounds[0])
    error = rounding.enlarged(unit * first + subnormal, 2)
    for layer, seen in zip(layers, bounds, strict=True):
        size = rounding.enlarged(_magnitude(seen) + error, 1)
        if isinstance(layer, Affine):
            error = _affine(layer, size, error, unit, smallest)
        else:
            error = _activation(layer, seen, error, unit, subnormal, RUNTIME_ERROR[precision])
    return np.asarray(error)


def _magnitude(seen: LayerBounds) -> Array:
    return np.maximum(np.abs(seen.lower), np.abs(seen.upper))


def _affine(layer: Affine, size: Array, error: Array, unit: float, smallest: float) -> Array:
    """One affine layer; where a stored number only bounds the file's, the runtime may be off by the whole bound."""
    terms = layer.weight.shape[1] + 1
    weight, bias = np.abs(layer.weight), np.abs(layer.bias)
    summation = rounding.enlarged(np.float64(terms * unit / (1.0 - terms * unit)), 6)
    propagated = error @ weight.T + summation * (size @ weight.T + bias) + terms * smallest
    if layer.weight_error is not None or layer.bias_error is not None:
        weight_error = np.zeros_like(weight) if layer.weight_error is None else layer.weight_error
        bias_error = np.zeros_like(bias) if layer.bias_error is None else layer.bias_error
        rounded = rounding.enlarged(2.0 * (weight_error + unit * weight), 3)
        propagated = propagated + size @ rounded.T + 2.0 * (bias_error + unit * bias)
    return rounding.enlarged(propagated, terms + 12)  # type: ignore[no-any-return]


def _activation(
    layer: Activation, seen: LayerBounds, error: Array, unit: float, subnormal: float, runtime: float
) -> Array:
    if layer.kind in ("relu", "clip"):
        return error
    if layer.kind == "leaky_relu":
        factor = max(1.0, abs(layer.slope))
        size = rounding.enlarged(_magnitude(seen) + error, 1)
        # slope * x is rounded once at run time
        return rounding.enlarged(error * factor + unit * factor * size + subnormal, 6)  # type: ignore[no-any-return]
    # tanh' and sigmoid' are largest at the point nearest to zero
    low, high = rounding.down(seen.lower - error), rounding.up(seen.upper + error)
    nearest = np.where((low <= 0.0) & (high >= 0.0), 0.0, np.minimum(np.abs(low), np.abs(high)))
    if layer.kind == "tanh":
        steepest = 1.0 - np.tanh(nearest) ** 2
    else:
        steepest = 0.25 * (1.0 - np.tanh(0.5 * nearest) ** 2)
    steepest = steepest + rounding.elementary_error(np.ones_like(steepest)) * 4.0
    return rounding.enlarged(np.minimum(steepest, 1.0) * error + runtime, 4)  # type: ignore[no-any-return]
