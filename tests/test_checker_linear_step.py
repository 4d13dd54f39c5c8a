"""The flow obligation by conservative linearisation: what the engine proves is accepted, what a trajectory refutes not.

Trajectories are thin enclosures by a Taylor expansion at 128 bits, which no set arithmetic enters.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from fractions import Fraction
from functools import lru_cache
from itertools import product
from typing import Any

import numpy as np
import pytest
from certificates import case_of
from flint import arb, arb_mat, ctx
from test_checker_jets import SUBJECTS, Subject, of_texts

from setrl.verify import linearization
from setrl.verify.balls import Ball
from setrl.verify.checker.image import Start
from setrl.verify.checker.leaf import SetClaim, StepClaim
from setrl.verify.checker.linear_step import LinearMotion, _linearised, _tail, follow_linear
from setrl.verify.checker.obligations import PRECISION
from setrl.verify.checker.polynomials import combine, powers_of
from setrl.verify.checker.program import ball
from setrl.verify.checker.rejection import Rejected
from setrl.verify.checker.taylor import solve
from setrl.verify.linearization import LinearStep, linear_step
from setrl.verify.result import Verdict
from setrl.verify.zonotope import Zonotope

F = Fraction

FIELDS: dict[str, Subject] = {
    **SUBJECTS,
    "decay": of_texts({"x": "-5*x"}, [1.0, 0.0]),
    "square": of_texts({"x": "x**2"}, [1.5, 0.0]),
    "cube": of_texts({"x": "x**3 + u"}, [0.1, 0.0]),
    "oscillator": of_texts({"x": "y", "y": "-25*x"}, [1.0, 0.0, 0.0]),
    "units": of_texts({"x": "1000000*y", "y": "-x/1000000 + u/1000000"}, [1.0, 1e-6, 0.5]),
    "resting": of_texts({"x": "y*u", "y": "0*x", "z": "y"}, [1.0, 0.0, 2.0, 1.0]),
    "chain": of_texts({"a": "b", "b": "c", "c": "u"}, [0.0, 0.0, 0.0, 1.0]),
}


@dataclass(frozen=True)
class Case:
    """One step from a set of a given size around a field's working point."""

    field: str
    size: float
    duration: Fraction
    order: int

    def __str__(self) -> str:
        return f"{self.field}-{self.size:g}-{self.duration}-{self.order}"

    @property
    def start(self) -> Start:
        """Correlated rows, some that move single coordinates, and a small box."""
        center = FIELDS[self.field].center
        size = len(center)
        generator = np.random.default_rng(size)
        scale = self.size * np.maximum(np.abs(center), 1e-6 if self.field == "units" else 0.3)
        rows = np.concatenate([np.eye(size), 0.5 * generator.normal(size=(3, size))]) * scale
        radius = 0.05 * scale * generator.random(size)
        if not self.size:
            rows = rows[:0]
        return Start(tuple(center), tuple(map(tuple, rows.tolist())), tuple(radius.tolist()))

    @property
    def zonotope(self) -> Zonotope:
        """The start as the engine has it."""
        start = self.start
        rows = np.array(start.rows).reshape(1, len(start.rows), len(start.center))
        return Zonotope(np.array([start.center]), rows, np.array([start.radius]))

    def step(self) -> LinearStep:
        """What the engine finds."""
        return linear_step(FIELDS[self.field].tape, self.zonotope, self.duration, self.order)

    def follow(self, claim: StepClaim) -> LinearMotion:
        """What the checker says; an exception where it rejects."""
        with ctx.workprec(PRECISION):
            return follow_linear(FIELDS[self.field].program, self.start, self.duration, self.order, claim)


def claim_of(step: LinearStep) -> StepClaim:
    """A step of one cell as a certificate has it."""
    assert step.sound.all() and step.prior is not None
    states, rows = step.added.shape[1], step.start.generators.shape[1]
    end = step.end.coordinates(slice(0, states))
    prior = (tuple(step.prior.lower[0, :states].tolist()), tuple(step.prior.upper[0, :states].tolist()))
    generators = tuple(map(tuple, end.generators[0].tolist()))
    claimed = SetClaim(
        tuple(end.center[0].tolist()), generators[:rows], generators[rows:], tuple(end.radius[0].tolist())
    )
    return StepClaim((), None, prior, None, claimed)


