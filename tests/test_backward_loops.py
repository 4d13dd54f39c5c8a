"""Closed loops with a policy between two linear bounds: what is claimed contains what happens, and is proved again."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import laws
import numpy as np
import pytest
from certificate_streams import opened
from certificates import Case, case_of
from test_laws import LOOPS
from test_teeth import wrapped

from setrl.specs.errors import UsageError
from setrl.verify import action_sets, backward_action, backward_slopes
from setrl.verify.action_sets import PARALLEL, TWO_LINES, ActionSet, better_set
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.closed_loop import Engine, Period
from setrl.verify.options import Options
from setrl.verify.result import Verdict
from setrl.verify.zonotope import Zonotope, diagonal_rows

Array = Any
FAST = (1, 2, 3, 4, 8, 10, 12, 18)
"""The quickest ones, of every activation, with clips, delays, expressions and several steps per period."""
QUICK = ("everything", "everything-delay-2", "discrete", "correlated-delay-1")
REST = sorted(set(range(150)) - set(FAST))
BOTH = ("crown", "best")


def forms_of(content: bytes, case: Case) -> set[int]:
    certificate = opened(content, case.policy, case.specification)
    return {period.form for leaf in certificate.leaves for period in leaf.periods}


def quick(cases: Any) -> list[Any]:
    """Those that take no time."""
    return [case for case in cases if case.name in QUICK]


def slow(cases: Any) -> list[Any]:
    return [pytest.param(case, marks=pytest.mark.slow) for case in cases if case.name not in QUICK]


@pytest.mark.parametrize("number", [*FAST, *(pytest.param(number, marks=pytest.mark.slow) for number in REST)])
def test_what_the_engine_proves_with_two_lines_is_verified(number: int) -> None:
    case = case_of(number, enclosure=BOTH[number % 2])
    result = case.verify()
    assert result.verdict is Verdict.VERIFIED, result.reason
    assert result.certificate is not None
    answer = check(result.certificate, case.policy, case.specification, workers=1)
    assert isinstance(answer, Accepted) and answer.header.version == 2
    if case.options.enclosure == "crown":
        assert forms_of(result.certificate, case) == {TWO_LINES}


@pytest.mark.parametrize("enclosure", BOTH)
@pytest.mark.parametrize("number", [0, pytest.param(7, marks=pytest.mark.slow)])
def test_covers_of_several_leaves_are_verified(number: int, enclosure: str) -> None:
    result = case_of(number, tight=0.7, splits=64, method="jets", enclosure=enclosure).verify()
    assert result.verdict is Verdict.VERIFIED and result.leaves > 1, result.reason


def test_each_period_of_each_cell_takes_the_form_that_is_better_there() -> None:
    for number in (20, 38):
        case = case_of(number, enclosure="best")
        assert forms_of(case.certificate, case) == {PARALLEL, TWO_LINES}
        assert isinstance(check(case.certificate, case.policy, case.specification, workers=1), Accepted)


@pytest.mark.parametrize("number", [0, 3, 8])
def test_the_default_is_the_first_version_of_the_format(number: int) -> None:
    case = case_of(number)
    assert opened(case.certificate, case.policy, case.specification).header["format"] == 1
    assert case_of(number, enclosure="zonotope").certificate == case.certificate


@pytest.mark.parametrize("enclosure", BOTH)
@pytest.mark.parametrize("case", [*quick(LOOPS), *slow(LOOPS)], ids=str)
def test_the_flowpipe_contains_simulated_trajectories(case: Any, enclosure: Any) -> None:
    laws.law_flowpipe(replace(case, options=replace(case.options, enclosure=enclosure)))


@pytest.mark.parametrize("case", [*quick(LOOPS), *slow(LOOPS)], ids=str)
def test_one_true_period_from_any_claimed_set_ends_in_the_next(case: Any) -> None:
    laws.law_one_period(replace(case, options=replace(case.options, enclosure="crown")), every=2)


def first_period(case: Any, options: Options, cells: int) -> Period:
    """Of several cells at once: parts of the initial set of different sizes."""
    engine, initial = laws.engine_of(case.loop, options)
    size = np.linspace(0.2, 1.0, cells)[:, None] * np.ones(initial.free.size)
    with np.errstate(all="ignore"):
        return Engine.advance(engine, 0, laws.first_cells(engine, initial, -size, size))[0]


def private_share(period: Period, unit: Array) -> Array:
    return (np.abs(period.computed.generators[:, period.tracked.generators.shape[1] :]).sum(1) / unit).sum(1)


@pytest.mark.parametrize("case", LOOPS, ids=str)
def test_the_better_of_both_adds_no_more_than_either(case: Any) -> None:
    periods = [first_period(case, replace(case.options, enclosure=e), 5) for e in ("zonotope", *BOTH)]
    unit = np.abs(periods[0].computed.generators).sum(1)
    unit = np.where(unit > 0.0, unit, 1.0)
    # rows behind the tracked ones are the observation's and the action's own; the latter are last in all three
    zonotope, crown, best = (private_share(period, unit) for period in periods)
    assert (best <= np.minimum(zonotope, crown) * (1 + 1e-12)).all()
    forms = periods[2].choices.forms
    assert forms is not None and forms.shape == (5,)
    assert np.allclose(best, np.where(forms == TWO_LINES, crown, zonotope))


def test_a_cell_without_a_bound_takes_the_enclosure_that_has_one() -> None:
    case = LOOPS[0]
    engine, initial = laws.engine_of(case.loop, replace(case.options, enclosure="best"))
    sets: list[Any] = []
    with pytest.MonkeyPatch.context() as patch, np.errstate(all="ignore"):
        original = action_sets.better_set
        patch.setattr("setrl.verify.closed_loop.better_set", lambda *a: sets.append(a) or original(*a))
        engine.advance(0, laws.first_cells(engine, initial))
    forward, backward, shared = sets[0]
    unknown = replace(forward, output=replace(forward.output, generators=np.nan * forward.output.generators))
    _, forms = original(unknown, backward, shared)
    assert (forms == TWO_LINES).all()
    unknown = replace(backward, output=replace(backward.output, generators=np.nan * backward.output.generators))
    _, forms = original(forward, unknown, shared)
    assert (forms == PARALLEL).all()


def test_sets_with_different_numbers_of_rows_keep_their_boxes_last() -> None:
    """Two cells, one of each set: shared rows first, then kept ones (or zeros), then the box."""
    generator = np.random.default_rng(0)

    def made(rows: int, size: Array) -> ActionSet:
        kept = size[:, None, None] * generator.normal(size=(2, rows, 2))
        shared, box = np.ones((2, 3, 2)), diagonal_rows(size[:, None] * generator.random((2, 2)))
        z = Zonotope(np.zeros((2, 2)), np.concatenate([shared, kept, box], 1), np.zeros((2, 2)))
        index = np.tile(np.arange(rows), (2, 1))
        return ActionSet(z, index, np.zeros((2, 2)), np.zeros(2), (), np.zeros(0, dtype=np.intp))

    for rows in ((4, 0), (0, 4)):
        forward, backward = made(rows[0], np.array([0.01, 1.0])), made(rows[1], np.array([1.0, 0.01]))
        found, forms = better_set(forward, backward, 3)
        assert forms.tolist() == [PARALLEL, TWO_LINES] and found.output.generators.shape == (2, 9, 2)
        for cell, given in enumerate((forward, backward)):
            own, count = given.output.generators[cell], given.kept.shape[1]
            padded = np.concatenate([own[: 3 + count], np.zeros((4 - count, 2)), own[3 + count :]])
            assert np.array_equal(found.output.generators[cell], padded)


def test_an_unknown_enclosure_is_refused() -> None:
    with pytest.raises(UsageError, match="enclosure must be zonotope, crown or best"):
        Options(enclosure="deepest")  # type: ignore[arg-type]


# Bugs ---------------------------------------------------------------------------------------------------------------


def half_the_box(merged_set: Any, z: Any, *rest: Any) -> Any:
    return merged_set(replace(z, radius=0.5 * z.radius), *rest)


def other_rows(merged_set: Any, z: Any, *rest: Any) -> Any:
    return merged_set(replace(z, generators=0.9 * z.generators), *rest)


def narrow_clip(clip: Any, *arguments: Any) -> Any:
    lines, inexact = clip(*arguments)
    return replace(lines, upper_offset=0.5 * (lines.upper_offset + lines.lower_offset)), inexact


def no_error(deployed_error: Any, *arguments: Any) -> Any:
    return 0.0 * deployed_error(*arguments)


def lines_inside(lines_with: Any, *arguments: Any) -> Any:
    lines = lines_with(*arguments)
    return replace(lines, lower_offset=lines.lower_offset + 1e-6)


def exchanged(lines_with: Any, *arguments: Any) -> Any:
    lines = lines_with(*arguments)
    return replace(lines, lower_slope=lines.upper_slope, upper_slope=lines.lower_slope)


def turned(lines_with: Any, *arguments: Any) -> Any:
    lines = lines_with(*arguments)
    return replace(lines, lower_slope=-lines.lower_slope)


BUGS: dict[str, tuple[Any, str, Any, dict[str, Any]]] = {
    "half the box": (backward_action, "merged_set", half_the_box, {"number": 0}),
    "rows of another set": (backward_action, "merged_set", other_rows, {"number": 6}),
    "upper line of the clip too low": (backward_action, "_clip", narrow_clip, {"number": 13, "wide": 6.0}),
    "deployed error dropped": (backward_action, "deployed_error", no_error, {"number": 6}),
    "lower lines too high": (backward_slopes, "lines_with", lines_inside, {"number": 6}),
    "slopes exchanged": (backward_slopes, "lines_with", exchanged, {"number": 1, "wide": 6.0}),
    "sign of lower slopes": (backward_slopes, "lines_with", turned, {"number": 12, "wide": 6.0}),
}


@pytest.mark.parametrize("name", BUGS)
def test_the_checker_rejects_what_a_broken_engine_claims(name: str) -> None:
    module, function, change, given = BUGS[name]
    case = case_of(**{**given, "enclosure": "crown"})
    assert isinstance(check(case.certificate, case.policy, case.specification, workers=1), Accepted)
    with pytest.MonkeyPatch.context() as patch:
        wrapped(module, function, change)(patch)
        result = case.verify(check=False)
    assert result.verdict is Verdict.CLAIMED and result.certificate is not None
    assert result.certificate != case.certificate
    assert not isinstance(check(result.certificate, case.policy, case.specification, workers=1), Accepted)
