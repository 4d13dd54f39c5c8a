"""Witness files: what is damaged is refused at once, what still proves is true; their tables and pictures."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Callable
from dataclasses import fields, replace
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from command_line import EXAMPLE, QUICK
from witnesses import GOOD_POLICY, GOOD_TEXT, good

import setrl
from setrl.models.binding import bind
from setrl.models.onnx_reader import read_policy
from setrl.models.simulation import simulate
from setrl.specs.errors import InputError
from setrl.specs.reader import parse_specification
from setrl.verify.checker.witness import Proof, Witness, prove, read_witness, record
from setrl.verify.checker.witness_file import MAX_BYTES, MAX_NUMBERS, Recording
from setrl.verify.options import Options
from setrl.verify.plot_witness import plot_witness
from setrl.verify.result import ProvedWitness, Result
from setrl.verify.witness_replay import exact_runner, replay, runtime_name
from setrl.verify.witness_trajectory import margins, trajectory_csv, trajectory_rows, write_trajectory

F = Fraction
POLICY = read_policy(GOOD_POLICY)
LOOP = bind(parse_specification(GOOD_TEXT), POLICY)


@pytest.fixture(scope="module")
def recorded() -> Witness:
    witness = record(good(), GOOD_POLICY, GOOD_TEXT, run=exact_runner(POLICY), runtime=runtime_name())
    assert isinstance(witness, Witness)
    return witness


def quickly(content: bytes) -> tuple[str, Proof | None]:
    """What becomes of a file: why it is refused, or its proof; within a second, and never by another exception."""
    before = time.process_time()
    try:
        witness = read_witness(content)
    except InputError as error:
        found: Proof | str = str(error)
    else:
        given = witness.deployed
        same = given is not None and replay(given.observations, given.actions, POLICY)
        found = prove(witness, GOOD_POLICY, GOOD_TEXT, replayed=runtime_name() if same else "")
    assert time.process_time() - before < 1.0
    return ("", found) if isinstance(found, Proof) else (found, None)


# Files ----------------------------------------------------------------------------------------------------------------


def test_a_witness_with_a_recording_survives_its_file(recorded: Witness) -> None:
    text = recorded.to_json()
    assert read_witness(text.encode()) == recorded and '"format": "setrl-witness/2"' in text
    assert read_witness(text.encode()).to_json() == text
    found = quickly(text.encode())[1]
    assert found is not None and found.grade == "proved (real and deployed)"


def test_files_of_version_1_are_read() -> None:
    text = good().to_json()
    earlier = text.replace("witness/2", "witness/1").replace(',\n  "deployed": null', "")
    assert earlier != text and read_witness(earlier.encode()) == good()
    for mixed in (text.replace("witness/2", "witness/1"), text.replace(',\n  "deployed": null', "")):
        with pytest.raises(InputError, match="has the keys"):
            read_witness(mixed.encode())


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ('"deployed": {', '"deployed": [], "more": {'),
        ('"runtime": "onnxruntime', '"runtime": "torch'),
        ('"runtime": "onnxruntime 1', '"runtime": "onnxruntime 1\\u001b[31m'),
        ('"runtime"', '"run"'),
        ('"actions": [', '"actions": [1, '),
        ('"actions": [', '"actions": [{"a": "1"}, '),
        ('"disturbances": [', '"disturbances": [{}, '),
        ('"noise": [', '"noise": ["1", '),
    ],
)
def test_a_recording_that_is_not_of_the_format_is_an_error(old: str, new: str, recorded: Witness) -> None:
    text = recorded.to_json()
    assert old in text
    with pytest.raises(InputError):
        read_witness(text.replace(old, new, 1).encode())


def rows_of(count: int) -> bytes:
    return replace(good(), noise=((),) * count).to_json().encode()


HOSTILE: dict[str, Callable[[], bytes]] = {
    "nothing": lambda: b"",
    "too many bytes": lambda: b" " * (MAX_BYTES + 1),
    "a million periods": lambda: rows_of(10**6),
    "as many periods as are read": lambda: rows_of(MAX_NUMBERS - 100),
    "as many numbers as are read": lambda: replace(good(), initial=(F(1, 3),) * (MAX_NUMBERS - 100)).to_json().encode(),
    "a number of a million digits": lambda: good().to_json().replace('"3/10"', '"' + "9" * 10**6 + '"').encode(),
    "a whole number of a million digits": lambda: good().to_json().replace('"3/10"', "9" * 10**6).encode(),
    "a huge exponent": lambda: good().to_json().replace('"3/10"', "1e999999999").encode(),
    "a huge exponent as text": lambda: good().to_json().replace('"3/10"', '"1e999999999"').encode(),
    "deep nesting": lambda: b"[" * 10**6,
    "deep objects": lambda: b'{"a":' * 10**5,
    "half a character": lambda: good().to_json().encode() + b"\xc3",
    "half a surrogate": lambda: good().to_json().replace('"it"', '"\\ud800"').encode(),
    "another document": lambda: b"[1, 2, 3]",
    "an object of nothing": lambda: b"{}",
    "a list of pairs": lambda: json.dumps([["format", "setrl-witness/2"]]).encode(),
    "a policy": lambda: GOOD_POLICY,
    "a specification": lambda: GOOD_TEXT,
    "huge noise": lambda: huge(F(10) ** 1199).to_json().encode(),
    "tiny noise": lambda: huge(F(1, 10**1199)).to_json().encode(),
    "huge actions": lambda: with_actions(F(10) ** 1199).to_json().encode(),
    "large actions": lambda: with_actions(F(2) ** 127).to_json().encode(),
    "tiny actions": lambda: with_actions(F(1, 2**149)).to_json().encode(),
}


def huge(size: Fraction) -> Witness:
    return replace(good(), noise=((size, -size),) * 5, observation_radius=(size, size))


def with_actions(size: Fraction) -> Witness:
    return replace(good(), deployed=Recording("onnxruntime 1", ((size, size),) * 3, ((size,),) * 3))


@pytest.mark.parametrize("name", HOSTILE)
def test_a_hostile_file_is_refused_at_once(name: str) -> None:
    reason, proof = quickly(HOSTILE[name]())
    if name in ("huge noise", "tiny noise") or "actions" in name:
        assert proof is None or proof.grade == "proved (real)"
    else:
        assert proof is None and reason


# Mutations ------------------------------------------------------------------------------------------------------------

NUMBERS = [F(0), F("0.05"), F("-0.05"), F("0.3"), F("0.1"), F("0.2"), F("0.5"), F(-1), F(1, 3), F(10) ** 300]
NUMBERS += [F(1, 10**300), F("0.05") + F(1, 10**50), F(2) ** -149, F(float(np.float32(0.1))), F("0.25"), F("0.4")]


def any_number(old: Fraction, generator: np.random.Generator) -> Fraction:
    match int(generator.integers(4)):
        case 0:
            return NUMBERS[generator.integers(len(NUMBERS))]
        case 1:
            return old + F(int(generator.integers(-3, 4)), 2 ** int(generator.integers(1, 60)))
        case 2:
            return -old
        case _:
            return old * F(int(generator.integers(1, 200)), 100)


def mutated(value: Any, generator: np.random.Generator) -> Any:
    """The same value with one thing in it changed."""
    if isinstance(value, Fraction):
        return any_number(value, generator)
    if isinstance(value, str):
        return value[:-1] if generator.integers(2) else value[::-1]
    if isinstance(value, Recording | Witness):
        name = str(generator.choice([entry.name for entry in fields(value)]))
        return replace(value, **{name: mutated(getattr(value, name), generator)})
    if isinstance(value, tuple) and value:
        place = int(generator.integers(len(value)))
        match int(generator.integers(8)):
            case 0:
                return value[:place] + value[place + 1 :]
            case 1:
                return (*value[:place], value[place], *value[place:])
            case 2:
                return value[::-1]
            case 3:
                return (value[place],) * len(value)
            case _:
                return (*value[:place], mutated(value[place], generator), *value[place + 1 :])
    return (F(1, 20), F(1, 20)) if value is None else None


def is_true(witness: Witness, proof: Proof) -> bool:
    """Whether the files admit the witness and its trajectory leaves [-9, 0.2]: another reading, another arithmetic."""
    radius = witness.observation_radius or (F("0.05"), F(0))
    admitted = (
        F("0.1") <= witness.initial[0] <= F("0.3")
        and witness.initial[1:] == (F(0),)
        and all(abs(x) <= r for row in witness.noise for x, r in zip(row, radius, strict=True))
        and all(-1 <= row[0] <= F("0.5") and row == witness.disturbances[0] for row in witness.disturbances)
        and witness.requirement == "it"
        and witness.time is not None
        and F("0.1") <= witness.time <= F("0.5")
    )
    noise, force = (
        np.array([[float(x) for x in row] for row in rows]) for rows in (witness.noise, witness.disturbances)
    )
    share = 100  # mutated times are rounded to the samples
    initial = [float(x) for x in witness.initial]
    run = simulate(LOOP, initial, noise[None], force[None], rtol=1e-11, atol=1e-12, samples_per_period=share)
    angle = np.interp(float(witness.time or 0), run.times, run.states[0, :, 0])
    violated = max(angle - 0.2, -9.0 - angle)
    return admitted and violated >= proof.depth - 1e-5 and proof.depth >= 0.0


@pytest.mark.parametrize("part", range(5))
def test_a_mutated_witness_is_refused_or_still_true(part: int, recorded: Witness) -> None:
    generator = np.random.default_rng([7, part])
    proved = 0
    for _ in range(60):
        witness = mutated(recorded, generator)
        _, proof = quickly(witness.to_json().encode())
        if proof is not None:
            proved += 1
            assert is_true(witness, proof), (witness, proof)
            if "deployed" in proof.grade:
                assert (witness.initial, witness.disturbances) == (recorded.initial, recorded.disturbances)
    assert 0 < proved < 40


@pytest.mark.parametrize("part", range(5))
def test_mutated_bytes_are_refused_or_still_true(part: int, recorded: Witness) -> None:
    generator = np.random.default_rng([8, part])
    content = recorded.to_json().encode()
    for _ in range(60):
        place, size = int(generator.integers(len(content))), int(generator.integers(1, 4))
        some = generator.integers(0, 256, size).astype(np.uint8).tobytes()
        digits = b"0123456789"[int(generator.integers(10)) :][:1]
        damaged = [
            content[:place],
            content[:place] + content[place + size :],
            content[:place] + some + content[place:],
            content[:place] + digits + content[place + 1 :],
        ][int(generator.integers(4))]
        _, proof = quickly(damaged)
        assert proof is None or is_true(read_witness(damaged), proof), damaged


# Tables and pictures --------------------------------------------------------------------------------------------------

LEFT = QUICK.replace("[-1, 1]", "[-1, 0.08]")
PLANE = LEFT.replace("stay: {z: [-1, 0.08]}", "avoid: {z: [0.06, 0.2], zdot: [-9, 9]}")
MISSED = LEFT.replace("stay: {z: [-1, 0.08]}", "reach: {z: [3, 4]}\n    during: [0.2, 0.5]")
DISTURBED = """\
setrl: 1
plant: {states: {x: m, v: m/s, w: 1}, inputs: {u: m/s^2}, disturbances: {d: N}, dynamics: {x: v, v: u + d, w: x - w}}
controller: {period: 0.1, observe: [x, v], delay: 1}
horizon: 0.3
initial: {x: [-0.1, 0.1], v: 0, w: 0}
perturbation: {observation: 0.01, disturbance: {d: 0.5}}
requirements:
  - stay: "x + v <= 0.02"
