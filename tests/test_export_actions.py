"""The network claims of a certificate: the exported network is the controller, the queries are what is claimed."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction
from itertools import pairwise
from pathlib import Path
from typing import Any

import numpy as np
import onnx
import pytest
from certificates import case_of
from export_cases import ALL, NUMBERS, case, factors, loop, networks, networks_of, observations, run, satisfied, source
from flint import arb, ctx

from setrl.models.policy import Affine
from setrl.models.simulation import act
from setrl.specs.reader import find_specification
from setrl.verify.checker import layers as exact
from setrl.verify.checker import obligations
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.leaf import ActionClaim
from setrl.verify.export.action_claims import RELATIVE, action_queries
from setrl.verify.export.exact import DIGITS, at_least, decimal_above, decimal_below
from setrl.verify.export.period_network import PRECISION, PeriodNetwork
from setrl.verify.export.sources import read_source
from setrl.verify.export.tracked import tracked_sets
from setrl.verify.verifier import verify

SAMPLES = 10_000


@pytest.mark.parametrize("number", ALL)
def test_the_sets_are_those_that_the_checker_proves(number: int, monkeypatch: pytest.MonkeyPatch) -> None:
    given, seen = case(number), []
    genuine = obligations._unboxed

    def spy(tracked: Any) -> Any:
        seen.append(genuine(tracked))
        return seen[-1]

    monkeypatch.setattr(obligations, "_unboxed", spy)
    assert isinstance(check(given.certificate, given.policy, given.specification, workers=1), Accepted)
    layout = source(number).layout
    leaves = [source(number).leaf(leaf) for leaf in range(len(source(number).boxes))]
    followed = [entry for leaf in leaves for entry in tracked_sets(layout, leaf)]
    assert len(seen) == len(followed) == layout.periods * len(leaves)
    assert [period for _, period in followed] == [period for leaf in leaves for period in leaf.periods]
    for proved, (start, _) in zip(seen, followed, strict=True):
        assert tuple(proved.center) == tuple(start.center) and not any(start.radius)
        assert [tuple(row) for row in proved.rows] == [tuple(row) for row in start.rows]


def test_the_sets_above_include_queues_of_actions_and_constant_disturbances() -> None:
    layouts = [source(number).layout for number in NUMBERS]
    assert max(layout.delay for layout in layouts) > 1 and any(layout.constant for layout in layouts)


@pytest.mark.parametrize("number", ALL)
def test_the_exported_network_is_the_controller_on_the_claimed_observations(number: int) -> None:
    generator = np.random.default_rng(number)
    for network in networks(number):
        onnx.checker.check_model(onnx.load_from_string(network.content), full_check=True)
        points = factors(network, 64, generator)
        expected = act(loop(number), observations(network, points))
        assert np.allclose(run(network.content, points), expected, rtol=0.0, atol=3e-5)


def written_actions(network: PeriodNetwork, point: Any) -> list[Any]:
    """The numbers of the file in ball arithmetic."""
    values = [arb(float(x)) for x in point]
    for written in network.layers:
        layer = written.exact
        if isinstance(written.layer, Affine):
            layer = exact.Dense(
                tuple(tuple(map(float, row)) for row in written.layer.weight.astype(network.precision)),
                tuple(map(float, written.layer.bias.astype(network.precision))),
            )
        values = exact.apply(layer, values)
    return values


@pytest.mark.parametrize("number", ALL)
def test_the_written_network_differs_from_the_exact_one_by_less_than_is_claimed(number: int) -> None:
    generator = np.random.default_rng(number)
    largest = Fraction(0)
    for network in networks(number):
        for point in factors(network, 8, generator):
            with ctx.workprec(PRECISION):
                values = [arb(float(x)) for x in point]
                for layer in network.layers:
                    values = exact.apply(layer.exact, values)
                pairs = zip(written_actions(network, point), values, strict=True)
                distances = [at_least(abs(a - b)) for a, b in pairs]
            assert all(distance <= most for distance, most in zip(distances, network.rounding, strict=True))
            largest = max(largest, *(d / most for d, most in zip(distances, network.rounding, strict=True) if most))
    assert largest > Fraction(1, 1000), "the bound says nothing"


@pytest.mark.parametrize("number", ALL)
@pytest.mark.parametrize("form", ["interval", "relative"])
def test_no_sample_is_beyond_a_claim(number: int, form: str) -> None:
    generator = np.random.default_rng(number)
    for network in networks(number):
        points = factors(network, SAMPLES // len(networks(number)), generator)
        actions = run(network.content, points)
        for asked in action_queries(network, form):
            worst = points[int(np.argmax(_excess(asked, points, actions)))]
            assert (_excess(asked, points, actions) < 0.0).all()
            result = run(network.content, worst)[0]
            assert not satisfied(asked.query, worst, result)


def _excess(asked: Any, points: Any, actions: Any) -> Any:
    """How far each point is beyond a bound, in float64."""
    sign = 1.0 if asked.side == "upper" else -1.0
    (constraint,) = asked.query.cases[0].constraints
    rows = np.zeros(points.shape[1])
    for index, number in constraint.inputs:
        rows[index] = float(number)
    return sign * actions[:, asked.output] - points @ rows - sign * float(asked.bound)


@pytest.mark.parametrize("number", [7, 29])
@pytest.mark.parametrize("form", ["interval", "relative"])
def test_a_claim_that_is_shrunk_below_a_recorded_action_is_violated_by_it(number: int, form: str) -> None:
    generator = np.random.default_rng(number)
    network = networks(number)[-1]
    points = factors(network, 64, generator)
    actions = run(network.content, points)
    for asked in action_queries(network, form):
        sign = 1.0 if asked.side == "upper" else -1.0
        excess = _excess(asked, points, actions)
        which = int(np.argmax(excess))
        moved = -float(excess[which]) + 1e-6
        center = list(network.action.center)
        center[asked.output] -= sign * moved
        planted = replace(network, action=replace(network.action, center=tuple(center)))
        (wrong,) = [q for q in action_queries(planted, form) if (q.output, q.side) == (asked.output, asked.side)]
        assert not satisfied(asked.query, points[which], actions[which])
        assert satisfied(wrong.query, points[which], actions[which])
        low, high = network.actions(points[which])[asked.output]
        rest = Fraction(float(points[which] @ _rows(wrong, points.shape[1])))
        assert sign * (low if sign > 0 else high) - rest > sign * wrong.claimed, "no violation of the claim itself"


def _rows(asked: Any, count: int) -> Any:
    rows = np.zeros(count)
    for index, number in asked.query.cases[0].constraints[0].inputs:
        rows[index] = float(number)
    return rows


@pytest.mark.parametrize("number", ALL)
def test_a_bound_is_beyond_the_claim_by_what_rounding_can_do_and_hardly_more(number: int) -> None:
    for network in networks(number):
        for form in ("interval", "relative"):
            for asked in action_queries(network, form):
                sign = 1 if asked.side == "upper" else -1
                room = sign * (asked.bound - asked.claimed) - asked.rounding
                (constraint,) = asked.query.cases[0].constraints
                written = {index: sign * number for index, number in constraint.inputs}
                kept = [i for i, factor in enumerate(network.factors) if form == RELATIVE and factor.kind == "tracked"]
                exact_rows = {i: Fraction(network.action.rows[network.factors[i].position][asked.output]) for i in kept}
                moved = sum((abs(written.get(i, Fraction(0)) - x) for i, x in exact_rows.items()), Fraction(0))
                assert set(written) <= set(kept) and network.rounding[asked.output] + moved <= asked.rounding
                assert 0 < room <= abs(asked.bound) * Fraction(10) ** (1 - DIGITS) + Fraction(10) ** (-DIGITS)


@pytest.mark.parametrize("number", ALL)
def test_the_interval_claim_is_the_claimed_set_of_actions(number: int) -> None:
    """Over all factors of the claimed set, private ones and the box included."""
    for network in networks(number):
        action = network.action
        for lower, upper in pairwise(action_queries(network)):
            if lower.output != upper.output:
                continue
            i = lower.output
            rows = [*action.rows, *action.private]
            reach = sum((abs(Fraction(row[i])) for row in rows), Fraction(action.box[i]))
            center = Fraction(action.center[i])
            assert (lower.claimed, upper.claimed) == (center - reach, center + reach)


def test_the_relative_form_never_asks_for_more_room_and_often_for_less() -> None:
    ratios = []
    for number in NUMBERS:
        widths = []
        for form in ("interval", RELATIVE):
            lower, upper = list(action_queries(networks(number)[-1], form))[:2]
            widths.append(upper.claimed - lower.claimed)
        ratios.append(widths[1] / widths[0])
    assert max(ratios) <= 1 and min(ratios) < Fraction(1, 4)


def test_factors_that_move_no_observation_are_no_inputs_and_every_other_one_is() -> None:
    for number in NUMBERS:
        for (start, period), network in zip(
            tracked_sets(source(number).layout, source(number).leaf(0)), networks(number), strict=True
        ):
            observed = source(number).layout.observed
            tracked = [f.position for f in network.factors if f.kind == "tracked"]
            if observed is not None:
                moving = [j for j, row in enumerate(start.rows) if any(row[i] for i in observed)]
            else:
                assert period.seen is not None
                moving = [j for j, row in enumerate(period.seen.rows) if any(row)]
            assert tracked == moving
            others: dict[str, Any] = {"perturbation": source(number).radius}
            if observed is None:
                assert period.seen is not None
                others |= {"product": [any(row) for row in period.seen.fresh], "map": period.seen.radius}
            for kind in ("perturbation", "product", "map"):
                moving = [i for i, size in enumerate(others.get(kind, ())) if size]
                assert [f.position for f in network.factors if f.kind == kind] == moving
            for factor in network.factors:
                if factor.kind in ("perturbation", "map"):
                    length = others[factor.kind][factor.position]
                    assert [x for x in factor.row if x] == [length] and factor.row[factor.position] == length


def test_a_claimed_row_whose_factor_is_no_input_widens_the_relative_claim() -> None:
    network = networks(7)[-1]
    dropped, kept = network.factors[0], network.factors[1:]
    assert dropped.kind == "tracked" and network.action.rows[dropped.position][0]
    reach = abs(Fraction(network.action.rows[dropped.position][0]))
    lower, upper, *_ = action_queries(network, RELATIVE)
    wider_lower, wider_upper, *_ = action_queries(replace(network, factors=kept), RELATIVE)
    assert wider_lower.claimed == lower.claimed - reach and wider_upper.claimed == upper.claimed + reach


def test_a_claim_that_is_attained_is_no_violation() -> None:
    """The bound of a query is beyond the claim even where that is a decimal and nothing is rounded."""
    action = ActionClaim((0.5,), (), (), (), (0.25,))
    network = replace(networks(3)[0], action=action, rounding=(Fraction(0),))
    lower, upper = action_queries(network)
    assert (lower.claimed, upper.claimed) == (Fraction(1, 4), Fraction(3, 4))
    assert lower.bound < lower.claimed < upper.claimed < upper.bound


@pytest.mark.parametrize(
    "text", ["0", "1/3", "-1/3", "0.1", "123456789.125", "-7e-12", "99999999999999999999", "1e-30"]
)
@pytest.mark.parametrize("strictly", [False, True])
def test_a_decimal_is_on_its_side_and_near(text: str, strictly: bool) -> None:
    number = Fraction(text)
    above, below = decimal_above(number, strictly), decimal_below(number, strictly)
    assert below <= number <= above and (not strictly or below < number < above)
    assert above - below <= 2 * max(abs(number), Fraction(1, 10**DIGITS)) * Fraction(10) ** (1 - DIGITS)
    for decimal in (above, below):
        assert (decimal * 10**60).denominator == 1


@pytest.mark.parametrize("name", ["nn-nav-set.onnx"])
def test_the_claims_of_nav_hold_on_samples(name: str, nav_folder: Path) -> None:
    place = find_specification("nav.yaml")
    result = verify(str(nav_folder / name), str(place), check=False)
    assert result.certificate is not None
    given = read_source(result.certificate, (nav_folder / name).read_bytes(), place.read_bytes(), place.parent)
    generator = np.random.default_rng(0)
    found = networks_of(given)
    queries = 0
    for network in found:
        points = factors(network, SAMPLES // len(found), generator)
        actions = run(network.content, points)
        for asked in action_queries(network):
            queries += 1
            assert (_excess(asked, points, actions) < 0.0).all()
        assert max(network.rounding) < Fraction(1, 10**5)
    assert queries == 120


def test_a_policy_in_float64_is_exported_in_float64() -> None:
    given = case_of(3, precision="float64", subject="unicycle")
    (first, *_) = networks_of(read_source(given.certificate, given.policy, given.specification))
    model = onnx.load_from_string(first.content)
    assert first.precision == "float64" and model.graph.input[0].type.tensor_type.elem_type == onnx.TensorProto.DOUBLE
    assert max(first.rounding) < Fraction(1, 10**12)
