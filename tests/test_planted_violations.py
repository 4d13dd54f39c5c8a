"""A specification that some trajectory violates is never VERIFIED, however narrowly it is violated."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import laws
import numpy as np
import pytest
from cases import EVERYTHING
from loops import box_region, loop_of, network, plant_of, requirement, specification_of, with_requirements
from planted import KINDS, NARROW, PLANTS, WIDE, Question, aim_of, fraction_of, pair_of, question_of

from setrl import verify
from setrl.models.onnx_reader import read_policy
from setrl.specs.reader import find_specification, read_specification
from setrl.specs.specification import Halfspace, Polytope, Region
from setrl.verify.checker.witness import Proof
from setrl.verify.options import Options
from setrl.verify.result import Result, Verdict

F = Fraction
GAPS = (1e-2, 1e-3, 1e-5, 1e-7, 1e-9)


def random_loop(seed: int) -> Any:
    """A random small network on a random plant, alternately in discrete and continuous time."""
    generator = np.random.default_rng(seed)
    kinds = ["relu", "tanh", "sigmoid", "leaky_relu", "clip"]
    kind = kinds[seed % 5]
    policy = network([2, 5, 1], [kind, "none"], seed, 1.5)
    a, b, c = (f"{x:.3f}" for x in generator.uniform(0.2, 0.9, 3))
    discrete = seed % 3 != 0
    if discrete:
        plant = plant_of(
            {"x": f"{a}*x + 0.3*sin(y) + {b}*u + d", "y": f"{c}*y - 0.2*x*y + 0.1*u**2"},
            disturbances="d",
            discrete=True,
        )
    elif seed % 2:
        plant = plant_of({"x": f"y - {a}*x**3", "y": f"-sin(x) + {b}*u + d"}, disturbances="d")
    else:
        plant = EVERYTHING
    low = generator.uniform(-0.5, 0.5, 2).round(3)
    width = generator.uniform(0.01, 0.2, 2).round(3)
    boxes = {s: (f"{lo:.3f}", f"{lo + w:.3f}") for s, lo, w in zip("xy", low, width, strict=True)}
    force = ("-0.05", "0.1", bool(seed % 2))
    specification = specification_of(
        plant,
        boxes,
        period="0.2",
        periods=2 + seed % 3,
        observation=("0", "0.02", "0.1")[seed % 3 if discrete else seed % 2],
        disturbances={"d": force},
        delay=int(seed % 7 == 4),
    )
    return loop_of(policy, specification)


def violated(loop: Any, seed: int) -> Any:
    """The same loop with a halfspace that the worst trajectory found leaves by a little at the end."""
    line = np.random.default_rng(1000 + seed).choice([-1.0, -0.5, 0.5, 1.0], size=2)
    best = laws.planted_boundary(loop, line, seed)
    gap = GAPS[seed % len(GAPS)] * max(1.0, abs(best))
    facet = Halfspace({"x": F(float(line[0])), "y": F(float(line[1]))}, F(best - gap), "planted")
    end = loop.specification.horizon
    wanted = requirement("stay", Region((Polytope((facet,)),)), end if seed % 2 else 0, end)
    return loop_of(loop.policy, with_requirements(loop.specification, wanted))


@pytest.mark.parametrize("seed", range(30))
def test_a_planted_violation_is_never_proved(seed: int) -> None:
    loop = violated(random_loop(seed), seed)
    laws.law_never_verified(loop, Options(splits=16))


@pytest.mark.slow
@pytest.mark.parametrize("seed", range(30, 330))
def test_hundreds_of_planted_violations_are_never_proved(seed: int) -> None:
    loop = violated(random_loop(seed), seed)
    laws.law_never_verified(loop, Options(splits=64))


def test_planted_violations_are_narrow() -> None:
    proved = 0
    for seed in range(1, 30, 2):
        loop = violated(random_loop(seed), seed)
        facet = loop.requirements[0].region[0]
        wider = replace(facet, bounds=tuple(b + F(1, 5) for b in facet.bounds))
        eased = replace(loop, requirements=(replace(loop.requirements[0], region=(wider,)),))
        try:
            laws.law_never_verified(eased, Options(splits=16))
        except AssertionError:
            proved += 1
    assert proved >= 8, "the planted boundaries are out of reach anyway: they show nothing"


# Files, through the front door --------------------------------------------------------------------------------------

NUMBERS, CHUNK = range(528), 8
FAST = (2, 5, 6, 7, 8, 11, 13, 14, 15, 20, 21, 22, 23, 29, 30, 31, 38, 39, 45, 46, 53)


@dataclass(frozen=True)
class Outcome:
    """What became of a question."""

    question: Question
    result: Result
    seconds: float

    @property
    def proved(self) -> bool:
        """Whether the violation was shown, in time."""
        return self.result.verdict is Verdict.FALSIFIED and self.seconds <= 30.0

    def __str__(self) -> str:
        question, reason = self.question, self.result.reason
        aim, period = question.aim, question.pair.loop().period
        window = f"[{float(aim.start / period):g}, {float(aim.end / period):g}] periods"
        said = "" if reason is None else reason.sentence
        return (
            f"{question.pair.name}: {aim.kind} {aim.shape} in {window}, {question.fraction:g}: "
            f"{self.result.verdict.name} after {self.seconds:.1f} s; {said}; {'; '.join(self.result.notes)}"
        )


OUTCOMES: dict[int, Outcome] = {}


def judged(number: int) -> Outcome:
    """The front door's answer to a question whose requirement a known trajectory provably violates."""
    if number not in OUTCOMES:
        question = question_of(number)
        truth = question.truth()
        assert isinstance(truth, Proof), (question.pair.name, truth)
        OUTCOMES[number] = Outcome(question, *question.ask())
    outcome = OUTCOMES[number]
    assert outcome.result.verdict in (Verdict.FALSIFIED, Verdict.UNKNOWN), str(outcome)
    assert (outcome.result.verdict is Verdict.FALSIFIED) == (outcome.result.witness is not None)
    return outcome


