"""Tasks in worker processes: a process that is lost costs its task, is named for what it was, and nothing else."""

from __future__ import annotations

import os
import pickle
import signal
import subprocess
import sys
import textwrap
import time
from collections.abc import Iterator
from pathlib import Path

import executor_tasks
import pytest
from executor_cases import LOST, MIB, gone, outcomes, task, within

from setrl.specs.errors import UsageError
from setrl.verify.executors.choice import executor_of
from setrl.verify.executors.local import LocalExecutor
from setrl.verify.executors.parcel import Parcel
from setrl.verify.executors.pipes import ClosedError, LateError, receive, send
from setrl.verify.executors.process import WorkerProcess, search_path
from setrl.verify.executors.task import Answer, Broken, Lost, Refused, Task, TaskOutcome

TESTS = str(Path(__file__).parent)


@pytest.fixture(scope="module")
def executor() -> Iterator[LocalExecutor]:
    with LocalExecutor(2) as found:
        yield found


@pytest.fixture(scope="module")
def batch() -> dict[str, TaskOutcome]:
    """Outcomes of every loss, and of a task that answers between any two of them."""
    tasks, names = [], []
    for number, (name, (loss, _)) in enumerate(LOST.items()):
        names += [name, f"answer {number}"]
        tasks += [loss, task(executor_tasks.double, number)]
    with LocalExecutor(2) as found:
        return dict(zip(names, outcomes(found, tasks), strict=True))


@pytest.mark.parametrize("name", LOST)
def test_a_lost_task_is_named_for_what_it_needed(name: str, batch: dict[str, TaskOutcome]) -> None:
    outcome, expected = batch[name], LOST[name][1]
    assert isinstance(outcome, Lost)
    assert (outcome.kind, outcome.sentence) == (expected.kind, expected.sentence)
    assert 0 <= outcome.seconds < 5


def test_the_other_tasks_of_the_batch_answer(batch: dict[str, TaskOutcome]) -> None:
    for number in range(len(LOST)):
        outcome = batch[f"answer {number}"]
        assert isinstance(outcome, Answer) and outcome.value == 2 * number


def test_a_task_may_hold_memory_up_to_its_limit_and_the_next_one_has_its_own(executor: LocalExecutor) -> None:
    enough = [task(executor_tasks.hold, 150, memory=300 * MIB), task(executor_tasks.hold, 400)] * 2
    assert [found.value for found in outcomes(executor, enough) if isinstance(found, Answer)] == [150, 400, 150, 400]


def test_wrong_input_is_refused_in_one_line_and_the_process_goes_on() -> None:
    with LocalExecutor() as found:
        before, refused, after = outcomes(
            found, [task(executor_tasks.pid), task(executor_tasks.refuse), task(executor_tasks.pid)]
        )
    assert isinstance(refused, Refused)
    assert refused.sentence == "p.onnx: an input of two numbers is needed (give it one)"
    assert isinstance(before, Answer) and isinstance(after, Answer) and before.value == after.value


def test_anything_else_that_is_raised_is_broken_with_its_traceback(executor: LocalExecutor) -> None:
    violated, mute, missing, nowhere = outcomes(
        executor,
        [
            task(executor_tasks.violate),
            task(executor_tasks.raise_mute),
            Task("executor_tasks:no_such_function", None),
            Task("no_such_module:function", None),
        ],
    )
    assert isinstance(violated, Broken) and isinstance(mute, Broken)
    assert violated.sentence == "AssertionError: lower bound above upper bound"
    assert "in violate" in violated.traceback
    assert mute.sentence.startswith("_MuteError: ") and "in raise_mute" in mute.traceback
    assert isinstance(missing, Broken) and "no_such_function" in missing.sentence
    assert isinstance(nowhere, Broken) and "no_such_module" in nowhere.sentence


def test_nothing_of_a_broken_process_is_left_for_the_next_task() -> None:
    with LocalExecutor() as found:
        counts = outcomes(found, [task(executor_tasks.count, fail) for fail in (False, False, True, False)])
    assert [answer.value for answer in counts if isinstance(answer, Answer)] == [1, 2, 1]