"""


def falsified(text: str, tmp_path: Path) -> tuple[Result, ProvedWitness]:
    path = tmp_path / "spec.yaml"
    path.write_text(text)
    result: Result = setrl.verify(str(EXAMPLE), path, options=Options(splits=1))
    assert result.witness is not None, result.notes
    return result, result.witness


def test_the_table_is_the_simulation_of_the_witness(tmp_path: Path) -> None:
    result, witness = falsified(DISTURBED, tmp_path)
    candidate = result.candidate
    assert candidate is not None
    rows = trajectory_rows(result.loop, candidate)
    assert rows[0] == [
        *("time (s)", "x (m)", "v (m/s)", "w", "u (m/s^2)", "perturbation of x", "perturbation of v", "d (N)"),
        "distance to stay 1",
    ]
    table = np.array([[float(cell or "nan") for cell in row] for row in rows[1:]])
    assert table.shape == (25, 9) and np.allclose(table[:, 0], np.linspace(0, 0.3, 25), atol=1e-15)
    assert np.array_equal(table[0, 1:4], candidate.initial)
    held = np.concatenate([candidate.noise, candidate.disturbances], axis=1)
    assert np.array_equal(table[:-1, 5:8], np.repeat(held, 8, axis=0)) and np.isnan(table[-1, 4:8]).all()
    assert (table[:8, 4] == 0.0).all() and (table[8:24, 4] != 0.0).all()  # delayed by a period
    assert np.allclose(table[:, 8], 0.02 - table[:, 1] - table[:, 2], atol=1e-15)
    assert -table[:, 8].min() == pytest.approx(witness.depth, abs=1e-6)


def test_the_distance_is_negative_where_and_only_where_a_requirement_is_violated(tmp_path: Path) -> None:
    for text, sign in ((LEFT, 1.0), (PLANE, -1.0), (MISSED, 1.0)):
        (requirement,) = bind(parse_specification(text), read_policy(str(EXAMPLE))).requirements
        side, value = (requirement.region[0], np.array([[0.07, 0.0]]))
        depth = min(
            float(b) - float(n[0]) * value[0, 0] for n, b in zip(side.normals, side.bounds, strict=True) if n[0]
        )
        assert margins(requirement, value)[0] == pytest.approx(sign * depth)


def test_the_csv_says_what_it_is_and_is_whole_or_not_there(tmp_path: Path) -> None:
    result, _ = falsified(LEFT, tmp_path)
    assert result.candidate is not None
    target = tmp_path / "w.csv"
    write_trajectory(str(target), result.loop, result.candidate)
    comment, _, rest = target.read_text().partition("\n")
    assert comment.startswith("# ") and "simulation" in comment and "witness file" in comment
    assert list(csv.reader(io.StringIO(rest))) == trajectory_rows(result.loop, result.candidate)
    assert target.read_text() == trajectory_csv(result.loop, result.candidate)
    with pytest.raises(InputError):
        write_trajectory(str(tmp_path / "none" / "w.csv"), result.loop, result.candidate)
    assert sorted(path.name for path in tmp_path.iterdir()) == ["spec.yaml", "w.csv"]


def test_the_picture_shows_the_violation_and_the_violating_part(tmp_path: Path) -> None:
    for text, labels in (
        (LEFT, ["z (m)", "zdot (m/s)"]),
        (PLANE, ["zdot (m/s)"]),
        (MISSED, ["z (m)", "zdot (m/s)"]),
    ):
        result, witness = falsified(text, tmp_path)
        assert result.candidate is not None
        figure = plot_witness(result.loop, result.candidate, witness)
        assert [axes.get_ylabel() for axes in figure.axes] == labels
        title, key = figure.get_suptitle(), [text.get_text() for text in figure.legends[0].get_texts()]
        assert title.startswith(f"FALSIFIED: {witness.requirement} is ") and "proved (real" in title
        assert key[0] == "initial set" and key[2].endswith(" s")
        for axes in figure.axes:
            (mark,) = [line for line in axes.lines if line.get_marker() == "X"]
            path = next(line for line in axes.lines if line.get_linewidth() == 1.2).get_xydata()
            thick = next(line for line in axes.lines if line.get_linewidth() == 2.6).get_xydata()
            assert (path == mark.get_xydata()[0]).all(axis=1).any()
            drawn = np.isfinite(thick[:, 1])
            assert drawn.any() and not drawn.all() and np.array_equal(thick[drawn], path[drawn])
            if axes.get_ylabel() == "z (m)" and text == LEFT:
                assert np.array_equal(drawn, path[:, 1] > 0.08)


def test_the_same_witness_gives_the_same_picture(tmp_path: Path) -> None:
    result, witness = falsified(LEFT, tmp_path)
    assert result.candidate is not None
    for name in ("a.png", "b.png"):
        plot_witness(result.loop, result.candidate, witness, str(tmp_path / name))
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()
    with pytest.raises(InputError, match=r"\.png, \.pdf, \.svg"):
        plot_witness(result.loop, result.candidate, witness, str(tmp_path / "a.gif"))
