"""Jets: the value, the gradient and the upper triangle of the Hessian of a function, each as a ball.

A jet of order 0, 1 or 2 in d variables has C = 1, 1 + d or 1 + d + d (d + 1)/2 entries; arrays have shape (..., C).
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from . import balls, rounding
from .balls import Ball

Array = NDArray[np.float64]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class JetSpace:
    """Layout of jets of one order in d variables, and the pairs of entries whose products make up a product.

    Attributes
    ----------
    order, dimension : int
    size : int
        C, entries of a jet.
    left, right : array, shape (P,)
        The product's entry c is the sum of ``a[left[p]] * b[right[p]]`` over the pairs p of segment c.
    starts : array, shape (C,)
        First pair of each segment.
    rows, columns : array
        Hessian entry h (position 1 + d + h) is the derivative by variables rows[h] <= columns[h].
    """

    order: int
    dimension: int
    size: int
    left: Indices
    right: Indices
    starts: Indices
    rows: Indices
    columns: Indices

    @property
    def gradient(self) -> slice:
        """Entries of the gradient."""
        return slice(1, 1 + self.dimension)

    @property
    def hessian(self) -> slice:
        """Entries of the Hessian's upper triangle, row by row."""
        return slice(1 + self.dimension, self.size)


@lru_cache(maxsize=64)
def jet_space(order: int, dimension: int) -> JetSpace:
    """The layout for jets of order 0, 1 or 2 in `dimension` variables."""
    pairs: list[list[tuple[int, int]]] = [[(0, 0)]]
    rows, columns = np.triu_indices(dimension)
    if order >= 1:
        pairs += [[(0, 1 + i), (1 + i, 0)] for i in range(dimension)]
    if order == 2:
        for h, (i, j) in enumerate(zip(rows.tolist(), columns.tolist(), strict=True)):
            entry = 1 + dimension + h
            pairs.append([(0, entry), (entry, 0), (1 + i, 1 + j), (1 + j, 1 + i)])
    flat = [pair for segment in pairs for pair in segment]
    starts = np.cumsum([0] + [len(segment) for segment in pairs[:-1]])
    return JetSpace(
        order,
        dimension,
        len(pairs),
        np.array([p[0] for p in flat], dtype=np.intp),
        np.array([p[1] for p in flat], dtype=np.intp),
        starts.astype(np.intp),
        rows.astype(np.intp) if order == 2 else np.zeros(0, np.intp),
        columns.astype(np.intp) if order == 2 else np.zeros(0, np.intp),
    )


def jet_product(space: JetSpace, a: Ball, b: Ball) -> Ball:
    """Product of two jets of shape (..., C) by the product rule."""
    left, left_rad = a.mid[..., space.left], a.rad[..., space.left]
    right, right_rad = b.mid[..., space.right], b.rad[..., space.right]
    left_abs, right_abs = np.abs(left), np.abs(right)
    mid = np.add.reduceat(left * right, space.starts, axis=-1)
    spread = left_abs * (right_rad + rounding.sum_error(8, right_abs)) + left_rad * (right_abs + right_rad)
    return Ball(mid, rounding.enlarged(np.add.reduceat(spread, space.starts, axis=-1), 12))


def compose(space: JetSpace, a: Ball, value: Ball, first: Ball, second: Ball) -> Ball:
    """Jet of f(a): value f, gradient f' g, Hessian f'' g g' + f' H, for f, f', f'' as balls of shape (..., 1)."""
    parts = [value]
    if space.order >= 1:
        gradient = a[..., space.gradient]
        parts.append(balls.multiply(first, gradient))
    if space.order == 2:
        outer = balls.multiply(gradient[..., space.rows], gradient[..., space.columns])
        parts.append(balls.add(balls.multiply(second, outer), balls.multiply(first, a[..., space.hessian])))
    return Ball(np.concatenate([p.mid for p in parts], axis=-1), np.concatenate([p.rad for p in parts], axis=-1))


Derivatives = tuple[Ball, Ball, Ball]
"""f, f' and f'' over the range of the value."""


def _exponential(x: Ball) -> Derivatives:
    value = balls.exp(x)
    return value, value, value


def _reciprocal(x: Ball) -> Derivatives:
    value = balls.divide(balls.exact(np.ones_like(x.mid)), x)
    square = balls.square(value)
    return value, balls.negate(square), balls.scale(balls.multiply(square, value), 2.0)


def _logarithm(x: Ball) -> Derivatives:
    inverse = balls.divide(balls.exact(np.ones_like(x.mid)), x)
    return balls.log(x), inverse, balls.negate(balls.square(inverse))


def _square_root(x: Ball) -> Derivatives:
    value = balls.sqrt(x)
    first = balls.divide(balls.exact(np.full_like(x.mid, 0.5)), value)
    # f'' = -1/(4 a^(3/2)) = -f'/(2 a)
    return value, first, balls.scale(balls.divide(first, x), -0.5)


def _hyperbolic_tangent(x: Ball) -> Derivatives:
    value = balls.tanh(x)
    first = balls.subtract(balls.exact(np.ones_like(x.mid)), balls.square(value))
    return value, first, balls.scale(balls.multiply(value, first), -2.0)


FUNCTIONS: dict[str, Callable[[Ball], Derivatives]] = {
    "exp": _exponential,
    "reciprocal": _reciprocal,
    "log": _logarithm,
    "sqrt": _square_root,
    "tanh": _hyperbolic_tangent,
}
"""Elementary functions by name, with two derivatives; `sincos_jets` has sine and cosine."""


def function_jet(space: JetSpace, name: str, a: Ball) -> Ball:
    """Jet of an elementary function of a jet, shape (..., C)."""
    return compose(space, a, *FUNCTIONS[name](a[..., :1]))


def sincos_jets(space: JetSpace, a: Ball) -> tuple[Ball, Ball]:
    """Jets of sin(a) and cos(a), computed together: each is the other's derivative."""
    sine, cosine = balls.sincos(a[..., :1])
    both = Ball(np.array([sine.mid, cosine.mid]), np.array([sine.rad, cosine.rad]))
    first = Ball(np.array([cosine.mid, -sine.mid]), np.array([cosine.rad, sine.rad]))
    result = compose(space, Ball(np.array([a.mid, a.mid]), np.array([a.rad, a.rad])), both, first, balls.negate(both))
    return result[0], result[1]
