"""Specification and plant files: what they mean, and that every mistake is named with file, line and remedy."""

from __future__ import annotations

import hashlib
import subprocess
import sys
from fractions import Fraction as F
from pathlib import Path

import pytest

import setrl.specs
from setrl.specs.errors import InputError, SpecificationError
from setrl.specs.expressions import Name, parse_expression
from setrl.specs.reader import (
    find_specification,
    parse_plant,
    parse_specification,
    read_plant,
    read_specification,
    shipped_specifications,
)
from setrl.specs.specification import AffineMap, Bounds, Disturbance, PlantDescription, Specification

BASE = """\
setrl: 1
plant: unicycle
controller: {period: 0.2}
horizon: 6.0
initial: {x: [2.9, 3.1], v: 0}
requirements:
  - avoid: {x: [1, 2]}
"""
"""Lines: setrl 1, plant 2, controller 3, horizon 4, initial 5, requirements 6, the requirement 7."""


def with_line(key: str, text: str) -> str:
    """BASE with the line of a top-level key replaced, or the line appended."""
    lines = BASE.splitlines()
    for index, line in enumerate(lines):
        if line.startswith(f"{key}:"):
            lines[index] = text
            return "\n".join(lines) + "\n"
    return BASE + text + "\n"


def read(text: str) -> Specification:
    return parse_specification(text, source="t.yaml")


def region_of(text: str) -> list[list[tuple[dict[str, F], F]]]:
    region = read(BASE + f"  - stay: {text}\n").requirements[1].region
    return [[(dict(half.coefficients), half.bound) for half in member.halfspaces] for member in region.members]


def test_every_key_of_the_language_is_read_exactly() -> None:
    text = """\
setrl: 1
description: all keys
plant: plants/mine.yaml
controller:
  period: 0.2
  observe: [x, "sin( theta )"]
  before: {scale: [0.5, 2], offset: 1}
  after: {matrix: [[1, 0.1], [0, 1e-3]], offset: [0, -1]}
  clip: {a: [-1, 1], omega: [-2, 2]}
  delay: {periods: 1, action: {a: 0.5}}
horizon: 1.2
initial: {x: [2.9, 3.1], theta: 0}
perturbation:
  observation: {x: 0.1, "sin(theta)": 0.01}
  disturbance:
    wind: 0.1
    gust: [-0.1, 0.2]
    bias: {range: [0, 1], varies: never}
    drag: {range: 0.3}
requirements:
  - avoid: {x: [1, 2], y: [1, null]}
    name: obstacle
  - reach: "x - 3*y <= 4"
  - reach: {x: [null, 0.5]}
    during: [0.4, 1]
  - stay: ["x <= 1", "1 <= y <= 2", {theta: [-1, 1]}]
    during: [0.05, 0.1]
  - avoid:
      union: [{x: [1, 1]}, "y > 2", ["x > 0", "y > 0"]]
    at: 0.4
reward:
  weights: {x: 1, y: 0.5}
  target: {x: 2}
  discount: 0.99
  penalty: {amount: 1, inside: {x: [1, 2]}}
allow_unknown: true
"""
    spec = read(text)
    control = spec.controller
    assert (spec.plant, spec.description, spec.horizon, spec.allow_unknown) == (
        "plants/mine.yaml",
        "all keys",
        F(6, 5),
        True,
    )
    assert control.period == F(1, 5)
    assert control.observe == {"x": Name("x"), "sin(theta)": parse_expression("sin(theta)")}
    assert control.before == AffineMap(None, (F(1, 2), F(2)), F(1))
    assert control.after == AffineMap(((F(1), F(1, 10)), (F(0), F(1, 1000))), F(1), (F(0), F(-1)))
    assert control.clip == {"a": Bounds(F(-1), F(1)), "omega": Bounds(F(-2), F(2))}
    assert (control.delay, control.delayed_action) == (1, {"a": F(1, 2)})
    assert spec.initial == {"x": Bounds(F(29, 10), F(31, 10)), "theta": Bounds(F(0), F(0))}
    assert spec.perturbation.observation == {"x": F(1, 10), "sin(theta)": F(1, 100)}
    assert spec.perturbation.disturbances == {
        "wind": Disturbance(Bounds(F(-1, 10), F(1, 10))),
        "gust": Disturbance(Bounds(F(-1, 10), F(1, 5))),
        "bias": Disturbance(Bounds(F(0), F(1)), constant=True),
        "drag": Disturbance(Bounds(F(-3, 10), F(3, 10))),
    }
    assert [(r.kind, r.name, r.start, r.end, r.line) for r in spec.requirements] == [
        ("avoid", "obstacle", 0, F(6, 5), 21),
        ("reach", "reach 1", F(6, 5), F(6, 5), 23),
        ("reach", "reach 2", F(2, 5), 1, 24),
        ("stay", "stay 1", F(1, 20), F(1, 10), 26),
        ("avoid", "avoid 2", F(2, 5), F(2, 5), 28),
    ]
    assert [len(requirement.region.members) for requirement in spec.requirements] == [1, 1, 1, 1, 3]
    reward = spec.reward
    assert reward is not None and reward.penalty is not None
    assert (reward.weights, reward.target, reward.discount) == ({"x": 1, "y": F(1, 2)}, {"x": 2}, F(99, 100))
    assert reward.penalty.amount == 1
    assert spec.digest == hashlib.sha256(text.encode()).hexdigest()
    for key, line in {
        "initial.x": 12, "requirements.0.avoid": 21, "controller.observe.0": 6, "perturbation.observation.x": 14,
        "perturbation.disturbance.wind": 16, "reward.weights.x": 32, "controller.clip.a": 9, "requirements.4": 28,
    }.items():  # fmt: skip
        assert spec.lines[key] == line


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("{x: [1, 2]}", [[({"x": -1}, -1), ({"x": 1}, 2)]]),
        ("{x: [null, 2], y: [1, ~]}", [[({"x": 1}, 2), ({"y": -1}, -1)]]),
        ("x - 3*y <= 4", [[({"x": 1, "y": -3}, 4)]]),
        ("[x <= 1, y >= 0]", [[({"x": 1}, 1), ({"y": -1}, 0)]]),
        ("{union: [x <= 1, {y: [null, 0]}]}", [[({"x": 1}, 1)], [({"y": 1}, 0)]]),
    ],
)
def test_region_is_a_union_of_intersections(text: str, expected: object) -> None:
    assert region_of(text) == expected


