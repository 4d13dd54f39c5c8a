"""Enclosures of curved functions with their derivatives written down, for automatic differentiation to call.

Left to itself it fails where it touches a square root of zero, and records a hundred small operations. The relaxations
are those of `verify.relaxations`; here are their derivatives. With the residual rho(x) = f(x) - m x and its extremes at
x_low and x_high,

    offset = (rho(x_low) + rho(x_high)) / 2,  error = (rho(x_high) - rho(x_low)) / 2,

and by the envelope theorem an extreme moves with the slope by ``-x``, and with an end of the interval by
``f'(x) - m`` where it is that end: inside the interval rho' is zero. Computed in numpy, which is three times as fast as
torch on arrays of this size.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray

from ..models.policy import Activation
from ..verify.relaxations import estimate
from .networks import Tensor

Array = NDArray[np.float64]

RELU, TANH = Activation("relu"), Activation("tanh")

NARROW = 1e-6
"""On narrower intervals the chord's slope moves with half the curvature at each end."""


def relaxed_relu(lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor]:
    """Slope m and half-width d of ReLU on [l, u], with ``relu(x) in m x + d +- d``.

    Parameters
    ----------
    lower, upper : Tensor
        float64, of one shape, lower <= upper.

    Returns
    -------
    tuple of Tensor
        Differentiable by both ends: on a crossing interval m = u / (u - l), d = -m l / 2.
    """
    slope, half = _Relu.apply(lower, upper)
    return slope, half


