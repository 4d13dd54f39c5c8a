"""Matrices of balls: products and exponential series contain the exact result."""

from __future__ import annotations

import math
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

from setrl.verify import balls
from setrl.verify.ball_matrices import absolute_product, exponential_coefficients, exponential_tail, product
from setrl.verify.balls import Ball


def exact_product(a: Any, b: Any) -> list[list[Fraction]]:
    columns = list(zip(*b, strict=True))
    return [[inner(row, column) for column in columns] for row in a]


def inner(row: Any, column: Any) -> Fraction:
    return sum((Fraction(x) * Fraction(y) for x, y in zip(row, column, strict=True)), Fraction(0))


def contains(ball: Ball, values: list[list[Fraction]]) -> bool:
    return all(
        abs(value - Fraction(float(ball.mid[i, j]))) <= Fraction(float(ball.rad[i, j]))
        for i, row in enumerate(values)
        for j, value in enumerate(row)
    )


def wide_matrix(generator: np.random.Generator, shape: tuple[int, ...]) -> Any:
    return generator.standard_normal(shape) * np.exp2(generator.integers(-40, 40, shape))


@pytest.mark.parametrize("seed", range(5))
def test_a_product_contains_the_products_of_its_members(seed: int) -> None:
    generator = np.random.default_rng(seed)
    mids = wide_matrix(generator, (3, 4)), wide_matrix(generator, (4, 2))
    for relative in (0.0, 1e-3):
        factors = [Ball(mid, relative * np.abs(mid)) for mid in mids]
        result = product(*factors)
        assert contains(result, exact_product(*mids))
        for _ in range(20):
            # members at random corners; half the radius, so that rounding keeps them inside
            signs = [generator.choice([-1.0, 1.0], mid.shape) for mid in mids]
            members = [mid + 0.5 * s * f.rad for mid, s, f in zip(mids, signs, factors, strict=True)]
            assert contains(result, exact_product(*members))


def test_the_radius_of_a_product_reaches_its_corners() -> None:
    one = Ball(np.array([[1.0, -2.0]]), np.array([[0.5, 0.25]]))
    other = Ball(np.array([[3.0], [1.0]]), np.array([[1.0], [2.0]]))
    corner = (1.5 * 4.0) + (-2.25 * 3.0)
    assert product(one, other).rad[0, 0] >= 0.5 * 4.0 + 1.0 + 0.25 * 3.0 + 2.0 * 2.0
    assert abs(corner - 1.0) <= product(one, other).rad[0, 0] <= 7.76


def test_a_product_without_a_bound_proves_nothing() -> None:
    result = product(Ball(np.ones((1, 1)), np.array([[np.inf]])), balls.exact(np.ones((1, 1))))
    assert not np.isfinite(result.rad).any()


def test_an_absolute_product_is_not_below_the_exact_one() -> None:
    generator = np.random.default_rng(1)
    a, b = np.abs(wide_matrix(generator, (6, 9))), np.abs(wide_matrix(generator, (9, 3)))
    bound = absolute_product(a, b)
    exact = exact_product(a, b)
    assert all(Fraction(float(bound[i, j])) >= exact[i][j] for i in range(6) for j in range(3))


def test_exponential_coefficients_contain_the_exact_ones() -> None:
    generator = np.random.default_rng(2)
    rate, first = wide_matrix(generator, (3, 3)), wide_matrix(generator, (3, 5))
    found = exponential_coefficients(rate[None], first[None], 6)
    exact = [[Fraction(x) for x in row] for row in first]
    for k in range(1, 7):
        assert contains(found[0, k - 1], exact), k
        exact = [[x / (k + 1) for x in row] for row in exact_product(rate, exact)]


def tail_of(rate: Any, last: Any, order: int) -> Any:
    """sum_(j>=1) K!/(K+j)! N^j p, summed until it no longer changes."""
    total, term = np.zeros_like(last), last
    for j in range(1, 200):
        term = rate @ term / (order + j)
        total = total + term
    return total


@pytest.mark.parametrize("order", [2, 4, 8])
def test_the_tail_bound_is_above_the_tail_and_near_it(order: int) -> None:
    generator = np.random.default_rng(3)
    for scale in (0.1, 1.0):
        rate = scale * generator.uniform(0.0, 1.0, (20, 3, 3)) / 3.0
        last = generator.uniform(0.0, 1.0, (20, 3))
        bound = exponential_tail(rate, last, order)
        truth = np.array([tail_of(n, p, order) for n, p in zip(rate, last, strict=True)])
        assert (bound >= truth).all()
        assert (bound <= 1.2 * truth).all()


def test_the_tail_bound_does_not_depend_on_the_units() -> None:
    generator = np.random.default_rng(4)
    rate, last = generator.uniform(0.0, 1.0, (1, 3, 3)), generator.uniform(0.0, 1.0, (1, 3))
    unit = np.array([1e-3, 1.0, 1e3])
    scaled = exponential_tail(rate * unit[:, None] / unit, last * unit, 4)
    np.testing.assert_allclose(scaled, exponential_tail(rate, last, 4) * unit, rtol=0.01)


def test_the_tail_of_a_nilpotent_matrix_vanishes_beyond_its_index() -> None:
    chain = np.array([[[0.0, 5.0], [0.0, 0.0]]])
    assert exponential_tail(chain, np.array([[1.0, 0.0]]), 2).max() < 1e-280


def test_a_tail_without_a_convergent_bound_is_infinite() -> None:
    order = 3
    assert np.isfinite(exponential_tail(np.array([[[order + 1.9]]]), np.ones((1, 1)), order)).all()
    assert np.isinf(exponential_tail(np.array([[[order + 2.0]]]), np.ones((1, 1)), order)).all()
    assert math.isinf(float(exponential_tail(np.array([[[np.nan]]]), np.ones((1, 1)), order)[0, 0]))