def test_what_does_not_pickle_is_raised_where_it_is_given_and_broken_where_it_is_returned(
    executor: LocalExecutor,
) -> None:
    with pytest.raises((pickle.PicklingError, AttributeError, TypeError)):
        executor.submit(task(executor_tasks.double, lambda: None))
    found = outcomes(executor, [task(executor_tasks.local_function), task(executor_tasks.unknown_here)])
    given = outcomes(executor, [task(executor_tasks.double, executor_tasks.Unreadable())])
    for outcome in found + given:
        assert isinstance(outcome, Broken)
    assert "only_there" in found[1].sentence  # type: ignore[union-attr]


def test_an_argument_is_taken_as_it_is_when_it_is_submitted(executor: LocalExecutor) -> None:
    argument = [1]
    executor.submit(task(executor_tasks.double, argument))
    argument.append(2)
    [(_, outcome)] = executor.wait(10)
    assert isinstance(outcome, Answer) and outcome.value == [1, 1]


def test_tasks_start_in_the_order_of_submission() -> None:
    with LocalExecutor(1) as found:
        answers = outcomes(found, [task(executor_tasks.started, os.devnull) for _ in range(20)])
    times = [answer.value for answer in answers if isinstance(answer, Answer)]
    assert len(times) == 20 and times == sorted(times)


def test_wait_returns_with_the_first_outcome_and_tasks_are_added_while_others_run() -> None:
    with LocalExecutor(2) as found:
        assert found.wait(10) == []
        slow = found.submit(task(executor_tasks.sleep, 30))
        first = found.submit(task(executor_tasks.double, 1))
        assert (slow, first) == (0, 1)
        start = time.monotonic()
        assert [number for number, _ in found.wait(20)] == [first]
        [(number, since)] = found.running()
        assert number == slow and 0 < since < 20
        second = found.submit(task(executor_tasks.double, 2))
        assert [number for number, _ in found.wait(20)] == [second]
        assert time.monotonic() - start < 5
        assert found.wait(0.05) == []


def test_two_hundred_tasks_on_two_workers_answer_once_each(executor: LocalExecutor) -> None:
    found = outcomes(executor, [task(executor_tasks.double, number) for number in range(200)])
    assert [answer.value for answer in found if isinstance(answer, Answer)] == [2 * number for number in range(200)]