def relaxed_tanh(lower: Tensor, upper: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Slope, offset and error of tanh on [l, u].

    Parameters
    ----------
    lower, upper : Tensor
        float64, of one shape, lower <= upper.

    Returns
    -------
    tuple of Tensor
        Differentiable by both ends.
    """
    slope, offset, error = _Tanh.apply(lower, upper)
    return slope, offset, error


def enclosed_sincos(center: Tensor, radius: Tensor) -> tuple[tuple[Tensor, ...], tuple[Tensor, ...]]:
    """Enclose sin and cos: ``sin(c + d) in a + m d +- e`` for |d| <= r, m = cos c, and the exact range of the rest.

    Where that range is wider than [-1, 1], m = a = 0 and e = 1.

    Parameters
    ----------
    center, radius : Tensor
        float64, of one shape.

    Returns
    -------
    tuple of tuple of Tensor
        a, m and e of sin, then of cos, differentiable by both.
    """
    found = _SineCosine.apply(center, radius)
    return found[:3], found[3:]


def center_and_radius(terms: Tensor) -> tuple[Tensor, Tensor]:
    """c and |g| 1 of affine forms, (..., 1 + q) to (...) twice; |x| has the derivative 0 at 0."""
    center, radius = _Extent.apply(terms)
    return center, radius


def with_center(terms: Tensor, slope: Tensor, center: Tensor) -> Tensor:
    """Affine forms ``<center, slope g>``, (..., 1 + q), from forms <c, g> and numbers (...)."""
    result: Tensor = _WithCenter.apply(terms, slope, center)
    return result


def _shared(*arrays: Array) -> tuple[Tensor, ...]:
    return tuple(torch.from_numpy(np.ascontiguousarray(array)) for array in arrays)


class _Relu(torch.autograd.Function):  # type: ignore[misc]
    @staticmethod
    def forward(ctx: Any, lower: Tensor, upper: Tensor) -> tuple[Tensor, ...]:
        ctx.low, ctx.high = lower.detach().numpy(), upper.detach().numpy()
        with np.errstate(over="ignore"):
            relaxation = estimate(RELU, ctx.low, ctx.high, np)
        return _shared(relaxation.slope, relaxation.error)

    @staticmethod
    def backward(ctx: Any, by_slope: Tensor, by_half: Tensor) -> tuple[Tensor, ...]:
        crossing = (ctx.low < 0.0) & (ctx.high > 0.0)
        scale = crossing / np.where(crossing, ctx.high - ctx.low, 1.0)
        low, high = ctx.low * scale, ctx.high * scale
        slope, half = by_slope.numpy() * scale, 0.5 * by_half.numpy()
        return _shared(high * (slope - half * high), low * (half * low - slope))


class _Tanh(torch.autograd.Function):  # type: ignore[misc]
    @staticmethod
    def forward(ctx: Any, lower: Tensor, upper: Tensor) -> tuple[Tensor, ...]:
        ctx.low, ctx.high = lower.detach().numpy(), upper.detach().numpy()
        with np.errstate(over="ignore"):
            relaxation = estimate(TANH, ctx.low, ctx.high, np)
        ctx.slope = relaxation.slope
        return _shared(relaxation.slope, relaxation.offset, relaxation.error)

    @staticmethod
    def backward(ctx: Any, by_slope: Tensor, by_offset: Tensor, by_error: Tensor) -> tuple[Tensor, ...]:
        slope = ctx.slope
        ends = np.stack([ctx.low, ctx.high])
        value = np.tanh(ends)
        rate = 1.0 - value * value
        # where the residual is largest and smallest: an end, or where tanh' = slope
        place = np.arctanh(np.sqrt(1.0 - np.clip(slope, 1e-12, 1.0)))
        inner = np.minimum(np.maximum(np.stack([place, -place]), ends[0]), ends[1])
        places = np.concatenate([ends, inner])
        residual = np.concatenate([value, np.tanh(inner)]) - slope * places
        first, last = residual.argmin(0)[None], residual.argmax(0)[None]
        by_low, by_high = 0.5 * (by_offset - by_error).numpy(), 0.5 * (by_offset + by_error).numpy()
        at_low, at_high = (np.take_along_axis(places, which, 0)[0] for which in (first, last))
        moved = by_slope.numpy() - by_low * at_low - by_high * at_high
        number = np.arange(2).reshape(2, *[1] * slope.ndim)
        at_ends = (rate - slope) * ((first == number) * by_low + (last == number) * by_high)
        return _shared(*(at_ends + moved * _slope_rates(ends, value, rate)))


def _slope_rates(ends: Array, value: Array, rate: Array) -> Array:
    """Derivatives of the chord's slope by lower and upper end: the relaxation of tanh has no other but at points."""
    width = ends[1] - ends[0]
    wide = width > NARROW
    safe = np.where(wide, width, 1.0)
    mismatch = (rate - (value[1] - value[0]) / safe) / safe
    return np.where(wide, np.stack([-mismatch[0], mismatch[1]]), -value * rate)


class _SineCosine(torch.autograd.Function):  # type: ignore[misc]
    @staticmethod
    def forward(ctx: Any, center: Tensor, radius: Tensor) -> tuple[Tensor, ...]:
        # cos x = sin(x + pi/2); rho(d) = sin(c + d) - sin c - d cos c is extreme at the ends, and where
        # cos(c + d) = cos c: at d = 0, and at -2 c up to whole turns
        c, r = center.detach().numpy(), radius.detach().numpy()
        c = np.stack([c, c + 0.5 * np.pi])
        value, slope = np.sin(c), np.cos(c)
        mirrored = np.remainder(np.pi - 2.0 * c, 2.0 * np.pi) - np.pi
        places = np.zeros((5, *c.shape))
        places[0], places[1] = r, -r
        places[2], places[3] = mirrored, mirrored - np.copysign(2.0 * np.pi, mirrored)
        places[2:4] = np.minimum(np.maximum(places[2:4], -r), r)
        residual = np.sin(c + places) - value - slope * places
        first, last = residual.argmin(0)[None], residual.argmax(0)[None]
        low, high = np.take_along_axis(residual, first, 0)[0], np.take_along_axis(residual, last, 0)[0]
        half = 0.5 * (high - low)
        ctx.fine = half <= 1.0
        ctx.kept = c, r, value, slope, *(np.take_along_axis(places, which, 0)[0] for which in (first, last))
        middle = np.where(ctx.fine, value + 0.5 * (low + high), 0.0)
        slope, half = np.where(ctx.fine, slope, 0.0), np.where(ctx.fine, half, 1.0)
        return _shared(middle[0], slope[0], half[0], middle[1], slope[1], half[1])

    @staticmethod
    def backward(ctx: Any, *by: Tensor) -> tuple[Tensor, ...]:
        c, r, value, slope, *places = ctx.kept
        middle, tilt, half = (np.stack([by[i].numpy(), by[i + 3].numpy()]) * ctx.fine for i in range(3))
        by_center, by_radius = middle * slope - tilt * value, np.zeros_like(c)
        for place, by_extreme in zip(places, (0.5 * (middle - half), 0.5 * (middle + half)), strict=True):
            rate = np.cos(c + place) - slope
            by_center += by_extreme * (rate + value * place)
            by_radius += by_extreme * rate * ((place == r) * 1.0 - (place == -r)) * (r > 0.0)
        return _shared(by_center.sum(0), by_radius.sum(0))


class _Extent(torch.autograd.Function):  # type: ignore[misc]
    @staticmethod
    def forward(ctx: Any, terms: Tensor) -> tuple[Tensor, ...]:
        ctx.save_for_backward(terms)
        return terms[..., 0].clone(), terms[..., 1:].abs().sum(-1)

    @staticmethod
    def backward(ctx: Any, by_center: Tensor, by_radius: Tensor) -> Tensor:
        (terms,) = ctx.saved_tensors
        result = terms.sgn().mul_(by_radius[..., None])
        result[..., 0] = by_center
        return result


class _WithCenter(torch.autograd.Function):  # type: ignore[misc]
    @staticmethod
    def forward(ctx: Any, terms: Tensor, slope: Tensor, center: Tensor) -> Tensor:
        ctx.save_for_backward(terms, slope)
        result = terms * slope[..., None]
        result[..., 0] = center
        return result

    @staticmethod
    def backward(ctx: Any, by_terms: Tensor) -> tuple[Tensor, ...]:
        terms, slope = ctx.saved_tensors
        result = by_terms * slope[..., None]
        result[..., 0] = 0.0
        return result, (by_terms[..., 1:] * terms[..., 1:]).sum(-1), by_terms[..., 0].clone()
