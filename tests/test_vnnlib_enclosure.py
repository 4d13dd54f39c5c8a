"""What is proved of forms over boxes: in exact arithmetic, for the runtime, and whatever the rounding."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest
from vnnlib_queries import F, affine, at_most, box_of, query_of, rational, weights

from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_runtime import deployed_runner
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine, Policy
from setrl.specs.errors import InputError
from setrl.specs.queries import Case, LinearConstraint
from setrl.specs.specification import Bounds
from setrl.verify.balls import Ball
from setrl.verify.open_loop.enclosure import FormBounds, bound_forms
from setrl.verify.open_loop.question import Question, questions_of
from setrl.verify.open_loop.search import Cells, refuted


def question_of(generator: np.random.Generator, inputs: int, outputs: int, constraints: int) -> Question:
    """Coefficients that are no floats, some of them 0."""
    made = [
        at_most(
            F(int(generator.integers(-9, 10)), 7),
            [F(int(n), 3) for n in generator.integers(-4, 5, size=outputs)],
            [F(int(n), 7) for n in generator.integers(-4, 5, size=inputs)],
        )
        for _ in range(constraints)
    ]
    (question,) = questions_of(query_of(inputs, outputs, [Case(box_of(generator, inputs), tuple(made))]))
    return question


def form(constraint: LinearConstraint, x: list[Fraction], y: list[Fraction]) -> Fraction:
    left = sum((c * x[i] for i, c in constraint.inputs), F(0)) + sum((c * y[j] for j, c in constraint.outputs), F(0))
    return left - constraint.bound


def network(generator: np.random.Generator, precision: str) -> Policy:
    kinds = [Activation("relu"), Activation("clip", lower=-0.5, upper=0.75), Activation("leaky_relu", slope=0.25)]
    kinds = kinds[: 3 if precision == "float32" else 1]
    layers = [affine(generator, 6, 3), kinds[int(generator.integers(len(kinds)))], affine(generator, 2, 6)]
    return read_policy(policy_bytes(layers, precision=precision))


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_forms_at_points_of_a_box_are_within_its_bounds(precision: str, backward: bool) -> None:
    for seed in range(12):
        generator = np.random.default_rng([seed, backward])
        policy = network(generator, precision)
        question = question_of(generator, 3, 2, 4)
        low = np.minimum(*(ends := generator.uniform(-1.2, 1.2, (2, 5, 3)).astype(np.float32).astype(np.float64)))
        high = np.where(generator.integers(3, size=(5, 3)) == 0, low, np.maximum(*ends))
        bounds = bound_forms(policy, question, low, high, backward)
        runner = deployed_runner(policy)
        constraints = list(dict.fromkeys(question.cases[0].constraints))
        for cell in range(5):
            for share in [*np.ndindex(2, 2, 2), *generator.uniform(0, 1, (4, 3))]:
                x = low[cell] + np.array(share) * (high[cell] - low[cell])
                x = np.clip(x.astype(np.float32).astype(np.float64), low[cell], high[cell])
                exact = [F(float(v)) for v in x]
                y = rational(policy.layers, exact)
                run = [F(float(v)) for v in runner(x)[0]]
                for row, constraint in enumerate(constraints):
                    value = form(constraint, exact, y)
                    assert F(float(bounds.lower[cell, row])) <= value <= F(float(bounds.upper[cell, row]))
                    assert F(float(bounds.deployed[cell, row])) <= form(constraint, exact, run)


def test_bounds_on_points_are_tight_and_still_bounds() -> None:
    """Where nothing is left but rounding, a bound without it would be wrong half of the time."""
    for seed in range(40):
        generator = np.random.default_rng([7, seed])
        layer = Affine(generator.normal(size=(2, 9)).astype(np.float32).astype(float), weights(generator, 2))
        policy = Policy((layer,), 9, 2)
        question = question_of(generator, 9, 2, 3)
        x = generator.uniform(-1, 1, (1, 9))
        bounds = bound_forms(policy, question, x, x)
        exact = [F(float(v)) for v in x[0]]
        y = rational(policy.layers, exact)
        for row, constraint in enumerate(dict.fromkeys(question.cases[0].constraints)):
            value = form(constraint, exact, y)
            assert F(float(bounds.lower[0, row])) <= value <= F(float(bounds.upper[0, row]))
            assert bounds.upper[0, row] - bounds.lower[0, row] < 1e-12


def test_products_that_cancel_are_bounded() -> None:
    """What is left of them is far below the rounding of the parts."""
    for seed in range(40):
        generator = np.random.default_rng([8, seed])
        up = generator.uniform(1, 2, (2, 1))
        down = (
            np.array([[up[1, 0], -up[0, 0]]]) * generator.uniform(1, 2) * (1 + generator.uniform(-1, 1, (1, 2)) * 1e-16)
        )
        policy = Policy((Affine(up, np.zeros(2)), Affine(down, np.zeros(1))), 1, 1)
        sign = F(1 if seed % 2 else -1)
        x = np.ones((1, 1))
        (question,) = questions_of(query_of(1, 1, [Case((Bounds(F(1), F(1)),), (at_most(F(0), [sign]),))]))
        bounds = bound_forms(policy, question, x, x)
        value = sign * rational(policy.layers, [F(1)])[0]
        assert F(float(bounds.lower[0, 0])) <= value <= F(float(bounds.upper[0, 0]))


def test_coefficients_are_within_their_balls() -> None:
    generator = np.random.default_rng(9)
    question = question_of(generator, 3, 2, 20)
    for row, constraint in enumerate(dict.fromkeys(question.cases[0].constraints)):
        for ball, terms in ((question.inputs, constraint.inputs), (question.outputs, constraint.outputs)):
            entries = dict(terms)
            for place, (mid, rad) in enumerate(zip(ball.mid[row], ball.rad[row], strict=True)):
                assert abs(F(float(mid)) - entries.get(place, F(0))) <= F(float(rad)) < F(1, 2**40)
        assert abs(F(float(question.bound.mid[row])) - constraint.bound) <= F(float(question.bound.rad[row]))


@pytest.mark.parametrize("backward", [False, True])
@pytest.mark.parametrize("part", ["inputs", "outputs", "bound"])
def test_every_number_of_a_ball_of_coefficients_is_meant(part: str, backward: bool) -> None:
    """Coefficients that are known to a tenth only: forms with any of them are bounded."""
    for seed in range(10):
        generator = np.random.default_rng([10, seed])
        policy = network(generator, "float32")
        question = question_of(generator, 3, 2, 3)
        known: Ball = getattr(question, part)
        rough = replace(question, **{part: Ball(known.mid, np.full_like(known.rad, 0.1))})
        x = generator.uniform(-1, 1, (1, 3))
        bounds = bound_forms(policy, rough, x, x, backward)
        y = policy(x)
        for sign in (-1.0, 1.0):
            # the extreme coefficients for these values
            spread = {"inputs": np.abs(x).sum(), "outputs": np.abs(y).sum(), "bound": 1.0}[part]
            extreme = question.values(x, y)[0] + sign * (0.1 - 1e-9) * spread
            assert (bounds.lower[0] <= extreme).all() and (extreme <= bounds.upper[0]).all()


def test_the_runtime_has_room_for_its_rounding() -> None:
    """A sum that float32 gets wrong by much more than the exact bound leaves."""
    layers = (Affine(np.ones((1, 3)), np.zeros(1)),)
    policy = read_policy(policy_bytes(layers))
    x = np.array([[1.0, 2.0**-24 * 1.5, 2.0**-24 * 1.5]])  # the runtime adds each and rounds up
    (question,) = questions_of(
        query_of(3, 1, [Case(tuple(Bounds(F(float(v)), F(float(v))) for v in x[0]), (at_most(F(0), [F(-1)]),))])
    )
    bounds = bound_forms(policy, question, x, x)
    value = -F(float(deployed_runner(policy)(x)[0, 0]))
    assert F(float(bounds.deployed[0, 0])) <= value
    assert value < F(float(bounds.lower[0, 0]))


@pytest.mark.parametrize("nothing", [np.nan, np.inf, -np.inf, 0.0, -1.0])
def test_what_is_no_positive_number_refutes_nothing(nothing: float) -> None:
    generator = np.random.default_rng(0)
    question = question_of(generator, 2, 2, 1)
    every = np.ones((1, 1), dtype=bool)
    cells = Cells(question.low[None], question.high[None], every, every)
    value = np.array([[nothing]])
    left = refuted(question, cells, FormBounds(value, value, value, np.zeros((1, 2, 1)), value))
    assert left.real.all() and left.deployed.all()
    one = np.array([[1.0]])
    left = refuted(question, cells, FormBounds(one, value, value, np.zeros((1, 2, 1)), value))
    assert not left.real.any() and left.deployed.all()


def test_one_refuted_constraint_refutes_its_case_and_no_other() -> None:
    box = (Bounds(F(0), F(1)),)
    first, second, third = (at_most(F(n), [F(1)]) for n in range(3))
    query = query_of(1, 1, [Case(box, (first, second)), Case(box, (second, third)), Case(box, (third,))])
    (question,) = questions_of(query)
    flags = np.array([[True, False, False], [False, True, False], [False, False, True], [False, False, False]])
    assert question.any_of_case(flags).tolist() == [
        [True, False, False],
        [True, True, False],
        [False, True, True],
        [False, False, False],
    ]


def test_networks_that_overflow_are_not_refuted() -> None:
    huge = Affine(np.full((1, 1), 1e30), np.zeros(1))
    layers = [huge, Activation("relu")] * 12 + [Activation("tanh"), Affine(np.ones((1, 1)), np.zeros(1))]
    policy = Policy(tuple(layers), 1, 1)
    (question,) = questions_of(query_of(1, 1, [Case((Bounds(F(1), F(2)),), (at_most(F(-5), [F(1)]),))]))
    bounds = bound_forms(policy, question, question.low[None], question.high[None])
    every = np.ones((1, 1), dtype=bool)
    assert refuted(question, Cells(question.low[None], question.high[None], every, every), bounds).deployed.all()


def test_the_floats_of_a_box_contain_it() -> None:
    generator = np.random.default_rng(3)
    for _ in range(50):
        box = box_of(generator, 4)
        (question,) = questions_of(query_of(4, 1, [Case(box, (at_most(F(0), [F(1)]),))]))
        assert all(F(float(v)) <= b.lower for v, b in zip(question.low, box, strict=True))
        assert all(F(float(v)) >= b.upper for v, b in zip(question.high, box, strict=True))


def test_numbers_that_no_float_reaches_are_an_error() -> None:
    box = (Bounds(F(0), F(10) ** 400),)
    with pytest.raises(InputError, match="larger than any float64"):
        questions_of(query_of(1, 1, [Case(box, (at_most(F(0), [F(1)]),))]))