FAST = {"functions": 16, "decay": 2, "square": 2, "oscillator": 3}
"""Fields that need shorter steps."""
CASES = [
    Case(name, size, duration / FAST.get(name, 1), order)
    for name in FIELDS
    for size, duration, order in (
        (0.0, F(1, 5), 2),
        (1e-12, F(1, 7), 5),
        (1e-6, F(1, 5), 3),
        (1e-3, F(1, 10), 1),
        (0.03, F(1, 10), 4),
        (0.1, F(1, 40), 5),
        (0.02, F(1, 320), 20),
    )
]


@pytest.mark.parametrize("case", CASES, ids=str)
def test_what_the_engine_proves_is_accepted(case: Case) -> None:
    step = case.step()
    claim = claim_of(step)
    motion = case.follow(claim)
    assert motion.start == case.start and motion.duration == case.duration
    states = len(claim.end.center)
    generator = np.random.default_rng(3)
    directions = [*np.eye(states), *-np.eye(states), *generator.normal(size=(3, states))]
    with ctx.workprec(PRECISION):
        for count in (1, 3):
            for part, engine in enumerate(step.time_intervals(count)):
                between = motion.between(part, count)
                # the supports that a requirement is proved with
                lowest = -engine.support(-np.array(directions))[0]
                for direction, low in zip(directions, lowest.tolist(), strict=True):
                    assert bool(between.least([arb(x) for x in direction.tolist()]) >= low)


def factors(case: Case, count: int) -> list[tuple[Any, Any]]:
    """Corners of a start's factors, rows and box."""
    generator = np.random.default_rng(8)
    start = case.start
    corners = [generator.choice([-1, 1], len(start.rows) + len(start.center)) for _ in range(count)]
    corners += [np.zeros_like(corners[0])]
    return [(corner[: len(start.rows)].tolist(), corner[len(start.rows) :].tolist()) for corner in corners]


@lru_cache(maxsize=256)
def trajectories(case: Case, count: int = 6) -> tuple[Any, ...]:
    """Row factors, start, and the solution's parts from corners of the start, at 128 bits."""
    start, found = case.start, []
    states = len(FIELDS[case.field].program.outputs)
    for rows, box in factors(case, count):
        with ctx.workprec(128):
            point = [
                arb(c) + sum((arb(row[i]) * b for row, b in zip(start.rows, rows, strict=True)), arb(0)) + arb(r) * e
                for i, (c, r, e) in enumerate(zip(start.center, start.radius, box, strict=True))
            ]
            solved = solve(FIELDS[case.field].program, point[:states], point[states:], case.duration)
            assert solved is not None
            found.append((rows, *solved))
    return tuple(found)


def least_widths(case: Case, end: SetClaim) -> list[float]:
    """Half-widths that the claimed center and rows leave to the box, as trajectories show: less would be false."""
    widest = [0.0] * len(end.center)
    for rows, _, final in trajectories(case):
        with ctx.workprec(128):
            for i, (x, c) in enumerate(zip(final, end.center, strict=True)):
                linear = sum((arb(row[i]) * b for row, b in zip(end.rows, rows, strict=True)), arb(c))
                widest[i] = max(widest[i], float(abs(x - linear).lower()))
    return widest


def with_box(claim: StepClaim, box: list[float]) -> StepClaim:
    """The same claim with another box of the remainder, and nothing beside it."""
    fresh = tuple(tuple(w if i == j else 0.0 for j in range(len(box))) for i, w in enumerate(box))
    return replace(claim, end=replace(claim.end, fresh=fresh, radius=(0.0,) * len(box)))


FALSE = [case for case in CASES if case.size >= 1e-6 or (not case.size and case.field not in ("quadrotor1d", "chain"))]


@pytest.mark.parametrize("case", FALSE, ids=str)
def test_an_end_that_leaves_a_trajectory_out_in_one_component_is_rejected(case: Case) -> None:
    claim = claim_of(case.step())
    least = least_widths(case, claim.end)
    refuted = 0
    for i, width in enumerate(least):
        box = [1e3 * (w + claim.end.fresh[j][j] + claim.end.radius[j]) + 1e-9 for j, w in enumerate(least)]
        case.follow(with_box(claim, box))
        box[i] = width * (1 - 1e-9)
        if width:
            refuted += 1
            with pytest.raises(Rejected, match=f"the end of a step: component {i} "):
                case.follow(with_box(claim, box))
    assert refuted or case.field == "resting"


