"""Every epsilon, against exact rational arithmetic."""

from __future__ import annotations

from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from setrl.verify import rounding
from setrl.verify.zonotope import Zonotope

F = Fraction
FIXED = settings(derandomize=True, deadline=None, max_examples=150, database=None)
U = F(1, 2**53)

finite = st.floats(allow_nan=False, allow_infinity=False, width=64)
moderate = st.floats(-1e150, 1e150)
wide = st.builds(lambda m, e: float(np.ldexp(m, e)), st.floats(-1, 1), st.integers(-1074, 400))
any_number = st.one_of(
    moderate, wide, st.sampled_from([0.0, 5e-324, -5e-324, 2.0**-1022, 1.0, 2.0**-53, 1.0 + 2.0**-52])
)


def exact(values: Any) -> list[Fraction]:
    return [F(float(v)) for v in np.ravel(values)]


@FIXED
@given(any_number, st.integers(0, 300))
def test_enlarged_undoes_so_many_roundings(x: float, roundings: int) -> None:
    x = abs(x)
    assert F(float(rounding.enlarged(x, roundings))) >= F(x) / (1 - U) ** roundings


@FIXED
@given(st.lists(wide | moderate, min_size=1, max_size=60))
def test_an_absolute_sum_is_an_upper_bound_in_any_order(values: list[float]) -> None:
    total = sum((abs(v) for v in exact(values)), F(0))
    array = np.array(values)
    for order in (array, array[::-1], np.sort(np.abs(array)), -np.sort(-np.abs(array))):
        assert F(float(rounding.absolute_sum(order, 0))) >= total
    forward = 0.0
    for value in values:  # strictly from the left, as no library would
        forward += abs(value)
    assert F(float(rounding.enlarged(forward, len(values)))) >= total


@pytest.mark.parametrize("count", [1, 2, 3, 16, 63, 64, 1000, 4096])
def test_one_signed_sums_that_lose_every_term_are_covered(count: int) -> None:
    for values in ([1.0] + [2.0**-53] * count, [2.0**-53] * count + [1.0], [1.0] + [1.1102230246251564e-16] * count):
        total = sum(exact(values), F(0))
        forward = 0.0
        for value in values:
            forward += value
        assert F(float(rounding.enlarged(forward, len(values)))) >= total
        assert F(float(rounding.absolute_sum(np.array(values), 0))) >= total


@FIXED
@given(st.lists(st.tuples(any_number, any_number), min_size=1, max_size=40))
def test_a_product_error_bounds_the_error_of_a_dot_product(pairs: list[tuple[float, float]]) -> None:
    a, b = np.array(pairs).T
    a, b = np.clip(a, -1e140, 1e140), np.clip(b, -1e140, 1e140)
    truth = sum((x * y for x, y in zip(exact(a), exact(b), strict=True)), F(0))
    bound = F(float(rounding.product_error(len(a), np.abs(a) @ np.abs(b))))
    left = 0.0
    for x, y in zip(a, b, strict=True):
        left += x * y
    for value in (float(a @ b), left, float(np.dot(a[::-1], b[::-1])), float((a * b).sum())):
        assert abs(F(value) - truth) <= bound


ROWS = {
    "absorbed": [1.0] + [2.0**-53] * 127,
    "absorbed-last": [2.0**-53] * 127 + [1.0],
    "just-absorbed": [1.0] + [2.0**-53 * (1 + 2.0**-50)] * 127,
    "wide": [2.0**e for e in range(-200, 200, 4)],
    "wide-alternating": [(-1.0) ** e * 2.0**e for e in range(-64, 64)],
    "subnormal": [5e-324] * 64 + [2.0**-1022] * 64,
    "thirds": [1 / 3] * 128,
    "cancelling": [1e16, 1.0, -1e16, 1.0] * 32,
}


@pytest.mark.parametrize("name", ROWS)
def test_a_product_error_covers_adversarial_rows(name: str) -> None:
    row = np.array(ROWS[name])
    for other in (np.ones_like(row), row, np.linspace(1, 2, row.size), np.full_like(row, 1 / 3)):
        truth = sum((x * y for x, y in zip(exact(row), exact(other), strict=True)), F(0))
        bound = F(float(rounding.product_error(row.size, np.abs(row) @ np.abs(other))))
        left = 0.0
        for x, y in zip(row, other, strict=True):
            left += x * y
        for value in (left, float(row @ other)):
            assert abs(F(value) - truth) <= bound


@pytest.mark.parametrize("seed", range(12))
def test_row_sums_of_product_errors_need_no_second_product(seed: int) -> None:
    generator = np.random.default_rng(seed)
    m, k, q = generator.integers(1, 12, 3)
    a = generator.normal(size=(m, k)) * np.exp2(generator.integers(-40, 40, (m, 1)).astype(float))
    b = generator.normal(size=(k, q)) * np.exp2(generator.integers(-300 * (seed % 3), 30, (k, q)).astype(float))
    computed = a @ b
    bound = rounding.product_error(int(k), np.abs(a) @ np.abs(b).sum(1), int(q))
    for i in range(m):
        total = F(0)
        for j in range(q):
            truth = sum((x * y for x, y in zip(exact(a[i]), exact(b[:, j]), strict=True)), F(0))
            total += abs(F(float(computed[i, j])) - truth)
        assert total <= F(float(bound[i]))