def report(outcomes: Sequence[Outcome]) -> float:
    """Print what was shown by fraction and what was not; the share that was shown of the wide ones."""
    print("\nfraction  questions  FALSIFIED   share  slowest s")
    for fraction in (*WIDE, *NARROW):
        some = [outcome for outcome in outcomes if outcome.question.fraction == fraction]
        shown = sum(outcome.proved for outcome in some)
        slowest = max((outcome.seconds for outcome in some), default=0.0)
        print(f"{fraction:8g} {len(some):10d} {shown:10d} {shown / max(len(some), 1):7.1%} {slowest:10.1f}")
    witnesses = [outcome for outcome in outcomes if outcome.result.witness is not None]
    beaten = sum(outcome.result.witness.depth > 1.01 * outcome.question.gap for outcome in witnesses)
    print(f"{beaten} of {len(witnesses)} witnesses are deeper than the trajectory that the question was made from")
    print("\n".join(str(outcome) for outcome in outcomes if not outcome.proved))
    wide = [outcome.proved for outcome in outcomes if outcome.question.fraction in WIDE]
    return sum(wide) / len(wide)


def test_violations_planted_in_files_are_never_verified_and_mostly_proved() -> None:
    assert report([judged(number) for number in FAST]) >= 0.9


@pytest.mark.slow
@pytest.mark.parametrize("first", NUMBERS[::CHUNK])
def test_hundreds_of_violations_planted_in_files_are_never_verified(first: int) -> None:
    for number in NUMBERS[first : first + CHUNK]:
        judged(number)


@pytest.mark.slow
def test_nine_in_ten_wide_violations_are_proved() -> None:
    if any(number not in OUTCOMES for number in NUMBERS):
        pytest.skip("the whole file has to run in one session")
    assert report([OUTCOMES[number] for number in NUMBERS]) >= 0.9


@pytest.mark.parametrize("number", (3, 48))
def test_violations_where_a_window_ends_between_samples_are_proved(number: int) -> None:
    assert judged(number).proved


