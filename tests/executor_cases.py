"""Tasks that are lost and what is to be said of them; waiting for outcomes and processes. For any executor."""

from __future__ import annotations

import signal
import time
from pathlib import Path
from typing import Any

import executor_tasks

from setrl.verify.executors.task import Executor, Lost, Task, TaskOutcome

MIB = 2**20


def task(function: Any, argument: Any = None, **limits: Any) -> Task:
    return Task(f"executor_tasks:{function.__name__}", argument, **limits)


def outcomes(executor: Executor, tasks: list[Task]) -> list[TaskOutcome]:
    """In the order of the tasks."""
    numbers = [executor.submit(one) for one in tasks]
    found: dict[int, TaskOutcome] = {}
    end = time.monotonic() + 60
    while len(found) < len(numbers) and time.monotonic() < end:
        for number, outcome in executor.wait(10):
            assert number not in found
            found[number] = outcome
    return [found[number] for number in numbers]


def gone(pid: int) -> bool:
    """Whether a process has ended; nobody may have asked for its exit code."""
    try:
        return Path(f"/proc/{pid}/stat").read_text().rsplit(")", 1)[1].split()[0] == "Z"
    except (FileNotFoundError, ProcessLookupError):
        return True


def within(seconds: float, condition: Any) -> bool:
    end = time.monotonic() + seconds
    while not condition():
        if time.monotonic() > end:
            return False
        time.sleep(0.01)
    return True


def descendants(parent: int) -> set[int]:
    """Processes that a process has started, and those that they have started."""
    children = {
        int(child)
        for thread in Path(f"/proc/{parent}/task").iterdir()
        for child in (thread / "children").read_text().split()
    }
    return children.union(*(descendants(child) for child in children if Path(f"/proc/{child}").exists()))


LOST = {
    "time": (
        task(executor_tasks.sleep, 60, seconds=0.3),
        Lost("time", "did not end within 0.3 s and was killed"),
    ),
    "time, while no other thread of the process runs": (
        task(executor_tasks.never_yields, seconds=0.3),
        Lost("time", "did not end within 0.3 s and was killed"),
    ),
    "memory": (
        task(executor_tasks.hold, 400, memory=200 * MIB),
        Lost("memory", "needed more than 200 MiB of memory"),
    ),
    "memory of an array": (
        task(executor_tasks.hold_array, 4000, memory=3 * 2**30),
        Lost("memory", "needed more than 3.0 GiB of memory"),
    ),
    "memory, called wrong input": (
        task(executor_tasks.hold_and_blame_the_input, 400, memory=200 * MIB),
        Lost("memory", "needed more than 200 MiB of memory"),
    ),
    "memory, in the words of a library": (
        task(executor_tasks.library_out_of_memory, memory=200 * MIB),
        Lost("memory", "needed more than 200 MiB of memory"),
    ),
    "memory, before the function is called": (
        task(executor_tasks.size, bytes(50 * MIB), memory=40 * MIB),
        Lost("memory", "needed more than 40 MiB of memory"),
    ),
    "SIGKILL": (task(executor_tasks.killed, signal.SIGKILL), Lost("signal", "was killed by SIGKILL")),
    "SIGSEGV": (task(executor_tasks.killed, signal.SIGSEGV), Lost("signal", "was killed by SIGSEGV")),
    "a signal without a name": (
        task(executor_tasks.killed, signal.SIGRTMIN + 3),
        Lost("signal", f"was killed by signal {signal.SIGRTMIN + 3}"),
    ),
    "exit": (task(executor_tasks.leave, 3), Lost("exit", "ended with exit code 3 before it answered")),
    "exit without a code": (task(executor_tasks.leave), Lost("exit", "ended with exit code 0 before it answered")),
    "exit with a text": (task(executor_tasks.leave, "no"), Lost("exit", "ended with exit code 1 before it answered")),
    "exit while a thread goes on": (
        task(executor_tasks.leave_with_thread, 5),
        Lost("exit", "ended with exit code 5 before it answered"),
    ),
}
