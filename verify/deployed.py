"""How far the deployed runtime's arithmetic can be from exact real arithmetic on the same weights.

|N_f32(x) - N_real(x)| <= e_L for every x of the enclosed observation set, whatever the summation order, with or without
fused multiply-add: with u = 2^-24 and g_k = k u / (1 - k u),

    e_0 = u |x| + 2^-126 (the cast of the observation),
    affine: e = |W| (e + 2^-126) + g_(k+1) (|W| (mag + e) + |b|) + 2^-126 (k + 1 + |mag + e|_1)
            (the last terms are underflow, denormal numbers flushed to zero or not),
    ReLU, LeakyReLU and Clip are 1-Lipschitz (LeakyReLU: times the slope, plus its rounding), plus 2^-126,
    tanh, sigmoid: e max f' + the runtime's own error (`runtime_error`).

A float64 network uses u = 2^-53 in the same formulas.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation, Affine, Layer
from . import rounding
from .network import LayerBounds
from .runtime_error import runtime_error

Array = NDArray[np.float64]

PRECISIONS = {"float32": (2.0**-24, 2.0**-126), "float64": (2.0**-53, 2.0**-1022)}
"""Unit roundoff and smallest normal number; what is smaller may be flushed to zero anywhere."""


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
    unit, smallest = PRECISIONS[precision]
    runtime = runtime_error(precision)
    first = _magnitude(bounds[0])
    error = rounding.enlarged(unit * first + smallest, 2)
    for layer, seen in zip(layers, bounds, strict=True):
        size = rounding.enlarged(_magnitude(seen) + error, 1)
        if isinstance(layer, Affine):
            error = _affine(layer, size, error, precision)
        else:
            error = _activation(layer, seen, error, unit, smallest, runtime)
    return np.asarray(error)


def _magnitude(seen: LayerBounds) -> Array:
    return np.maximum(np.abs(seen.lower), np.abs(seen.upper))


def _affine(layer: Affine, size: Array, error: Array, precision: str) -> Array:
    """One affine layer.

    A number that the runtime's precision cannot represent (maps of the specification), or that only bounds the file's,
    is rounded once more: its error counts twice, for the rounding and for the distance from the exact number.
    """
    smallest = PRECISIONS[precision][1]
    terms, factor, weight, bias, weight_error, bias_error = _constants(layer, precision)
    # denormal products, sums, inputs and weights may be flushed to zero
    propagated = (error + smallest) @ weight.T + factor * (size @ weight.T + bias)
    propagated = propagated + terms * smallest + smallest * size.sum(-1, keepdims=True)
    if weight_error is not None:
        propagated = propagated + rounding.enlarged(size + error, 1) @ weight_error.T + bias_error
    return rounding.enlarged(propagated, terms + 12)  # type: ignore[no-any-return]


@lru_cache(maxsize=256)
def _constants(layer: Affine, precision: str) -> tuple[int, float, Array, Array, Array | None, Array]:
    """Terms of a sum, its rounding factor g, |W|, |b|, and the conversion errors of W (None where all are 0) and b."""
    unit = PRECISIONS[precision][0]
    terms = layer.weight.shape[1] + 1
    if not terms * unit < 0.5:
        raise AssertionError(f"a sum of {terms} terms in {precision} has no error bound")
    factor = float(rounding.enlarged(np.float64(terms * unit / (1.0 - terms * unit)), 6))
    # onnxruntime may move a factor that is one number into the product beside it, and holds it in float32 there
    held = "float32" if _is_one_factor(layer.weight) else precision
    weight_error = conversion_error(layer.weight, layer.weight_error, held)
    bias_error = conversion_error(layer.bias, layer.bias_error, precision)
    converted = weight_error if weight_error.any() or bias_error.any() else None
    return terms, factor, np.abs(layer.weight), np.abs(layer.bias), converted, bias_error


def _is_one_factor(weight: Array) -> bool:
    """Whether a matrix is a number times the identity, and not just a sign."""
    factor, square = weight[0, 0], weight.shape[0] == weight.shape[1]
    return square and abs(factor) != 1.0 and bool((weight == factor * np.eye(len(weight))).all())


def conversion_error(stored: Array, error: Array | None, precision: str) -> Array:
    """Bound of the distance between the exact number and the one the runtime holds, 0 where both are the stored one."""
    unit, smallest = PRECISIONS[precision]
    inexact = np.zeros_like(stored) if error is None else error
    held = stored.astype(precision).astype(np.float64)
    # the rounding of the stored number, its distance from the exact one, and a denormal number flushed to zero
    bound = rounding.enlarged(2.0 * (inexact + unit * np.abs(stored)) + smallest, 3)
    denormal = (stored != 0.0) & (np.abs(stored) < smallest)
    bound = np.where((inexact == 0.0) & (held == stored) & ~denormal, 0.0, bound)
    return np.where(np.isfinite(held), bound, np.inf)  # too large for the runtime: nothing is known


def _activation(
    layer: Activation, seen: LayerBounds, error: Array, unit: float, smallest: float, runtime: float
) -> Array:
    if layer.kind in ("relu", "clip"):
        return rounding.enlarged(error + smallest, 1)  # type: ignore[no-any-return]
    if layer.kind == "leaky_relu":
        factor = max(1.0, abs(layer.slope))
        size = rounding.enlarged(_magnitude(seen) + error, 1)
        # slope * x is rounded once at run time
        return rounding.enlarged(error * factor + unit * factor * size + smallest, 6)  # type: ignore[no-any-return]
    # tanh' and sigmoid' are largest at the point nearest to zero
    low, high = rounding.down(seen.lower - error), rounding.up(seen.upper + error)
    nearest = np.where((low <= 0.0) & (high >= 0.0), 0.0, np.minimum(np.abs(low), np.abs(high)))
    if layer.kind == "tanh":
        steepest = 1.0 - np.tanh(nearest) ** 2
    else:
        steepest = 0.25 * (1.0 - np.tanh(0.5 * nearest) ** 2)
    steepest = steepest + rounding.elementary_error(np.ones_like(steepest)) * 4.0
    return rounding.enlarged(np.minimum(steepest, 1.0) * error + runtime, 4)  # type: ignore[no-any-return]
