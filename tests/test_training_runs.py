"""What a training run leaves: a folder that explains itself, checkpoints that never tear, curves without a gap."""

from __future__ import annotations

import io
import json
import math
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import pytest

pytest.importorskip("torch", reason="torch is part of the extra `train`")
pytest.importorskip("safetensors", reason="safetensors is part of the extra `train`")
pytest.importorskip("tensorboard", reason="tensorboard is part of the extra `train`")
import torch

from setrl.models.onnx_reader import read_policy
from setrl.specs.errors import InputError, PolicyError, SetrlError
from setrl.specs.reader import find_specification, read_specification, shipped_specifications
from setrl.train import checkpoints, export, learning_curves, progress
from setrl.train.checkpoints import load, save, stored
from setrl.train.events import EventWriter
from setrl.train.export import best_seed, export_policy, publish_best, report_policy, require_same_network
from setrl.train.learning_curves import LearningCurves, plot_curves, read_curves
from setrl.train.networks import Layout, initial_parameters, layers_of
from setrl.train.options import TrainingOptions, plain
from setrl.train.progress import TrainingProgress, training_progress
from setrl.train.run_folder import RunFolder
from setrl.verify.checker.certificate import Accepted, check
from setrl.verify.options import Options

ROOT = Path(__file__).resolve().parents[1]
OPTIONS = TrainingOptions(seeds=2, episodes=10)

SPECIFICATION = """\
setrl: 1
plant: quadrotor1d
controller: {period: 0.1}
horizon: 0.3
initial: {z: [-0.1, 0.1], zdot: 0}
perturbation: {observation: 0.01}
requirements:
  - stay: {z: [-5, 5]}
    name: altitude
reward: {weights: {z: 1, zdot: 0.01}, discount: 0.99}
"""
PLANT = """\
states: {z: m, zdot: m/s}
inputs: {a: 1}
dynamics:
  z: zdot
  zdot: a
"""


def write(path: Path, text: str) -> Path:
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(text)
    return path


def created(folder: Path, text: str = SPECIFICATION) -> RunFolder:
    source = write(folder / "given" / "spec.yaml", text)
    return RunFolder.create(folder / "runs" / "a", {"options": plain(OPTIONS)}, read_specification(source))


def refusal(error: Any) -> str:
    """One line that names a place and what to do."""
    text = str(error.value)
    assert "\n" not in text and len(text) < 600, text
    assert error.value.where and error.value.remedy, text
    return text


def files(folder: Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in sorted(folder.rglob("*")) if path.is_file()}


