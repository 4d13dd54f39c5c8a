"""VNN-LIB text: exact both ways, read by the official parser, refused where it is not understood."""

from __future__ import annotations

import importlib
import math
from fractions import Fraction
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from vnnlib_queries import at_most, known_queries, query_of

from setrl.specs.errors import InputError
from setrl.specs.queries import Case, LinearConstraint, Query
from setrl.specs.specification import Bounds
from setrl.specs.vnnlib_numbers import LARGEST, LEAST, number_text, read_number
from setrl.specs.vnnlib_reader import parse_vnnlib
from setrl.specs.vnnlib_writer import vnnlib_1_text, vnnlib_2_text

vnnlib = pytest.importorskip("vnnlib", reason="the official parser is part of the extra `dev`")
F = Fraction
NORMAL = st.floats(allow_nan=False, allow_infinity=False, allow_subnormal=False)
RATIONAL = st.builds(F, st.integers(-(10**9), 10**9), st.integers(1, 10**9))


def plain(text: str) -> bool:
    whole, point, rest = text.removeprefix("-").partition(".")
    return point == "." and whole.isdigit() and rest.isdigit() and text.isascii()


@settings(max_examples=60, deadline=None)
@given(NORMAL)
def test_every_normal_float_is_written_exactly(x: float) -> None:
    for toward in (-1, 1):
        text = number_text(F(x), toward)
        assert plain(text) and float(text) == x and read_number(text) == F(x)


@settings(max_examples=60, deadline=None)
@given(st.floats(allow_nan=False, allow_infinity=False), RATIONAL, st.sampled_from([-1, 1]))
def test_what_is_not_written_exactly_is_moved_in_the_given_direction(x: float, factor: Fraction, toward: int) -> None:
    value = F(x) * factor
    if abs(value) > LARGEST:
        with pytest.raises(InputError, match="larger than any float64"):
            number_text(value, toward)
        return
    text = number_text(value, toward)
    read = read_number(text)
    assert plain(text) and (read - value) * toward >= 0
    assert read == 0 or abs(read) >= LEAST
    assert abs(read - value) <= max(abs(value) / 10**35, LEAST)


@pytest.mark.parametrize("tiny", [math.ulp(0.0), 2.0**-1022 - math.ulp(0.0), 1e-310])
def test_subnormal_numbers_are_moved_outward(tiny: float) -> None:
    assert read_number(number_text(F(tiny), 1)) == LEAST
    assert number_text(F(tiny), -1) == number_text(F(-tiny), 1) == "0.0"
    assert read_number(number_text(F(-tiny), -1)) == -LEAST


SIZES = {"inputs": 4, "outputs": 3}


@st.composite
def queries(draw: Any, exact: bool) -> Query:
    """With shapes of several axes; `exact` where decimals express every number."""
    number = NORMAL.map(F) if exact else st.one_of(RATIONAL, NORMAL.map(F))
    number = number.filter(lambda value: value == 0 or 2.0**-900 < abs(value) < 2.0**900)

    def terms(size: int) -> Any:
        entries = st.dictionaries(st.integers(0, size - 1), number.filter(bool), max_size=size)
        return entries.map(lambda found: tuple(sorted(found.items())))

    def bounds() -> Any:
        return st.tuples(number, number).map(lambda ends: Bounds(min(ends), max(ends)))

    constraint = st.builds(LinearConstraint, terms(4), terms(3), number)
    proper = constraint.filter(lambda k: k.outputs or len(k.inputs) > 1)
    boxes = [tuple(draw(bounds()) for _ in range(4)) for _ in range(draw(st.integers(1, 2)))]
    cases = [
        Case(draw(st.sampled_from(boxes)), tuple(draw(st.lists(proper, min_size=1, max_size=3))))
        for _ in range(draw(st.integers(1, 3)))
    ]
    return Query((1, 2, 2), (1, 3), tuple(cases))


def normal(constraint: LinearConstraint) -> LinearConstraint:
    """Up to a positive factor."""
    scale = abs((constraint.inputs + constraint.outputs)[0][1])
    inputs, outputs = (tuple((i, c / scale) for i, c in side) for side in (constraint.inputs, constraint.outputs))
    return LinearConstraint(inputs, outputs, constraint.bound / scale)


@settings(max_examples=15, deadline=None)
@given(queries(exact=True))
def test_a_query_of_floats_reads_back_as_it_was_written(query: Query) -> None:
    for text, shapes in (
        (vnnlib_1_text(query), ((1, 4), (1, 3))),
        (vnnlib_2_text(query), (query.inputs, query.outputs)),
    ):
        read = parse_vnnlib(text.encode())
        assert (read.inputs, read.outputs) == shapes
        assert len(read.cases) == len(query.cases)
        for found, case in zip(read.cases, query.cases, strict=True):
            assert found.box == case.box
            assert [normal(k) for k in found.constraints] == [normal(k) for k in case.constraints]


