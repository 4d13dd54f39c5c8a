"""Tasks on a cluster of Ray: outcomes mean what they mean on this machine, and what the cluster loses is done again."""

from __future__ import annotations

import os
import signal
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import executor_tasks
import pytest
from executor_cases import LOST, MIB, descendants, gone, outcomes, task, within

from setrl.specs.errors import UsageError
from setrl.verify.executors.choice import executor_of
from setrl.verify.executors.ray_cluster import RayExecutor
from setrl.verify.executors.task import Answer, Broken, Lost, Refused

pytest.importorskip("ray", reason="ray is the extra `ray`")
TESTS = str(Path(__file__).parent)


@pytest.fixture(autouse=True)
def no_other_cluster(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("RAY_ADDRESS", raising=False)


@pytest.fixture(scope="module")
def cluster() -> Iterator[RayExecutor]:
    """A cluster on this machine, with two workers."""
    with pytest.MonkeyPatch.context() as patch:
        patch.delenv("RAY_ADDRESS", raising=False)
        with RayExecutor(2, path=[TESTS]) as found:
            yield found


KINDS = ("time", "memory", "SIGKILL", "exit")


def test_outcomes_are_the_same_as_on_this_machine(cluster: RayExecutor) -> None:
    assert cluster.workers == 2
    *lost, answer, refused, broken, unpicklable, unreadable = outcomes(
        cluster,
        [
            *(LOST[kind][0] for kind in KINDS),
            task(executor_tasks.blob, 5 * MIB),
            task(executor_tasks.refuse),
            task(executor_tasks.violate),
            task(executor_tasks.local_function),
            task(executor_tasks.unknown_here),
        ],
    )
    for kind, outcome in zip(KINDS, lost, strict=True):
        assert isinstance(outcome, Lost)
        assert (outcome.kind, outcome.sentence) == (LOST[kind][1].kind, LOST[kind][1].sentence)
    assert isinstance(answer, Answer) and answer.value == executor_tasks.blob(5 * MIB)
    assert isinstance(refused, Refused)
    assert refused.sentence == "p.onnx: an input of two numbers is needed (give it one)"
    assert isinstance(broken, Broken) and "in violate" in broken.traceback
    assert broken.sentence == "AssertionError: lower bound above upper bound"
    assert isinstance(unpicklable, Broken) and isinstance(unreadable, Broken)


def test_wait_returns_with_the_first_outcome(cluster: RayExecutor) -> None:
    slow = cluster.submit(task(executor_tasks.sleep, 2))
    quick = cluster.submit(task(executor_tasks.double, 1))
    assert [number for number, _ in cluster.running()] == [slow, quick]
    assert [number for number, _ in cluster.wait(20)] == [quick]
    assert [number for number, _ in cluster.running()] == [slow]
    assert cluster.wait(0) == []
    assert [number for number, _ in cluster.wait(20)] == [slow]


def test_tasks_whose_process_of_ray_is_killed_answer_all_the_same(
    cluster: RayExecutor, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    name = tmp_path / "process"
    first = cluster.submit(task(executor_tasks.first_try_sleeps, str(name), name="first"))
    others = [cluster.submit(task(executor_tasks.double, number)) for number in range(20)]
    assert within(20, name.exists)
    assert first in dict(cluster.running())
    killed = int(name.read_text())
    os.kill(killed, signal.SIGKILL)
    found: dict[int, object] = {}
    end = time.monotonic() + 60
    while len(found) < 21 and time.monotonic() < end:
        found |= {number: outcome.value for number, outcome in cluster.wait(10) if isinstance(outcome, Answer)}
    assert [found[number] for number in others] == [2 * number for number in range(20)]
    assert found[first] != killed
    assert cluster.running() == [] and cluster.wait(10) == []
    assert capfd.readouterr().out == ""


@pytest.mark.slow
def test_a_task_that_costs_the_cluster_every_process_is_lost(cluster: RayExecutor) -> None:
    lost, other = outcomes(cluster, [task(executor_tasks.kill_parent), task(executor_tasks.double, 1)])
    assert isinstance(other, Answer) and other.value == 2
    assert isinstance(lost, Lost) and lost.kind == "cluster"
    assert lost.sentence == "was lost with its process 4 times (WorkerCrashedError)"


def test_leaving_ends_what_runs_and_the_cluster(
    cluster: RayExecutor, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    """The last test of this module: no other one can use the cluster afterwards."""
    import ray

    names = [tmp_path / "one", tmp_path / "two"]
    for name, seconds in zip(names, (60, 0), strict=True):
        cluster.submit(task(executor_tasks.name_and, (str(name), seconds)))
    cluster.submit(task(executor_tasks.sleep, 60))
    assert within(20, lambda: all(name.exists() for name in names))
    with pytest.raises(UsageError, match="connected to a cluster already"), RayExecutor(1):
        pass
    processes = descendants(os.getpid())
    assert {int(name.read_text()) for name in names} <= processes
    start = time.monotonic()
    cluster.__exit__(None, None, None)
    assert time.monotonic() - start < 10
    assert not ray.is_initialized()
    assert within(5, lambda: all(gone(process) for process in processes))
    assert cluster.wait(1) == [] and cluster.running() == []
    with pytest.raises(RuntimeError):
        cluster.submit(task(executor_tasks.sleep, 60))
    assert capfd.readouterr().out == ""


def test_without_ray_the_remedy_is_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"pip install 'setrl\[ray\]'") as caught:
        with executor_of("ray", 1):
            pass
    assert caught.value.remedy


def test_a_cluster_that_exists_has_its_own_number_of_workers(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("RAY_ADDRESS", "127.0.0.1:1")
    with pytest.raises(UsageError, match="as many workers as it has processors"):
        executor_of("ray", 2)


def test_workers_are_counted_from_one() -> None:
    with pytest.raises(UsageError, match="at least one worker"):
        RayExecutor(0)