@pytest.mark.parametrize(
    ("key", "line"),
    [
        ("controller", "controller: {period: 0.2, clip: [-1, 1], delay: 2}"),
        ("controller", "controller: {period: 1e-1}"),
        ("controller", "controller: {period: 0.2, observe: {first: x, speed: v*cos(theta)}}"),
        ("horizon", "horizon: 0.2"),
        ("horizon", "horizon: '6'".replace("'", "")),
        ("perturbation", "perturbation: {observation: 0}"),
        ("perturbation", "perturbation: {}"),
        ("allow_unknown", "allow_unknown: false"),
        ("description", "description: '1'"),
        ("plant", "plant: {states: {x: m, v: m/s}, inputs: {a: }, dynamics: {x: v, v: a}}"),
    ],
)
def test_specification_accepts(key: str, line: str) -> None:
    read(with_line(key, line))


WRONG = [
    # key of the replaced or appended line, the line, where, parts of the message with its remedy
    ("setrl", "setrl: 2", 1, "language version 1", "setrl: 1"),
    ("setrl", "# no version", 2, "'setrl' is missing", "add 'setrl: ...'"),
    ("plant", "plant:", 2, "no value", "remove it"),
    ("plant", "plant: [a]", 2, "a plant's name, a path or a mapping", "unicycle"),
    ("horizn", "horizn: 3", 8, "unknown key 'horizn'", "did you mean horizon? known: setrl, description, plant"),
    ("horizon", "horizn: 6", 4, "unknown key 'horizn'", "did you mean horizon?"),
    ("horizon", "horizon: 6.1", 4, "not a whole multiple of the period 0.2", "write 6 or 6.2"),
    ("horizon", "horizon: 0.1", 4, "not a whole multiple", "write 0.2"),
    ("horizon", "horizon: 0", 4, "greater than 0", "positive"),
    ("horizon", "horizon: 1e300", 4, "at most 100000 periods", "longer period"),
    ("horizon", "horizon: 0x10", 4, "expected a number", "decimal"),
    ("horizon", "horizon: nan", 4, "expected a number", "finite"),
    ("horizon", "horizon: .inf", 4, "expected a number", "finite"),
    ("horizon", "horizon: 017", 4, "expected a number", "leading zeros"),
    ("horizon", "horizon: '6'", 4, "expected a number", "remove the quotes"),
    ("horizon", "horizon: 1e301", 4, "exponent", "between +-300"),
    ("horizon", "horizon: [6]", 4, "found a list of 1", "write a decimal"),
    ("controller", "controller: {}", 3, "'period' is missing", "add 'period: ...'"),
    ("controller", "controller: 0.2", 3, "expected a mapping, found '0.2'", "keys: period"),
    ("controller", "controller: {period: -0.2}", 3, "greater than 0", "positive"),
    ("controller", "controller: {period: 0.2, observe: x}", 3, "a list of expressions", "[x, y, sin(theta)]"),
    ("controller", "controller: {period: 0.2, observe: []}", 3, "at least one entry", "add one"),
    ("controller", "controller: {period: 0.2, observe: [x.y]}", 3, "column 2 of 'x.y'", "a name has no parts"),
    ("controller", "controller: {period: 0.2, observe: [x, 'x ']}", 3, "observed twice", "remove one"),
    ("controller", "controller: {period: 0.2, observe: {2x: x}}", 3, "expected a name", "ASCII letters"),
    ("controller", "controller: {period: 0.2, clip: 1}", 3, "[lower, upper] or a mapping", "[-1, 1]"),
    ("controller", "controller: {period: 0.2, clip: [1, -1]}", 3, "empty box", "swap"),
    ("controller", "controller: {period: 0.2, clip: {a: [1]}}", 3, "a list of 1", "two numbers"),
    ("controller", "controller: {period: 0.2, delay: 0.5}", 3, "whole number", "write 0, 1, 2"),
    ("controller", "controller: {period: 0.2, delay: 30}", 3, "not shorter than the run of 30", "shorten the delay"),
    ("controller", "controller: {period: 0.2, before: {scale: 1, matrix: [[1]]}}", 3, "exclude each other", "diagonal"),
    ("controller", "controller: {period: 0.2, before: {matrix: [[1, 2], [3]]}}", 3, "differ in length", "as many"),
    ("controller", "controller: {period: 0.2, before: {scale: [1, 2], offset: [1]}}", 3, "offset has 1", "equal"),
    ("controller", "controller: {period: 0.2, after: {scal: 1}}", 3, "unknown key 'scal'", "did you mean scale?"),
    ("initial", "initial: {x: [3.1, 2.9]}", 5, "initial.x: empty box", "swap"),
    ("initial", "initial: {x: [1, null]}", 5, "found nothing", "write a decimal"),
    ("initial", "initial: {x: [1, 2, 3]}", 5, "a list of 3", "write two numbers"),
    ("initial", "initial: {x: }", 5, "found nothing", "write a decimal"),
    ("initial", "initial: {}", 5, "at least one entry", "add one"),
    ("initial", "initial: {union: 1}", 5, "reserved word", "another name"),
    ("initial", "initial: {sin: 1}", 5, "reserved word", "another name"),
    ("initial", "initial: {lambda: 1}", 5, "reserved word", "another name"),
    ("initial", "initial: {θ: 1}", 5, "expected a name", "ASCII letters"),
    ("initial", "initial: {x: 1, x: 2}", 5, "a second time", "keep one"),
    ("initial", "initial: [x]", 5, "expected a mapping", "key: value"),
    ("perturbation", "perturbation: {observation: -0.1}", 8, "not negative", "minus sign"),
    ("perturbation", "perturbation: {observation: [0.1]}", 8, "a radius or a mapping", "{x: 0.1}"),
    ("perturbation", "perturbation: {disturbance: {wind: [1, 0]}}", 8, "empty box", "swap"),
    ("perturbation", "perturbation: {disturbance: {wind: -1}}", 8, "not negative", "minus sign"),
    ("perturbation", "perturbation: {disturbance: {wind: {range: 1, varies: often}}}", 8, "'every period'", "one of"),
    ("requirements", "requirements: []\nx:", 7, "unknown key 'x'", "known:"),
    ("reward", "reward: {weights: {x: -1}}", 8, "not negative", "minus sign"),
    ("reward", "reward: {weights: {x: 1}, discount: 1.1}", 8, "(0, 1]", "write 1"),
    ("reward", "reward: {weights: {x: 1}, discount: 0}", 8, "greater than 0", "positive"),
    ("reward", "reward: {weights: {x: 1}, target: {y: 1}}", 8, "without weight", "give it a weight"),
    ("reward", "reward: {weights: {x: 1}, penalty: {amount: 1}}", 8, "'inside' is missing", "add 'inside: ...'"),
    ("allow_unknown", "allow_unknown: yes", 8, "true or false", "without quotes"),
    ("allow_unknown", "allow_unknown: True", 8, "true or false", "without quotes"),
    ("description", "description: [a]", 8, "expected text", "a word or a sentence"),
]  # fmt: skip


