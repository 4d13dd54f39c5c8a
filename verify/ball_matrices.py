"""Products and powers of matrices of balls, for batches of small matrices."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from . import balls, rounding
from .balls import Ball

Array = NDArray[np.float64]


def product(a: Ball, b: Ball) -> Ball:
    """Enclose ``A B`` for all A in a and B in b.

    ``|AB - A0 B0| <= |A0| rb + ra (|B0| + rb)``, and fl(A0 B0) is off by `rounding.product_error`.

    Parameters
    ----------
    a : Ball, shape (..., m, k)
    b : Ball, shape (..., k, q)

    Returns
    -------
    Ball, shape (..., m, q)

    References
    ----------
    .. [1] S. M. Rump, "Fast and parallel interval arithmetic", BIT 39(3), 1999, section 3.
    """
    terms = a.mid.shape[-1]
    left, right = np.abs(a.mid), np.abs(b.mid)
    radius = rounding.product_error(terms, left @ right)
    if b.rad.any():
        radius = radius + left @ b.rad
    if a.rad.any():
        radius = radius + a.rad @ (right + b.rad)
    return Ball(a.mid @ b.mid, rounding.enlarged(radius, terms + 6))


def absolute_product(a: Array, b: Array) -> Array:
    """Upper bound of ``A B`` for matrices without negative entries."""
    return rounding.enlarged(a @ b, a.shape[-1] + 1)  # type: ignore[no-any-return]


def exponential_coefficients(rate: Array, first: Array, order: int) -> Ball:
    """Time coefficients ``M_k = A^(k-1) G / k!``, k = 1 .. K, of the solution of ``x' = A x + G q``, q constant.

    With x(0) = 0 that solution is ``(sum_(k>=1) t^k M_k) q``. G = [A, I] makes ``[e^(A t) - I, int_0^t e^(A s) ds]``
    of it, so that one recurrence yields the exponential and its integral.

    Parameters
    ----------
    rate : array, shape (B, n, n)
        A, floats that are meant exactly.
    first : array, shape (B, n, p)
        G, floats that are meant exactly.
    order : int
        K >= 1.

    Returns
    -------
    Ball, shape (B, K, n, p)
    """
    coefficients = [balls.exact(first)]
    for k in range(2, order + 1):
        coefficients.append(balls.divide_exact(product(balls.exact(rate), coefficients[-1]), float(k)))
    return Ball(np.stack([c.mid for c in coefficients], 1), np.stack([c.rad for c in coefficients], 1))


PERRON_ITERATIONS = 12
TAIL_REFINEMENTS = 3


def exponential_tail(rate: Array, last: Array, order: int) -> Array:
    """Bound what a truncated exponential series leaves out, inf where the bound is not valid.

    With N >= 0 (|A| t) and a bound p of the last term's coefficient, K = `order`, the rest of the series is

        sum_(j>=1) K!/(K+j)! N^j p  <=  y,   where  y = N p/(K+1) + N y/(K+2),

    since (K+1) ... (K+j) >= (K+1) (K+2)^(j-1). For any s > 0 with ``N s <= rho (K+2) s`` and rho < 1,
    ``y <= max_i (u_i/s_i) / (1 - rho) s`` with u = N p/(K+1); the classic bound [1]_ has s = (1, ..., 1). A Perron
    vector of N has the smallest rho and follows the units of the states. Every upper bound of y put into the right-hand
    side is one again: that sharpens it per component.

    Parameters
    ----------
    rate : array, shape (B, n, n)
        N, rounded up.
    last : array, shape (B, n)
        p, rounded up.
    order : int

    Returns
    -------
    array, shape (B, n)

    References
    ----------
    .. [1] M. Althoff, O. Stursberg, M. Buss, "Reachability analysis of nonlinear systems with uncertain parameters
       using conservative linearization", CDC 2008, section III.
    """
    vector = np.ones_like(last)[..., None]
    for _ in range(PERRON_ITERATIONS):
        vector = vector + rate @ vector
        # the floor keeps s > 0 where a state drives nothing
        vector = np.maximum(vector / vector.max(-2, keepdims=True), 2.0**-40)
    mapped = absolute_product(rate, vector)
    share = rounding.enlarged((mapped / vector).max(-2, keepdims=True) / float(order + 2), 3)
    start = rounding.enlarged(absolute_product(rate, last[..., None]) / float(order + 1), 1)
    gap = rounding.down(1.0 - share)
    height = rounding.enlarged((start / vector).max(-2, keepdims=True), 1)
    valid = gap > 0.0
    bound = np.where(valid, rounding.enlarged(height / np.where(valid, gap, 1.0) * vector, 3), np.inf)
    for _ in range(TAIL_REFINEMENTS):
        again = rounding.enlarged(start + absolute_product(rate, bound) / float(order + 2), 3)
        bound = np.where(valid, np.minimum(bound, again), np.inf)
    return bound[..., 0]
