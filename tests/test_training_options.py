"""Where options come from, which values they may have, and what `setrl train` refuses before it writes anything."""

from __future__ import annotations

import json
import math
from dataclasses import fields, replace
from pathlib import Path

import pytest
from command_line import QUICK, contents, run

from setrl.specs.errors import SetrlError, UsageError
from setrl.specs.reader import find_specification, read_specification, shipped_specifications
from setrl.train.algorithms.table import TABLE
from setrl.train.configuration import TUNED, configure, read_assignment, read_value
from setrl.train.launch import create_run
from setrl.train.options import ALGORITHMS, PAPER, FlowpipeOptions, TrainingOptions, options_from, plain
from setrl.train.task import start_bounds, task_of

TABLE_2 = {
    "actor_learning_rate": 1e-4,
    "critic_learning_rate": 1e-3,
    "discount": 0.99,
    "target_update": 0.05,
    "exploration": 0.1,
    "batch": 64,
    "buffer": 10**6,
    "episodes": 2000,
    "epsilon": 0.1,
    "actor_weight": 0.1,
    "critic_weight": 0.01,
}
"""Of the paper, for both bases; the critic's regularisation differs."""


@pytest.fixture(scope="module")
def quadrotor():
    return read_specification(find_specification("quadrotor1d"))


@pytest.mark.parametrize(("base", "decay"), [("ddpg", 0.01), ("td3", 0.0)])
def test_the_papers_preset_is_its_table_to_the_letter(quadrotor, base, decay):
    options = configure(quadrotor, {"base": base, "algorithm": "sa-sc"}, preset="paper").options
    task = task_of(quadrotor)
    for name, value in {**TABLE_2, "critic_decay": decay}.items():
        found = getattr(options, name)
        assert (task.discount if found is None else found) == value, name
    assert options.smoothing == 0.2  # the second number in the row of exploration noise
    assert PAPER.keys() == {"ddpg", "td3"}


def test_the_command_line_wins_over_the_file_and_the_file_over_tuned_weights(quadrotor, tmp_path):
    tuned = configure(quadrotor, {})
    assert tuned.start == {"z": [-4, 4], "zdot": 0}
    assert tuned.options.actor_weight != configure(quadrotor, {}, preset="none").options.actor_weight
    file = tmp_path / "options.yaml"
    file.write_text(
        "actor_weight: 0.5\ntarget_update: 1e-2\nhidden: [8, 4]\nflowpipe: {steps: 3}\nstart: {z: 1, zdot: 0}\n"
    )
    found = configure(quadrotor, {"target_update": 0.02, "flowpipe.pairs": 2}, file=file)
    assert (found.options.actor_weight, found.options.target_update) == (0.5, 0.02)
    assert (found.options.hidden, found.options.flowpipe.steps, found.options.flowpipe.pairs) == ((8, 4), 3, 2)
    assert found.start == {"z": 1, "zdot": 0}


def test_tuned_weights_are_those_of_the_algorithm_that_is_trained(quadrotor):
    by_set, point = (configure(quadrotor, {"algorithm": name}).options for name in ("sa-pc", "pa-pc"))
    assert by_set.actor_weight != point.actor_weight


def test_a_file_with_a_shipped_name_has_no_tuned_weights(tmp_path):
    copy = tmp_path / "quadrotor1d.yaml"
    copy.write_text(find_specification("quadrotor1d").read_text())
    found = configure(read_specification(copy), {})
    assert found.start is None
    assert found.options == TrainingOptions()
    with pytest.raises(UsageError, match="tuned"):
        configure(read_specification(copy), {}, preset="tuned")


@pytest.mark.parametrize("path", sorted(TUNED.glob("*.yaml")), ids=lambda path: path.stem)
def test_tuned_settings_can_be_used(path):
    assert path.name in shipped_specifications() or path.stem in shipped_specifications()
    specification = read_specification(find_specification(path.stem))
    for name in ALGORITHMS:
        found = configure(specification, {"algorithm": name})
        task_of(specification, None if found.start is None else start_bounds(found.start))
        assert found.options.epsilon is not None
        assert found.radii


def test_options_survive_plain_data():
    options = TrainingOptions(algorithm="sa-sc", hidden=(3, 2), epsilon=0.25, flowpipe=FlowpipeOptions(steps=7))
    assert options_from(json.loads(json.dumps(plain(options)))) == options


def test_every_algorithm_has_its_class():
    assert set(TABLE) == set(ALGORITHMS)


@pytest.mark.parametrize(
    ("text", "value"),
    [("3", 3), ("1e-3", 1e-3), ("-2.5", -2.5), ("true", True), ("null", None), ("ddpg", "ddpg"), ("nan", "nan")],
)
def test_values_are_read_as_written(text, value):
    found = read_value(text)
    assert found == value
    assert type(found) is type(value)


def test_a_list_is_written_with_commas():
    assert read_assignment("hidden=64, 32") == ("hidden", [64, 32])
    assert read_assignment("hidden=8") == ("hidden", [8])
    assert read_assignment("flowpipe.steps=200") == ("flowpipe.steps", 200)