@pytest.mark.parametrize(("key", "line", "where", "message", "remedy"), WRONG, ids=[row[1] for row in WRONG])
def test_wrong_specification_names_line_and_remedy(key: str, line: str, where: int, message: str, remedy: str) -> None:
    with pytest.raises(SpecificationError) as caught:
        read(with_line(key, line))
    text = str(caught.value)
    assert text.startswith(f"t.yaml:{where}: ")
    assert message in text
    assert remedy in (caught.value.remedy or "")
    assert "\n" not in text


WRONG_REQUIREMENTS = [
    ("- {}", "exactly one of avoid, stay and reach, found none", "one list entry"),
    ("- {name: a}", "exactly one of avoid, stay and reach", "one list entry"),
    ("- {avoid: x > 1, stay: x < 1}", "found avoid and stay", "one list entry"),
    ("- {avoids: x > 1}", "unknown key 'avoids'", "did you mean avoid?"),
    ("- x > 1", "expected a mapping", "key: value"),
    ("- {avoid: }", "no value", "remove it"),
    ("- {avoid: {x: [2, 1]}}", "empty box", "swap"),
    ("- {avoid: {x: [null, null]}}", "at least one bound", "are free"),
    ("- {avoid: {x: 1}}", "expected [lower, upper]", "null is a side without a bound"),
    ("- {avoid: {x: [1]}}", "expected [lower, upper]", "null is a side without a bound"),
    ("- {avoid: {}}", "at least one entry", "add one"),
    ("- {avoid: []}", "at least one entry", "add one"),
    ("- {avoid: {union: []}}", "at least one entry", "add one"),
    ("- {avoid: {union: [{union: [x > 1]}]}}", "union", ""),
    ("- {avoid: {union: [x > 1], x: [1, 2]}}", "unknown key 'x'", "known: union"),
    ("- {avoid: [[x > 1]]}", "a comparison or a box", "x - 3*y"),
    ("- {avoid: x == 1}", "found '=='", "tolerance"),
    ("- {avoid: x*y > 1}", "not linear", "linear in the states"),
    ("- {avoid: x > 1, at: 7}", "outside the run [0, 6]", "lengthen the horizon"),
    ("- {avoid: x > 1, at: 0.3}", "not a whole multiple", "write 0.2 or 0.4"),
    ("- {stay: x > 1, at: 0.3}", "not a whole multiple", "write 0.2 or 0.4"),
    ("- {reach: x > 1, at: 5.9}", "not a whole multiple", "write 5.8 or 6"),
    ("- {reach: x > 1, at: -1}", "not negative", "minus sign"),
    ("- {reach: x > 1, during: [0.1, 0.4]}", "not a whole multiple", "write 0 or 0.2"),
    ("- {stay: x > 1, during: [1, 6.1]}", "outside the run", "lengthen the horizon"),
    ("- {stay: x > 1, during: [-1, 6]}", "outside the run", "lengthen the horizon"),
    ("- {stay: x > 1, during: [2, 1]}", "empty box", "swap"),
    ("- {stay: x > 1, during: 2}", "expected [lower, upper]", "two numbers"),
    ("- {stay: x > 1, during: [1, 2], at: 1}", "at and during exclude each other", "keep the one"),
    ("- {stay: x > 1, name: avoid 1}\n  - {stay: x > 1, name: avoid 1}", "is taken", "choose another"),
    ("- {stay: x > 1, name: ''}", "expected text", "a word"),
]