@FIXED
@given(any_number, any_number, st.integers(0, 20))
def test_a_relative_error_covers_rounded_operations(x: float, y: float, extra: int) -> None:
    for value, truth in ((x + y, F(x) + F(y)), (x - y, F(x) - F(y))):
        assert abs(F(value) - truth) <= F(float(rounding.relative_error(value, 1)))
    x, y = np.clip([x, y], -1e150, 1e150)
    value = float(x) * float(y)
    assert abs(F(value) - F(float(x)) * F(float(y))) <= F(float(rounding.relative_error(value, 1 + extra)))
    assert F(float(rounding.relative_error(x, extra))) >= (extra + 2) * U * abs(F(float(x)))


@FIXED
@given(any_number, any_number)
def test_lower_and_upper_are_outside(center: float, radius: float) -> None:
    radius = abs(radius)
    assert F(float(rounding.lower(center, radius))) <= F(center) - F(radius)
    assert F(float(rounding.upper(center, radius))) >= F(center) + F(radius)


@FIXED
@given(any_number, any_number)
def test_a_ball_contains_its_interval(one: float, other: float) -> None:
    low, high = min(one, other), max(one, other)
    center, radius = (float(x) for x in rounding.center_radius(low, high))
    assert F(center) - F(radius) <= F(low) and F(high) <= F(center) + F(radius)
    assert radius >= 0.0
    point = rounding.center_radius(np.array([low]), np.array([low]))
    assert F(float(point[0][0])) - F(float(point[1][0])) <= F(low) <= F(float(point[0][0])) + F(float(point[1][0]))


@FIXED
@given(st.fractions() | st.builds(lambda n, e: F(n) * F(10) ** e, st.integers(), st.integers(-330, 280)))
def test_a_rational_is_in_its_ball_and_between_its_floats(number: Fraction) -> None:
    center, radius = rounding.ball_of(number)
    assert abs(number - F(center)) <= F(radius)
    assert (radius == 0.0) == (F(center) == number)
    below, above = rounding.float_below(number), rounding.float_above(number)
    assert F(below) <= number <= F(above)
    assert np.nextafter(below, np.inf) >= above and (below == above) == (F(below) == number)


@FIXED
@given(finite)
def test_next_floats_bound_one_operation(x: float) -> None:
    with np.errstate(over="ignore"):
        assert rounding.down(x) < x < rounding.up(x)


def test_nothing_becomes_finite() -> None:
    with np.errstate(all="ignore"):
        for bad in (np.nan, np.inf):
            assert not np.isfinite(rounding.enlarged(bad, 1))
            assert not np.isfinite(rounding.relative_error(bad, 1))
            assert not np.isfinite(rounding.product_error(3, bad))
            assert not np.isfinite(rounding.upper(1.0, bad)) and not np.isfinite(rounding.lower(1.0, bad))


def test_the_machine_keeps_the_assumptions() -> None:
    assert rounding.self_test() == []


# The sums inside a set -----------------------------------------------------------------------------------------------


@FIXED
@given(st.data())
def test_spread_support_and_interval_are_upper_bounds_in_rationals(data: Any) -> None:
    n, q = data.draw(st.integers(1, 4)), data.draw(st.integers(0, 20))

    def array(*shape: int) -> Any:
        size = int(np.prod(shape))
        values = st.lists(any_number.map(lambda x: float(np.clip(x, -1e100, 1e100))), min_size=size, max_size=size)
        return np.array(data.draw(values), dtype=float).reshape(shape)

    z = Zonotope(array(1, n), array(1, q, n), np.abs(array(1, n)))
    spread, interval = z.spread[0], z.interval
    for i in range(n):
        total = sum((abs(x) for x in exact(z.generators[0, :, i])), F(float(z.radius[0, i])))
        assert F(float(spread[i])) >= total
        assert F(float(interval.upper[0, i])) >= F(float(z.center[0, i])) + total
        assert F(float(interval.lower[0, i])) <= F(float(z.center[0, i])) - total
    lines = array(3, n)
    supports = z.support(lines)[0]
    for line, support in zip(lines, supports, strict=True):
        truth = sum((x * y for x, y in zip(exact(z.center[0]), exact(line), strict=True)), F(0))
        for row in z.generators[0]:
            truth += abs(sum((x * y for x, y in zip(exact(row), exact(line), strict=True)), F(0)))
        truth += sum((x * abs(y) for x, y in zip(exact(z.radius[0]), exact(line), strict=True)), F(0))
        assert F(float(support)) >= truth


def test_the_spread_of_many_generators_that_are_absorbed_is_an_upper_bound() -> None:
    for count in (15, 16, 17, 64, 257, 1000):
        rows = np.full((1, count, 1), 2.0**-53)
        rows[0, 0] = 1.0
        z = Zonotope(np.zeros((1, 1)), rows, np.full((1, 1), 2.0**-54))
        total = sum(exact(rows), F(1, 2**54))
        assert F(float(z.spread[0, 0])) >= total
        assert F(float(z.support(np.ones((1, 1)))[0, 0])) >= total
