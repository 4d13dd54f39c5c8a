"""Ball operations enclose what python-flint computes at 200 bits."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx

from setrl.verify import balls, rounding
from setrl.verify.balls import Ball

F = Fraction
CASES = 400


@pytest.fixture(autouse=True)
def precise() -> Any:
    before = ctx.prec
    ctx.prec = 200
    yield
    ctx.prec = before


def arguments(seed: int, positive: bool = False, largest: float = 30.0) -> Ball:
    """Thin, narrow and wide balls, large and tiny centers, near zero and near the domain's end."""
    generator = np.random.default_rng(seed)
    mid = generator.normal(size=CASES) * 10.0 ** generator.uniform(-8, np.log10(largest), CASES)
    mid[:20] = np.concatenate([[0.0, 1.0, -1.0, 5e-324, -5e-324, 2.0**-1022, 1e-300], generator.normal(size=13)])
    mid[20:60] = np.pi / 2 * np.arange(-20, 20)  # where sine or cosine turn
    rad = np.abs(mid) * 10.0 ** generator.uniform(-17, 0.5, CASES)
    rad[::3] = 0.0
    rad[1::7] = 10.0 ** generator.uniform(-12, 0.3, rad[1::7].size)
    if positive:
        mid = np.abs(mid) + 1e-300
        rad = np.minimum(rad, mid * (1 - 10.0 ** generator.uniform(-12, -0.1, CASES)))
    return Ball(mid, rad)


def members(ball: Ball, i: int) -> list[Any]:
    """Both ends, the middle and some points between, as exact balls (rationals of floats)."""
    mid, rad = (F(float(x[i])) for x in (ball.mid, ball.rad))
    return [mid + rad * F(k, 8) for k in (-8, -5, 0, 3, 8)]


def number(x: Fraction) -> Any:
    return arb(x.numerator) / arb(x.denominator)


def encloses(result: Ball, i: int, truth: Any) -> bool:
    """Whether the result certainly contains the 200-bit ball (or has no bound)."""
    mid, rad = float(result.mid[i]), float(result.rad[i])
    return not np.isfinite(rad) or bool(abs(truth - arb(mid)) <= arb(rad))


UNARY: dict[str, tuple[Callable[[Ball], Ball], Callable[[Any], Any], bool]] = {
    "negate": (balls.negate, lambda x: -x, False),
    "square": (balls.square, lambda x: x * x, False),
    "exp": (balls.exp, lambda x: x.exp(), False),
    "tanh": (balls.tanh, lambda x: x.tanh(), False),
    "log": (balls.log, lambda x: x.log(), True),
    "sqrt": (balls.sqrt, lambda x: x.sqrt(), True),
    "sin": (lambda a: balls.sincos(a)[0], lambda x: x.sin(), False),
    "cos": (lambda a: balls.sincos(a)[1], lambda x: x.cos(), False),
    "scale": (lambda a: balls.scale(a, -0.7), lambda x: x * arb(-0.7), False),
    "divide_exact": (lambda a: balls.divide_exact(a, 3.0), lambda x: x / arb(3), False),
    "reciprocal": (lambda a: balls.divide(balls.exact(np.ones_like(a.mid)), a), lambda x: 1 / x, False),
}


@pytest.mark.parametrize("name", UNARY)
@pytest.mark.parametrize("seed", range(3))
def test_functions_of_one_ball_enclose_every_member(name: str, seed: int) -> None:
    operation, truth, positive = UNARY[name]
    a = arguments(seed, positive)
    result = operation(a)
    assert (result.rad >= 0).all()
    for i in range(CASES):
        for x in members(a, i):
            value = truth(number(x))
            if value.is_finite():
                assert encloses(result, i, value), (name, a.mid[i], a.rad[i], float(x))
    if name not in ("log", "sqrt", "reciprocal"):
        assert np.isfinite(result.rad).all(), "a bound is missing where there is one"


BINARY: dict[str, tuple[Callable[[Ball, Ball], Ball], Callable[[Any, Any], Any]]] = {
    "add": (balls.add, lambda x, y: x + y),
    "subtract": (balls.subtract, lambda x, y: x - y),
    "multiply": (balls.multiply, lambda x, y: x * y),
    "divide": (balls.divide, lambda x, y: x / y),
}


@pytest.mark.parametrize("name", BINARY)
@pytest.mark.parametrize("seed", range(3))
def test_functions_of_two_balls_enclose_every_pair(name: str, seed: int) -> None:
    operation, truth = BINARY[name]
    a, b = arguments(seed), arguments(seed + 100)
    order = np.random.default_rng(seed).permutation(CASES)
    b = Ball(b.mid[order], b.rad[order])
    result = operation(a, b)
    for i in range(CASES):
        for x in members(a, i):
            for y in members(b, i):
                value = truth(number(x), number(y))
                if value.is_finite():
                    assert encloses(result, i, value), (name, i, float(x), float(y))


def test_sine_and_cosine_of_large_and_wide_arguments_are_enclosed() -> None:
    generator = np.random.default_rng(5)
    mid = np.concatenate([10.0 ** generator.uniform(2, 15, 200), np.pi * np.arange(200), generator.normal(size=200)])
    rad = np.concatenate([10.0 ** generator.uniform(-12, 1, 200), np.linspace(0, 1.6, 200), np.linspace(1.4, 1.6, 200)])
    a = Ball(mid, rad)
    for result, function in zip(balls.sincos(a), (lambda x: x.sin(), lambda x: x.cos()), strict=True):
        for i in range(mid.size):
            assert all(encloses(result, i, function(number(x))) for x in members(a, i))
        assert (result.rad <= 1.5).all()


