"""Leaves of one certificate, checked side by side in processes of their own.

The processes are started from this module by name, never by copying or importing the caller's program; they read the
policy and the specification from the same bytes as the caller.
"""

from __future__ import annotations

import os
import pickle
import subprocess
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeAlias

from ...specs.errors import InputError
from .certificate_file import Header, unpacked
from .cover import Box
from .leaf import read_leaf
from .obligations import Found, check_leaf
from .rejection import Rejected

Task: TypeAlias = tuple[bytes, bytes, Box]
"""Floats and whole numbers of a leaf, and the box it is responsible for."""

POLL = 0.2
"""Seconds between two questions whether time is up."""


@dataclass(frozen=True)
class Setup:
    """What every process has to know first."""

    header: Header
    policy: bytes
    specification: bytes
    folder: Path | None


def check_in_processes(
    setup: Setup, tasks: Sequence[Task], workers: int, stop: Callable[[], bool] | None = None
) -> Iterator[Found | str]:
    """Answers in the order of the tasks; a text says why a leaf was rejected. Ends early where time is up.

    Parameters
    ----------
    setup : Setup
    tasks : sequence of Task
    workers : int
    stop : callable, optional

    Raises
    ------
    RuntimeError
        A process ended without an answer.
    """
    pool = _Pool(setup, tasks, min(workers, len(tasks)))
    try:
        for number in range(len(tasks)):
            while not pool.ready(number):
                if stop is not None and stop():
                    return
            yield pool.answers[number]
    finally:
        pool.close()


class _Pool:
    def __init__(self, setup: Setup, tasks: Sequence[Task], workers: int) -> None:
        self.tasks = tasks
        self.answers: dict[int, Any] = {}
        self.news = threading.Condition()
        self.next = 0
        self.problem = ""
        environment = {**os.environ, "PYTHONPATH": os.pathsep.join(path for path in sys.path if path)}
        # -P: nothing that lies in the folder where the caller happens to be takes the place of a module
        command = [sys.executable, "-P", "-m", __name__]
        self.processes = [
            # a session of its own: an interrupt is for the caller, who then ends the processes
            subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, env=environment, start_new_session=True
            )
            for _ in range(workers)
        ]
        self.threads = [
            threading.Thread(target=self._serve, args=(process, setup), daemon=True) for process in self.processes
        ]
        for thread in self.threads:
            thread.start()

    def _serve(self, process: Any, setup: Setup) -> None:
        """Give one process a task after the other."""
        try:
            pickle.dump(setup, process.stdin)
            while True:
                with self.news:
                    number = self.next
                    self.next += 1
                if number >= len(self.tasks):
                    return
                pickle.dump(self.tasks[number], process.stdin)
                process.stdin.flush()
                answer = pickle.load(process.stdout)  # noqa: S301, from a process of our own
                with self.news:
                    self.answers[number] = answer
                    self.news.notify_all()
        except (OSError, EOFError, pickle.UnpicklingError, ValueError) as error:
            with self.news:
                self.problem = self.problem or f"a process that checks leaves ended: {error}"
                self.news.notify_all()

    def ready(self, number: int) -> bool:
        """Wait a moment for an answer."""
        with self.news:
            if number not in self.answers and not self.problem:
                self.news.wait(POLL)
            if number not in self.answers and self.problem:
                raise RuntimeError(self.problem)
            return number in self.answers

    def close(self) -> None:
        """End the processes, whatever they are doing."""
        for process in self.processes:
            process.kill()
        for process in self.processes:
            process.wait()
            for pipe in (process.stdin, process.stdout):
                if pipe is not None:
                    pipe.close()
        for thread in self.threads:
            thread.join()


def serve() -> None:
    """What such a process does: read a setup, then leaves, and answer each."""
    from .certificate import prepare

    source, sink = sys.stdin.buffer, sys.stdout.buffer
    setup: Setup = pickle.load(source)  # noqa: S301, from the process that started this one
    case = prepare(setup.header, setup.policy, setup.specification, setup.folder)
    while True:
        try:
            floats, integers, box = pickle.load(source)  # noqa: S301, as above
        except EOFError:
            return
        answer: Found | str
        try:
            answer = check_leaf(case, read_leaf(case.layout, *unpacked(floats, integers)), box)
        except (Rejected, InputError) as problem:
            answer = str(problem)
        pickle.dump(answer, sink)
        sink.flush()


if __name__ == "__main__":
    # by its own name: what is pickled must not belong to a module called __main__
    from setrl.verify.checker.processes import serve as serve_leaves

    serve_leaves()