BAD = {
    "epsilon": [-0.1, math.nan, math.inf, "much", True],
    "actor_weight": [-1.0, math.nan],
    "discount": [0.0, 1.5],
    "target_update": [0.0, -0.1, 2],
    "omega": [-0.1, 1.1],
    "episodes": [-1, 2.5, "many"],
    "seeds": [0, 10_000],
    "batch": [0],
    "hidden": [[], [0], ["wide"], 64],
    "algorithm": ["sac", "SA-PC"],
    "base": ["ppo"],
    "precision": ["float16"],
    "warmup": [10**7],
    "flowpipe": [{"steps": -1}, {"stepz": 3}, {"clip": 0.0}, {"epsilon": math.nan}, 5],
    "episode": [1],
}


@pytest.mark.parametrize(("name", "value"), [(name, value) for name, values in BAD.items() for value in values])
def test_a_value_of_no_use_is_refused_by_name(name, value):
    with pytest.raises(UsageError) as error:
        options_from({name: value})
    assert name in str(error.value)


def test_every_option_is_documented():
    documented = TrainingOptions.__doc__ or ""
    inner = FlowpipeOptions.__doc__ or ""
    assert all(entry.name in documented for entry in fields(TrainingOptions))
    assert all(entry.name in inner for entry in fields(FlowpipeOptions))


NO_REWARD = QUICK[: QUICK.index("reward:")]
REFUSED: dict[str, tuple[list[str], list[str]]] = {
    "no specification": ([], ["--spec", "quadrotor1d"]),
    "unknown algorithm": (["--spec", "spec.yaml", "--algorithm", "sac"], ["sac", "sa-pc"]),
    "unknown option": (["--spec", "spec.yaml", "--set", "epsilonn=0.1"], ["epsilonn", "epsilon"]),
    "no assignment": (["--spec", "spec.yaml", "--set", "epsilon"], ["--set", "name=value"]),
    "negative radius": (["--spec", "spec.yaml", "--epsilon", "-0.1"], ["epsilon", "-0.1"]),
    "radius that is no number": (["--spec", "spec.yaml", "--epsilon", "nan"], ["epsilon", "nan"]),
    "no reward": (["--spec", "free.yaml"], ["free.yaml", "reward"]),
    "unknown start": (["--spec", "spec.yaml", "--config", "start.yaml"], ["start", "altitude"]),
    "missing file": (["--spec", "spec.yaml", "--config", "none.yaml"], ["none.yaml"]),
    "bad file": (["--spec", "spec.yaml", "--config", "bad.yaml"], ["bad.yaml", "epochs"]),
    "a run that is there": (["--spec", "spec.yaml", "--name", "taken"], ["taken", "--resume", "--name"]),
    "a name that is a path": (["--spec", "spec.yaml", "--name", "../x"], ["--name"]),
    "no run to resume": (["--resume", "runs/none"], ["runs/none"]),
    "resumed with options": (["--resume", "runs/taken", "--seeds", "3"], ["--resume"]),
    "paper without tuned": (["--spec", "spec.yaml", "--preset", "tuned"], ["--preset", "tuned"]),
    "time without purpose": (["--spec", "spec.yaml", "--timeout", "5"], ["--timeout", "--until-verified"]),
    "margins without requirements": (
        ["--spec", "aimless.yaml", "--set", "flowpipe.objective=margin", "--flowpipe", "5"],
        ["objective", "requirement"],
    ),
}


@pytest.fixture
def folder(tmp_path, monkeypatch) -> Path:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "spec.yaml").write_text(QUICK)
    (tmp_path / "free.yaml").write_text(NO_REWARD)
    aimless = QUICK[: QUICK.index("requirements:")] + QUICK[QUICK.index("reward:") :]
    (tmp_path / "aimless.yaml").write_text(aimless)
    (tmp_path / "start.yaml").write_text("start: {altitude: 1}\n")
    (tmp_path / "bad.yaml").write_text("epochs: 3\n")
    create_run("spec.yaml", {"episodes": 1}, name="taken")
    return tmp_path


@pytest.mark.parametrize("case", REFUSED)
def test_what_cannot_be_trained_is_one_line_with_a_remedy(case, folder, capsys):
    arguments, words = REFUSED[case]
    before = contents(folder)
    found = run(capsys, "train", *arguments)
    assert found.code == 2, found.err
    assert found.out == ""
    assert len(found.err.strip().splitlines()) == 1, found.err
    assert all(word in found.err for word in words), found.err
    assert contents(folder) == before


def test_evaluating_what_has_not_finished_says_so(folder, capsys):
    found = run(capsys, "evaluate", "runs/taken")
    assert found.code == 2
    assert "setrl train --resume" in found.err
    assert run(capsys, "evaluate", "nowhere").code == 2


def test_a_start_box_that_names_no_state_is_an_error(quadrotor):
    with pytest.raises(SetrlError, match="altitude"):
        task_of(quadrotor, start_bounds({"altitude": 1}))
    assert replace(TrainingOptions(), seeds=3, first_seed=4).seed_numbers == (4, 5, 6)