@pytest.mark.parametrize(("entry", "message", "remedy"), WRONG_REQUIREMENTS, ids=[row[0] for row in WRONG_REQUIREMENTS])
def test_wrong_requirement_names_line_and_remedy(entry: str, message: str, remedy: str) -> None:
    with pytest.raises(SpecificationError) as caught:
        read(BASE + f"  {entry}\n")
    assert str(caught.value).startswith(f"t.yaml:{8 + entry.count(chr(10))}: requirements.")
    assert message in caught.value.message
    assert remedy in (caught.value.remedy or "")


def test_specification_without_requirements_and_reward_is_an_error() -> None:
    text = BASE[: BASE.index("requirements")]
    with pytest.raises(SpecificationError, match="t.yaml:1: .*neither requirements nor a reward"):
        read(text)
    assert read(text + "reward: {weights: {x: 1}}\n").requirements == ()
    with pytest.raises(SpecificationError, match=r"t.yaml:6: requirements: expected at least one entry"):
        read(text + "requirements: []\n")


def test_radius_of_something_the_policy_does_not_see_is_an_error() -> None:
    text = with_line("controller", "controller: {period: 0.2, observe: [x, sin(theta)]}")
    assert read(text + "perturbation: {observation: {'sin( theta)': 0.1}}").perturbation.observation == {
        "sin(theta)": F(1, 10)
    }
    with pytest.raises(SpecificationError, match=r"t.yaml:8: .*does not observe this .*known: x, sin\(theta\)"):
        read(text + "perturbation: {observation: {y: 0.1}}")


