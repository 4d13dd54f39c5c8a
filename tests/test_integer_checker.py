"""Both checkers accept what is honest; the integer one rejects what the first one rejects for a shared obligation."""

from __future__ import annotations

import ast
import hashlib
import json
import math
import struct
import sys
from collections.abc import Callable
from dataclasses import fields, is_dataclass, replace
from fractions import Fraction
from functools import lru_cache
from pathlib import Path
from typing import Any

import numpy as np
import onnx_models
import pytest
from certificate_streams import opened, sealed
from certificates import Case, case_of
from loops import network

from setrl import verify
from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Affine
from setrl.specs.errors import InputError
from setrl.specs.reader import find_specification
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.checker.certificate_file import MAGIC, canonical, read_certificate
from setrl.verify.checker.integers.action import check_action
from setrl.verify.checker.integers.check import IntegerAnswer, check_links_and_network, prepare
from setrl.verify.checker.integers.cover import cells
from setrl.verify.checker.integers.links import next_set
from setrl.verify.checker.integers.sets import Tracked, require_room
from setrl.verify.checker.leaf import ActionClaim, read_leaf
from setrl.verify.checker.rejection import Rejected
from setrl.verify.options import Options

ROOT = Path(__file__).resolve().parents[1]
KINDS = ("relu", "tanh", "leaky_relu", "sigmoid", "clip")
PLANTS = (
    ("pendulum", {"theta": "[0.38, 0.42]", "thetadot": -0.2}, 1, ""),
    ("unicycle", {"x": "[2.9, 3.1]", "y": 3, "v": "[0.4, 0.5]", "theta": "[0, 0.1]"}, 2, ""),
    (
        "{states: {x: m, y: m}, inputs: {u: m}, disturbances: {d: m, w: m}, "
        "dynamics: {'x+': 0.9*x + 0.2*sin(y) - u + d, 'y+': y/(1 + x**2) + 0.3*u*w}}",
        {"x": "[0.1, 0.2]", "y": 0.3},
        1,
        "{d: [-0.1, 0.2], w: {range: [0.5, 1.5], varies: never}}",
    ),
    (
        "{states: {p: m, v: m/s}, inputs: {u: N, b: N}, disturbances: {f: N, g: N}, "
        "dynamics: {p: v, v: u - b*p + f*v + g}}",
        {"p": "[0.2, 0.3]", "v": "[-0.1, 0]"},
        2,
        "{f: 0.05, g: {range: [-0.02, 0.03], varies: never}}",
    ),
)

SHARED = (
    "the certificate",
    "the set of actions",
    "the line of neuron",
    "the first set",
    "the link to the next",
    "a later step's start",
    "a disturbance's range",
    "the tree and the leaves",
)
"""Texts of the first checker's rejections that name an obligation of both."""


