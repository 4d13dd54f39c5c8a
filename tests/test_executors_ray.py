"""Tasks on a cluster of Ray: outcomes mean what they mean on this machine, and what the cluster loses is done again."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import executor_tasks
import pytest
from executor_cases import LOST, MIB, gone, outcomes, task, within

from setrl.specs.errors import UsageError
from setrl.verify.executors.choice import executor_of
from setrl.verify.executors.ray_cluster import RayExecutor
from setrl.verify.executors.task import Answer, Broken, Lost, Refused, Task

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


def descendants(parent: int) -> set[int]:
    children = {
        int(child)
        for thread in Path(f"/proc/{parent}/task").iterdir()
        for child in (thread / "children").read_text().split()
    }
    return children.union(*(descendants(child) for child in children if Path(f"/proc/{child}").exists()))


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


def test_tasks_whose_process_of_ray_is_killed_answer_all_the_same(cluster: RayExecutor, tmp_path: Path) -> None:
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


@pytest.mark.slow
def test_a_task_that_costs_the_cluster_every_process_is_lost(cluster: RayExecutor) -> None:
    lost, other = outcomes(cluster, [task(executor_tasks.kill_parent), task(executor_tasks.double, 1)])
    assert isinstance(other, Answer) and other.value == 2
    assert isinstance(lost, Lost) and lost.kind == "cluster"
    assert lost.sentence == "was lost with its process 4 times (WorkerCrashedError)"


def test_leaving_ends_what_runs_and_the_cluster(cluster: RayExecutor, tmp_path: Path) -> None:
    """The last test of this module: no other one can use the cluster afterwards."""
    import ray

    names = [tmp_path / "one", tmp_path / "two"]
    for name, seconds in zip(names, (60, 0), strict=True):
        cluster.submit(task(executor_tasks.name_and, (str(name), seconds)))
    cluster.submit(task(executor_tasks.sleep, 60))
    assert within(20, lambda: all(name.exists() for name in names))
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


@pytest.fixture
def foreign(tmp_path: Path) -> Iterator[str]:
    """Address of a cluster that somebody else has started, where setrl can be imported."""
    ray, port = Path(sys.executable).with_name("ray"), 26379
    if not ray.exists():
        pytest.skip(f"there is no {ray}")
    environment = {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(path for path in sys.path if path),
        "RAY_USAGE_STATS_ENABLED": "0",
    }
    command = [str(ray), "start", "--head", f"--port={port}", "--num-cpus=1", "--include-dashboard=false", "--block"]
    head = subprocess.Popen(
        [*command, "--node-ip-address=127.0.0.1", "--disable-usage-stats"],
        env=environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.DEVNULL,
        cwd=tmp_path,
    )
    try:
        time.sleep(8)
        yield f"127.0.0.1:{port}"
    finally:
        processes = descendants(head.pid)
        head.terminate()
        try:
            head.wait(20)
        except subprocess.TimeoutExpired:
            head.kill()
            head.wait()
        for process in processes:
            if not gone(process):
                os.kill(process, signal.SIGKILL)


@pytest.mark.slow
def test_a_cluster_that_exists_is_used_where_it_has_the_same_setrl_and_goes_on_afterwards(
    foreign: str, monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    name = tmp_path / "process"
    with RayExecutor(address=foreign, path=[TESTS]) as found:
        assert found.workers == 1
        [outcome] = outcomes(found, [task(executor_tasks.double, 4)])
        assert isinstance(outcome, Answer) and outcome.value == 8
        found.submit(task(executor_tasks.name_and, (str(name), 60)))
        assert within(20, name.exists)
    assert within(10, lambda: gone(int(name.read_text())))
    monkeypatch.setenv("RAY_ADDRESS", foreign)
    with pytest.raises(UsageError, match="as many workers as it has processors"):
        executor_of("ray", 2)
    monkeypatch.setattr("setrl.verify.executors.ray_cluster.__version__", "0.0.9")
    with pytest.raises(UsageError, match=r"setrl 0\.0\.9 is needed .* has setrl 0\.1\.0"):
        with executor_of("ray", None):
            pass
    monkeypatch.undo()
    with RayExecutor(address=foreign, path=[TESTS]) as found:
        assert isinstance(outcomes(found, [Task("math:sqrt", 4.0)])[0], Answer)


@pytest.mark.slow
def test_an_address_without_a_cluster_is_refused() -> None:
    with pytest.raises(UsageError, match="no cluster"):
        with RayExecutor(address="127.0.0.1:1"):
            pass


def test_without_ray_the_remedy_is_to_install_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "ray", None)
    with pytest.raises(UsageError, match=r"pip install 'setrl\[ray\]'") as caught:
        with executor_of("ray", 1):
            pass
    assert caught.value.remedy


def test_workers_are_counted_from_one() -> None:
    with pytest.raises(UsageError, match="at least one worker"):
        RayExecutor(0)
