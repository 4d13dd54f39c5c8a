"""A witness is proved where its trajectory violates the requirement, and only where the specification admits it."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from loops import network
from witnesses import GOOD_POLICY, GOOD_TEXT, HOLD, KEEP, MAP, PENDULUM, good, text_of, witness_of

from setrl.models.binding import bind
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Activation, Affine
from setrl.models.simulation import simulate
from setrl.specs.errors import InputError
from setrl.specs.reader import find_specification, parse_specification
from setrl.verify.checker.proof import Shown, proof_of
from setrl.verify.checker.question import Question, pose
from setrl.verify.checker.witness import Proof, prove, read_witness

F = Fraction


def proved(policy: bytes, specification: bytes, *arguments: Any, **options: Any) -> Proof:
    found = prove(witness_of(policy, specification, *arguments, **options), policy, specification)
    assert isinstance(found, Proof), found
    return found


def refused(policy: bytes, specification: bytes, *arguments: Any, **options: Any) -> str:
    found = prove(witness_of(policy, specification, *arguments, **options), policy, specification)
    assert isinstance(found, str), found
    return found


# Closed forms: x' = u with u = -x held for 0.1 s, so that x is multiplied by 0.9 in every period -------------------


@pytest.mark.parametrize(
    ("gap", "holds"), [("-1e-30", True), ("0", False), ("1e-30", False), ("-1e-300", True), ("1e-300", False)]
)
@pytest.mark.parametrize("kind", ["stay", "avoid", "reach"])
def test_the_boundary_is_met_to_hundreds_of_digits(kind: str, gap: str, holds: bool) -> None:
    """x = 0.9^5 = 0.59049 at 0.5 s; a gap below zero is a violation. Touching in a number that is no dyadic one is not
    decided: no precision tells it from not touching.
    """
    side = {"stay": "x <=", "avoid": "x >=", "reach": "x <="}[kind]
    bound = F("0.59049") + F(gap)
    text = text_of(HOLD, f'{kind}: "{side} {bound.numerator}/{bound.denominator}"\n    at: 0.5', initial="{x: 1}")
    found = prove(witness_of(KEEP, text, [1], None if kind == "reach" else "0.5"), KEEP, text)
    assert isinstance(found, Proof) == holds, found
    if isinstance(found, Proof):
        assert 0.0 <= found.depth <= 1.1e-30 and found.radius < 1e-30


def test_a_violation_between_the_samples_is_proved_at_its_exact_time() -> None:
    text = text_of(HOLD, "avoid: {x: [0.94, 0.96]}", initial="{x: 1}")
    assert proved(KEEP, text, [1], "0.05").depth == pytest.approx(0.01)
    assert "outside" in refused(KEEP, text, [1], "0")
    assert "outside" in refused(KEEP, text, [1], "0.1")
    assert proved(KEEP, text_of(HOLD, "avoid: {x: [1, 2]}", initial="{x: 1}"), [1], 0).depth == 0.0


def test_reach_is_missed_only_at_every_instant_of_its_window() -> None:
    for low, holds in (("0.65", True), ("0.66", False)):
        text = text_of(HOLD, f"reach: {{x: [{low}, 0.7]}}\n    during: [0.2, 0.5]", initial="{x: 1}")
        found = prove(witness_of(KEEP, text, [1], None), KEEP, text)
        assert isinstance(found, Proof) is not holds  # 0.9^4 = 0.6561
    missed = text_of(HOLD, "reach: {x: [0, 0.5]}\n    during: [0.2, 0.5]", initial="{x: 1}")
    assert "every sampling instant from 0.2 s to 0.5 s" in proved(KEEP, missed, [1], None).sentence
    assert "no single time" in refused(KEEP, missed, [1], "0.2")


def test_unions_are_left_only_if_every_member_is() -> None:
    inside = text_of(HOLD, "stay: {union: [{x: [0, 0.5]}, {x: [0.55, 0.7]}]}", initial="{x: 1}")
    assert proved(KEEP, inside, [1], 0).depth == pytest.approx(0.3)
    assert "inside" in refused(KEEP, inside, [1], "0.5")
    entered = text_of(HOLD, "avoid: {union: [{x: [0, 0.5]}, {x: [0.55, 0.7]}]}", initial="{x: 1}")
    assert proved(KEEP, entered, [1], "0.5").depth == pytest.approx(0.04049)


def test_delay_clip_and_maps_are_exact() -> None:
    controller = "{period: 0.1, delay: {periods: 2, action: {u: 0.5}}, before: {scale: 2}, after: {offset: 1}, "
    controller += "clip: {u: [-0.75, 10]}}"
    text = text_of(HOLD, 'stay: "x <= 0"', initial="{x: 1}", controller=controller)
    # actions 0.5, 0.5, then max(1 - 2 x, -0.75) of x = 1, 1.05, 1.1
    for time, x in (("0.1", "1.05"), ("0.2", "1.1"), ("0.3", "1.025"), ("0.5", "0.875")):
        assert proved(KEEP, text, [1], time).depth == pytest.approx(float(F(x)), rel=1e-15)


# Plants with known behaviour ----------------------------------------------------------------------------------------


def planted(specification: bytes, policy: bytes, gap: float, seed: int) -> Any:
    """A facet that one simulated trajectory leaves by `gap` at a time of the grid, its witness, and whether it does."""
    loop = bind(parse_specification(specification), read_policy(policy))
    generator = np.random.default_rng(seed)
    low, high = np.array([[float(b) for b in pair] for pair in loop.initial]).T
    initial = generator.uniform(low, high)
    noise = generator.uniform(-0.049, 0.049, (loop.periods, len(loop.observation_names)))
    force = np.tile(generator.uniform(-0.09, 0.09, (1, len(loop.disturbances))), (loop.periods, 1))
    samples = 1 if loop.plant.discrete else 4
    run = simulate(loop, initial, noise[None], force[None], rtol=1e-12, atol=1e-13, samples_per_period=samples)
    place = int(generator.integers(1, run.times.size))
    bound = F(float(run.states[0, place, 0]) - gap)
    text = specification.replace(b"<= 99", f"<= {bound.numerator}/{bound.denominator}".encode())
    return text, witness_of(policy, text, initial, place * loop.period / samples, noise, force)


@pytest.mark.parametrize("seed", range(6))
@pytest.mark.parametrize("name", ["pendulum", "map", "quadrotor1d"])
def test_planted_violations_are_proved_and_near_misses_are_not(name: str, seed: int) -> None:
    policy = policy_bytes(network([2, 8, 1], ["tanh" if seed % 2 else "relu", "tanh"], seed, 1.5).layers)
    plant, (x, y) = {
        "pendulum": (PENDULUM, ("theta", "omega")),
        "map": (MAP, ("x", "y")),
        "quadrotor1d": ("quadrotor1d", ("z", "zdot")),
    }[name]
    forces = "" if name == "quadrotor1d" else ", disturbance: {d: {range: 0.1, varies: never}}"
    specification = text_of(
        plant,
        f'stay: "{x} <= 99"',
        initial=f"{{{x}: [0.1, 0.4], {y}: [-0.2, 0.2]}}",
        perturbation=f"{{observation: 0.05{forces}}}",
        controller=f"{{period: 0.1, observe: [{x}, sin({y}) - {x}]}}",
    )
    text, witness = planted(specification, policy, 1e-6, seed)
    found = prove(witness, policy, text)
    assert isinstance(found, Proof) and found.depth == pytest.approx(1e-6, rel=1e-2) and found.radius < 1e-30
    text, witness = planted(specification, policy, -1e-6, seed)
    reason = prove(witness, policy, text)
    assert isinstance(reason, str) and "provably inside" in reason


# Corrupted witnesses ------------------------------------------------------------------------------------------------


def row(rows: Any, period: int, *values: Any) -> Any:
    return (*rows[:period], tuple(map(F, values)), *rows[period + 1 :])


CORRUPTED: dict[str, Any] = {
    "start outside": lambda w: replace(w, initial=(F("0.3") + F(1, 10**40), F(0))),
    "start of another size": lambda w: replace(w, initial=w.initial[:1]),
    "noise outside": lambda w: replace(w, noise=row(w.noise, 4, F("0.05") + F(1, 10**40), 0)),
    "noise where there is none": lambda w: replace(w, noise=row(w.noise, 0, 0, F(1, 10**40))),
    "noise too short": lambda w: replace(w, noise=w.noise[:-1]),
    "noise too long": lambda w: replace(w, noise=(*w.noise, w.noise[0])),
    "noise of another size": lambda w: replace(w, noise=row(w.noise, 1, 0)),
    "disturbance outside": lambda w: replace(w, disturbances=((F("0.5") + F(1, 10**40),),) * 5),
    "disturbance below": lambda w: replace(w, disturbances=((F("-1.01"),),) * 5),
    "disturbance that changes": lambda w: replace(w, disturbances=row(w.disturbances, 3, F("0.4"))),
    "disturbances too short": lambda w: replace(w, disturbances=w.disturbances[:2]),
    "time before the window": lambda w: replace(w, time=F("0.05")),
    "time after the run": lambda w: replace(w, time=F("0.6")),
    "no time": lambda w: replace(w, time=None),
    "unknown requirement": lambda w: replace(w, requirement="that"),
    "another policy": lambda w: replace(w, policy=w.policy[::-1]),
    "another specification": lambda w: replace(w, specification=w.policy),
    "another plant": lambda w: replace(w, plant=w.policy),
    "smaller radius": lambda w: replace(w, observation_radius=(F("0.04"), F(0))),
    "radius of another size": lambda w: replace(w, observation_radius=(F("0.05"),)),
    "negative radius": lambda w: replace(w, observation_radius=(F("0.05"), F(-1))),
}


def test_the_witness_that_is_corrupted_is_proved_before() -> None:
    found = prove(good(), GOOD_POLICY, GOOD_TEXT)
    assert isinstance(found, Proof) and found.grade == "proved (real)" and found.depth > 0.05
    assert found.sentence.startswith("`it` is left at 0.3 s by 0.")
    wider = prove(
        replace(good(), observation_radius=(F("0.06"), F(0)), noise=((F("0.06"), F(0)),) * 5), GOOD_POLICY, GOOD_TEXT
    )
    assert isinstance(wider, Proof) and "observation radius (0.06, 0), which is not the spec" in wider.sentence


@pytest.mark.parametrize("name", CORRUPTED)
def test_a_corrupted_witness_is_rejected(name: str) -> None:
    reason = prove(CORRUPTED[name](good()), GOOD_POLICY, GOOD_TEXT)
    assert isinstance(reason, str) and reason


def test_other_files_are_rejected() -> None:
    witness = good()
    assert "another policy" in str(prove(witness, KEEP, GOOD_TEXT))
    assert "another specification" in str(prove(witness, GOOD_POLICY, GOOD_TEXT + b"\n"))
    fitting = replace(witness, policy=hashlib.sha256(KEEP).hexdigest())
    assert "does not fit" in str(prove(fitting, KEEP, GOOD_TEXT))
    broken = b"no model"
    foreign = replace(witness, policy=hashlib.sha256(broken).hexdigest())
    assert "cannot read" in str(prove(foreign, broken, GOOD_TEXT))


def test_time_that_is_up_ends_the_attempt_between_two_periods() -> None:
    asked: list[int] = []

    def stop() -> bool:
        asked.append(1)
        return len(asked) > 2

    assert prove(good(), GOOD_POLICY, GOOD_TEXT, stop=stop) == "the time is up"
    assert len(asked) == 3
    asked.clear()
    unmoved = text_of("{states: {x: 1}, inputs: {u: 1}, dynamics: {x: 1}}", 'stay: "x <= 0.2"', initial="{x: 0}")
    # also where the plant does not feel that the action is missing
    assert prove(witness_of(KEEP, unmoved, [0], "0.5"), KEEP, unmoved, stop=stop) == "the time is up"
    assert len(asked) == 3
    assert isinstance(prove(good(), GOOD_POLICY, GOOD_TEXT, stop=lambda: False), Proof)


@pytest.mark.parametrize("depth", [1e-30, 0.35888, 0.0999999999, 1.0, 12345.678, 7e22, 0.3588822932288076])
def test_the_depth_in_the_sentence_is_not_larger_than_the_proved_one(depth: float) -> None:
    question = pose(good(), GOOD_POLICY, GOOD_TEXT)
    assert isinstance(question, Question)
    found = proof_of(question, "proved (real)", [Shown(depth, 0.0, 160)], "somehow")
    shown = re.search(r" by (\S+) from ", found.sentence)
    assert shown is not None and F(depth) * F("0.99") < F(shown[1]) <= F(depth)


def test_a_solution_that_blows_up_is_refused() -> None:
    plant = "{states: {x: m}, inputs: {u: m}, dynamics: {x: 10*x**2 + 0*u}}"
    text = text_of(plant, 'avoid: "x >= 2"', initial="{x: 1}", horizon="0.2")
    assert isinstance(prove(witness_of(KEEP, text, [1], "0.08"), KEEP, text), Proof)
    assert "could not be enclosed" in refused(KEEP, text, [1], "0.2")


def test_a_witness_survives_its_file() -> None:
    witness = good()
    assert read_witness(witness.to_json().encode()) == witness
    other = replace(witness, time=None, observation_radius=(F(1, 3), F(0)), plant="ab")
    assert read_witness(other.to_json().encode()) == other
    assert other.to_json() == other.to_json()


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("setrl-witness/2", "setrl-witness/3"),
        ("setrl-witness/2", "setrl-witness/1"),
        ('"3/10"', '"0.3"'),
        ('"3/10"', '"3/0"'),
        ('"3/10"', "0.3"),
        ('"3/10"', '"inf"'),
        ('"time"', '"when"'),
        ('"time": "3/10",', '"time": "3/10", "time": "1/10",'),
        ('"requirement": "it"', '"requirement": ["it"]'),
        ("{", "["),
        ('"disturbances": [', '"disturbances": [1, '),
    ],
)
def test_a_file_that_is_no_witness_is_an_error(old: str, new: str) -> None:
    text = good().to_json()
    assert old in text
    with pytest.raises(InputError):
        read_witness(text.replace(old, new, 1).encode())


# ARCH-COMP NAV ------------------------------------------------------------------------------------------------------


def test_nav_with_a_larger_obstacle_is_falsified(nav_folder: Path) -> None:
    policy = (nav_folder / "nn-nav-set.onnx").read_bytes()
    text = find_specification("nav").read_bytes().replace(b"y: [1, 2]}  #", b"y: [1, 2.5]}  #")
    assert b"2.5" in text
    found = proved(policy, text, [3, 3, 0, 0], F(15, 8), name="obstacle")
    assert found.radius < 1e-30 and found.depth > 0.1 and "`obstacle` is entered at 1.875 s" in found.sentence
    assert "outside" in refused(policy, text, [3, 3, 0, 0], F(6, 5), name="obstacle")
    narrow = text.replace(b"[-0.5, 0.5], y: [-0.5, 0.5]", b"[-0.02, 0.02], y: [-0.02, 0.02]")
    assert proved(policy, narrow, [F("2.9"), F("2.9"), 0, 0], None, name="goal").radius < 1e-20


def test_a_clip_layer_saturates_exactly() -> None:
    layers = (Affine(np.array([[-8.0]]), np.zeros(1)), Activation("clip", lower=-0.5, upper=0.5))
    policy = policy_bytes(layers)
    text = text_of(HOLD, 'stay: "x <= 0"', initial="{x: 1}")
    assert proved(policy, text, [1], "0.5").depth == pytest.approx(0.75, rel=1e-15)