@pytest.mark.parametrize("case", [case for case in CASES if case.size != 1e-12], ids=str)
def test_the_sets_between_the_ends_contain_every_trajectory(case: Case) -> None:
    motion = case.follow(claim_of(case.step()))
    states = len(motion.tail)
    directions = [*np.eye(states).tolist(), *(-np.eye(states)).tolist(), [1.0] * states]
    for count, part in ((1, 0), (2, 1), (3, 0), (3, 2)):
        low, high = case.duration * part / count, case.duration * (part + 1) / count
        with ctx.workprec(PRECISION):
            between = motion.between(part, count)
            least = [between.least([arb(x) for x in direction]).lower() for direction in directions]
        for _, segments, _ in trajectories(case, 3):
            for share in (F(0), F(1, 3), F(1, 2), F(1)):
                time = low + (high - low) * share
                with ctx.workprec(128):
                    segment = next(s for s in segments if s.start <= time <= s.start + s.length)
                    state = segment.at(time)
                    for direction, bound in zip(directions, least, strict=True):
                        along = sum((x * arb(d) for x, d in zip(state, direction, strict=True)), arb(0))
                        # a thin trajectory may touch the bound
                        assert not bool(along < bound)


PUSHED = [
    of_texts({"x": "3*x + u**2/2"}, [0.0] * 3, "u v"),
    of_texts({"x": "3*x + u*v"}, [0.0] * 3, "u v"),
    of_texts({"x": "y + u**2/2", "y": "v**2/2 - 4*x"}, [0.0] * 4, "u v"),
]
"""Linear but for what constant inputs push with: here they attain the bounds of the linearisation's remainder."""


@pytest.mark.parametrize("order", [1, 2, 6])
@pytest.mark.parametrize("subject", PUSHED, ids=["square", "product", "pair"])
def test_a_push_that_attains_the_remainder_is_within_its_bound(subject: Subject, order: int) -> None:
    program, duration = subject.program, F(1, 8)
    states, dimension = len(program.outputs), len(subject.center)
    rows = np.eye(dimension)[states:]
    start = Start((0.0,) * dimension, tuple(map(tuple, rows.tolist())), (0.0,) * dimension)
    with ctx.workprec(PRECISION):
        box = [arb(0, 9)] * states + [arb(0, 1)] * 2
        found = _linearised(program, start, duration, order, box)
        powers = powers_of(ball(duration), order + 1)
        center, driven = combine(powers, found.motion.value), combine(powers, found.driven)
    for inputs in product((-1, 0, 1), repeat=2):
        with ctx.workprec(128):
            solved = solve(program, [arb(0)] * states, [arb(x) for x in inputs], duration)
            assert solved is not None
            for x, c, half, tail in zip(solved[1], center, driven, found.tail, strict=True):
                assert not bool(abs(x - c) > half + tail)


# Bugs planted in the engine -----------------------------------------------------------------------------------------


def nothing(original: Any, *arguments: Any) -> Any:
    result = original(*arguments)
    return Ball(0.0 * result.mid, 0.0 * result.rad) if isinstance(result, Ball) else 0.0 * result


def center_only(original: Any, *arguments: Any) -> Any:
    result = original(*arguments)
    return Ball(result.mid, 0.0 * result.rad)


def start_box(original: Any, tape: Any, box: Any, *arguments: Any) -> Any:
    return box


def at_the_point(original: Any, tape: Any, box: Any) -> Any:
    return original(tape, Ball(box.mid, 0.0 * box.rad))


def no_hull(original: Any, prior: Any, point: Any) -> Any:
    return Ball(point, 0.0 * prior.rad)


def one_coefficient_less(original: Any, jacobian: Any, z: Any, point: Any, drift: Any, order: int) -> Any:
    found = original(jacobian, z, point, drift, order)
    value = Ball(found.value.mid.copy(), found.value.rad)
    value.mid[:, -1] = 0.0
    return replace(found, value=value)


