"""Two readers of specifications that share nothing agree on what a file says."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from flint import ctx

from setrl.models.binding import bind
from setrl.models.float_algebra import FloatAlgebra
from setrl.models.policy import Affine, Policy
from setrl.models.tape import run
from setrl.specs.errors import InputError, SpecificationError
from setrl.specs.reader import find_specification, parse_specification, shipped_specifications
from setrl.verify.checker.contract import read_contract
from setrl.verify.checker.taylor import compile_program, evaluate

RICH = """
setrl: 1
description: everything the language has
plant:
  states: {p: m, v: m/s, w: "1"}
  inputs: {a: N, b: N}
  disturbances: {d: N, e: N, f: N}
  parameters: {k: {value: 1/3, unit: kg}, l: 0.25, m: -2**-2}
  dynamics: {v: a/k - l*v**3 + d*e, p: v + tanh(w) - f, w: m*sin(p)*b}
controller:
  period: 0.05
  observe: [p - w, "v * 2", sin(w), k*p]
  before: {scale: [1, 2, 0.5, -1], offset: 0.125}
  after: {matrix: [[1, -2], [0.1, 3]], offset: [0, 1e-1]}
  clip: {a: [-1, 1], b: [-0.3, 4]}
  delay: {periods: 2, action: {b: 0.7}}
horizon: 0.5
initial: {w: 0.1, p: [-0.1, 0.3], v: [1, 1]}
perturbation:
  observation: {"(v*2)": 0.01, p - w: 1e-3}
  disturbance: {d: 0.5, e: [-1, 2], f: {range: 0.25, varies: never}}
requirements:
  - avoid: {p: [1, null], v: [-1, 2.5]}
  - stay: ["-3 <= p - 2*v < 3", {w: [null, 4]}]
    during: [0.1, 0.4]
  - avoid: {union: [{p: [1, 2]}, "v >= 3", ["v > 1", "p/2 + 1 >= w"]]}
    name: avoid 1
  - reach: {p: [0, 1]}
    name: "goal"
    during: [0.25, 0.5]
  - reach: "1 >= v >= -1"
    at: 0.3