def plain_case(number: int) -> Case:
    """A closed loop in which everything comes up that decides about sets of actions and links."""
    kind = KINDS[number % 5]
    plant, start, inputs, force = PLANTS[number % 4]
    size, precision = len(start), "float64" if number % 9 == 7 and kind != "leaky_relu" else "float32"
    wide = [6, 5] if number % 3 else [7]
    last = ("none", "tanh", "clip")[number // 5 % 3]
    layers = network([size, *wide, inputs], [kind] * len(wide) + [last], number, 0.8, precision).layers
    lines = ["setrl: 1", f"plant: {plant}", "controller:", f"  period: {1 if '+' in plant else 0.1}"]
    lines += [f"  observe: [{', '.join([*start][::-1])}]"] if number % 7 == 1 else []
    lines += [f"  before: {{scale: {[0.7, 0.9, 1.1, 0.3][:size]}, offset: 0.1}}"] if number % 2 else []
    matrix = [[1.1 if i == j else 0.3 for j in range(inputs)] for i in range(inputs)]
    lines += [f"  after: {{matrix: {matrix}, offset: 0.07}}"] if number % 4 > 1 else []
    lines += ["  clip: [-0.4, 0.35]"] if number % 3 == 1 else []
    lines += [f"  delay: {1 + number // 6 % 2}"] if number % 6 == 4 else []
    lines += [f"horizon: {4 if '+' in plant else 0.4}", f"initial: {json.dumps(start)}".replace('"', "")]
    noise = ("0", "0.01", f"{{{next(iter(start))}: 0.02}}")[number // 2 % 3]
    lines += [f"perturbation: {{observation: {noise}" + (f", disturbance: {force}" if force else "") + "}"]
    lines += ["requirements:", f"  - stay: {{{next(iter(start))}: [-1000, 1000]}}"]
    options = {"deployed": number % 4 != 3, "method": "linearization" if number % 8 == 5 else "jets"}
    if number % 5 == 0:
        options |= {"taylor_order": 3, "remainder_share": 0.002}  # several steps per period
    return Case(
        f"{number}-{kind}", policy_bytes(layers, precision=precision), "\n".join(lines).encode(), Options(**options)
    )


def built() -> Case:
    """A network of operators that a chain of Gemm does not have."""
    matrix, last = onnx_models.random(5, 3, seed=2), onnx_models.random(1, 5, seed=3)
    scale = np.array([0.5, 3.0, 1.0], dtype=np.float32)
    nodes: list[Any] = [
        ("Sub", ["x", "mean"], "a", {}),
        ("Div", ["a", "scale"], "b", {}),
        ("Gather", ["b", "order"], "c", {"axis": 1}),
        ("Tanh", ["c"], "d", {}),
        ("Sigmoid", ["d"], "e", {}),
        ("Gather", ["e", "order"], "f", {"axis": 1}),
        ("Gemm", ["f", "w", "w0"], "g", {"transB": 1}),
        ("Relu", ["g"], "h", {}),
        ("Mul", ["h", "half"], "i", {}),
        ("Gemm", ["i", "v", "v0"], "y", {"transB": 1}),
    ]
    constants = {
        "mean": np.array([0.1, 0.2, 0.0], dtype=np.float32),
        "scale": scale,
        "order": np.array([2, 0, 1]),
        "w": matrix,
        "w0": np.zeros(5, dtype=np.float32),
        "half": np.array([0.5], dtype=np.float32),
        "v": last,
        "v0": np.array([0.25], dtype=np.float32),
    }
    policy = onnx_models.bytes_of(nodes, constants, shape=("batch", 3))
    text = (
        "setrl: 1\nplant: {states: {x: m, y: m, z: m}, inputs: {u: m}, dynamics: {x: y, y: z + u, z: -x - u}}\n"
        "controller: {period: 0.1}\nhorizon: 0.3\ninitial: {x: [0.1, 0.2], y: 0, z: [-0.1, 0.1]}\n"
        "perturbation: {observation: 0.01}\nrequirements: [{stay: {x: [-100, 100]}}]\n"
    )
    return Case("built", policy, text.encode())


BUILT = built()
AT_THE_CLIP = Case(
    "at the clip",
    policy_bytes((Affine(np.ones((1, 1)), np.zeros(1)),)),
    b"setrl: 1\nplant: {states: {x: m}, inputs: {u: m}, dynamics: {'x+': x/2 - u/4}}\n"
    b"controller: {period: 1, clip: [-1, 0.5]}\nhorizon: 2\ninitial: {x: [0, 0.5]}\n"
    b"requirements: [{stay: {x: [-9, 9]}}]\n",
)
"""Exact actions end where the clip begins: only the runtime's are clipped."""
CASES = [plain_case(number) for number in range(36)]


def verdicts(case: Case, certificate: bytes) -> tuple[str, IntegerAnswer]:
    """Of both checkers: why the first one rejects, or ""; what the integer one says."""
    files = certificate, case.policy, case.specification
    try:
        answer = check(*files, workers=1)
        first = "" if isinstance(answer, Accepted) else answer
    except InputError as error:
        first = f"the certificate: {error}"
    try:
        return first, check_links_and_network(*files)
    except InputError as error:
        return first, IntegerAnswer(False, f"the certificate: {error}", 0, 0)


def read_periods(case: Case) -> int:
    """Of one leaf."""
    file = read_certificate(case.certificate)
    return prepare(file.header, case.policy, case.specification, None).layout.periods


def shared(reason: str) -> bool:
    """Whether both checkers have the obligation that a text of the first one names."""
    return any(text in reason for text in SHARED)


@pytest.mark.parametrize("case", [*CASES, BUILT, AT_THE_CLIP], ids=str)
def test_an_honest_certificate_is_accepted(case: Case) -> None:
    first, second = verdicts(case, case.certificate)
    assert not shared(first)
    assert second.accepted and second.reason == "" and second.uncovered == 0
    assert second.periods == read_periods(case) > 0


@pytest.mark.parametrize("number", [0, 2])
def test_every_leaf_of_a_cover_is_checked(number: int) -> None:
    case = case_of(number, tight=0.7, splits=64, method="jets")
    leaves = len(read_certificate(case.certificate).header.leaves)
    first, second = verdicts(case, case.certificate)
    assert leaves > 1 and not first and second.accepted
    assert second.periods + second.uncovered == leaves * read_periods(case)


@pytest.mark.parametrize("number", [*range(8), *(pytest.param(n, marks=pytest.mark.slow) for n in range(8, 230))])
def test_both_checkers_accept_the_corpus_nonlinear_observations_included(number: int) -> None:
    case = case_of(number)
    first, second = verdicts(case, case.certificate)
    assert not first and second.accepted and second.reason == ""
    assert second.periods > 0 == second.uncovered


def test_a_claimed_observation_is_what_the_policy_sees() -> None:
    case = case_of(7)
    certificate = opened(case.certificate, case.policy, case.specification)
    (leaf,) = certificate.leaves
    seen = leaf.periods[0].seen
    assert certificate.setting.layout.observed is None and seen is not None
    for changed in (
        replace(seen, center=(seen.center[0] + 0.1, *seen.center[1:])),
        replace(seen, radius=(seen.radius[0] + 0.1, *seen.radius[1:])),
        replace(seen, rows=((seen.rows[0][0] + 0.1, *seen.rows[0][1:]), *seen.rows[1:])),
    ):
        period = replace(leaf.periods[0], seen=changed)
        other = replace(leaf, periods=(period, *leaf.periods[1:]))
        content = sealed(certificate.header, [(w.floats, w.integers) for w in [certificate.writer(other)]])
        second = check_links_and_network(content, case.policy, case.specification)
        assert not second.accepted and "the set of actions" in second.reason


def test_what_only_the_runtime_clips_needs_room_too() -> None:
    """The slope 1 and rows of the tracked set itself: exact below the clip, not for an action that is rounded up."""
    given, file, room = AT_THE_CLIP.specification, read_certificate(AT_THE_CLIP.certificate), []
    for text in (given.replace(b"clip: [-1, 0.5]", b"clip: [-1, 9]"), given):
        header = replace(file.header, specification=hashlib.sha256(text).hexdigest())
        setting = prepare(header, AT_THE_CLIP.policy, text, None)
        leaf = read_leaf(setting.layout, *file.streams(0))
        tracked = Tracked(leaf.center, leaf.rows, leaf.radius).in_rows()
        box = 1e-9
        while True:
            action = ActionClaim(tracked.center, tuple(tracked.rows), (), (), (box,))
            claim = replace(leaf.periods[0], clip_slopes=(1.0,), action=action)
            try:
                check_action(setting.policy, tracked, claim, "here")
                break
            except Rejected:
                box *= 1.01
        room.append(box)
    free, clipped = room
    assert 1.9 * free < clipped < 2.1 * free


def test_a_queue_of_delayed_actions_moves_up_by_one() -> None:
    case = CASES[10]
    file = read_certificate(case.certificate)
    setting = prepare(file.header, case.policy, case.specification, None)
    layout, leaf = setting.layout, read_leaf(setting.layout, *file.streams(0))
    assert (layout.delay, layout.inputs, len(layout.constant)) == (2, 1, 1)
    current = Tracked(leaf.center, leaf.rows, leaf.radius).in_rows()
    for period in leaf.periods[:-1]:
        following = next_set(layout, current, period, "here")
        held, first, second = layout.states, layout.states + 1, layout.states + 2
        assert following.center[:held] == period.steps[-1].end.center
        assert following.center[held] == current.center[held]
        assert following.center[first] == current.center[second]
        assert following.center[second] == period.action.center[0]
        kept = period.kept or ()
        for row, position in zip(following.rows, kept, strict=True):
            if position < len(current.rows):
                assert row[held:] == (*current.rows[position][held::2], period.action.rows[position][0])
        current = following.in_rows()
    assert any(row[layout.states + 1] for row in current.rows)


def test_a_tree_of_more_cells_than_leaves_is_rejected() -> None:
    tree = [[0, "29/10"], None, None]
    first, second = verdicts(CASES[1], resealed(CASES[1].certificate, header=lambda data: data.update(tree=tree)))
    assert "differ in number" in first and "differ in number" in second.reason


class Placed(float):
    """A float that knows its position in a leaf's stream."""

    place: int

    @classmethod
    def of(cls, place: int, number: float) -> Placed:
        made = cls(number)
        made.place = place
        return made


@lru_cache(maxsize=64)
def places_of(case: Case) -> dict[str, list[int]]:
    """Positions of the first leaf's floats by the names of the fields that they end in."""
    file = read_certificate(case.certificate)
    floats, integers = file.streams(0)
    layout = prepare(file.header, case.policy, case.specification, None).layout
    found: dict[str, list[int]] = {}

    def visit(value: Any, name: str) -> None:
        if isinstance(value, Placed):
            found.setdefault(name, []).append(value.place)
        elif is_dataclass(value):
            for field in fields(value):
                visit(getattr(value, field.name), f"{name}.{field.name}")
        elif isinstance(value, tuple):
            for entry in value:
                visit(entry, name)

    visit(read_leaf(layout, [Placed.of(i, x) for i, x in enumerate(floats)], integers), "leaf")
    return found


def resealed(
    certificate: bytes,
    change: Callable[[list[float], list[int]], None] = lambda floats, integers: None,
    header: Callable[[dict[str, Any]], None] = lambda data: None,
) -> bytes:
    """A certificate with other numbers or another header, and the digest that fits them."""
    start = read_certificate(certificate).start
    data = json.loads(certificate[len(MAGIC) + 8 : start])
    floats = list(struct.unpack_from(f"<{data['floats']}d", certificate, start))
    integers = list(struct.unpack_from(f"<{data['integers']}i", certificate, start + 8 * data["floats"]))
    change(floats, integers)
    header(data)
    payload = struct.pack(f"<{len(floats)}d", *floats) + struct.pack(f"<{len(integers)}i", *integers)
    text = canonical(data | {"payload": hashlib.sha256(payload).hexdigest()})
    return MAGIC + struct.pack("<Q", len(text)) + text + payload


def changing(stream: str, place: int, change: Callable[[Any], Any]) -> Callable[[list[float], list[int]], None]:
    """A change of one number of a stream."""

    def changed(floats: list[float], integers: list[int]) -> None:
        numbers: list[Any] = floats if stream == "floats" else integers
        numbers[place] = change(numbers[place])

    return changed


def agree(case: Case, certificate: bytes, what: str) -> bool:
    """Judge a changed certificate; whether the first checker rejects it for an obligation of both."""
    first, second = verdicts(case, certificate)
    common = shared(first)
    assert not (common and second.accepted), (case.name, what, first)
    assert second.accepted or first, (case.name, what, second.reason)
    return common


DAMAGED = [CASES[number] for number in (1, 3, 10, 11, 13)] + [AT_THE_CLIP]
STEPS = plain_case(20)
DAMAGES: dict[str, tuple[str, Callable[[float], float]]] = {
    "a slope": ("leaf.periods.lines.slopes", lambda x: x + 0.25),
    "an offset": ("leaf.periods.lines.offsets", lambda x: x + 0.01),
    "an error": ("leaf.periods.lines.errors", lambda x: x * 0.9),
    "an action's center": ("leaf.periods.action.center", lambda x: x + 1e-3),
    "a row of the actions": ("leaf.periods.action.rows", lambda x: x + 1e-3),
    "a private row": ("leaf.periods.action.private", lambda x: x - math.copysign(1e-3, x)),
    "a box of actions": ("leaf.periods.action.box", lambda x: x * 0.9),
    "a link's radius": ("leaf.periods.radius", lambda x: x * 0.999),
    "a negative radius": ("leaf.periods.radius", lambda x: -x),
    "a later start's radius": ("leaf.periods.steps.start_radius", lambda x: x * 0.9),
    "the first center": ("leaf.center", lambda x: x + 1e-6),
    "the first rows": ("leaf.rows", lambda x: x * 0.999),
    "the first radius": ("leaf.radius", lambda x: x - 1e-9),
    "a disturbance's center": ("leaf.disturbance_center", lambda x: x + 0.01),
    "a disturbance's spread": ("leaf.disturbance_spread", lambda x: x * 0.99),
    "a slope of the clip": ("leaf.periods.clip_slopes", lambda x: x - 0.3),
}


@pytest.mark.parametrize("name", DAMAGES)
def test_a_damage_that_the_first_checker_notices_is_noticed(name: str) -> None:
    field, damage = DAMAGES[name]
    cases = [STEPS] if "steps" in field else [case for case in DAMAGED if places_of(case).get(field)]
    generator, rejected = np.random.default_rng(1), 0
    for case in cases:
        places = places_of(case)[field]
        for place in generator.choice(places, min(3, len(places)), replace=False).tolist():
            changed = resealed(case.certificate, changing("floats", place, damage))
            rejected += agree(case, changed, f"{name} {place}")
    assert rejected > 0


RANDOM: tuple[Callable[[float], float], ...] = (
    lambda x: x * 0.99,
    lambda x: x * 1.01,
    lambda x: -x,
    lambda x: 0.0,
    lambda x: x + 1e-4,
    lambda x: x - 1e-4,
    lambda x: math.nextafter(x, 0.0),
    lambda x: x * 1e300 if abs(x) < 1e8 else x,
    lambda x: 5e-324,
)


@pytest.mark.parametrize("count", [40, pytest.param(1500, marks=pytest.mark.slow)])
def test_the_checkers_agree_about_any_changed_float(count: int) -> None:
    generator, rejected = np.random.default_rng(count), 0
    for number in range(count):
        case = DAMAGED[number % len(DAMAGED)]
        place = int(generator.integers(len(read_certificate(case.certificate).streams(0)[0])))
        damage = RANDOM[number // len(DAMAGED) % len(RANDOM)]
        rejected += agree(case, resealed(case.certificate, changing("floats", place, damage)), f"float {place}")
    assert rejected > count // 10


@pytest.mark.parametrize("count", [40, pytest.param(600, marks=pytest.mark.slow)])
def test_the_checkers_agree_about_any_changed_whole_number(count: int) -> None:
    """Which rows are dropped, origins of private rows, counts."""
    generator, rejected = np.random.default_rng(count), 0
    for number in range(count):
        case = DAMAGED[number % len(DAMAGED)]
        place = int(generator.integers(len(read_certificate(case.certificate).streams(0)[1])))
        step = (1, -1)[number // len(DAMAGED) % 2]
        change = changing("integers", place, lambda x, step=step: x + step)
        rejected += agree(case, resealed(case.certificate, change), f"whole number {place}")
    assert rejected > count // 10


def test_another_dropped_row_has_no_room() -> None:
    """A large row in the place of a small one: only the link notices."""
    case, found = DAMAGED[0], 0
    for place in range(len(read_certificate(case.certificate).streams(0)[1])):
        changed = resealed(case.certificate, changing("integers", place, lambda x: max(x - 1, 0)))
        try:
            second = check_links_and_network(changed, case.policy, case.specification)
        except InputError:
            continue
        if "the link to the next" in second.reason:
            assert "the link to the next" in verdicts(case, changed)[0]
            found += 1
        if found > 3:
            return
    raise AssertionError("no dropped row was exchanged")


HEADERS: dict[str, Callable[[dict[str, Any]], None]] = {
    "another policy": lambda data: data.update(policy="0" * 64),
    "another specification": lambda data: data.update(specification="0" * 64),
    "another plant": lambda data: data.update(plant="0" * 64),
    "a smaller error of the runtime": lambda data: data["runtime"].update(error="1/3000000"),
    "a runtime of another precision": lambda data: data.update(semantics=["real", "float64"]),
    "one leaf less in the tree": lambda data: data["tree"].pop(),
    "one leaf more in the tree": lambda data: data["tree"].append(None),
    "a moved cut": lambda data: move(data, "1/1000"),
    "a cut outside": lambda data: move(data, "1000"),
    "a cut below": lambda data: move(data, "-1000"),
    "a cut of no state": lambda data: data["tree"][0].__setitem__(0, 7),
    "a cut of a negative state": lambda data: data["tree"][0].__setitem__(0, -1),
}


def test_the_cells_of_a_tree_cover_the_root() -> None:
    root = ((Fraction(0), Fraction(1)), (Fraction(-1), Fraction(3)))
    cut = (0, Fraction(1, 3)), (1, Fraction(3))
    low, high, flat = cells((cut[0], None, cut[1], None, None), root)
    assert low == [(0, Fraction(1, 3)), root[1]]
    assert high == [(Fraction(1, 3), 1), root[1]] and flat == [(Fraction(1, 3), 1), (3, 3)]
    for tree, complaint in (
        ([(0, Fraction(2)), None, None], "outside"),
        ([(0, Fraction(-1)), None, None], "outside"),
        ([(2, Fraction(0)), None, None], "no state"),
        ([(-1, Fraction(0)), None, None], "no state"),
        ([(0, Fraction(1, 2)), None], "early"),
        ([], "early"),
        ([None, None], "too many"),
    ):
        with pytest.raises(Rejected, match=complaint):
            cells(tree, root)


def test_what_is_dropped_needs_room_and_no_negative_one_is_lent() -> None:
    require_room([(1.0, -2.0), (0.125, 0.0)], (0.0, 0.5), (1.125, 2.5), "here")
    for radius, room in (((0.0, 0.5), (1.125, 2.4)), ((0.0, -0.5), (1.2, 3.0)), ((2.0**-60, 0.5), (1.125, 2.5))):
        with pytest.raises(Rejected, match="here"):
            require_room([(1.0, -2.0), (0.125, 0.0)], radius, room, "here")


def move(data: dict[str, Any], distance: str) -> None:
    node = data["tree"][0]
    node[1] = str(Fraction(node[1]) + Fraction(distance))


@pytest.mark.parametrize("name", HEADERS)
def test_a_header_about_something_else_is_rejected(name: str) -> None:
    case = case_of(0, tight=0.7, splits=64, method="jets", deployed=True)
    first, second = verdicts(case, resealed(case.certificate, header=HEADERS[name]))
    assert first and not second.accepted, (first, second)


@pytest.mark.parametrize(
    ("radii", "complaint"),
    [(["0"], "radii"), (["0"] * 5, "radii"), (["0", "0", "0", "-1/2"], "radii"), (["1/10"] * 4, "neuron")],
)
def test_other_radii_of_the_observation_are_rejected(radii: list[str], complaint: str) -> None:
    case = CASES[1]
    changed = resealed(case.certificate, header=lambda data: data.update(observation_radius=radii))
    first, second = verdicts(case, changed)
    assert first and not second.accepted and complaint in second.reason, (first, second)


def verified(policy: Path, name: str) -> tuple[str, IntegerAnswer]:
    specification = find_specification(name)
    certificate = verify(str(policy), str(specification)).certificate
    assert certificate is not None
    case = Case(name, policy.read_bytes(), specification.read_bytes())
    return verdicts(case, certificate)


def test_the_shipped_example_is_accepted() -> None:
    first, second = verified(ROOT / "models" / "policies" / "quadrotor1d-set.onnx", "quadrotor1d")
    assert not first and second == IntegerAnswer(True, "", 30, 0)


def test_nav_set_is_accepted(nav_folder: Path) -> None:
    first, second = verified(nav_folder / "nn-nav-set.onnx", "nav")
    assert not first and second == IntegerAnswer(True, "", 30, 0)


@pytest.mark.slow
def test_nav_point_is_accepted(nav_folder: Path) -> None:
    first, second = verified(nav_folder / "nn-nav-point.onnx", "nav")
    assert not first and second.accepted and second.periods > 30 and second.uncovered == 0


def test_states_that_vanish_are_followed_at_their_own_size() -> None:
    """After 150 periods the states are of size 2^-150: no fixed number of places would do."""
    layers = (Affine(np.array([[0.1, 0.3]]), np.zeros(1)),)
    text = (
        "setrl: 1\nplant: {states: {x: m, y: m}, inputs: {u: m}, dynamics: {'x+': 0.5*x + u/8, 'y+': 0.4*y - u/16}}\n"
        "controller: {period: 1}\nhorizon: 150\ninitial: {x: [0.5, 1], y: [0, 1]}\n"
        "requirements: [{stay: {x: [-9, 9]}}]\n"
    )
    case = Case("vanishing", policy_bytes(layers, precision="float64"), text.encode(), Options(deployed=False))
    first, second = verdicts(case, case.certificate)
    assert not first and second == IntegerAnswer(True, "", 150, 0)


def test_no_number_of_a_ball_library_decides(monkeypatch: pytest.MonkeyPatch) -> None:
    import flint

    def refuse(*arguments: Any, **options: Any) -> Any:
        raise AssertionError("a ball was asked for")

    case = CASES[1]
    certificate = case.certificate
    for name in ("arb", "arb_mat", "fmpq", "fmpz", "acb"):
        for module in list(sys.modules.values()):
            if getattr(module, "__name__", "").startswith("setrl.verify.checker") and hasattr(module, name):
                monkeypatch.setattr(module, name, refuse)
        monkeypatch.setattr(flint, name, refuse)
    assert check_links_and_network(certificate, case.policy, case.specification).accepted


def test_the_package_imports_only_the_readers_and_the_standard_library() -> None:
    readers = {"certificate_file", "contract", "layers", "layout", "leaf", "network", "rejection", "errors"}
    folder = ROOT / "verify" / "checker" / "integers"
    for file in sorted(folder.glob("*.py")):
        for node in ast.walk(ast.parse(file.read_text())):
            if isinstance(node, ast.Import):
                assert {alias.name for alias in node.names} <= {"hashlib", "math", "struct"}, file
            elif isinstance(node, ast.ImportFrom) and node.level == 0:
                assert node.module is not None and node.module.split(".")[0] in sys.stdlib_module_names, file
            elif isinstance(node, ast.ImportFrom) and node.level > 1:
                assert node.module is not None and node.module.split(".")[-1] in readers, (file, node.module)