def stronger(original: Any, *arguments: Any) -> Any:
    result = original(*arguments)
    return Ball(result.mid * (1 + 1e-6), result.rad)


def without_radius(original: Any, *arguments: Any) -> Any:
    result = original(*arguments)
    return replace(result, radius=0.0 * result.radius)


def other_start(original: Any, tape: Any, box: Ball, *arguments: Any) -> Any:
    return Ball(box.mid, 0.0 * box.rad), np.ones(len(box.mid), dtype=bool)


BUGS: list[tuple[str, Callable[..., Any], Case]] = [
    ("lagrange_remainder", nothing, Case("pendulum", 0.03, F(1, 10), 4)),
    ("lagrange_remainder", center_only, Case("unicycle", 0.03, F(1, 10), 4)),
    ("hessian_bounds", at_the_point, Case("cube", 0.8, F(1, 10), 4)),
    ("hessian_domain", no_hull, Case("square", 0.03, F(1, 10), 4)),
    ("tightened", start_box, Case("quadrotor2d", 0.0, F(1, 5), 2)),
    ("a_priori_enclosure", other_start, Case("navigation", 0.03, F(1, 10), 4)),
    ("_tail", nothing, Case("quadrotor2d", 0.0, F(1, 5), 2)),
    ("_tail", nothing, Case("decay", 0.1, F(1, 10), 2)),
    ("exponential_tail", nothing, Case("oscillator", 0.1, F(1, 10), 3)),
    ("_series", one_coefficient_less, Case("oscillator", 0.03, F(1, 10), 3)),
    ("exponential_coefficients", stronger, Case("quadrotor1d", 0.03, F(1, 10), 4)),
    ("linear_map", without_radius, Case("chain", 0.03, F(1, 10), 4)),
]


def refuted(case: Case, end: SetClaim) -> bool:
    """Whether a trajectory shows that a claimed end is false."""
    room = [r + row[i] for i, (r, row) in enumerate(zip(end.radius, end.fresh, strict=True))]
    return any(width > most for width, most in zip(least_widths(case, end), room, strict=True))


@pytest.mark.parametrize(
    ("name", "change", "case"), BUGS, ids=[f"{name}-{change.__name__}-{case}" for name, change, case in BUGS]
)
def test_a_bug_in_the_engine_that_a_trajectory_shows_is_rejected(
    name: str, change: Callable[..., Any], case: Case, monkeypatch: pytest.MonkeyPatch
) -> None:
    honest = claim_of(case.step())
    assert not refuted(case, honest.end)
    case.follow(honest)
    original = getattr(linearization, name)
    monkeypatch.setattr(linearization, name, lambda *arguments: change(original, *arguments))
    claim = claim_of(case.step())
    assert refuted(case, claim.end)
    with pytest.raises(Rejected):
        case.follow(claim)


def test_a_bug_in_the_engine_costs_the_verdict(monkeypatch: pytest.MonkeyPatch) -> None:
    case = case_of(9, method="linearization", taylor_order=2, remainder_share=0.9)
    assert case.verify().verdict is Verdict.VERIFIED
    original = linearization._tail
    monkeypatch.setattr(linearization, "_tail", lambda *arguments: 0.0 * original(*arguments))
    found = case.verify()
    assert found.verdict is Verdict.UNKNOWN and found.reason is not None and found.reason.source == "check"
    assert "the end of a step" in found.reason.sentence


# Corrupted claims ---------------------------------------------------------------------------------------------------


def moved(numbers: Any, position: int, distance: float) -> Any:
    return (*numbers[:position], numbers[position] + distance, *numbers[position + 1 :])