def test_what_a_task_prints_goes_to_stderr_before_it_answers(
    capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delenv("PYTHONUNBUFFERED", raising=False)
    with LocalExecutor() as found:
        [outcome] = outcomes(found, [task(executor_tasks.chatter, "hello")])
    assert isinstance(outcome, Answer) and outcome.value == "hello"
    said = capfd.readouterr()
    assert said.out == ""
    assert [line for line in said.err.splitlines() if line.startswith("hello")] == ["hello", "hello 1", "hello child"]


def test_large_arguments_and_answers_travel_whole(executor: LocalExecutor) -> None:
    size = 50_000_000
    answer, length = outcomes(
        executor, [task(executor_tasks.blob, size), task(executor_tasks.size, executor_tasks.blob(size))]
    )
    assert isinstance(answer, Answer) and answer.value == executor_tasks.blob(size)
    assert isinstance(length, Answer) and length.value == size


def test_a_worker_is_bare_has_one_thread_for_products_and_a_session_of_its_own(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.delenv("OMP_NUM_THREADS", raising=False)
    with LocalExecutor() as found:
        [outcome] = outcomes(found, [task(executor_tasks.environment)])
    assert isinstance(outcome, Answer)
    threads, modules, own_session = outcome.value
    assert threads == "1" and own_session
    assert not {"numpy", "onnx", "scipy", "pydantic"} & set(modules)


def test_an_interrupt_is_not_for_the_workers(executor: LocalExecutor) -> None:
    [outcome] = outcomes(executor, [task(executor_tasks.interrupted)])
    assert isinstance(outcome, Answer) and outcome.value == "went on"


def test_what_lies_in_the_current_folder_is_not_imported_and_what_the_path_names_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("here", "there", "elsewhere"):
        (tmp_path / name).mkdir()
        (tmp_path / name / "whereabouts.py").write_text(f"PLACE = {name!r}\n")
    (tmp_path / "here" / "pickle.py").write_text("raise RuntimeError('the wrong module')\n")
    monkeypatch.chdir(tmp_path / "here")
    monkeypatch.setattr(sys, "path", ["", *sys.path])
    without = LocalExecutor()
    monkeypatch.setattr(sys, "path", [str(tmp_path / "elsewhere"), *sys.path])
    with_path = LocalExecutor(path=["../there"])
    (tmp_path / "here" / "below").mkdir()
    monkeypatch.chdir("below")  # a path is meant as it was when it was given
    with without, with_path:
        [missing] = outcomes(without, [task(executor_tasks.where)])
        [found] = outcomes(with_path, [task(executor_tasks.where)])
    assert isinstance(missing, Broken) and "whereabouts" in missing.sentence
    assert isinstance(found, Answer) and found.value == "there"


def test_in_the_current_folder_no_module_is_replaced(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    (tmp_path / "pickle.py").write_text("raise RuntimeError('the wrong module')\n")
    monkeypatch.chdir(tmp_path)
    with LocalExecutor() as found:
        assert isinstance(outcomes(found, [task(executor_tasks.double, 1)])[0], Answer)


def test_leaving_ends_everything_at_once(tmp_path: Path) -> None:
    with LocalExecutor(2):
        pass
    names = [tmp_path / "one", tmp_path / "two"]
    with LocalExecutor(2) as found:
        found.submit(task(executor_tasks.name_and, (str(names[0]), 60)))
        found.submit(task(executor_tasks.name_and, (str(names[1]), 0)))
        for _ in range(5):
            found.submit(task(executor_tasks.sleep, 60))
        assert within(10, lambda: all(name.exists() for name in names))
        start = time.monotonic()
    assert time.monotonic() - start < 1
    assert all(not Path(f"/proc/{name.read_text()}").exists() for name in names)
    assert found.wait(30) == []
    assert time.monotonic() - start < 2
    with pytest.raises(RuntimeError):
        found.submit(task(executor_tasks.sleep, 60))


def test_a_task_that_is_killed_takes_the_processes_along_that_it_started(tmp_path: Path) -> None:
    name = tmp_path / "child"
    with LocalExecutor() as found:
        [outcome] = outcomes(found, [task(executor_tasks.child_of_task, str(name), seconds=0.5)])
    assert isinstance(outcome, Lost) and outcome.kind == "time"
    assert within(2, lambda: gone(int(name.read_text())))


def test_a_process_that_ends_is_noticed_while_a_copy_of_it_holds_its_pipes(tmp_path: Path) -> None:
    name = tmp_path / "copy"
    with LocalExecutor() as found:
        [outcome] = outcomes(found, [task(executor_tasks.orphan, str(name))])
    assert outcome == Lost("exit", "ended with exit code 4 before it answered", outcome.seconds)
    assert outcome.seconds < 5
    assert within(2, lambda: gone(int(name.read_text())))


@pytest.mark.parametrize("wait", [0.0, 0.2], ids=["at once", "later"])
def test_a_worker_that_dies_between_two_tasks_costs_none(wait: float) -> None:
    with LocalExecutor() as found:
        [last] = outcomes(found, [task(executor_tasks.pid)])
        for _ in range(5):
            assert isinstance(last, Answer)
            killed = last.value
            os.kill(killed, signal.SIGKILL)
            time.sleep(wait)
            [last] = outcomes(found, [task(executor_tasks.pid)])
            assert isinstance(last, Answer) and last.value != killed


def test_workers_that_cannot_begin_are_lost_and_not_started_forever(tmp_path: Path) -> None:
    (tmp_path / "setrl.py").write_text("raise SystemExit(7)\n")
    with LocalExecutor(path=[str(tmp_path)]) as found:
        [outcome] = outcomes(found, [task(executor_tasks.double, 1)])
    assert outcome == Lost("exit", "ended with exit code 7 before it answered", outcome.seconds)


def test_a_process_that_cannot_be_started_is_a_loss(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sys, "executable", "/no/such/python")
    with LocalExecutor() as found:
        [outcome] = outcomes(found, [task(executor_tasks.double, 1)])
    assert outcome == Lost("exit", "its process could not be started: No such file or directory")


def test_neither_processes_nor_descriptors_are_left_behind() -> None:
    def descriptors() -> set[str]:
        return set(os.listdir("/proc/self/fd"))

    def children() -> set[str]:
        return set(Path(f"/proc/self/task/{os.getpid()}/children").read_text().split())

    losses = [loss for loss, _ in LOST.values()][-5:]
    before = descriptors(), children()
    with LocalExecutor(2) as found:
        outcomes(found, [one for loss in losses for one in (loss, *[task(executor_tasks.double, 1)] * 3)])
        assert len(descriptors()) <= len(before[0]) + 2 * found.workers
    assert (descriptors(), children()) == before


PARENT = """
import sys
from setrl.verify.executors.local import LocalExecutor
from setrl.verify.executors.task import Task

if __name__ == "__main__":
    with LocalExecutor(2, path=[sys.argv[1]]) as found:
        found.submit(Task("executor_tasks:name_and", (sys.argv[2], 60)))
        found.submit(Task("executor_tasks:name_and", (sys.argv[3], 0)))
        found.wait(60)
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT], ids=["SIGKILL", "SIGINT"])
def test_workers_end_with_a_parent_that_is_killed_or_interrupted(tmp_path: Path, number: int) -> None:
    names = [tmp_path / "sleeps", tmp_path / "computes"]
    parent = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(PARENT), TESTS, *map(str, names)],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)},
        stderr=subprocess.DEVNULL,
    )
    try:
        assert within(20, lambda: all(name.exists() for name in names))
        workers = [int(name.read_text()) for name in names]
        assert not any(gone(worker) for worker in workers)
        parent.send_signal(number)
        assert within(2, lambda: all(gone(worker) for worker in workers))
    finally:
        parent.kill()
        parent.wait()
        for name in names:  # where the test has failed
            if name.exists() and not gone(int(name.read_text())):
                os.kill(int(name.read_text()), signal.SIGKILL)


def test_a_worker_ends_when_its_pipe_closes_with_the_processes_that_its_task_started(tmp_path: Path) -> None:
    """Where the kernel does not end a process with its parent, the pipe does."""
    name = tmp_path / "child"
    process = WorkerProcess(search_path([TESTS]))
    parcel = Parcel("executor_tasks:child_of_task", pickle.dumps(str(name)))
    send(process._tasks, pickle.dumps(parcel))
    assert within(10, name.exists)
    os.close(process._tasks)
    process._tasks = os.open(os.devnull, os.O_RDONLY)
    assert within(2, lambda: not process.lives() and gone(int(name.read_text())))
    process.close()


@pytest.mark.parametrize("orphan", [False, True], ids=["its pipe closes", "its parent ended before it could ask"])
def test_a_worker_that_shares_its_session_ends_alone(orphan: bool) -> None:
    inbox, tasks = os.pipe()
    worker = subprocess.Popen(
        [
            sys.executable,
            "-P",
            "-m",
            "setrl.verify.executors.worker",
            str(inbox),
            "2",
            str(1 if orphan else os.getpid()),
        ],
        env={**os.environ, "PYTHONPATH": os.pathsep.join(search_path())},
        pass_fds=(inbox,),
    )
    os.close(inbox)
    if not orphan:
        os.close(tasks)
    assert worker.wait(5) == 1
    if orphan:
        os.close(tasks)


def test_a_message_that_does_not_arrive_is_late_or_closed() -> None:
    source, sink = os.pipe()
    with pytest.raises(LateError):
        receive(source, time.monotonic() + 0.05)
    send(sink, b"whole")
    assert receive(source) == b"whole"
    os.write(sink, (9).to_bytes(8, "big") + b"half")
    with pytest.raises(ClosedError):
        receive(source, lives=lambda: False)
    os.close(sink)
    with pytest.raises(ClosedError):
        receive(source)
    os.close(source)


def test_a_full_pipe_does_not_keep_the_sender_beyond_its_time() -> None:
    source, sink = os.pipe()
    os.set_blocking(sink, False)
    start = time.monotonic()
    with pytest.raises(LateError):
        send(sink, bytes(MIB), start + 0.1)
    assert time.monotonic() - start < 2
    os.close(source)
    with pytest.raises(ClosedError):
        send(sink, b"nobody reads")
    os.close(sink)


def test_the_executor_is_chosen_by_name_and_has_a_worker_per_processor() -> None:
    with executor_of("local", None) as found:
        assert found.workers == len(os.sched_getaffinity(0))
    with executor_of("local", 3) as found:
        assert found.workers == 3
    for kind, workers in (("cloud", None), ("local", 0)):
        with pytest.raises(UsageError):
            executor_of(kind, workers)