def test_default_name_avoids_the_given_ones() -> None:
    spec = read(BASE + "  - {avoid: x > 5, name: avoid 1}\n")
    assert [requirement.name for requirement in spec.requirements] == ["avoid 2", "avoid 1"]


PLANT = """\
states: {x: m, v: m/s}
inputs: {a: m/s^2}
disturbances: {wind: N}
parameters: {m: {value: 1/3, unit: kg}, g: 9.81, k: 1e-3}
dynamics:
  x: v
  v: (a + wind)/m - g*k
"""


def test_plant_is_read_exactly() -> None:
    plant = parse_plant(PLANT, "p.yaml", "mine")
    assert (plant.name, plant.source, plant.discrete) == ("mine", "p.yaml", False)
    assert (list(plant.states), list(plant.inputs), list(plant.disturbances)) == (["x", "v"], ["a"], ["wind"])
    assert plant.states["v"] == "m/s"
    assert plant.parameters == {"m": (F(1, 3), "kg"), "g": (F(981, 100), ""), "k": (F(1, 1000), "")}
    assert plant.dynamics["v"] == parse_expression("(a + wind)/m - g*k")
    assert plant.lines == {"x": 6, "v": 7}


def test_dynamics_follow_the_order_of_the_states() -> None:
    text = "name: n\ndescription: d\nstates: {x: 1, y: 1}\ninputs: {a: 1}\ndynamics: {y+: x, x+: a}\n"
    plant = parse_plant(text)
    assert list(plant.dynamics) == ["x", "y"]
    assert (plant.discrete, plant.name, plant.description) == (True, "n", "d")


WRONG_PLANTS = [
    # replaced text, its replacement, line, parts
    ("x: v\n", "x: wnd\n", 6, "unknown name 'wnd'", "did you mean wind? known: x, v, a, wind"),
    ("x: v\n", "x: v.w\n", 6, "column 2 of 'v.w'", "no parts"),
    ("x: v\n", "", 5, "'x' has no dynamics", "add 'x: ...'"),
    ("x: v\n", "x: v\n  y: v\n", 7, "'y' is not a state", "known: x, v"),
    ("x: v\n", "x+: v\n", 7, "mixes with 'x+'", "all keys"),
    ("x: v\n", "x: [v]\n", 6, "expected an expression", "text such as"),
    ("{a:", "{x:", 2, "also one of the states", "rename"),
    ("{a:", "{sin:", 2, "reserved word", "another name"),
    ("{wind:", "{m:", 4, "also one of the disturbances", "rename"),
    ("1/3", "g/3", 4, "unknown name 'g'", "known: none"),
    ("1/3", "sqrt(2)", 4, "rational constant", "functions belong"),
    ("1/3", "1/0", 4, "division by zero", "change the divisor"),
    ("1/3", "1e300*1e300", 4, "fewer digits", "round"),
    ("value: 1/3", "val: 1/3", 4, "unknown key 'val'", "did you mean value?"),
    ("g: 9.81", "g: [9.81, m]", 4, "a number or {value, unit}", "{value: 0.05, unit: kg}"),
    ("states: {x: m, v: m/s}", "states: [x, v]", 1, "expected a mapping", "key: value"),
    ("inputs: {a: m/s^2}", "inputs: {}", 2, "at least one entry", "add one"),
    ("inputs:", "input:", 2, "unknown key 'input'", "did you mean inputs?"),
]