@contextmanager
def full_disk(room: int = 1000) -> Iterator[None]:
    """No file can become larger than so many bytes, which fails as a full disk does: in the middle of a write."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (room, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


# The folder --------------------------------------------------------------------------------------


def test_a_run_is_read_back_as_it_was_created(tmp_path: Path) -> None:
    run = created(tmp_path)
    again = RunFolder.open(run.path)
    assert again == run
    assert again.options() == OPTIONS
    assert again.specification.read_text() == SPECIFICATION
    assert set(again.configuration["versions"]) >= {"setrl", "python", "torch", "numpy"}
    assert again.version_changes() == []


def test_a_configuration_names_no_place_of_the_machine(tmp_path: Path) -> None:
    run = created(tmp_path)
    assert not [name for name, content in files(run.path).items() if str(tmp_path).encode() in content]


@pytest.mark.parametrize(
    "reference", ["mine.yaml", "below/mine.yaml", "../beside/mine.yaml", "../given/x/../mine.yaml"]
)
def test_a_run_needs_nothing_but_its_folder(tmp_path: Path, reference: str) -> None:
    (tmp_path / "given" / "x").mkdir(parents=True)
    plant = write(Path(os.path.normpath(tmp_path / "given" / reference)), PLANT)
    run = created(tmp_path, SPECIFICATION.replace("quadrotor1d", reference))
    before = read_specification(tmp_path / "given" / "spec.yaml")
    moved = tmp_path / "elsewhere"
    run.path.rename(moved)
    plant.unlink()
    (tmp_path / "given" / "spec.yaml").unlink()
    layout, row = network()
    export_policy(moved / "seed-0", layout, row)
    again = RunFolder.open(moved)
    assert again.read_specification().digest == before.digest
    # the plant is found from the copy, by the engine and by the checker
    assert report_policy(again.seed(0), again.specification).verdict.value == "VERIFIED"


@pytest.mark.parametrize("name", shipped_specifications())
def test_a_run_of_a_shipped_specification_is_read_back(tmp_path: Path, name: str) -> None:
    given = read_specification(find_specification(name))
    run = RunFolder.create(tmp_path / "run", {"options": plain(OPTIONS)}, given)
    again = RunFolder.open(run.path).read_specification()
    assert (again.digest, again.plant) == (given.digest, given.plant)


def test_a_plant_at_an_absolute_place_has_to_stay_as_it_was(tmp_path: Path) -> None:
    plant = write(tmp_path / "plants" / "mine.yaml", PLANT)
    run = created(tmp_path, SPECIFICATION.replace("quadrotor1d", str(plant)))
    run.read_specification()
    write(plant, PLANT.replace("zdot: a", "zdot: 2*a"))
    with pytest.raises(InputError, match="no longer the one of this run") as error:
        run.read_specification()
    refusal(error)


def test_an_inline_plant_is_in_the_copy(tmp_path: Path) -> None:
    inline = "plant:\n" + "".join(f"  {line}\n" for line in PLANT.splitlines())
    run = created(tmp_path, SPECIFICATION.replace("plant: quadrotor1d\n", inline))
    assert run.configuration["plant"] == {"kind": "inline", "file": "", "sha256": ""}
    assert list(RunFolder.open(run.path).read_specification().plant.states) == ["z", "zdot"]


def test_an_existing_run_is_never_overwritten(tmp_path: Path) -> None:
    run = created(tmp_path)
    before = files(run.path)
    with pytest.raises(InputError, match="there is a run of this name") as error:
        created(tmp_path)
    assert "--resume" in refusal(error) and "--name" in refusal(error)
    assert files(run.path) == before


def test_a_folder_with_anything_in_it_is_refused_and_an_empty_one_is_not(tmp_path: Path) -> None:
    other = write(tmp_path / "runs" / "a" / "thesis.tex", "x")
    with pytest.raises(InputError, match="not empty") as error:
        created(tmp_path)
    assert "--resume" not in refusal(error)
    assert files(tmp_path / "runs") == {"a/thesis.tex": b"x"}
    other.unlink()
    created(tmp_path)


def test_a_run_that_cannot_be_created_leaves_nothing_in_the_way(tmp_path: Path) -> None:
    with full_disk(), pytest.raises(InputError, match="cannot write the file") as error:
        created(tmp_path)
    refusal(error)
    assert not (tmp_path / "runs" / "a").exists()
    created(tmp_path)


def test_a_place_that_cannot_hold_a_run_is_a_sentence(tmp_path: Path) -> None:
    write(tmp_path / "runs", "a file")
    with pytest.raises(InputError, match="nothing can be written here") as error:
        created(tmp_path)
    refusal(error)


def test_a_specification_without_its_file_is_refused(tmp_path: Path) -> None:
    source = write(tmp_path / "spec.yaml", SPECIFICATION)
    specification = read_specification(source)
    source.write_text(SPECIFICATION + "# changed\n")
    with pytest.raises(InputError, match="as a file") as error:
        RunFolder.create(tmp_path / "run", {"options": {}}, specification)
    refusal(error)
    assert not (tmp_path / "run").exists()


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\xff\xfe",
        b"[1, 2]",
        b"[" * 100_000,
        b'{"format": "setrl-run/9"}',
        b'{"format": "setrl-run/1"}',
        b'{"format": "setrl-run/1", "options": [], "specification": {}, "plant": {}, "versions": {}}',
    ],
)
def test_a_damaged_or_foreign_configuration_is_a_sentence(tmp_path: Path, content: bytes) -> None:
    run = created(tmp_path)
    (run.path / "configuration.json").write_bytes(content)
    with pytest.raises(InputError) as error:
        RunFolder.open(run.path)
    assert "configuration.json" in refusal(error)


def test_a_configuration_points_to_nothing_outside_of_the_run(tmp_path: Path) -> None:
    run = created(tmp_path)
    file = run.path / "configuration.json"
    for outside in ("../../given/spec.yaml", "/etc/passwd"):
        data = json.loads(file.read_text())
        data["specification"]["file"] = outside
        file.write_text(json.dumps(data))
        with pytest.raises(InputError, match="not inside") as error:
            RunFolder.open(run.path)
        refusal(error)


def test_a_folder_that_is_no_run_is_a_sentence(tmp_path: Path) -> None:
    created(tmp_path)
    with pytest.raises(InputError, match=r"no such folder.*runs here: a") as error:
        RunFolder.open(tmp_path / "runs" / "b")
    refusal(error)
    with pytest.raises(InputError, match="no folder of a training run") as error:
        RunFolder.open(tmp_path)
    refusal(error)


def test_options_of_another_version_are_named_with_the_file(tmp_path: Path) -> None:
    run = created(tmp_path)
    file = run.path / "configuration.json"
    file.write_text(file.read_text().replace('"episodes"', '"epochs"'))
    with pytest.raises(SetrlError, match=r"configuration.json: epochs: there is no option"):
        RunFolder.open(run.path).options()


@pytest.mark.parametrize("name", ["inputs/spec.yaml", "inputs/plants/quadrotor1d.yaml"])
def test_a_changed_copy_is_noticed(tmp_path: Path, name: str) -> None:
    run = created(tmp_path)
    run.read_specification()
    with (run.path / name).open("a") as file:
        file.write("# a remark\n")
    with pytest.raises(InputError, match="not the one that the run was started with") as error:
        run.read_specification()
    refusal(error)


def test_a_shipped_plant_that_became_another_one_is_noticed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    import setrl.models.plant as plants

    run = created(tmp_path)
    shipped = (plants.PLANTS_FOLDER / "quadrotor1d.yaml").read_text()
    monkeypatch.setattr(plants, "PLANTS_FOLDER", tmp_path)
    write(tmp_path / "quadrotor1d.yaml", shipped + "# a remark changes nothing\n")
    run.read_specification()
    write(tmp_path / "quadrotor1d.yaml", shipped.replace("9.81", "9.8"))
    with pytest.raises(InputError, match="no longer the one of this run") as error:
        run.read_specification()
    refusal(error)


def test_a_run_is_written_by_one_process_at_a_time_and_a_dead_one_holds_nothing(tmp_path: Path) -> None:
    run = created(tmp_path)
    code = (
        "import sys, time; from setrl.train.run_folder import RunFolder\n"
        "with RunFolder.open(sys.argv[1]).locked(): print('locked', flush=True); time.sleep(60)"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    holder = subprocess.Popen([sys.executable, "-c", code, run.path], env=environment, stdout=subprocess.PIPE)
    with holder:
        assert holder.stdout is not None and holder.stdout.readline() == b"locked\n"
        with pytest.raises(InputError, match=f"number: {holder.pid}") as error, run.locked():
            raise AssertionError("locked twice")
        refusal(error)
        holder.send_signal(signal.SIGKILL)
        holder.wait()
        with run.locked():
            pass
    with run.locked():
        with pytest.raises(InputError, match="another process"), run.locked():
            raise AssertionError("locked twice")


# Checkpoints -------------------------------------------------------------------------------------


def state(number: int, size: int = 50) -> tuple[dict[str, Any], dict[str, Any]]:
    """Tensors and numbers that say the same number."""
    return {"a": torch.full((size,), number), "b": torch.tensor(float(number))}, {"episode": number}


def test_a_checkpoint_is_read_back_bit_for_bit(tmp_path: Path) -> None:
    generator = torch.Generator().manual_seed(3)
    tensors = {
        "float32": torch.randn((3, 4), generator=generator),
        "transposed": torch.randn((3, 4), generator=generator).double().T,
        "special": torch.tensor([math.nan, -0.0, math.inf, 5e-324], dtype=torch.float64),
        "truth": torch.tensor([[True, False]]),
        "number": torch.tensor(7),
        "empty": torch.zeros((0, 3)),
        "parameter": torch.ones(2, requires_grad=True),
        "view": torch.arange(10)[2:5],
    }
    numbers = {"best": -math.inf, "generator": {"state": 2**127 + 1}, "tiny": 0.1 + 0.2, "text": "\u00e9", "none": None}
    where = save(tmp_path / "made", tensors, numbers)
    again, values, place = load(tmp_path / "made")
    assert place == where and values == numbers and set(again) == set(tensors)
    for name, tensor in tensors.items():
        assert again[name].dtype == tensor.dtype and again[name].shape == tensor.shape
        assert again[name].numpy().tobytes() == tensor.detach().contiguous().numpy().tobytes()


def test_the_last_two_checkpoints_are_kept(tmp_path: Path) -> None:
    for number in range(1, 13):
        save(tmp_path, *state(number))
    assert [path.name for path in stored(tmp_path)] == [
        "checkpoint-000012.safetensors",
        "checkpoint-000011.safetensors",
    ]
    assert sorted(files(tmp_path)) == [path.name for path in reversed(stored(tmp_path))]


def damage(path: Path, kind: str) -> None:
    content = bytearray(path.read_bytes())
    if kind == "data":
        content[-3] ^= 1
    elif kind == "numbers":
        place = content.index(b"episode")
        content[place] ^= 1
    elif kind == "type":
        content = bytearray(bytes(content).replace(b'"F32"', b'"I32"'))
    elif kind == "foreign":
        content = bytearray(checkpoints._content({}, "{}").replace(b"setrl-checkpoint/1", b"setrl-checkpoint/9"))
    else:
        content = content[: {"torn": len(content) - 5, "header": 40, "empty": 0}[kind]]
    path.write_bytes(content)


@pytest.mark.parametrize("kind", ["data", "numbers", "type", "foreign", "torn", "header", "empty"])
def test_a_damaged_checkpoint_is_passed_over_and_said_to_be(tmp_path: Path, kind: str) -> None:
    for number in (1, 2):
        save(tmp_path, *state(number))
    damage(stored(tmp_path)[0], kind)
    told: list[str] = []
    tensors, numbers, where = load(tmp_path, tell=told.append)
    assert numbers == {"episode": 1} and bool((tensors["a"] == 1).all())
    assert where == stored(tmp_path)[1]
    assert len(told) == 1 and "checkpoint-000002" in told[0] and "\n" not in told[0]


def test_a_damaged_checkpoint_does_not_count_as_the_one_to_go_back_to(tmp_path: Path) -> None:
    for number in (1, 2):
        save(tmp_path, *state(number))
    damage(stored(tmp_path)[0], "data")
    damaged, intact = stored(tmp_path)
    newest = save(tmp_path, *state(3))
    assert stored(tmp_path) == [newest, intact] and not damaged.exists()


def test_no_intact_checkpoint_is_a_sentence(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(InputError, match="there is no checkpoint") as error:
        load(tmp_path / "nowhere")
    refusal(error)
    save(tmp_path, *state(1))
    damage(stored(tmp_path)[0], "torn")
    with pytest.raises(InputError, match="none of 1 checkpoints is intact") as error:
        load(tmp_path)
    refusal(error)
    assert "damaged" in capsys.readouterr().err


def test_a_full_disk_leaves_the_checkpoint_before(tmp_path: Path) -> None:
    save(tmp_path, *state(1))
    with full_disk(), pytest.raises(InputError, match="cannot write the file") as error:
        save(tmp_path, *state(2, 10_000))
    assert "make room" in refusal(error)
    assert load(tmp_path)[1] == {"episode": 1}
    assert len(files(tmp_path)) == 1


def test_a_folder_that_cannot_be_made_is_a_sentence(tmp_path: Path) -> None:
    write(tmp_path / "file", "x")
    with pytest.raises(InputError) as error:
        save(tmp_path / "file" / "checkpoints", *state(1))
    refusal(error)


SAVING = """
import os, sys, time
import numpy as np
from setrl.train.checkpoints import save
folder, log = sys.argv[1:3]
for number in (0, 0, 0, 0):
    before = time.perf_counter()
    save(folder, {"a": np.full(60_000, 0), "b": np.array(0)}, {"episode": 0})