def test_there_is_no_bound_outside_the_domain() -> None:
    touching = Ball(np.array([0.0, 1.0, -1.0, 1e-3]), np.array([0.0, 1.5, 0.5, 2e-3]))
    one = balls.exact(np.ones(4))
    for result in (balls.log(touching), balls.sqrt(touching), balls.divide(one, touching)):
        assert not np.isfinite(result.rad[[1, 3]]).any()
    assert not np.isfinite(balls.log(touching).rad[[0, 2]]).any()
    assert not np.isfinite(balls.divide(one, touching).rad[0])


def test_what_has_no_bound_gets_none() -> None:
    nothing = Ball(np.array([0.0, 0.0, np.nan]), np.array([np.inf, np.nan, 1.0]))
    good = balls.exact(np.array([2.0, 2.0, 2.0]))
    with np.errstate(all="ignore"):
        results = [operation(nothing, good) for operation, _ in BINARY.values()]
        results += [operation(good, nothing) for operation, _ in BINARY.values()]
        results += [balls.square(nothing), balls.exp(nothing), balls.log(nothing), balls.sqrt(nothing)]
    for result in results:
        assert not np.isfinite(result.mid + result.rad).any()


@pytest.mark.parametrize("text", ["1/3", "0.1", "1e-400", "-22/7", "5"])
def test_a_rational_is_enclosed(text: str) -> None:
    value = F(text)
    ball = balls.rational(value)
    assert abs(F(float(ball.mid)) - value) <= F(float(ball.rad))


def test_a_hull_contains_both_ends() -> None:
    generator = np.random.default_rng(1)
    low = generator.normal(size=300) * 10.0 ** generator.uniform(-300, 300, 300)
    high = low + np.abs(generator.normal(size=300)) * 10.0 ** generator.uniform(-300, 300, 300)
    ball = balls.hull(low, high)
    for i in range(300):
        assert F(float(ball.mid[i])) - F(float(ball.rad[i])) <= F(float(low[i]))
        assert F(float(ball.mid[i])) + F(float(ball.rad[i])) >= F(float(high[i]))


# numpy's elementary functions ---------------------------------------------------------------------------------------

SAMPLES = 20_000
FUNCTIONS: dict[str, tuple[Any, Any, float, bool]] = {
    "sin": (np.sin, lambda x: x.sin(), 1e6, False),
    "cos": (np.cos, lambda x: x.cos(), 1e6, False),
    "exp": (np.exp, lambda x: x.exp(), 700.0, False),
    "log": (np.log, lambda x: x.log(), 1e300, True),
    "sqrt": (np.sqrt, lambda x: x.sqrt(), 1e300, True),
    "tanh": (np.tanh, lambda x: x.tanh(), 25.0, False),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numpy_s_functions_are_within_the_assumed_error(name: str) -> None:
    function, truth, largest, positive = FUNCTIONS[name]
    ctx.prec = 100
    generator = np.random.default_rng(8)
    x = 10.0 ** generator.uniform(-12, np.log10(largest), SAMPLES)
    x[: SAMPLES // 4] = generator.uniform(0, 4, SAMPLES // 4)
    x[:2000] = np.nextafter(np.arange(1, 2001) * np.pi / 4, generator.choice([-np.inf, np.inf], 2000))
    if name == "exp":
        x = np.minimum(x, largest)
    if name == "log":
        x[2000:4000] = 1.0 + generator.normal(size=2000) * 10.0 ** generator.uniform(-15, -1, 2000)
    if not positive:
        x *= generator.choice([-1.0, 1.0], SAMPLES)
    values = function(x)
    worst = 0.0
    for point, value in zip(x.tolist(), values.tolist(), strict=True):
        true = truth(arb(point))
        error = abs(arb(value) - true)
        assert error <= abs(true) * arb(rounding.ELEMENTARY_UNITS / 2) * arb(2.0**-53), (name, point)
        worst = max(worst, float(error.mid()) / (abs(value) * 2.0**-53 + 1e-300))
    assert worst <= rounding.ELEMENTARY_UNITS / 2


def test_vectorised_functions_agree_with_scalar_ones_within_the_assumed_error() -> None:
    x = np.linspace(0.01, 20, 1003)
    for function, _, _, _ in FUNCTIONS.values():
        together, alone = function(x), np.array([function(v) for v in x])
        assert (np.abs(together - alone) <= 4 * 2.0**-52 * np.abs(alone)).all()


def test_an_argument_without_a_bound_has_no_value() -> None:
    """log is not defined on all of [-0.1, 0.3], and neither are tanh(log x) and sin(log x), bounded as they look."""
    unknown = balls.log(balls.Ball(np.array([0.1, 2.0]), np.array([0.2, 0.5])))
    assert np.isinf(unknown.rad[0]) and np.isfinite(unknown.rad[1])
    for result in (balls.tanh(unknown), *balls.sincos(unknown), balls.exp(balls.negate(unknown))):
        assert np.isinf(result.rad[0]) and np.isfinite(result.rad[1])
    wide = balls.Ball(np.array([1.0]), np.array([50.0]))
    assert all(result.magnitude[0] <= 1.0 + 1e-12 for result in balls.sincos(wide))
