"""Two lines per neuron, followed backward: what is claimed is proved if it is true, and never if it is false."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from certificate_streams import Certificate, Streams, Writer, opened, sealed
from certificates import Case, case_of
from crown import Crown, Observed, boxed, lines_of, point, with_slopes
from flint import arb, arb_mat, ctx

from setrl.specs.errors import InputError
from setrl.verify.checker import obligations
from setrl.verify.checker.action import Policy, check_action
from setrl.verify.checker.backward import Backward, _Line, _Side, _split
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.deployment import Deployment
from setrl.verify.checker.expressions import parse
from setrl.verify.checker.image import Image, Start, image_of
from setrl.verify.checker.layers import Activation, Dense, Diagonal, Layer, Selection
from setrl.verify.checker.layout import SMOOTH, Layout
from setrl.verify.checker.leaf import (
    BOX,
    NEURON,
    PERTURBATION,
    PRODUCT,
    TWO_LINES,
    ActionClaim,
    PeriodClaim,
    Products,
    SetClaim,
    TwoLines,
)
from setrl.verify.checker.observed import observe
from setrl.verify.checker.program import compile_program
from setrl.verify.checker.rejection import Rejected
from setrl.verify.options import Options
from setrl.verify.verifier import verify

Array = Any
ROOT = Path(__file__).resolve().parents[1]
KINDS = (
    Activation("relu"),
    Activation("leaky_relu", slope=0.01),
    Activation("tanh"),
    Activation("sigmoid"),
    Activation("clip", low=-0.5, high=0.75),
)
SEEDS = range(40)
VIEWS = ("x*y + z", "sin(x) - y", "z**2 + x*x")
"""A nonlinear observation of three states; its Hessian is that of the exact function at any point but for sin."""


def claimed(image: Image, states: Start) -> SetClaim:
    """A set of floats, a little larger than an image."""
    count, size = len(states.rows), len(image.center)
    flat = [x for row in states.rows for x in row]
    mapped = (arb_mat(count, len(states.center), flat) * image.jacobian.transpose()).tolist()
    rows, fresh = (tuple(tuple(float(x.mid()) for x in row) for row in part) for part in (mapped, image.fresh))
    radius = tuple(float((r.upper() * (1 + 2.0**-12) + 2.0**-40).mid()) for r in image.rest)
    assert len(radius) == size
    return SetClaim(tuple(float(c.mid()) for c in image.center), rows, fresh, radius)


class Problem:
    """A policy, a set of states, and a claim with two lines per neuron whose box is the smallest."""

    def __init__(self, seed: int) -> None:
        self.generator = generator = np.random.default_rng(seed)
        self.expressions = VIEWS if seed % 3 == 2 else ()
        self.size, self.inputs = 3, 1 + seed % 2
        layers = [*self._layers(seed)]
        clipped = seed % 4 == 1
        radius = [0.0, 0.02, 0.0] if seed % 2 else [0.0] * 3
        neurons, width = [], self.size
        for layer in layers:
            if isinstance(layer, Activation):
                neurons.append((width, layer.kind in SMOOTH))
            else:
                width = len(layer.index) if isinstance(layer, Selection) else len(layer.offset)
        layout = Layout(
            states=self.size,
            inputs=self.inputs,
            observations=self.size,
            constant=(),
            varying=(),
            delay=0,
            periods=1,
            period=Fraction(1),
            discrete=False,
            observed=None if self.expressions else (0, 1, 2),
            neurons=tuple(count for count, _ in neurons),
            smooth=tuple(smooth for _, smooth in neurons),
            clipped=clipped,
            conditions=(),
            penalty=(),
            method="jets",
            version=2,
        )
        bounds = ((Fraction(-1, 3), Fraction(2, 5)),) * (self.inputs if clipped else 0)
        deployed = Deployment("float32", arb(2) ** -21, bounds) if seed % 5 else None
        program = compile_program([parse(text) for text in self.expressions or ("x", "y", "z")], ("x", "y", "z"))
        balls = [(arb(float(a)), arb(float(b))) for a, b in bounds]
        self.policy = Policy(tuple(layers), program, [arb(r) for r in radius], balls, deployed, layout)
        rows = 0.3 * generator.normal(size=(4, self.size)) * (0.1 if seed % 7 == 3 else 1.0)
        self.states = Start(
            tuple(generator.normal(size=self.size).tolist()), [tuple(row) for row in rows.tolist()], (0.0,) * self.size
        )
        self.products = Products((0, 1, 2, 3), ((0, 0), (0, 3), (1, 2))) if self.expressions else None
        with ctx.workprec(64):
            self.observed = (
                None if self.products is None else claimed(image_of(program, self.states, self.products), self.states)
            )
            self.seen = observe(layout, program, self.policy.radius, self.states, self.products, self.observed)
        self.slopes = tuple(generator.uniform(-0.2, 1.2, self.inputs).tolist()) if clipped else None
        choose = self._any_lines if seed % 3 == 1 else lines_of
        self.crown = Crown(self.policy, Observed.of(self.seen), self.slopes, choose)
        kept = [*self.crown.columns(np.ones((self.inputs, self.size)))]
        extra = [(NEURON, 0)] if neurons and seed % 2 else []
        self.action = self.crown.claim(kept[:: 1 + seed % 2], extra)

    def _layers(self, seed: int) -> Iterator[Layer]:
        """One to three hidden layers; others between them, activations without an affine layer in front."""
        generator, size = self.generator, self.size
        if seed % 6 == 4:
            yield Diagonal((0.5, -1.0, 2.0), (0.0, 0.1, -0.2))
            yield Selection((2, 0, 1, 2))
            size = 4
        if seed % 8 == 5:
            yield KINDS[2]
        for depth in range(1 + seed % 3):
            width = int(generator.integers(4, 9))
            yield self._dense(size, width)
            if seed % 4 == 2:
                yield self._dense(width, width)
            yield KINDS[(seed + depth * (seed % 2)) % len(KINDS)]
            if seed % 9 == 7:
                yield KINDS[3]
            size = width
        yield self._dense(size, self.inputs)
        if seed % 4 == 3:
            yield KINDS[2]
            yield Diagonal((1.5,) * self.inputs, (0.25,) * self.inputs)

    def _dense(self, size: int, width: int) -> Dense:
        weight = self.generator.normal(size=(width, size)) / np.sqrt(size) * 1.3
        offset = 0.3 * self.generator.normal(size=width)
        rows = tuple(tuple(row) for row in weight.astype(np.float32).astype(float).tolist())
        return Dense(rows, tuple(offset.astype(np.float32).astype(float).tolist()))

    def _any_lines(self, activation: Activation, low: Array, high: Array) -> TwoLines:
        return with_slopes(activation, *self.generator.uniform(-0.1, 1.1, (2, len(low))), low, high)

    def accepts(self, action: ActionClaim | None = None, lines: list[TwoLines] | None = None) -> bool:
        claim = PeriodClaim(
            self.products,
            self.observed,
            (),
            self.slopes,
            self.action if action is None else action,
            (),
            None,
            None,
            (),
            None,
            TWO_LINES,
            tuple(self.crown.lines if lines is None else lines),
        )
        try:
            with ctx.workprec(64):
                check_action(self.policy, self.states, claim, "here")
        except Rejected:
            return False
        return True

    def sampled(self, count: int) -> tuple[Array, Array, dict[tuple[int, int], Array]]:
        """Observations of corners and of points inside; the states' factors; the observation's own factors."""
        rows = np.array(self.states.rows)
        factors = self.generator.uniform(-1, 1, size=(count, len(rows)))
        factors[: count // 2] = np.sign(factors[: count // 2])
        states = self.states.center + factors @ rows
        x, y, z = states.T
        exact = np.array([x * y + z, np.sin(x) - y, z**2 + x * x]).T if self.expressions else states
        own: dict[tuple[int, int], Array] = {}
        left = exact - self.crown.seen.center - factors @ self.crown.seen.rows[:, : len(rows)].T
        if self.products is not None:
            for number, (i, j) in enumerate(self.products.pairs):
                a, b = factors[:, self.products.factors[i]], factors[:, self.products.factors[j]]
                own[PRODUCT, number] = 2 * a * a - 1 if i == j else a * b
                left = left - own[PRODUCT, number][:, None] * self.crown.seen.rows[:, len(rows) + number]
        for number, size in enumerate(self.crown.seen.box):
            own[BOX, number] = left[:, number] / size if size else 0.0 * left[:, number]
        noise = np.sign(self.generator.normal(size=exact.shape))
        for number in range(exact.shape[1]):
            own[PERTURBATION, number] = noise[:, number]
        return exact + noise * self.crown.seen.noise, factors, own


def through(layers: Any, x: Array, number: Any = np.float64) -> Iterator[tuple[Layer, Array]]:
    """Every layer and its input, computed in one format."""
    x = x.astype(number)
    for layer in layers:
        yield layer, x
        match layer:
            case Dense():
                x = x @ np.array(layer.matrix, number).T + np.array(layer.offset, number)
            case Diagonal():
                x = x * np.array(layer.scale, number) + np.array(layer.offset, number)
            case Selection():
                x = x[:, list(layer.index)]
            case Activation():
                x = point(layer, x).astype(number)
    yield Selection(()), x


@pytest.fixture(scope="module", params=SEEDS)
def problem(request: pytest.FixtureRequest) -> Problem:
    return Problem(request.param)


def test_a_claim_is_proved_exactly_if_its_box_is_not_below_what_its_lines_leave(problem: Problem) -> None:
    box, room = np.array(problem.action.box), 1e-9
    assert problem.accepts(boxed(problem.action, box + room))
    for i in range(len(box)):
        less = box + room
        less[i] = box[i] - room
        assert not problem.accepts(boxed(problem.action, less))


def test_rows_that_are_not_kept_or_are_others_have_to_fit_into_the_box(problem: Problem) -> None:
    box, generator = np.array(problem.action.box) + 1e-9, problem.generator
    moved = replace(problem.action, rows=tuple(problem.action.rows[::-1]), box=tuple(box.tolist()))
    private = problem.action.private
    forgotten = replace(moved, rows=problem.action.rows, private=private[1:], origins=problem.action.origins[1:])
    center = tuple((np.array(problem.action.center) + generator.choice([-1, 1], len(box)) * 0.01).tolist())
    for action in (moved, forgotten, replace(problem.action, center=center)):
        needed = problem.crown.needed(action)
        assert problem.accepts(boxed(action, needed + 1e-9))
        assert not problem.accepts(boxed(action, needed - 1e-9))


def test_every_action_is_in_the_smallest_set_that_is_proved(problem: Problem) -> None:
    points, factors, own = problem.sampled(10_000)
    claim = problem.action
    assert problem.accepts(boxed(claim, np.array(claim.box) + 1e-9))
    for number in (np.float64, np.float32) if problem.policy.deployment else (np.float64,):
        *_, (_, action) = through(problem.policy.layers, points, number)
        if problem.slopes is not None:
            action = np.clip(action, *(number(float(bound)) for bound in problem.policy.bounds[0]))
        left = action.astype(float) - claim.center - factors @ np.array(claim.rows)
        for origin, row in zip(claim.origins, claim.private, strict=True):
            if origin in own:
                left -= own[origin][:, None] * row
        assert (np.abs(left) <= np.array(claim.box) + 1e-9).all()


def test_inputs_of_all_layers_are_within_what_is_derived(problem: Problem) -> None:
    points, _, _ = problem.sampled(10_000)
    with ctx.workprec(64):
        form, ranges = Backward(problem.seen, problem.crown.lines), iter(problem.crown.ranges)
        for layer, x in through(problem.policy.layers, points):
            low, high = form.bounds()
            ends = np.array([[float(a) for a in low], [float(b) for b in high]])
            assert (ends[0] - 1e-9 <= x.min(0)).all() and (x.max(0) <= ends[1] + 1e-9).all()
            if isinstance(layer, Activation):
                assert np.allclose(ends, next(ranges), rtol=1e-9, atol=1e-9)
                form.activate(layer, low, high)
            elif not isinstance(layer, Selection) or layer.index:
                form.affine(layer)


FIELDS = ("lower_slopes", "lower_offsets", "upper_slopes", "upper_offsets")


def moved(lines: list[TwoLines], layer: int, field: str, neuron: int, by: float) -> list[TwoLines]:
    entry = list(getattr(lines[layer], field))
    entry[neuron] += by
    return [replace(given, **{field: tuple(entry)}) if i == layer else given for i, given in enumerate(lines)]


def is_false(activation: Activation, lines: TwoLines, low: Array, high: Array) -> bool:
    """Whether a line is on the wrong side of its function somewhere, clearly."""
    x = low + (high - low) * np.linspace(0, 1, 2001)[:, None]
    y = point(activation, x)
    below = np.array(lines.lower_slopes) * x + np.array(lines.lower_offsets)
    above = np.array(lines.upper_slopes) * x + np.array(lines.upper_offsets)
    return bool((below > y + 1e-9).any() or (above < y - 1e-9).any())


def test_a_line_that_is_not_on_its_side_of_the_function_is_rejected(problem: Problem) -> None:
    """Every offset moved inwards; slopes moved or exchanged."""
    lines, generator, rejected = problem.crown.lines, problem.generator, 0
    kinds = [layer for layer in problem.policy.layers if isinstance(layer, Activation)]
    generous = boxed(problem.action, np.full(problem.inputs, 1e3))
    assert problem.accepts(generous)
    for i, (kind, ends) in enumerate(zip(kinds, problem.crown.ranges, strict=True)):
        for neuron in range(len(ends[0])):
            assert not problem.accepts(generous, moved(lines, i, "lower_offsets", neuron, 1e-8))
            assert not problem.accepts(generous, moved(lines, i, "upper_offsets", neuron, -1e-8))
        wrong = [replace(lines[i], lower_slopes=lines[i].upper_slopes, upper_slopes=lines[i].lower_slopes)]
        wrong += [moved(lines, i, FIELDS[s], n, by)[i] for s in (0, 2) for n in range(2) for by in (-0.1, 0.1)]
        for claim in wrong:
            if is_false(kind, claim, *ends):
                rejected += 1
                assert not problem.accepts(generous, [*lines[:i], claim, *lines[i + 1 :]])
    assert rejected or not generator


@pytest.mark.parametrize("middle", [-3.0, 0.0, 3.0])
@pytest.mark.parametrize("kind", [Activation("relu"), Activation("leaky_relu", slope=0.01)], ids=str)
def test_lines_that_are_the_function_or_meet_it_in_a_bend_need_no_room(kind: Activation, middle: float) -> None:
    """Of ranges whose ends have 64 bits, so that their products with a slope have more."""
    ends = arb(middle) - arb(1) / 3, arb(middle) + arb(1) / 3
    for slope in {-3.0: (kind.slope,), 3.0: (1.0,), 0.0: (kind.slope, 1.0)}[middle]:
        above = (slope, 0.0) if middle else (0.0, 1.0)
        with ctx.workprec(64):
            form = Backward(Problem(0).seen, [TwoLines((slope,), (0.0,), (above[0],), (above[1],))])
            form.activate(kind, [ends[0]], [ends[1]])


@pytest.mark.parametrize("entry", [arb(0.25, 0.75), arb(-0.25, 0.75), arb(0, 2), arb(0.5), arb(-0.5), arb(0)], ids=str)
def test_an_entry_whose_sign_is_not_known_takes_both_lines(entry: Any) -> None:
    lines = [_Line([arb(2)], [arb(-3)]), _Line([arb(-5)], [arb(7)])]
    side = _split(_Side(arb_mat(1, 1, [entry]), [arb(1)]), *lines)
    low, high = float(entry.lower()), float(entry.upper())
    for a in np.linspace(low, high, 21).tolist():
        slope, offset = (2 * a, 1 - 3 * a) if a >= 0 else (-5 * a, 1 + 7 * a)
        assert side.matrix[0, 0].contains(arb(slope)) and side.offset[0].contains(arb(offset))


# Whole certificates -------------------------------------------------------------------------------------------------


def streams(certificate: Certificate) -> list[Streams]:
    layout = replace(certificate.setting.layout, version=2)
    return [(w.floats, w.integers) for w in (Writer(layout).leaf(leaf) for leaf in certificate.leaves)]


def resealed(certificate: Certificate, **given: Any) -> bytes:
    return sealed({**certificate.header, "format": 2}, streams(certificate), **given)


def parallel_to(claim: PeriodClaim) -> Any:
    """The slopes of a claim of version 1, as two parallel lines."""
    waiting = iter(claim.lines)

    def choose(activation: Activation, low: Array, high: Array) -> TwoLines:
        slopes = np.array(next(waiting).slopes)
        return with_slopes(activation, slopes, slopes, low, high)

    return choose


def followed(content: bytes, policy: bytes, specification: bytes) -> list[tuple[Start, PeriodClaim]]:
    """Every set of states of an accepted certificate and what is claimed about its period."""
    found: list[tuple[Start, PeriodClaim]] = []

    def watched(given: Policy, states: Start, claim: PeriodClaim, what: str) -> None:
        found.append((states, claim))
        check_action(given, states, claim, what)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(obligations, "check_action", watched)
        answer = check(content, policy, specification, workers=1)
    assert isinstance(answer, Accepted), answer
    return found


def converted(content: bytes, policy: bytes, specification: bytes, parallel: bool) -> tuple[Certificate, list[bool]]:
    """Two lines per neuron in the periods whose claimed actions contain what these leave; and which those are."""
    certificate = opened(content, policy, specification)
    waiting = iter(followed(content, policy, specification))
    proved, leaves, given = [], [], certificate.setting.policy
    for leaf in certificate.leaves:
        periods = []
        for period in leaf.periods:
            states, claim = next(waiting)
            assert claim == period
            with ctx.workprec(64):
                seen = observe(given.layout, given.observe, given.radius, states, claim.observation, claim.seen)
            crown = Crown(given, Observed.of(seen), claim.clip_slopes, parallel_to(claim) if parallel else lines_of)
            proved.append(bool((crown.needed(claim.action) <= (1 - 1e-9) * np.array(claim.action.box)).all()))
            if proved[-1]:
                period = replace(period, lines=(), form=TWO_LINES, two_lines=tuple(crown.lines))
            periods.append(period)
        leaves.append(replace(leaf, periods=tuple(periods)))
    return replace(certificate, leaves=tuple(leaves)), proved


def case(number: int) -> Case:
    """No rows of neurons of their own: backward bounds do not know them."""
    return case_of(number, action_rows=0)


def quieter(question: Case) -> bytes:
    """The same certificate for a tenth of the perturbation: its sets of actions have room."""
    certificate = opened(question.certificate, question.policy, question.specification)
    radius = [str(r / 10) for r in certificate.setting.contract.radius]
    return sealed(certificate.header, certificate.streams, observation_radius=radius)


WHOLE = (7, 8, 10, 16, 17, 20, 22, 26, 28, 35, 38)
"""Cases with a perturbation: a tenth of it leaves room for lines of other slopes in every period."""


@pytest.mark.parametrize("number", WHOLE)
def test_a_certificate_with_two_lines_per_neuron_in_every_period_is_accepted(number: int) -> None:
    question = case(number)
    files = question.policy, question.specification
    certificate, proved = converted(quieter(question), *files, False)
    assert all(proved)
    answer = check(resealed(certificate), *files, workers=1)
    assert isinstance(answer, Accepted) and answer.header.version == 2, answer


@pytest.mark.parametrize("number", [10, 16, 22, 42])
def test_parallel_lines_of_version_1_are_two_lines_too(number: int) -> None:
    question = case(number)
    files = question.policy, question.specification
    certificate, proved = converted(question.certificate, *files, True)
    assert all(proved)
    assert isinstance(check(resealed(certificate), *files, workers=1), Accepted)


@pytest.mark.parametrize("number", [2, 11, 25])
def test_each_period_has_a_form_of_its_own(number: int) -> None:
    question = case(number)
    files = question.policy, question.specification
    certificate, proved = converted(quieter(question), *files, False)
    assert any(proved) and not all(proved)
    assert isinstance(check(resealed(certificate), *files, workers=1), Accepted)


def test_the_benchmark_is_proved_with_two_lines_per_neuron(nav_folder: Path) -> None:
    """Proved for a perturbation; without it, parallel lines prove all periods and other lines most."""
    policy, specification = nav_folder / "nn-nav-set.onnx", ROOT / "specs" / "nav.yaml"
    options = Options(action_rows=0)
    result = verify(str(policy), str(specification), epsilon=0.003, options=options, check=False, workers=1)
    assert result.certificate is not None
    files = policy.read_bytes(), specification.read_bytes()
    noisy = opened(result.certificate, *files)
    quiet = sealed(noisy.header, noisy.streams, observation_radius=["0"] * 4)
    for parallel, least in ((True, 30), (False, 15)):
        certificate, proved = converted(quiet, *files, parallel)
        assert len(proved) == 30 and sum(proved) >= least
        assert isinstance(check(resealed(certificate), *files, workers=1), Accepted)


@pytest.mark.parametrize("number", [7, 20])
def test_false_lines_in_a_whole_certificate_are_rejected(number: int) -> None:
    question = case(number)
    files = question.policy, question.specification
    certificate, proved = converted(quieter(question), *files, False)
    assert all(proved)
    for field, by in (("lower_offsets", 1e-9), ("upper_offsets", -1e-9)):
        for place in range(len(proved)):
            (leaf,), periods = certificate.leaves, list(certificate.leaves[0].periods)
            lines = moved([*periods[place].two_lines], 0, field, 1, by)
            periods[place] = replace(periods[place], two_lines=tuple(lines))
            wrong = replace(certificate, leaves=(replace(leaf, periods=tuple(periods)),))
            answer = check(resealed(wrong), *files, workers=1)
            assert isinstance(answer, str) and "neuron 1 of a" in answer, answer


# Versions -----------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("number", [0, 10])
def test_both_versions_are_read_and_no_other(number: int) -> None:
    question = case(number)
    files = question.policy, question.specification
    certificate = opened(question.certificate, *files)
    for content, version in ((question.certificate, 1), (resealed(certificate), 2)):
        answer = check(content, *files, workers=1)
        assert isinstance(answer, Accepted) and answer.header.version == version
    for version in (0, 3, -1):
        with pytest.raises(InputError, match="this program reads format 1 and 2"):
            check(resealed(certificate, format=version), *files, workers=1)


@pytest.mark.parametrize("number", [0, 10, 17])
def test_streams_of_one_version_are_not_those_of_another(number: int) -> None:
    question = case(number)
    files = question.policy, question.specification
    certificate, _ = converted(quieter(question), *files, False)
    plain = opened(quieter(question), *files)
    assert isinstance(check(sealed(plain.header, plain.streams), *files, workers=1), Accepted)
    for content in (
        sealed({**certificate.header, "format": 1}, streams(certificate)),
        sealed({**plain.header, "format": 1}, streams(plain)),
        sealed({**plain.header, "format": 2}, plain.streams),
    ):
        assert isinstance(check(content, *files, workers=1), str)


@pytest.mark.parametrize("form", [-1, 2, 1])
def test_an_unknown_form_or_one_of_other_lines_is_rejected(form: int) -> None:
    question = case(10)
    files = question.policy, question.specification
    certificate = opened(question.certificate, *files)
    (leaf,) = certificate.leaves
    periods = (replace(leaf.periods[0], form=form), *leaf.periods[1:])
    wrong = replace(certificate, leaves=(replace(leaf, periods=periods),))
    answer = check(resealed(wrong), *files, workers=1)
    assert isinstance(answer, str) and ("from 0 to 1" in answer) == (form != 1)