def test_half_a_radius_beyond_the_reach_nothing_is_falsified_and_much_is_verified() -> None:
    verdicts = []
    for number in (5, 7, 13, 15, 21, 23, 29, 31, 39, 45):
        question = question_of(number, fraction=-0.5)
        assert isinstance(question.truth(), str)
        verdicts.append(question.ask()[0].verdict)
    assert Verdict.FALSIFIED not in verdicts
    assert verdicts.count(Verdict.VERIFIED) >= 6, "the planted boundaries are out of reach anyway: they show nothing"


def test_the_questions_have_everything_in_them() -> None:
    pairs = [pair_of(number) for number in NUMBERS]
    heads = [pair.head for pair in pairs]
    loops = [pair.loop() for pair in pairs[:100]]
    aims = [aim_of(loop, number) for number, loop in enumerate(loops)]
    assert {pair.name.split("-", 1)[1] for pair in pairs} == {f"{plant}-{kind}" for plant in PLANTS for kind in KINDS}
    for text in (
        "varies: never",
        "varies: every period",
        "observation: 0,",
        "observation: {x",
        "clip",
        "delay",
        "{periods: 2",
    ):
        assert sum(text in head for head in heads) >= 20, text
    for text in ("observe", "before", "after", "d: [0.05, 0.05]"):
        assert sum(text in head for head in heads) >= 50, text
    assert {loop.periods for loop in loops} == {2, 3, 4, 5, 6}
    assert len({(aim.kind, aim.shape) for aim in aims}) == 12
    assert {(pair.options.method, pair.options.deployed) for pair in pairs} == {
        (method, deployed) for method in ("jets", "linearization") for deployed in (True, False)
    }
    wide = [fraction_of(number) in WIDE for number in NUMBERS]
    assert sum(wide) >= 250 and len(wide) - sum(wide) >= 250


# ARCH-COMP NAV ------------------------------------------------------------------------------------------------------


def navigation(folder: Path, network_name: str, *requirements: Any) -> tuple[Any, Any]:
    policy = read_policy(str(folder / f"nn-nav-{network_name}.onnx"))
    specification = read_specification(find_specification("nav"))
    return policy, replace(specification, requirements=tuple(requirements)) if requirements else specification


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("point", requirement("avoid", box_region(x=("0.9", "2.6"), y=(1, 2)), 0, 6)),
        ("set", requirement("avoid", box_region(x=(1, 2), y=(1, "2.5")), 0, 6)),
        ("point", requirement("reach", box_region(x=("-0.02", "0.02"), y=("-0.02", "0.02")), 6, 6)),
        ("set", requirement("reach", box_region(x=("-0.02", "0.02"), y=("-0.02", "0.02")), 6, 6)),
    ],
    ids=["point-obstacle", "set-obstacle", "point-goal", "set-goal"],
)
def test_violated_variants_of_nav_are_never_verified(nav_folder: Path, name: str, what: Any) -> None:
    policy, specification = navigation(nav_folder, name, what)
    with np.errstate(all="ignore"):
        result = verify(policy, specification, options=Options(splits=200))
        laws.law_never_verified(loop_of(policy, specification), Options(splits=8))
    assert not result.verdict.positive
    assert result.candidate is not None


def test_nav_set_is_verified_from_one_tight_cell(nav_folder: Path) -> None:
    result = verify(*navigation(nav_folder, "set"), options=Options(splits=1))
    assert result.verdict is Verdict.VERIFIED and result.cells == 1
    final = result.flowpipe.points[0, -1]
    radius = 0.5 * (final[1] - final[0])
    assert (radius <= 1.05 * np.array([0.091, 0.026, 0.027, 0.223])).all(), radius


@pytest.mark.slow
def test_nav_point_is_verified_by_splitting(nav_folder: Path) -> None:
    result = verify(*navigation(nav_folder, "point"))
    assert result.verdict is Verdict.VERIFIED and result.leaves > 1
