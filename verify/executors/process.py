"""One worker process, seen from outside: it is given a task, and ended when it does not keep to its limits."""

from __future__ import annotations

import contextlib
import math
import os
import pickle
import signal
import subprocess
import sys
import threading
import time
from collections.abc import Sequence

from .parcel import Parcel
from .pipes import ClosedError, LateError, receive, send
from .task import Answer, Lost, Refused, TaskOutcome

_ONE_THREAD = {name: "1" for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS")}
"""Tasks run side by side, one per processor: a matrix product takes one thread. Read when numpy is imported."""


def search_path(path: Sequence[str] = ()) -> list[str]:
    """What a worker imports from: these folders, then those of this process but for the current one.

    Parameters
    ----------
    path : sequence of str
    """
    return [os.path.abspath(folder) for folder in (*path, *sys.path) if folder]


class WorkerProcess:
    """A process that serves one task after another.

    It ends with the process (on Linux: the thread) that started it, even where that is killed.

    Parameters
    ----------
    search : sequence of str
        Folders that the process imports from, before those of its Python.
    """

    def __init__(self, search: Sequence[str]) -> None:
        # -P: nothing that lies in the folder where the caller happens to be takes the place of a module
        command = [sys.executable, "-P", "-m", "setrl.verify.executors.worker"]
        environment = {**os.environ, **_ONE_THREAD, "PYTHONPATH": os.pathsep.join(search)}
        with contextlib.ExitStack() as stack:
            inbox, self._tasks = _pipe(stack)
            self._answers, outbox = _pipe(stack)
            os.set_blocking(self._tasks, False)
            # a session of its own: an interrupt is for the caller, who then ends the process and what it started
            self._process = subprocess.Popen(
                [*command, str(inbox), str(outbox), str(os.getpid())],
                stdin=subprocess.DEVNULL,
                env=environment,
                pass_fds=(inbox, outbox),
                start_new_session=True,
            )
            stack.pop_all()
        os.close(inbox)
        os.close(outbox)
        self._ending = threading.Lock()
        self._killed = self._served = False

    def lives(self) -> bool:
        """Whether the process is there, and has not been told to end."""
        if self._killed:
            return False
        if self._process.returncode is None and hasattr(os, "waitid"):
            # not reaped yet: its number remains its own, so that `kill` reaches what it started and nobody else
            return os.waitid(os.P_PID, self._process.pid, os.WEXITED | os.WNOHANG | os.WNOWAIT) is None
        return self._process.poll() is None

    def run(self, parcel: Parcel) -> TaskOutcome | None:
        """Have a task done.

        Parameters
        ----------
        parcel : Parcel

        Returns
        -------
        outcome
            The value of an answer is pickled. None: a process that had served before ended before it took the task,
            which is another one's then. After anything but an answer or a refusal the process no longer `lives`:
            `close` it and take another.
        """
        start = time.monotonic()
        until = math.inf if parcel.seconds is None else start + parcel.seconds
        taken = False
        try:
            send(self._tasks, pickle.dumps(parcel, pickle.HIGHEST_PROTOCOL), until, self.lives)
            receive(self._answers, until, self.lives)  # an empty message: the task is taken
            taken = True
            outcome: TaskOutcome = pickle.loads(receive(self._answers, until, self.lives))  # noqa: S301, ours
        except LateError:
            self.kill()
            return Lost("time", f"did not end within {parcel.seconds:g} s and was killed", time.monotonic() - start)
        except ClosedError:
            self.kill()  # with what it started
            code = self._reaped()
            return None if self._served and not taken else _death(code, time.monotonic() - start)
        self._served = True
        if not isinstance(outcome, Answer | Refused):
            self.kill()
        return outcome

    def kill(self) -> None:
        """End the process and those that it started, whatever they do. Any thread may call this."""
        with self._ending:
            self._killed = True
            if self._process.returncode is None:
                # macOS: nobody may signal a process that has ended
                with contextlib.suppress(ProcessLookupError, PermissionError):
                    os.killpg(self._process.pid, signal.SIGKILL)

    def close(self) -> None:
        """End the process, whatever it does, and wait until it is gone."""
        self.kill()
        self._reaped()
        os.close(self._tasks)
        os.close(self._answers)

    def _reaped(self) -> int:
        """Exit code, after `kill`."""
        with self._ending:
            return self._process.wait()


def _pipe(stack: contextlib.ExitStack) -> tuple[int, int]:
    """A pipe's end to read from and its end to write to, closed where a later step fails."""
    ends = os.pipe()
    for end in ends:
        stack.callback(os.close, end)
    return ends


def _death(code: int, seconds: float) -> Lost:
    if code >= 0:
        return Lost("exit", f"ended with exit code {code} before it answered", seconds)
    try:
        name = signal.Signals(-code).name
    except ValueError:  # a real-time signal
        name = f"signal {-code}"
    return Lost("signal", f"was killed by {name}", seconds)
