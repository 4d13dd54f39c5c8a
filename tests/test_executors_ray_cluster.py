"""Tasks on a cluster of Ray that somebody else has started."""

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
from executor_cases import descendants, gone, outcomes, task, within

from setrl.specs.errors import UsageError
from setrl.verify.executors.choice import executor_of
from setrl.verify.executors.ray_cluster import RayExecutor
from setrl.verify.executors.task import Answer, Task

pytest.importorskip("ray", reason="ray is the extra `ray`")
TESTS = str(Path(__file__).parent)


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
    monkeypatch.setattr("setrl.verify.executors.ray_cluster.__version__", "0.0.9")
    with pytest.raises(UsageError, match=r"setrl 0\.0\.9 is needed .* has setrl 0\.1\.0"):
        with executor_of("ray", None):
            pass
    monkeypatch.undo()
    with RayExecutor(address=foreign, path=[TESTS]) as found:
        assert isinstance(outcomes(found, [Task("math:sqrt", 4.0)])[0], Answer)


@pytest.mark.parametrize("address", ["127.0.0.1:1", "ray://127.0.0.1:1", "nowhere.invalid:6379"])
def test_an_address_without_a_cluster_is_refused_at_once(address: str) -> None:
    start = time.monotonic()
    with pytest.raises(UsageError, match=f"no cluster to be used at {address}"):
        with RayExecutor(address=address):
            pass
    assert time.monotonic() - start < 10