reward: {weights: {p: 1}}
allow_unknown: true
"""


def policy(inputs: int, outputs: int) -> Policy:
    return Policy((Affine(np.ones((outputs, inputs)), np.zeros(outputs)),), inputs, outputs)


def texts() -> dict[str, bytes]:
    shipped = {name: find_specification(name).read_bytes() for name in shipped_specifications()}
    return {**shipped, "rich": RICH.encode()}


@pytest.mark.parametrize("name", sorted(texts()))
def test_both_readers_read_the_same_specification(name: str) -> None:
    content = texts()[name]
    ours = read_contract(content)
    inputs = len(ours.before.matrix) if ours.before else len(ours.observe)
    loop = bind(parse_specification(content), policy(inputs, len(ours.plant.inputs)))
    plant = loop.plant
    assert ours.digest == loop.specification.digest
    assert (ours.plant.states, ours.plant.inputs) == (plant.states, plant.inputs)
    assert (ours.plant.disturbances, ours.plant.discrete) == (plant.disturbances, plant.discrete)
    assert (ours.period, ours.periods, ours.initial) == (loop.period, loop.periods, loop.initial)
    assert (ours.radius, ours.delay, ours.delayed_action) == (
        loop.observation_radius,
        loop.delay,
        loop.delayed_action,
    )
    assert ours.clip == (loop.clip or (None,) * len(plant.inputs))
    for mine, theirs in ((ours.before, loop.before), (ours.after, loop.after)):
        assert (mine is None and theirs is None) or (mine.matrix, mine.offset) == (theirs.matrix, theirs.offset)  # type: ignore[union-attr]
    assert [(*entry.bounds, entry.constant) for entry in ours.disturbances] == [
        (entry.lower, entry.upper, entry.constant) for entry in loop.disturbances
    ]
    assert len(ours.requirements) == len(loop.requirements)
    for mine_, theirs_ in zip(ours.requirements, loop.requirements, strict=True):
        window = (mine_.kind, mine_.name, mine_.start, mine_.end)
        assert window == (theirs_.kind, theirs_.name, theirs_.start, theirs_.end)
        region = [[(facet.coefficients, facet.bound) for facet in member] for member in mine_.region]
        assert region == [list(zip(member.normals, member.bounds, strict=True)) for member in theirs_.region]
    same_functions(ours, loop)


def same_functions(ours: Any, loop: Any) -> None:
    plant = ours.plant
    values = np.random.default_rng(0).uniform(0.1, 1.0, len(loop.plant.tape.inputs)).tolist()
    field = compile_program(plant.dynamics, (*plant.states, *plant.inputs, *plant.disturbances))
    seen = compile_program(ours.observe, plant.states)
    state = values[: len(plant.states)]
    with ctx.workprec(160):
        from flint import arb

        slope = [float(value) for value in evaluate(field, [arb(x) for x in values])]
        observed = [float(value) for value in evaluate(seen, [arb(x) for x in state])]
    assert slope == pytest.approx(run(loop.plant.tape, FloatAlgebra(), values), rel=1e-12, abs=1e-12)
    expected = state if loop.observation is None else run(loop.observation, FloatAlgebra(), state)
    assert observed == pytest.approx(expected, rel=1e-12, abs=1e-12)


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("setrl: 1", "setrl: 2"),
        ("horizon: 0.5", "horizon: 0.51"),
        ("horizon: 0.5", "horizon: 0.5\nhorizon: 0.5"),
        ("horizon: 0.5", "horizon: 0x1"),
        ("horizon: 0.5", "horizon: +0.5"),
        ("horizon: 0.5", "horizon: 5e999"),
        ("period: 0.05", "period: 0.05\n  speed: 1"),
        ("period: 0.05", "period: &here 0.05"),
        ("period: 0.05", "period: !!float 0.05"),
        ("scale: [1, 2, 0.5, -1]", "scale: [1, 2, 0.5]"),
        ("[[1, -2], [0.1, 3]]", "[[1, -2], [0.1]]"),
        ("a: [-1, 1]", "c: [-1, 1]"),
        ("a: [-1, 1]", "a: [1, -1]"),
        ("periods: 2", "periods: 10"),
        ("periods: 2", "periods: 0.5"),
        ("w: 0.1, p", "q: 0.1, p"),
        ("w: 0.1, p: [-0.1, 0.3]", "p: [0.4, 0.3]"),
        ('"(v*2)": 0.01', "v*3: 0.01"),
        ('"(v*2)": 0.01', "v*2: 0.01, (v*2): 0.02"),
        ("varies: never", "varies: often"),
        ("name: avoid 1", 'name: "goal"'),
        ("at: 0.3", "at: 0.31"),
        ("at: 0.3", "at: 0.3\n    during: [0, 0.3]"),
        ("during: [0.1, 0.4]", "during: [0.1, 0.6]"),
        ("1 >= v >= -1", "1 >= v <= -1"),
        ("1 >= v >= -1", "v == 1"),
        ("1 >= v >= -1", "v*v >= 1"),
        ("1 >= v >= -1", "0*v >= 1"),
        ("1 >= v >= -1", "u >= 1"),
        ("p: [1, null]", "p: [null, null]"),
        ("tanh(w)", "tanh(z)"),
        ("f: N}", "a: N}"),
        ("w: m*sin", "w+: m*sin"),
        ("l: 0.25", "l: sqrt(2)"),
    ],
)
def test_both_readers_refuse_the_same_files(old: str, new: str) -> None:
    assert old in RICH
    content = RICH.replace(old, new, 1).encode()
    with pytest.raises(InputError):
        read_contract(content)
    with pytest.raises(InputError):
        bind(parse_specification(content), policy(4, 2))


@pytest.mark.parametrize(
    "content", [b"", b"- 1", b"a: [", b"a: *b", b"\xff", b"a: 1\n---\nb: 2", b"[" * 100, b" " * 2**21]
)
def test_what_is_no_document_is_refused(content: bytes) -> None:
    with pytest.raises(SpecificationError):
        read_contract(content)


def test_plant_files_are_found_beside_the_specification(tmp_path: Path) -> None:
    (tmp_path / "cart.yaml").write_text("states: {p: m}\ninputs: {a: N}\ndynamics: {p: a}\n")
    content = (
        b"{setrl: 1, plant: cart.yaml, controller: {period: 1}, horizon: 1, initial: {p: 0}, reward: {weights: {p: 1}}}"
    )
    contract = read_contract(content, tmp_path)
    assert contract.plant.states == ("p",) and len(contract.plant_digest) == 64
    for folder in (None, tmp_path / "nowhere"):
        with pytest.raises(SpecificationError):
            read_contract(content, folder)