print(time.perf_counter() - before, flush=True)
for line in sys.stdin:
    started = int(line)
    child = os.fork()
    if child:
        print(child, flush=True)
        os.waitpid(child, 0)
        print("ended", flush=True)
        continue
    done = os.open(log, os.O_WRONLY | os.O_APPEND | os.O_CREAT)
    for number in range(started, started + 10**6):
        save(folder, {"a": np.full(60_000, number), "b": np.array(number)}, {"episode": number})
        os.write(done, b"%d\\n" % number)
"""


def test_a_writer_that_is_killed_at_any_moment_leaves_a_whole_checkpoint(tmp_path: Path) -> None:
    folder, log = tmp_path / "checkpoints", tmp_path / "log"
    log.touch()
    generator = np.random.default_rng(9)
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    command = [sys.executable, "-c", SAVING, folder, log]
    numbers = {"episode": 0}
    with subprocess.Popen(
        command, env=environment, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, bufsize=1
    ) as process:
        assert process.stdin is not None and process.stdout is not None
        seconds = float(process.stdout.readline())  # of one checkpoint
        for _ in range(20):
            process.stdin.write(f"{numbers['episode'] + 1}\n")
            child = int(process.stdout.readline())
            time.sleep(generator.uniform(0.0, 6.0) * seconds)
            os.kill(child, signal.SIGKILL)
            assert process.stdout.readline() == "ended\n"
            told, before = list[str](), numbers["episode"]
            tensors, numbers, _ = load(folder, tell=told.append)
            assert bool((tensors["a"] == numbers["episode"]).all()) and int(tensors["b"]) == numbers["episode"]
            assert not told, told
            finished = max(before, *map(int, ["0", *log.read_text().split()]))
            assert numbers["episode"] in (finished, finished + 1), "what was saved is still there"
        process.stdin.close()
    assert numbers["episode"] > 5, "the writers were killed while they wrote, not before"
    save(folder, *state(1))
    assert len(files(folder)) == 2, "what killed writers left is gone"


# Learning curves ---------------------------------------------------------------------------------

SEEDS = (4, 5, 6)


def row(number: int) -> dict[str, Any]:
    generator = np.random.default_rng(number)
    values = {
        "return": generator.normal(size=3),
        "steps": np.array([30, 29, number]),
        "critic_loss": generator.normal(size=3).astype(np.float32) if number > 2 else np.full(3, np.nan),
        "actor_loss": generator.normal(size=3),
    }
    return values | ({"value": np.array([-1.5, -np.inf, 0.1 + number])} if number % 4 == 0 else {})


def curves_of(path: Path, last: int, completed: int = 0) -> bytes:
    curves = LearningCurves(path, SEEDS, completed=completed)
    for number in range(completed + 1, last + 1):
        curves.add(number, row(number))
    curves.close()
    return path.read_bytes()


def test_curves_hold_a_row_per_episode_and_seed(tmp_path: Path) -> None:
    curves_of(tmp_path / "curves.csv", 8)
    curves = read_curves(tmp_path / "curves.csv")
    assert curves.seeds == SEEDS and curves.numbers.tolist() == list(range(1, 9))
    for number in range(1, 9):
        for name in learning_curves.EPISODE_COLUMNS[2:]:
            expected = row(number).get(name, np.full(3, np.nan))
            found = curves.columns[name][number - 1].astype(expected.dtype)
            assert np.array_equal(found, expected, equal_nan=expected.dtype.kind == "f"), name


@pytest.mark.parametrize("completed", [0, 1, 5, 8])
def test_resumed_curves_are_those_of_an_undisturbed_run(tmp_path: Path, completed: int) -> None:
    path, whole = tmp_path / "curves.csv", curves_of(tmp_path / "whole.csv", 9)
    covered = len(curves_of(path, completed))
    generator = np.random.default_rng(completed)
    for cut in (covered, covered + 1, len(whole) - 1, len(whole), *generator.integers(covered, len(whole), 10)):
        path.write_bytes(whole[:cut])  # what the run wrote until it was killed
        assert curves_of(path, 9, completed) == whole


def test_curves_that_lack_rows_of_the_checkpoint_are_refused_and_a_deleted_file_is_not(tmp_path: Path) -> None:
    path = tmp_path / "curves.csv"
    lines = curves_of(path, 6).splitlines(keepends=True)
    twice, missing, cut = (
        [*lines[:5], lines[4], *lines[6:]],
        [*lines[:5], *lines[6:]],
        [*lines[:-1], lines[-1].rstrip()],
    )
    for spoilt in (lines[:-1], twice, missing, lines[1:], cut, [b"\0"]):
        path.write_bytes(b"".join(spoilt))
        with pytest.raises(InputError) as error:
            LearningCurves(path, SEEDS, completed=6)
        assert "curves.csv" in refusal(error)
        assert path.read_bytes() == b"".join(spoilt)
    path.unlink()
    curves_of(path, 8, 6)
    curves_of(path, 9, 7)
    assert read_curves(path).numbers.tolist() == [7, 8, 9]


def test_a_row_out_of_turn_is_a_broken_invariant(tmp_path: Path) -> None:
    curves = LearningCurves(tmp_path / "curves.csv", SEEDS)
    for number, values in ((2, row(2)), (0, row(0)), (1, {"reward": np.zeros(3)})):
        with pytest.raises(AssertionError):
            curves.add(number, values)
    curves.close()


def test_curves_on_a_full_disk_are_a_sentence_and_can_be_resumed(tmp_path: Path) -> None:
    path, whole = tmp_path / "curves.csv", curves_of(tmp_path / "whole.csv", 9)
    curves = LearningCurves(path, SEEDS)
    with full_disk(), pytest.raises(InputError, match="cannot write the file") as error:
        for number in range(1, 10):
            curves.add(number, row(number))
    refusal(error)
    with full_disk(), pytest.raises(InputError, match="cannot write the file"):
        curves.close()
    curves.close()
    completed = curves.completed
    assert 0 < completed < 9
    assert curves_of(path, 9, completed) == whole


@pytest.mark.parametrize(
    "content", ["", "x\n", "a,b,c\n1,2,3\n", "episode,seed,return\n1,2\n", "episode,seed,r\n1,x,3\n"]
)
def test_what_are_no_curves_is_a_sentence(tmp_path: Path, content: str) -> None:
    with pytest.raises(InputError) as error:
        read_curves(write(tmp_path / "curves.csv", content))
    refusal(error)


def test_curves_are_drawn_with_every_seed_and_their_median(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    for last in (0, 1, 40):
        curves_of(tmp_path / "curves.csv", last)
        curves = read_curves(tmp_path / "curves.csv")
        figure = plot_curves(curves, tmp_path / "curves.png", "pa-pc", "quadrotor1d.yaml")
        assert (tmp_path / "curves.png").read_bytes().startswith(b"\x89PNG")
    (axes,) = figure.axes
    lines = [line for line in axes.lines if len(line.get_xdata()) == 40]
    thin, thick = lines[:3], lines[3]
    assert [line.get_ydata().tolist() for line in thin] == curves.columns["return"].T.tolist()
    assert thick.get_ydata().tolist() == np.median(curves.columns["return"], 1).tolist()
    assert thick.get_linewidth() > 2.0 * thin[0].get_linewidth()
    # two of three seeds have a bound, so the median is the smaller one of them
    (value,) = [line for line in axes.lines if line.get_label() == "V: median"]
    assert value.get_xdata().tolist() == [4, 8, 12, 16, 20, 24, 28, 32, 36, 40]
    assert set(value.get_ydata().tolist()) == {-1.5}


# Events ------------------------------------------------------------------------------------------


def shown(folder: Path) -> dict[str, list[tuple[int, float]]]:
    """What TensorBoard shows: its own reader, with its own rule for runs that begin again."""
    from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

    reader = EventAccumulator(str(folder))
    reader.Reload()
    return {tag: [(event.step, event.value) for event in reader.Scalars(tag)] for tag in reader.Tags()["scalars"]}


def test_tensorboard_shows_every_step_once_after_a_resume(tmp_path: Path) -> None:
    first = EventWriter(tmp_path / "events", (1, 2))
    for step in range(1, 7):
        first.add(step, {"return": np.array([step, math.nan]), "V": np.array([-0.5, -math.inf])})
    first.close()
    second = EventWriter(tmp_path / "events", (1, 2), completed=4)
    for step in range(5, 9):
        second.add(step, {"return": np.array([10.0 * step, math.nan])})
    second.close()
    found = shown(tmp_path / "events")
    assert found["return/1"] == [(1, 1), (2, 2), (3, 3), (4, 4), (5, 50), (6, 60), (7, 70), (8, 80)]
    assert set(found) == {"return/1", "V/1", "V/2"}


def test_events_load_little_of_tensorboard() -> None:
    code = (
        "import sys, tempfile; from setrl.train.events import EventWriter\n"
        "writer = EventWriter(tempfile.mkdtemp(), (1,)); writer.add(1, {'V': [1.0]}); writer.close()\n"
        "print([name for name in ('torch', 'tensorflow', 'werkzeug', 'pandas') if name in sys.modules])"
    )
    environment = {**os.environ, "PYTHONPATH": str(ROOT / ".src")}
    outcome = subprocess.run([sys.executable, "-c", code], env=environment, capture_output=True, text=True)
    assert outcome.stdout.strip() == "[]", outcome.stderr


def test_events_on_a_full_disk_or_without_a_folder_are_a_sentence(tmp_path: Path) -> None:
    writer = EventWriter(tmp_path, (1,))
    with full_disk(), pytest.raises(InputError, match="cannot write the events") as error:
        for step in range(1000):
            writer.add(step, {"V": np.ones(1)})
            writer.flush()
    refusal(error)
    with full_disk(), pytest.raises(InputError, match="cannot write the events"):
        writer.close()
    writer.close()
    with pytest.raises(InputError) as error:
        EventWriter(write(tmp_path / "file", "x") / "events", (1,))
    refusal(error)


# Progress ----------------------------------------------------------------------------------------


def test_progress_says_where_a_run_is() -> None:
    now, said = [0.0], list[tuple[float, str]]()
    shown = TrainingProgress(lambda share, text: said.append((share, text)), 1.0, 200, 100, clock=lambda: now[0])
    for episode in range(101, 151):
        now[0] += 0.5
        shown.advance(episode, np.array([-100.0, float(episode), 300.0]))
        if episode == 110:
            shown.validated(np.array([-7.0, -4.00001, -2.0]))
    assert len(said) == 25, "two episodes take a second"
    # the 20 episodes 131 to 150, of which the middle seed decides; V is a lower bound and is rounded down
    assert said[-1] == (0.75, "episode 150/200, return 140.5, V -4.001, 2 episodes/s, 0:25 left")
    assert "V" not in said[2][1]
    shown.begin(300, "step")
    now[0] += 10.0
    shown.validated(np.array([-math.inf, -math.inf, -2.0]))
    shown.advance(1)
    assert said[-1][1] == "step 1/300, V without a bound, 0.1 steps/s, 49:50 left"


def test_without_a_terminal_there_is_a_line_now_and_then(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(progress, "BETWEEN_LINES", 0.0)
    with training_progress(True, 10) as shown:
        shown.advance(3, np.array([1.0]))
    captured = capsys.readouterr()
    assert captured.err.startswith("episode 3/10, return 1, ") and captured.err.count("\n") == 1
    assert captured.out == ""
    with training_progress(False, 10) as shown:
        shown.advance(3, np.array([1.0]))
    assert capsys.readouterr().err == ""


def test_on_a_terminal_there_is_a_bar(monkeypatch: pytest.MonkeyPatch) -> None:
    class Terminal(io.StringIO):
        def isatty(self) -> bool:
            return True

    terminal = Terminal()
    monkeypatch.setattr(sys, "stderr", terminal)
    monkeypatch.setattr(progress, "_BETWEEN_UPDATES", 0.0)
    monkeypatch.setenv("TERM", "xterm")
    monkeypatch.setenv("COLUMNS", "120")
    with training_progress(True, 10) as shown:
        shown.advance(3, np.array([1.0]))
    assert "30.0 %" in terminal.getvalue() and "episode 3/10" in terminal.getvalue()


# Export ------------------------------------------------------------------------------------------

LAYOUT = Layout((2, 8, 1), True)


def network(seed: int = 0, dtype: torch.dtype = torch.float32) -> tuple[Layout, torch.Tensor]:
    return LAYOUT, initial_parameters(LAYOUT, [np.random.default_rng(seed)], dtype)[0]


def test_an_exported_policy_computes_what_torch_computes(tmp_path: Path) -> None:
    layout, row = network()
    policy = export_policy(tmp_path / "seed-0", layout, row, description="seed 0")
    assert policy.digest == read_policy(tmp_path / "seed-0" / "policy.onnx").digest
    assert (policy.inputs, policy.outputs, policy.precision) == (2, 1, "float32")
    stored_numbers = np.concatenate(
        [part.ravel() for layer in policy.layers if hasattr(layer, "weight") for part in (layer.weight, layer.bias)]
    )
    assert stored_numbers.tolist() == row.double().tolist()


@pytest.mark.parametrize("precision", ["float32", "float64"])
def test_parameters_of_a_float64_run_are_exported_in_either_precision(tmp_path: Path, precision: str) -> None:
    layout, row = network(1, torch.float64)
    assert export_policy(tmp_path, layout, row, precision=precision).precision == precision


def test_a_file_that_is_not_what_torch_has_is_not_exported(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    layout, row = network()
    monkeypatch.setattr(export, "layers_of", lambda layout, row: layers_of(layout, row + 1e-3))
    with pytest.raises(AssertionError, match="do not compute the same"):
        export_policy(tmp_path, layout, row)


@pytest.mark.parametrize("parameter", range(33))
def test_one_wrong_parameter_in_the_file_is_noticed(tmp_path: Path, parameter: int) -> None:
    layout, row = network()
    policy = export_policy(tmp_path, layout, row)
    changed = row.clone()
    changed[parameter] += 1e-3
    with pytest.raises(AssertionError, match="do not compute the same"):
        require_same_network(policy, layout, changed)


def test_a_diverged_network_is_a_sentence(tmp_path: Path) -> None:
    layout, row = network()
    row[3] = math.nan
    with pytest.raises(PolicyError, match="diverged"):
        export_policy(tmp_path, layout, row)


def test_a_report_holds_the_verdict_and_a_certificate_that_the_checker_accepts(tmp_path: Path) -> None:
    run = created(tmp_path)
    layout, row = network()
    folder = run.seed(7)
    policy = export_policy(folder, layout, row)
    result = report_policy(folder, run.specification, options=Options(splits=4))
    assert (folder / "report.txt").read_text().startswith("VERIFIED: no trajectory of plant quadrotor1d")
    data = json.loads((folder / "report.json").read_text())
    assert (data["verdict"], data["certificate"]["path"]) == ("VERIFIED", "policy.cert")
    assert data["subject"]["policy"]["sha256"] == policy.digest
    assert data["subject"]["specification"]["sha256"] == run.configuration["specification"]["sha256"]
    answer = check(
        (folder / "policy.cert").read_bytes(), policy.content, (tmp_path / "given" / "spec.yaml").read_bytes()
    )
    assert isinstance(answer, Accepted), "of the specification that was given, not only of the copy"
    assert result.certificate == (folder / "policy.cert").read_bytes()


def test_a_new_policy_never_lies_beside_the_report_of_another(tmp_path: Path) -> None:
    run = created(tmp_path)
    folder = run.seed(0)
    export_policy(folder, *network())
    report_policy(folder, run.specification)
    assert (folder / "policy.cert").exists()
    export_policy(folder, *network(1))
    assert sorted(files(folder)) == ["policy.onnx"]
    narrow = write(tmp_path / "narrow.yaml", SPECIFICATION.replace("[-5, 5]", "[-0.05, 0.05]"))
    for _ in range(2):
        report_policy(folder, narrow)
        assert sorted(files(folder)) == ["policy.onnx", "report.json", "report.txt"]
        assert not (folder / "report.txt").read_text().startswith("VERIFIED")
        report_policy(folder, run.specification)
        assert (folder / "policy.cert").exists()


def test_the_best_seed_is_the_one_of_the_largest_bound() -> None:
    assert best_seed({3: -5.0, 4: -2.0, 5: -2.0}) == 4
    assert best_seed({3: math.nan, 4: -math.inf, 5: -1e9}) == 5
    assert best_seed({3: math.nan, 4: -math.inf}) == 3


def test_the_best_policy_is_published_at_the_top(tmp_path: Path) -> None:
    run = created(tmp_path)
    policies = {seed: export_policy(run.seed(seed), *network(seed)) for seed in (0, 1)}
    assert publish_best(run, {0: -math.inf, 1: -3.0}, {"epsilon": 0.1}) == 1
    assert read_policy(run.policy).digest == policies[1].digest
    assert json.loads(run.summary.read_text()) == {
        "best_seed": 1,
        "policy": "seed-1/policy.onnx",
        "values": {"0": None, "1": -3.0},
        "epsilon": 0.1,
    }