@pytest.mark.parametrize(
    ("old", "new", "line", "message", "remedy"), WRONG_PLANTS, ids=[row[1] for row in WRONG_PLANTS]
)
def test_wrong_plant_names_line_and_remedy(old: str, new: str, line: int, message: str, remedy: str) -> None:
    assert old in PLANT
    with pytest.raises(SpecificationError) as caught:
        parse_plant(PLANT.replace(old, new), "p.yaml")
    assert str(caught.value).startswith(f"p.yaml:{line}: ")
    assert message in caught.value.message
    assert remedy in (caught.value.remedy or "")


def test_inline_plant_has_the_lines_of_its_file() -> None:
    inline = "plant:\n  states: {x: m}\n  inputs: {a: 1}\n  dynamics:\n    x: a*0"
    plant = read(with_line("plant", inline)).plant
    assert isinstance(plant, PlantDescription)
    assert plant.lines == {"x": 6}
    with pytest.raises(SpecificationError, match=r"t.yaml:6: plant.dynamics.x: column 1 of 'b': unknown name 'b'"):
        read(with_line("plant", inline.replace("a*0", "b")))


@pytest.mark.parametrize("name", shipped_specifications())
def test_shipped_specification_is_read(name: str) -> None:
    spec = read_specification(find_specification(name))
    assert spec.requirements and spec.reward is not None and spec.description
    assert spec.digest == hashlib.sha256(Path(spec.source).read_bytes()).hexdigest()


def test_nav_is_the_contract_of_the_competition() -> None:
    spec = read_specification(find_specification("nav.yaml"))
    assert (spec.plant, spec.controller.period, spec.horizon) == ("unicycle", F(1, 5), 6)
    assert spec.initial["x"] == spec.initial["y"] == Bounds(F(29, 10), F(31, 10))
    obstacle, goal = spec.requirements
    assert (obstacle.kind, obstacle.name, obstacle.start, obstacle.end) == ("avoid", "obstacle", 0, 6)
    assert (goal.kind, goal.name, goal.start, goal.end) == ("reach", "goal", 6, 6)


def test_file_in_the_current_folder_comes_before_the_shipped_one(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shipped = find_specification("nav")
    assert shipped == find_specification("nav.yaml") and shipped.is_absolute()
    (tmp_path / "nav").mkdir()
    (tmp_path / "nav.yaml").write_text(BASE)
    assert find_specification("nav") == find_specification("nav.yaml") == Path("nav.yaml")
    assert read_specification("nav.yaml").source == "nav.yaml"


@pytest.mark.parametrize("name", ["nvigation", "nowhere", "folder/nav.yaml", "../nav", "nav.txt", "", "\x00"])
def test_unknown_specification_lists_the_shipped_ones(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    with pytest.raises(InputError, match="nav, navigation, pendulum, quadrotor1d, quadrotor2d"):
        find_specification(name)


def test_unreadable_file_is_an_error_with_its_path(tmp_path: Path) -> None:
    for path in (tmp_path / "none.yaml", tmp_path):
        with pytest.raises(SpecificationError, match="cannot read the file"):
            read_specification(path)
        with pytest.raises(SpecificationError, match="cannot read the file"):
            read_plant(path)


def test_errors_are_imported_without_a_parser() -> None:
    code = "import sys, setrl.specs.errors; sys.exit(any(name in sys.modules for name in ('pydantic', 'yaml')))"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_documentation_examples_are_read() -> None:
    page = (Path(setrl.specs.__file__).parents[1] / "docs" / "specification.md").read_text()
    blocks = [block.split("```")[0] for block in page.split("```yaml\n")[1:]]
    assert len(blocks) == 2
    assert read(blocks[0]).requirements[2].name == "stay 1"
    assert parse_plant(blocks[1]).parameters["m"] == (F(1, 3), "kg")