@settings(max_examples=15, deadline=None)
@given(queries(exact=False))
def test_a_text_asks_at_least_what_the_query_asks(query: Query) -> None:
    for text in (vnnlib_1_text(query), vnnlib_2_text(query)):
        for found, case in zip(parse_vnnlib(text).cases, query.cases, strict=True):
            assert all(f.lower <= b.lower and b.upper <= f.upper for f, b in zip(found.box, case.box, strict=True))
            for wide, constraint in zip(map(normal, found.constraints), map(normal, case.constraints), strict=True):
                assert (wide.inputs, wide.outputs) == (constraint.inputs, constraint.outputs)
                assert wide.bound >= constraint.bound


@settings(max_examples=15, deadline=None)
@given(queries(exact=False))
def test_the_official_parser_reads_what_is_written_in_version_2(query: Query) -> None:
    read = vnnlib.parse_query_string(vnnlib_2_text(query, network="policy_1"))
    assert [network.name for network in read.networks] == ["policy_1"]


def test_the_official_parser_sees_the_boxes_and_constraints_that_were_written() -> None:
    seen = 0
    for known in known_queries()[::8]:
        shared = {case.box for case in known.query.cases}
        if len(shared) > 1 or any(k.inputs for case in known.query.cases for k in case.constraints):
            continue
        compat = importlib.import_module("vnnlib.compat")
        found = compat.transform(vnnlib.parse_query_string(vnnlib_2_text(known.query)))
        (box,) = shared
        assert all(case.input_box == [(float(b.lower), float(b.upper)) for b in box] for case in found)
        polytopes = [polytope for case in found for polytope in case.output_constraints]
        for polytope, case in zip(polytopes, known.query.cases, strict=True):
            rows = zip(polytope.coeff_matrix, polytope.rhs, case.constraints, strict=True)
            for row, bound, constraint in rows:
                entries = dict(constraint.outputs)
                asked = [float(entries.get(j, F(0))) for j in range(len(row))] + [float(constraint.bound)]
                scale = max(map(abs, asked[:-1])) / max(map(abs, row))
                assert [scale * number for number in (*row, bound)] == pytest.approx(asked, rel=1e-12, abs=1e-12)
                seen += 1
    assert seen > 10


@pytest.mark.parametrize("network", ["", "1N", "a b", "é", "N)", "_N"])
def test_a_network_has_a_name_that_every_parser_reads(network: str) -> None:
    query = query_of(1, 1, [Case((Bounds(F(0), F(1)),), (at_most(F(0), [F(1)]),))])
    with pytest.raises(InputError, match="no name of a network"):
        vnnlib_2_text(query, network)


def test_a_query_that_nothing_satisfies_is_not_written_as_one_that_everything_does() -> None:
    box = (Bounds(F(0), F(1)),)
    for cases in ([], [Case(box, (at_most(F(-1), [F(0)]),))]):
        with pytest.raises(InputError, match="without a case"):
            vnnlib_1_text(query_of(1, 1, cases))
    free = Case(box, (at_most(F(1), [F(0)]),))
    asked = Case(box, (at_most(F(-1), [F(1)]),))
    (read,) = parse_vnnlib(vnnlib_1_text(query_of(1, 1, [asked, free]))).cases
    assert read == Case(box, ())


def test_comments_stay_comments() -> None:
    box = (Bounds(F(0), F(1)),)
    case = Case(box, (at_most(F(0), [F(1)]),))
    query = Query((1, 1), (1, 1), (case,), "first\n(assert (<= Y_0 1.0))\rsecond\u2028third \x0b ü")
    for text in (vnnlib_1_text(query), vnnlib_2_text(query)):
        assert text.isascii()
        assert parse_vnnlib(text).cases == (case,)
        assert parse_vnnlib(text).comment.splitlines()[:2] == ["first", "(assert (<= Y_0 1.0))"]
    vnnlib.parse_query_string(vnnlib_2_text(query))


def test_a_coefficient_that_no_decimal_expresses_is_scaled_and_not_rounded() -> None:
    box = (Bounds(F(0), F(1)),)
    constraint = LinearConstraint(((0, F(1, 3)),), ((0, F(1, 7)),), F(1, 11))
    text = vnnlib_1_text(query_of(1, 1, [Case(box, (constraint,))]))
    assert "(* 7.0 X_0)" in text and "(* 3.0 Y_0)" in text
