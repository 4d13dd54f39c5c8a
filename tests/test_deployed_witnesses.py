"""What a runtime's recorded actions prove: of the execution, nothing of exact arithmetic, and only if they are real."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import replace
from fractions import Fraction
from itertools import chain, combinations
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import arb
from loops import network
from witnesses import GOOD_POLICY, GOOD_TEXT, HOLD, MAP, PENDULUM, good, text_of, witness_of

from setrl.models.binding import bind
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_runtime import deployed_runner
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Affine, Policy
from setrl.models.simulation import simulate
from setrl.specs.reader import find_specification, parse_specification
from setrl.verify.checker.recorded import FLOAT32, FLOAT64, rounded
from setrl.verify.checker.witness import Proof, Recording, Witness, prove, record
from setrl.verify.witness_replay import exact_runner, replay, runtime_name

F = Fraction


def recorded(witness: Witness, policy: bytes, specification: bytes) -> Witness | str:
    run = exact_runner(read(policy))
    return record(witness, policy, specification, run=run, runtime=runtime_name())


def read(policy: bytes) -> Policy:
    return read_policy(policy)


def proved(witness: Witness, policy: bytes, specification: bytes) -> Proof | str:
    """As the front door does it: the recording is run again."""
    assert witness.deployed is not None
    same = replay(witness.deployed.observations, witness.deployed.actions, read(policy))
    return prove(witness, policy, specification, replayed=runtime_name() if same else "")


def small(rows: Any, bias: Any, precision: str = "float32") -> bytes:
    weight = np.array(rows, dtype=np.float64)
    return policy_bytes((Affine(weight, np.array(bias, dtype=np.float64)),), precision=precision)


# Floats ---------------------------------------------------------------------------------------------------------------


def hard_numbers() -> list[Fraction]:
    """Numbers at, beside and between floats of both types, from below the smallest to above the largest."""
    generator = np.random.default_rng(3)
    floats = [*generator.normal(size=200), *np.ldexp(generator.normal(size=400), generator.integers(-1080, 1024, 400))]
    floats += [*np.ldexp(generator.normal(size=200), generator.integers(-155, 129, 200)), 0.0, 2.0**-149, 2.0**-1074]
    exact = [F(value) for value in floats if np.isfinite(value)]
    singles = [F(float(np.float32(value))) for value in floats if abs(value) < 3e38]
    ties = [value * (1 + F(1, 2**bits)) for value in singles for bits in (24, 53)]
    return [*exact, *ties, *(value + F(1, 10**60) for value in ties), *(value - F(1, 10**60) for value in ties)]


def test_numbers_are_rounded_as_the_hardware_does() -> None:
    largest32, largest64 = F(float(np.finfo(np.float32).max)), F(float(np.finfo(np.float64).max))
    for value in hard_numbers():
        nearest = FLOAT64.nearest(value)
        assert nearest is None if abs(value) > largest64 else nearest == F(float(value))
        if F(float(value)) == value:  # numpy rounds float64 numbers only
            with np.errstate(over="ignore", under="ignore"):
                single = float(np.float32(float(value)))
            assert FLOAT32.nearest(value) == (F(single) if np.isfinite(single) else None)
        if (single := FLOAT32.nearest(value)) is not None and abs(value) < largest32:
            below, above = (np.nextafter(np.float32(single), np.float32(side)) for side in (-np.inf, np.inf))
            others = [F(float(side)) for side in (below, above) if np.isfinite(side)]
            assert all(abs(value - single) <= abs(value - other) for other in others)


def test_a_ball_is_rounded_only_where_all_of_its_points_are() -> None:
    tie = F(1) + F(1, 2**24)
    one, following = F(1), F(1) + F(1, 2**23)
    exact = arb(1) + arb(2) ** -24
    assert rounded(exact, FLOAT32) == one  # to even
    assert rounded(arb(following.numerator) / following.denominator + arb(2) ** -24, FLOAT32) == F(1) + F(1, 2**22)
    assert rounded(exact - arb(2) ** -100, FLOAT32) == one and rounded(exact + arb(2) ** -40, FLOAT32) == following
    assert rounded(arb(tie.numerator / 2**24, 1e-20), FLOAT32) is None
    assert rounded(arb(1, 1e-9), FLOAT32) == one and rounded(arb(1, 1e-7), FLOAT32) is None
    assert rounded(arb(1, 1e-9), FLOAT64) is None
    assert rounded(arb(0, 1e-50), FLOAT32) == 0 and rounded(arb(0, 1e-44), FLOAT32) is None
    assert rounded(arb(2) ** -(10**12), FLOAT64) == 0
    for value in (arb("nan"), arb("inf"), arb(10) ** 39, arb(10) ** (10**12), arb(0, "inf")):
        assert rounded(value, FLOAT32) is None


def test_sums_that_count_as_exact_are_exact_in_every_order() -> None:
    generator = np.random.default_rng(5)
    accepted = 0
    for _ in range(400):
        wide = generator.integers(1, 14)
        whole = generator.integers(-(2**wide), 2**wide, generator.integers(1, 6))
        terms = [
            F(int(n)) * F(2) ** int(e) for n, e in zip(whole, generator.integers(-12, 13, whole.size), strict=True)
        ]
        exact = FLOAT32.adds(terms)
        accepted += exact
        some = chain.from_iterable(combinations(terms, count) for count in range(1, len(terms) + 1))
        sums = [sum(chosen, F(0)) for chosen in some]
        assert not exact or all(FLOAT32.nearest(value) == value for value in sums)
    assert accepted > 100
    assert FLOAT32.adds([F(1), F(1, 2**23)]) and not FLOAT32.adds([F(1), F(1, 2**24)])
    assert not FLOAT32.adds([F(1), F(2**24), F(-(2**24))]) and not FLOAT32.adds([F(1, 10)])
    assert not FLOAT32.adds([F(1, 2**127)]) and not FLOAT32.adds([F(2**127), F(2**127)])  # flushed, overflows


# Witnesses ------------------------------------------------------------------------------------------------------------


def test_what_violates_in_both_senses_is_proved_in_both() -> None:
    witness = recorded(good(), GOOD_POLICY, GOOD_TEXT)
    assert isinstance(witness, Witness) and witness.deployed is not None
    assert len(witness.deployed.actions) == 3  # periods that begin before 0.3 s
    seen = np.float32([0.35, 0.0])
    assert witness.deployed.observations[0] == tuple(F(float(value)) for value in seen)
    returned = deployed_runner(read(GOOD_POLICY))(seen.astype(float))
    assert witness.deployed.actions[0] == tuple(F(float(value)) for value in returned[0])
    found = proved(witness, GOOD_POLICY, GOOD_TEXT)
    assert isinstance(found, Proof) and found.grade == "proved (real and deployed)" and not found.objection
    assert "in exact real arithmetic and for the actions that onnxruntime" in found.sentence and found.radius < 1e-30


CASES: dict[str, tuple[str, str, Callable[[int, str], bytes], dict[str, str]]] = {
    "pendulum": (
        PENDULUM,
        "theta omega",
        lambda seed, precision: policy_bytes(network([2, 8, 1], ["tanh", "tanh"], seed).layers, precision=precision),
        {"perturbation": "{observation: 0.05, disturbance: {d: {range: 0.1, varies: never}}}"},
    ),
    "map": (
        MAP,
        "x y",
        lambda seed, precision: policy_bytes(network([2, 8, 1], ["relu", "tanh"], seed).layers, precision=precision),
        {"controller": "{period: 0.1, observe: [x, sin(y) - x]}"},
    ),
    "maps, clip and delay": (
        PENDULUM,
        "theta omega",
        lambda seed, precision: policy_bytes(network([1, 6, 2], ["tanh", "tanh"], seed).layers, precision=precision),
        {
            "controller": "{period: 0.1, delay: {periods: 1, action: {a: 0.1}}, before: {matrix: [[0, 0.5]]}, "
            "after: {matrix: [[2, 0]]}, clip: {a: [-0.875, 10.1]}}",
        },
    ),
}


def between(name: str, precision: str, seed: int) -> tuple[bytes, bytes, Witness, bool]:
    """A facet halfway between the exact and the executed trajectory, a witness, and whether the executed one leaves."""
    plant, states, policy_of, options = CASES[name]
    policy = policy_of(seed, precision)
    first, second = states.split()
    text = text_of(
        plant, f'stay: "{first} <= 99"', initial=f"{{{first}: [0.1, 0.4], {second}: [-0.2, 0.2]}}", **options
    )
    loop = bind(parse_specification(text), read(policy))
    generator = np.random.default_rng(seed)
    initial = generator.uniform([0.1, -0.2], [0.4, 0.2])
    noise = generator.uniform(-0.049, 0.049, (loop.periods, 2))
    force = np.tile(generator.uniform(-0.09, 0.09, (1, 1)) * bool(options.get("perturbation")), (loop.periods, 1))
    given: dict[str, Any] = {"rtol": 1e-12, "atol": 1e-13}
    exact, executed = (
        simulate(loop, initial, noise[None], force[None], policy=runner, **given).states[0, -1, 0]
        for runner in (None, deployed_runner(loop.policy))
    )
    bound = (F(float(exact)) + F(float(executed))) / 2
    text = text.replace(b"<= 99", f"<= {bound.numerator}/{bound.denominator}".encode())
    assert abs(executed - exact) > 1e-11
    return policy, text, witness_of(policy, text, initial, "0.5", noise, force), bool(executed > exact)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("name", CASES)
def test_a_boundary_between_the_two_trajectories_is_violated_in_one_sense_only(name: str, seed: int) -> None:
    policy, text, witness, executed = between(name, "float32", seed)
    real = prove(witness, policy, text)
    found = recorded(witness, policy, text)
    if executed:
        assert isinstance(real, str) and "provably inside" in real and isinstance(found, Witness)
        proof = proved(found, policy, text)
        assert isinstance(proof, Proof) and proof.grade == "proved (deployed)"
        assert "computes, not in exact real arithmetic (the trajectory is provably inside" in proof.sentence
    else:
        assert isinstance(real, Proof) and isinstance(found, str) and "provably inside" in found
        lax = text.replace(b"<= ", b"<= -1 + ")
        other = recorded(replace(witness, specification=hashlib.sha256(lax).hexdigest()), policy, lax)
        assert isinstance(other, Witness)
        proof = proved(replace(witness, deployed=other.deployed), policy, text)
        assert isinstance(proof, Proof) and proof.grade == "proved (real)" and "inside" in proof.objection


def test_both_directions_occur_among_these_boundaries() -> None:
    assert {between(name, "float32", seed)[3] for name in CASES for seed in range(4)} == {True, False}


def test_a_float64_network_is_given_observations_rounded_to_float64() -> None:
    policy = small([[1 / 3, -0.7]], [0.1], "float64")
    text = text_of(PENDULUM, 'stay: "theta <= 0.3"', initial="{theta: 1/3, omega: 0.1}".replace("1/3", "0.3333"))
    witness = recorded(witness_of(policy, text, ["0.3333", "0.1"], "0.3"), policy, text)
    assert isinstance(witness, Witness) and witness.deployed is not None
    assert witness.deployed.observations[0] == (F(0.3333), F(0.1))
    found = proved(witness, policy, text)
    assert isinstance(found, Proof) and found.grade == "proved (real and deployed)"


@pytest.mark.parametrize(
    ("controller", "objection"),
    [
        ("before: {scale: 0.1}", "`before` rounds"),
        ("before: {offset: 0.5}", "`before` rounds"),
        ("after: {scale: 0.1}", "`after` rounds"),
        ("after: {offset: 0.5}", "`after` rounds"),
        ("clip: {u: [-1, -0.9]}", "`clip` rounds"),
        ("clip: {u: [0.1, 1]}", "`clip` rounds"),
        ("before: {scale: 2}, after: {scale: 4}, clip: {u: [-0.1, 0.1]}", ""),
        ("before: {scale: 1}, after: {scale: -0.5}, clip: {u: [-0.75, -0.5]}", ""),
    ],
)
def test_maps_and_bounds_that_round_prove_nothing_of_the_execution(controller: str, objection: str) -> None:
    policy = small([[0.3]], [1e-3])
    text = text_of(HOLD, 'stay: "x <= -9"', initial="{x: 0.01}", controller=f"{{period: 0.1, {controller}}}")
    plain = witness_of(policy, text, ["0.01"], "0.5")
    assert isinstance(prove(plain, policy, text), Proof)
    witness = recorded(plain, policy, text)
    if objection:
        assert isinstance(witness, str) and witness == f"{objection} in float32"
    else:
        assert isinstance(witness, Witness)
        found = proved(witness, policy, text)
        assert isinstance(found, Proof) and found.grade == "proved (real and deployed)"


# Recordings that are not what the runtime does ------------------------------------------------------------------------


@pytest.fixture(scope="module")
def recording() -> Recording:
    witness = recorded(good(), GOOD_POLICY, GOOD_TEXT)
    assert isinstance(witness, Witness) and witness.deployed is not None
    return witness.deployed


def changed(rows: Any, period: int, by: Any) -> Any:
    return (*rows[:period], (rows[period][0] + F(by), *rows[period][1:]), *rows[period + 1 :])


WRONG: dict[str, Any] = {
    "an action one unit off": lambda r: replace(r, actions=changed(r.actions, 1, F(1, 2**30))),
    "an observation one unit off": lambda r: replace(r, observations=changed(r.observations, 2, F(1, 2**25))),
    "an action that is no float": lambda r: replace(r, actions=changed(r.actions, 2, F(1, 3))),
    "an action that is too large": lambda r: replace(r, actions=changed(r.actions, 2, F(10) ** 1100)),
    "an observation that is too large": lambda r: replace(r, observations=changed(r.observations, 0, F(10) ** 1100)),
    "a period less": lambda r: replace(r, observations=r.observations[:-1], actions=r.actions[:-1]),
    "a period more": lambda r: replace(r, observations=(*r.observations, r.observations[0])),
    "no periods": lambda r: replace(r, observations=(), actions=()),
    "an action less": lambda r: replace(r, actions=((), *r.actions[1:])),
    "an observation less": lambda r: replace(r, observations=(r.observations[0][:1], *r.observations[1:])),
    "swapped periods": lambda r: replace(r, observations=r.observations[::-1], actions=r.actions[::-1]),
}


def test_a_recording_proves_nothing_unless_it_was_run_again(recording: Recording) -> None:
    found = prove(replace(good(), deployed=recording), GOOD_POLICY, GOOD_TEXT)
    assert isinstance(found, Proof) and found.grade == "proved (real)" and "not run again" in found.objection
    assert "onnxruntime" not in found.sentence


@pytest.mark.parametrize("name", WRONG)
def test_a_recording_that_is_wrong_proves_nothing(name: str, recording: Recording) -> None:
    witness = replace(good(), deployed=WRONG[name](recording))
    if "an action" in name:
        assert not replay(witness.deployed.observations, witness.deployed.actions, read(GOOD_POLICY))
    found = proved(witness, GOOD_POLICY, GOOD_TEXT)
    assert isinstance(found, Proof) and found.grade == "proved (real)" and found.objection


@pytest.mark.parametrize("name", [name for name in WRONG if name != "an action one unit off"])
def test_what_no_runtime_can_have_recorded_is_refused_whoever_vouches_for_it(name: str, recording: Recording) -> None:
    witness = replace(good(), deployed=WRONG[name](recording))
    found = prove(witness, GOOD_POLICY, GOOD_TEXT, replayed=runtime_name())
    assert isinstance(found, Proof) and found.grade == "proved (real)" and found.objection


def test_another_network_does_not_replay(recording: Recording) -> None:
    assert replay(recording.observations, recording.actions, read(GOOD_POLICY))
    other = policy_bytes(network([2, 4, 1], ["tanh", "tanh"], 4, 0.1).layers)
    assert not replay(recording.observations, recording.actions, read(other))


def test_a_runtime_that_overflows_records_nothing() -> None:
    policy = small([[1e30]], [0.0])
    text = text_of(HOLD, 'stay: "x <= -9"', initial="{x: 1}")
    witness = recorded(witness_of(policy, text, [1], "0.5"), policy, text)
    assert isinstance(witness, str) and "not" in witness


def test_recording_stops_when_the_time_is_up() -> None:
    run = exact_runner(read(GOOD_POLICY))
    found = record(good(), GOOD_POLICY, GOOD_TEXT, run=run, runtime=runtime_name(), stop=lambda: True)
    assert found == "the time is up"


def test_nav_with_a_larger_obstacle_is_falsified_as_deployed(nav_folder: Path) -> None:
    policy = (nav_folder / "nn-nav-set.onnx").read_bytes()
    text = find_specification("nav").read_bytes().replace(b"y: [1, 2]}  #", b"y: [1, 2.5]}  #")
    witness = recorded(witness_of(policy, text, [3, 3, 0, 0], F(15, 8), name="obstacle"), policy, text)
    assert isinstance(witness, Witness) and witness.deployed is not None and len(witness.deployed.actions) == 10
    found = proved(witness, policy, text)
    assert isinstance(found, Proof) and found.grade == "proved (real and deployed)" and found.radius < 1e-30
