"""Enclosures of elementary functions at fixed-point numbers, from integer series whose remainders are bounded below.

Arguments are integers at `bits`; results are intervals at `bits` that contain the exact value. Inside, `GUARD` more
bits are carried; one unit there is called an ulp.
"""

from __future__ import annotations

from functools import lru_cache
from math import isqrt

from .fixed import Interval, shifted_up

GUARD = 40
HALVINGS = 8


@lru_cache(maxsize=64)
def log_two(bits: int) -> Interval:
    """Log 2 ``= 2 sum_k 3^-(2k+1)/(2k+1)``.

    Every summand is rounded down by less than an ulp. The sum ends before N where ``2 3^-(2N+1)`` is below one ulp; the
    rest is below ``1 + 1/9 + ... < 2`` ulps.
    """
    power, total, terms = (2 << bits) // 3, 0, 0
    while power:
        total += power // (2 * terms + 1)
        power //= 9
        terms += 1
    return total, total + terms + 2


def exponential(x: int, bits: int) -> Interval:
    """``e^-x`` for x >= 0.

    With k such that ``r = k log 2 - x`` is in (0, log 2]: ``e^-x = 2^-k (e^(r 2^-8))^(2^8)``. The Taylor series at
    ``s = r 2^-8 < 1/2``, every term t_n = floor(t_(n-1) s/n): a term's error is below ``1 + 1/2 + 1/4 + ... = 2`` ulps,
    and what follows the first t_N = 0, a term below 2 ulps, is below ``2 (1/2 + 1/4 + ...) = 2`` ulps. Because
    ``e^s < 2``, the width of the interval of s counts at most twice.
    """
    work = bits + GUARD
    least_log, most_log = log_two(work)
    y = x << GUARD
    if y >= bits * most_log:  # e^-x <= 2^-bits
        return 0, 1
    k = y // least_log + 1
    least = k * least_log - y >> HALVINGS
    most = shifted_up(k * most_log - y, HALVINGS)
    assert 0 <= least <= most <= 1 << (work - 1)
    total = term = 1 << work
    count = 0
    while term:
        count += 1
        term = (term * least >> work) // count
        total += term
    low, high = total, total + 2 * count + 2 + 2 * (most - least)
    for _ in range(HALVINGS):
        low, high = low * low >> work, shifted_up(high * high, work)
    return low >> (k + GUARD), shifted_up(high, k + GUARD)


def tanh(x: int, bits: int) -> Interval:
    """``(1 - E)/(1 + E)``, ``E = e^(-2x)``, for x > 0, where it is also at most x and at most 1; odd."""
    if x == 0:
        return 0, 0
    if x < 0:
        low, high = tanh(-x, bits)
        return -high, -low
    least, most = exponential(2 * x << HALVINGS, bits + HALVINGS)
    one = 1 << (bits + HALVINGS)
    low = (one - most << bits) // (one + most)
    high = -((least - one << bits) // (one + least))
    return max(low, 0), min(high, x, 1 << bits)


def logarithm(n: int, scale: int, bits: int) -> Interval:
    """``log(n 2^-scale)`` for n > 0.

    ``= log m + e log 2`` with m in [1/2, 1), and ``-log m = 2^8 2 atanh z``, ``z = (1 - v)/(1 + v)``,
    ``v = m^(2^-8)``. The series ``z + z^3/3 + ...`` for z < 1/4, powers p_k = floor(p_(k-1) floor(z^2)): a power's
    error is below ``2 (1 + 1/4 + ...) < 3`` ulps, a term's below 4, and what follows the first p_N = 0, a power below
    3 ulps, is below ``3 (1 + 1/4 + ...) = 4`` ulps together with it. ``2 atanh`` is no steeper than 4 there.
    """
    work = bits + GUARD
    exponent = n.bit_length()
    low = (n << work) >> exponent
    high = shifted_up(n << work, exponent)
    for _ in range(HALVINGS):
        low, high = isqrt(low << work), isqrt(high << work) + 1
    one = 1 << work
    least = (one - high << work) // (one + high)
    most = -((low - one << work) // (one + low))
    least = max(least, 0)
    assert least <= most < one >> 2
    square = least * least >> work
    power, total, count = least, 0, 0
    while power:
        total += power // (2 * count + 1)
        power = power * square >> work
        count += 1
    near, far = 2 * total, 2 * (total + 4 * count + 4) + 4 * (most - least)
    near, far = near << HALVINGS, far << HALVINGS  # of -log m
    turns = exponent - scale
    logs = [turns * end for end in log_two(work)]
    return min(logs) - far >> GUARD, shifted_up(max(logs) - near, GUARD)


def square_root(n: int, scale: int, bits: int) -> Interval:
    """``sqrt(n 2^-scale)`` for n >= 0: floor(sqrt(floor(y))) is floor(sqrt(y))."""
    root = isqrt((n << 2 * bits) >> scale)
    return root, root + 1
