"""Tasks in worker processes on this machine."""

from __future__ import annotations

import threading
import time
from collections import deque
from collections.abc import Sequence
from types import TracebackType
from typing import Self

from ...specs.errors import UsageError
from .parcel import Parcel, opened, packed
from .process import WorkerProcess, search_path
from .task import Lost, Task, TaskOutcome


class LocalExecutor:
    """Worker processes on this machine, each with one thread for matrix products, each serving one task after another.

    A process is started when there is a task for it, and replaced by a fresh one after a task that was lost or broke.
    Tasks start in the order of submission. What they print goes to stderr. Processes that a task starts in a session
    of their own are not ended with it.

    The memory limit is ``RLIMIT_DATA``: heap, stacks of threads and private writable mappings of the whole process,
    not shared libraries; a process that has imported the verifier with numpy, onnx and onnxruntime holds 90 MiB before
    it does anything. Linux enforces it; macOS counts the heap at most, so that there a task may need more unnoticed.

    Parameters
    ----------
    workers : int
        Tasks that run side by side.
    path : sequence of str, optional
        Folders, put in front of those from which the caller imports.

    Raises
    ------
    UsageError
        Fewer than one worker.
    """

    def __init__(self, workers: int = 1, *, path: Sequence[str] = ()) -> None:
        if workers < 1:
            raise UsageError(f"at least one worker is needed, received {workers}")
        self._workers = workers
        self._search = search_path(path)
        self._lock = threading.Lock()
        self._work = threading.Condition(self._lock)
        self._news = threading.Condition(self._lock)
        self._queue: deque[tuple[int, Parcel]] = deque()
        self._started: dict[int, float] = {}
        self._outcomes: list[tuple[int, TaskOutcome]] = []
        self._count = 0
        self._threads: list[threading.Thread] = []
        self._processes: set[WorkerProcess] = set()
        self._failed = self._closed = False

    @property
    def workers(self) -> int:
        """How many tasks run side by side."""
        return self._workers

    def submit(self, task: Task) -> int:
        """Queue a task; what does not pickle raises here what pickle raises."""
        parcel = packed(task)
        with self._lock:
            if self._closed:
                raise RuntimeError("a task was submitted after the end of the executor's context")
            number = self._count
            self._count += 1
            self._queue.append((number, parcel))
            if len(self._threads) < min(self._workers, len(self._queue) + len(self._started)):
                # Linux ends a worker with the thread that started it: these threads live as long as the context
                thread = threading.Thread(target=self._serve, daemon=True)
                self._threads.append(thread)
                thread.start()
            self._work.notify()
        return number

    def wait(self, seconds: float) -> list[tuple[int, TaskOutcome]]:
        """As the protocol says; returns at once where no task is left."""

        def news() -> bool:
            return bool(self._outcomes or self._failed or not (self._queue or self._started))

        with self._lock:
            self._news.wait_for(news, max(0.0, min(seconds, threading.TIMEOUT_MAX)))
            if self._failed:
                raise RuntimeError("a thread that serves worker processes ended; stderr says why")
            found, self._outcomes = self._outcomes, []
        return [(number, opened(outcome)) for number, outcome in found]

    def running(self) -> list[tuple[int, float]]:
        """As the protocol says, by number."""
        now = time.monotonic()
        with self._lock:
            return sorted((number, now - start) for number, start in self._started.items())

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self._lock:
            self._closed = True
            self._queue.clear()
            for process in self._processes:
                process.kill()
            self._work.notify_all()
        for thread in self._threads:
            thread.join()

    def _serve(self) -> None:
        """What a thread does: give one process a task after the other."""
        process: WorkerProcess | None = None
        try:
            while (following := self._next()) is not None:
                number, parcel = following
                outcome: TaskOutcome | None = None
                while outcome is None:
                    if process is None or not process.lives():
                        self._drop(process)
                        process, problem = self._fresh()
                    outcome = process.run(parcel) if process is not None else Lost("exit", problem)
                    if process is not None and not process.lives():
                        self._drop(process)
                        process = None
                self._record(number, outcome)
        finally:
            self._drop(process)
            with self._lock:
                if not self._closed:
                    self._failed = True
                    self._news.notify_all()

    def _next(self) -> tuple[int, Parcel] | None:
        """Wait for a task; None when the context has ended."""
        with self._lock:
            self._work.wait_for(lambda: self._queue or self._closed)
            if self._closed:
                return None
            number, parcel = self._queue.popleft()
            self._started[number] = time.monotonic()
            return number, parcel

    def _record(self, number: int, outcome: TaskOutcome) -> None:
        with self._lock:
            del self._started[number]
            if not self._closed:  # a loss that the end of the context caused is none
                self._outcomes.append((number, outcome))
                self._news.notify_all()

    def _fresh(self) -> tuple[WorkerProcess | None, str]:
        """A new process, or why there is none."""
        try:
            process = WorkerProcess(self._search)
        except OSError as error:
            return None, f"its process could not be started: {error.strerror or error}"
        with self._lock:
            self._processes.add(process)
            if self._closed:
                process.kill()
        return process, ""

    def _drop(self, process: WorkerProcess | None) -> None:
        if process is not None:
            with self._lock:
                self._processes.discard(process)
            process.close()