def corruptions(claim: StepClaim) -> Iterator[tuple[str, StepClaim]]:
    """Claims of which one part is another one."""
    end = claim.end
    assert claim.prior is not None
    for i, center in enumerate(end.center):
        room = end.radius[i] + end.fresh[i][i]
        for distance in (2.1 * room, -2.1 * room):
            yield "center", replace(claim, end=replace(end, center=moved(end.center, i, distance)))
        yield "remainder", replace(claim, end=replace(end, fresh=tuple(moved(row, i, -row[i]) for row in end.fresh)))
        yield "radius", replace(claim, end=replace(end, radius=moved(end.radius, i, -room)))
        for j, row in enumerate(end.rows):
            if row[i]:
                distance = 2.1 * room + 1e-9 * abs(row[i])
                rows = (*end.rows[:j], moved(row, i, -distance), *end.rows[j + 1 :])
                yield "row", replace(claim, end=replace(end, rows=rows))
        low, high = claim.prior
        yield "prior", replace(claim, prior=(moved(low, i, 9.0 + abs(center)), high))
        # a guess that is only too narrow is widened: any guess that ends in an inclusion will do
        yield "guess", replace(claim, prior=(low, moved(high, i, low[i] - high[i])))
    for j in range(len(end.rows)):
        rows = (*end.rows[:j], tuple(-x for x in end.rows[j]), *end.rows[j + 1 :])
        yield "row", replace(claim, end=replace(end, rows=rows))


@pytest.mark.parametrize("name", ["pendulum", "unicycle", "everything", "quadrotor2d"])
def test_a_corrupted_claim_that_a_trajectory_refutes_is_rejected(name: str) -> None:
    case = Case(name, 0.03, F(1, 20), 4)
    claim = claim_of(case.step())
    seen: dict[str, int] = {}
    for what, corrupted in corruptions(claim):
        if what == "guess":
            case.follow(corrupted)
        elif what == "prior" or refuted(case, corrupted.end):
            seen[what] = seen.get(what, 0) + 1
            with pytest.raises(Rejected, match="a-priori" if what == "prior" else "the end of a step"):
                case.follow(corrupted)
    assert {"center", "row", "prior"} <= set(seen)


def test_the_remainder_is_a_box() -> None:
    case = Case("pendulum", 0.03, F(1, 10), 4)
    claim = claim_of(case.step())
    (first, second), end = claim.end.fresh, claim.end
    # a reflected row is the same box
    case.follow(replace(claim, end=replace(end, fresh=(moved(first, 0, -2 * first[0]), second))))
    with pytest.raises(Rejected, match="not those of a box"):
        case.follow(replace(claim, end=replace(end, fresh=(first, moved(second, 0, 1e-30)))))


@pytest.mark.parametrize("low", [-1e200, 1e200])
def test_an_a_priori_guess_without_bounds_proves_nothing(low: float) -> None:
    case = Case("everything", 0.03, F(1, 10), 4)
    claim = replace(claim_of(case.step()), prior=((low, low), (1.1e200, 1.1e200)))
    with pytest.raises(Rejected, match="a-priori"):
        case.follow(claim)


def test_a_step_that_is_too_long_for_the_series_is_rejected() -> None:
    with ctx.workprec(PRECISION), pytest.raises(Rejected, match="no bound"):
        _tail(arb_mat([[100]]), [arb(1)], 5)


@pytest.mark.parametrize("order", [1, 2, 5])
@pytest.mark.parametrize("rate", [[[2.0]], [[0, 3e6, 0], [1e-6, 0.5, 0], [0, 0, 0]], [[0, 1, 0], [0, 0, 1], [0, 0, 0]]])
def test_the_tail_is_the_sum_of_its_terms(rate: Any, order: int) -> None:
    count = len(rate)
    last = [1.0, 1e-6, 0.0][:count]
    with ctx.workprec(200):
        term, total = [arb(x) for x in last], [arb(0)] * count
        for j in range(1, 120):
            term = [sum((arb(a) * x for a, x in zip(row, term, strict=True)), arb(0)) / (order + j) for row in rate]
            total = [a + b for a, b in zip(total, term, strict=True)]
        with ctx.workprec(PRECISION):
            bound = _tail(arb_mat([list(row) for row in rate]), [arb(x) for x in last], order)
        for exact, found in zip(total, bound, strict=True):
            assert not bool(found < exact) and bool(found <= exact * (1 + arb(2) ** -20))


@pytest.mark.parametrize("number", [0, 3, 7, 9, 10, 16, 19, 23, 30, 35, 44])
def test_closed_loops_are_verified_by_linearisation(number: int) -> None:
    assert case_of(number, method="linearization").verify().verdict is Verdict.VERIFIED
