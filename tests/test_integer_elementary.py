"""The integer checker's arithmetic: fixed-point enclosures of functions, of residuals, of affine forms, of e_L."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from typing import Any

import numpy as np
import pytest
from flint import arb, ctx, fmpz

from setrl.verify.checker import activation as balls
from setrl.verify.checker.deployment import Deployment
from setrl.verify.checker.integers import elementary
from setrl.verify.checker.integers.fixed import Factor, Matrix, ceil_at, floor_at, whole
from setrl.verify.checker.integers.forms import Form
from setrl.verify.checker.integers.residuals import clip_residual, residual
from setrl.verify.checker.integers.runtime import Runtime, Weights, steepest
from setrl.verify.checker.layers import Activation, Dense, Diagonal, apply
from setrl.verify.checker.program import ball
from setrl.verify.checker.rejection import Rejected

ACTIVATIONS = (
    Activation("relu"),
    Activation("leaky_relu", slope=0.125),
    Activation("leaky_relu", slope=1.75),
    Activation("tanh"),
    Activation("sigmoid"),
    Activation("clip", low=-0.75, high=1.0),
    Activation("clip", high=0.3),
    Activation("clip", low=-0.1),
)
FUNCTIONS: dict[str, tuple[Callable[[int, int], Any], Callable[[Any], Any]]] = {
    "exp": (lambda n, bits: elementary.exponential(abs(n), bits), lambda x: (-abs(x)).exp()),
    "tanh": (elementary.tanh, lambda x: x.tanh()),
    "1 - tanh": (
        lambda n, bits: complement(elementary.tanh(abs(n), bits), bits),
        lambda x: 2 / ((2 * abs(x)).exp() + 1),
    ),
    "log": (lambda n, bits: elementary.logarithm(abs(n) + (n == 0), bits, bits), lambda x: abs(x).log()),
    "sqrt": (lambda n, bits: elementary.square_root(abs(n), bits, bits), lambda x: abs(x).sqrt()),
}


def complement(interval: tuple[int, int], bits: int) -> tuple[int, int]:
    return (1 << bits) - interval[1], (1 << bits) - interval[0]


def at(number: int, bits: int) -> Any:
    """The exact ball of a fixed-point number."""
    return arb(fmpz(number)) * arb(2) ** -bits


def arguments(bits: int, count: int, generator: Any) -> list[int]:
    """Of both signs and all sizes, from one unit to 2^50; whole ones, zero, powers of two and their neighbours."""
    sizes = [int(top) << int(shift) >> 52 for top, shift in zip(*wide(bits, count, generator), strict=True)]
    special = [
        0,
        1,
        1 << bits,
        (1 << bits) - 1,
        (1 << bits) + 1,
        3 << bits,
        1 << (bits - 1),
        100 << bits,
        1 << (bits + 50),
    ]
    return [sign * n for n in (*sizes, *special) for sign in (1, -1)]


def wide(bits: int, count: int, generator: Any) -> tuple[Any, Any]:
    return generator.integers(1, 2**52, count), generator.integers(0, bits + 50, count)


@pytest.mark.parametrize("bits", [64, 160, 500])
@pytest.mark.parametrize("name", FUNCTIONS)
def test_an_enclosure_contains_the_value_and_is_a_few_units_wide(name: str, bits: int) -> None:
    enclose, exact = FUNCTIONS[name]
    with ctx.workprec(3 * bits + 200):
        for n in arguments(bits, 400, np.random.default_rng(bits)):
            if name == "tanh" and abs(n) > 8 << bits:  # no ball is provably below 1: that is for `1 - tanh`
                continue
            low, high = enclose(n, bits)
            value = exact(at(n if name != "log" or n else 1, bits))
            assert bool(at(low, bits) <= value) and bool(value <= at(high, bits)), (name, n, bits)
            assert high - low <= 2, (name, n, bits)


def test_log_two_is_enclosed() -> None:
    for bits in range(30, 400, 7):
        low, high = elementary.log_two(bits)
        with ctx.workprec(3 * bits):
            assert bool(at(low, bits) < arb(2).log()) and bool(arb(2).log() < at(high, bits)) and high - low < bits


def test_logarithms_of_floats_of_any_size_are_enclosed() -> None:
    generator = np.random.default_rng(3)
    floats = np.ldexp(generator.uniform(0.5, 1.0, 300), generator.integers(-1073, 1024, 300)).tolist()
    with ctx.workprec(800):
        for x in (*floats, 5e-324, 1.0, 1.0 - 2.0**-53, 0.5):
            factor = Factor.of(x)
            low, high = elementary.logarithm(factor.n, factor.scale, 160)
            assert bool(at(low, 160) <= arb(x).log()) and bool(arb(x).log() <= at(high, 160)) and high - low <= 2


def test_fixed_point_roundings_are_the_nearest_ones_outward() -> None:
    generator = np.random.default_rng(5)
    numbers = [*np.ldexp(generator.normal(size=300), generator.integers(-400, 60, 300)).tolist(), 0.0, 5e-324, -1.0]
    for x in (*numbers, Fraction(1, 3), Fraction(-22, 7), Fraction(5)):
        exact, low, high = Fraction(x), floor_at(x, 90), ceil_at(x, 90)
        assert Fraction(low, 1 << 90) <= exact <= Fraction(high, 1 << 90) and 0 <= high - low <= 1
        factor = Factor.of(x)
        least, most = (Fraction(factor.n + more, 1 << factor.scale) for more in (0, factor.loose))
        assert least <= exact <= most and (factor.loose or least == exact)
        assert abs(exact) <= Fraction(factor.absolute, 1 << factor.scale)
        assert most - least <= abs(exact) * Fraction(1, 1 << 190)
        inside = factor.times((-3, 1 << 70))
        for end in (-3, 1 << 70):
            assert inside[0] <= exact * end <= inside[1]
        if isinstance(x, float):
            assert Fraction(whole(x), 1 << 1074) == exact


def slopes_of(generator: Any, count: int) -> list[float]:
    tiny = np.ldexp(generator.uniform(0.5, 1, count), generator.integers(-300, 1, count)).tolist()
    near = (1.0 - np.ldexp(1.0, -generator.integers(1, 53, count))).tolist()
    return [*tiny, *near, *generator.normal(size=count).tolist(), 0.0, 1.0, -1.0, 0.25, 0.5, 0.125, 2.0, 1e300]


@pytest.mark.parametrize("activation", ACTIVATIONS, ids=str)
def test_residuals_are_those_of_the_first_checker_and_contain_samples(activation: Activation) -> None:
    bits, generator = 160, np.random.default_rng(7)
    with ctx.workprec(1200):
        for number, slope in enumerate(slopes_of(generator, 40)):
            middle, half = generator.normal() * 3.0, abs(generator.normal()) * 10.0 ** (number % 6 - 4)
            low, high = (floor_at(float(x), bits) for x in (middle - half, middle + half))
            least, most = residual(activation, Factor.of(slope), low, high, bits)
            below, above = balls.residual(activation, slope, at(low, bits), at(high, bits))
            assert bool(at(least, bits) <= below) and bool(above <= at(most, bits))
            room = 8 + abs(slope) * 16
            assert bool(below <= at(least, bits) + arb(room) * arb(2) ** -bits), (slope, low, high)
            assert bool(at(most, bits) - arb(room) * arb(2) ** -bits <= above), (slope, low, high)
            for share in np.linspace(0.0, 1.0, 17).tolist():
                x = at(low, bits) + arb(share) * at(high - low, bits)
                left = apply(activation, [x])[0] - arb(slope) * x
                assert bool(at(least, bits) <= left) and bool(left <= at(most, bits)), (slope, share)


def test_a_clip_at_rationals_is_enclosed() -> None:
    bounds, bits = (Fraction(-1, 3), Fraction(2, 7)), 60
    for low, high, slope in ((-1.0, 1.0, 0.5), (0.0, 0.1, 1.0), (-2.0, -1.0, 0.0), (0.25, 0.3, -1.0)):
        least, most = clip_residual(bounds, Factor.of(slope), floor_at(low, bits), ceil_at(high, bits), bits)
        steps = [Fraction(low) + (Fraction(high) - Fraction(low)) * k / 210 for k in range(211)]
        left = [min(max(x, bounds[0]), bounds[1]) - Fraction(slope) * x for x in (*steps, *bounds) if low <= x <= high]
        assert Fraction(least, 1 << bits) <= min(left) and max(left) <= Fraction(most, 1 << bits)
        assert min(left) - Fraction(least, 1 << bits) < Fraction(1, 1 << 57) > Fraction(most, 1 << bits) - max(left)


def value_of(form: Form, signs: dict[tuple[int, int], Fraction], bits: int) -> list[tuple[Fraction, Fraction]]:
    """Interval of every component at values of the factors."""
    form.settle()
    result = []
    for i, (center, error) in enumerate(zip(form.center, form.error, strict=True)):
        value = center + sum(column[i] * signs[origin] for origin, column in form.columns.items())
        result.append((Fraction(value - error) / (1 << bits), Fraction(value + error) / (1 << bits)))
    return result


def coarse(floats: Any, generator: Any, loose: int) -> tuple[list[Factor], list[Fraction]]:
    """Factors of few bits, and exact numbers that they stand for; with `loose` anywhere within one unit above."""
    factors = [Factor(int(x * 2**8), 8, loose) for x in floats]
    return factors, [Fraction(f.n, 1 << 8) + loose * Fraction(float(generator.uniform())) / (1 << 8) for f in factors]


@pytest.mark.parametrize("kind", ["dense", "dense loosely", "diagonal", "diagonal loosely", "select", "line"])
def test_operations_on_forms_enclose_the_exact_result_for_every_factor(kind: str) -> None:
    bits = 40
    for seed in range(80):
        generator = np.random.default_rng(seed)
        size, outputs = 3, 4
        whole_ = generator.integers(-(1 << 41), 1 << 41, (5, size)).tolist()
        form = Form(whole_[0], [abs(x) >> 20 for x in whole_[1]], {(-1, 0): whole_[2], (-1, 1): whole_[3]}, None)
        form.fresh = 2, 0, [abs(x) for x in whole_[4]]
        signs = {origin: Fraction(float(generator.uniform(-1, 1))) for origin in [(-1, 0), (-1, 1)]}
        signs |= {(2, i): Fraction(int(generator.choice([-1, 1]))) for i in range(size)}
        x = [Fraction(int(generator.integers(-1, 2)) * e, 1 << bits) for e in form.error]
        center = [Fraction(c, 1 << bits) for c in form.center]
        for i in range(size):
            x[i] += center[i] + Fraction(whole_[2][i], 1 << bits) * signs[-1, 0]
            x[i] += (
                Fraction(whole_[3][i], 1 << bits) * signs[-1, 1] + Fraction(abs(whole_[4][i]), 1 << bits) * signs[2, i]
            )
        spread = [sum(abs(row[i]) for row in whole_[2:]) + error for i, error in enumerate(form.error)]
        assert form.spread() == spread
        loose = int("loosely" in kind)
        offset = [
            (int(b), int(b) + int(generator.integers(0, 1 << 30))) for b in generator.integers(-(1 << 41), 1 << 41, 4)
        ]
        bias = [Fraction(int(generator.integers(low, high + 1)), 1 << bits) for low, high in offset]
        if "dense" in kind:
            table = [coarse(row, generator, loose) for row in generator.normal(size=(outputs, size))]
            rows, absolute = ([[f.n for f in fs] for fs, _ in table], [[f.absolute for f in fs] for fs, _ in table])
            form.multiply(Matrix(rows, 8, [[1] * size] * outputs if loose else None, absolute), offset)
            expected = [
                sum((w * a for w, a in zip(row, x, strict=True)), b) for (_, row), b in zip(table, bias, strict=True)
            ]
        elif "diagonal" in kind:
            factors, weights = coarse(generator.normal(size=size), generator, loose)
            form.scale(factors, offset[:size])
            expected = [w * a + b for w, a, b in zip(weights, x, bias[:size], strict=True)]
        elif kind == "select":
            form.select((2, 0, 2, 1))
            expected = [x[2], x[0], x[2], x[1]]
        else:
            slopes = generator.normal(size=size).tolist()
            left = [(int(a), int(a) + 7 * i) for i, a in enumerate(generator.integers(-9, 9, size))]
            form.follow([Factor.of(s) for s in slopes], left, 3, 0)
            chosen = [low + int(generator.integers(0, 2)) * (high - low) for low, high in left]
            expected = [Fraction(s) * a + Fraction(r, 1 << bits) for s, a, r in zip(slopes, x, chosen, strict=True)]
            assert form.fresh is not None
            halves = zip(chosen, left, form.fresh[2], strict=True)
            own = [Fraction(r - (sum(ends) >> 1), max(half, 1)) for r, ends, half in halves]
            assert max(map(abs, own)) <= 1
            signs |= {(3, i): sign for i, sign in enumerate(own)}
        found = value_of(form, signs, bits)
        assert all(low <= y <= high for y, (low, high) in zip(expected, found, strict=True))


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_errors_of_a_runtime_are_those_of_the_first_checker(precision: str) -> None:
    bits, generator, own = 1100, np.random.default_rng(11), Fraction(1, 2**21)
    runtime, first = Runtime(precision, own), Deployment(precision, ball(own), ())
    held = generator.normal(size=(4, 3)).astype(np.float32).astype(float)
    tables = [held.tolist(), (held + 1e-9).tolist(), [[Fraction(x) / 3 for x in row] for row in held.tolist()]]
    with ctx.workprec(200):
        for table, offset in ((t, b) for t in tables for b in ([0.0] * 4, [0.1] * 4, [Fraction(1, 3)] * 4)):
            size, error = ([abs(float(x)) * s for x in generator.normal(size=3)] for s in (5.0, 1e-5))
            fixed = [[ceil_at(x, bits) for x in numbers] for numbers in (size, error)]
            exact = [[arb(x) for x in numbers] for numbers in (size, error)]
            rows, layer = tuple(map(tuple, table)), Dense(tuple(map(tuple, table)), tuple(offset))
            found = runtime.dense(Weights.of(layer, runtime), *fixed, bits)
            same(found, first.through(layer, *exact), bits)
            for factors in ((rows[0][0], 1.0, -1.0), (rows[1][1],) * 3):
                diagonal = Diagonal(factors, (0.0, offset[0], 0.0))
                same(runtime.diagonal(diagonal, *fixed, bits), first.through(diagonal, *exact), bits)
            same(runtime.cast(fixed[0], bits), first.start(exact[0]), bits)
            for activation in ACTIVATIONS:
                ends = sorted(generator.normal(size=(3, 2)).tolist(), key=str)
                ends = [sorted(pair) for pair in ends]
                bounds = [(floor_at(a, bits), floor_at(b, bits)) for a, b in ends]
                low, high = ([arb(pair[k]) for pair in ends] for k in (0, 1))
                found = runtime.activated(activation, bounds, fixed[1], bits)
                same(found, first.activated(activation, low, high, exact[1]), bits)


def same(found: list[int], expected: list[Any], bits: int) -> None:
    """Equal but for the roundings of both."""
    for n, value in zip(found, expected, strict=True):
        assert bool(at(n, bits) >= value * (1 - arb(2) ** -150) - arb(2) ** -1000)
        assert bool(at(n, bits) <= value * (1 + arb(2) ** -150) + arb(2) ** -1000)


@pytest.mark.parametrize("kind", ["tanh", "sigmoid"])
def test_the_steepest_slope_is_that_of_the_point_nearest_to_zero(kind: str) -> None:
    for low, high, nearest in ((-1.0, 2.0, 0.0), (0.5, 2.0, 0.5), (-3.0, -1.5, -1.5), (90.0, 91.0, 90.0)):
        value = (arb(nearest) / (2 if kind == "sigmoid" else 1)).tanh()
        exact = (1 - value**2) / (4 if kind == "sigmoid" else 1)
        found = at(steepest(kind, floor_at(low, 200), floor_at(high, 200), 200), 200)
        assert bool(found >= exact - arb(2) ** -45) and bool(found <= exact + arb(2) ** -45)
        assert not bool(found < exact)


def test_what_a_runtime_cannot_hold_has_no_bound() -> None:
    runtime = Runtime("float32", Fraction(1, 2**21))
    with pytest.raises(Rejected, match="too large"):
        Weights.of(Dense(((1e39,),), (0.0,)), runtime)
    with pytest.raises(Rejected, match="no error bound"):
        runtime.growth(2**23)
    assert runtime.conversion(1e-40) > 0 and runtime.conversion(0.1) > 0 == runtime.conversion(0.5)


def test_matrices_of_rationals_enclose_them() -> None:
    table = [[0.5, Fraction(1, 3)], [Fraction(-2, 7), 5e-324], [Fraction(-3, 4), -1e300]]
    matrix = Matrix.of(table)
    assert matrix.loose == [[0, 1], [1, 0], [0, 0]]
    for row, low, more, size in zip(table, matrix.rows, matrix.loose, matrix.absolute, strict=True):
        for number, n, extra, most in zip(row, low, more, size, strict=True):
            least, exact, unit = Fraction(n, 1 << matrix.scale), Fraction(number), Fraction(1, 1 << matrix.scale)
            assert least <= exact <= least + extra * unit and abs(exact) <= most * unit
    assert Matrix.of([[0.5, 3.0]]).loose is None
