"""What a worker process does: read a task, call its function within its memory limit, answer, and again.

Tasks and answers have pipes of their own. What a task prints goes to stderr: stdout belongs to the caller's output.
"""

from __future__ import annotations

import errno
import importlib
import os
import pickle
import queue
import signal
import sys
import threading
import time
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from ...specs.errors import SetrlError
from .parcel import Parcel
from .pipes import ClosedError, receive, send
from .task import Answer, Broken, Lost, Refused, TaskOutcome

_PR_SET_PDEATHSIG = 1
_SHORTAGE = ("std::bad_alloc", os.strerror(errno.ENOMEM), "can't start new thread")
"""How libraries that are not Python say that there is no more memory."""


def serve(tasks: int, answers: int, parent: int) -> None:
    """Answer tasks until the parent is gone.

    Parameters
    ----------
    tasks, answers : int
        Descriptors of the pipes.
    parent : int
        Process that started this one.
    """
    for descriptor in (tasks, answers):
        os.set_inheritable(descriptor, False)  # processes that a task starts have no part in this
    os.dup2(2, 1)
    sys.stdout = sys.stderr
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # an interrupt is for the parent, who then ends this process
    _end_with(parent)
    inbox: queue.SimpleQueue[bytearray] = queue.SimpleQueue()
    threading.Thread(target=_read_tasks, args=(tasks, inbox), daemon=True).start()
    while True:
        parcel: Parcel = pickle.loads(inbox.get())  # noqa: S301, from the process that started this one
        send(answers, b"")  # taken: should this process end now, that is the task's doing
        send(answers, pickle.dumps(call(parcel), pickle.HIGHEST_PROTOCOL))
        del parcel  # it may be large


def call(parcel: Parcel) -> TaskOutcome:
    """Do a task in this process.

    Parameters
    ----------
    parcel : Parcel
        Its time limit is not looked at: only another process can end this one whatever it does.

    Returns
    -------
    outcome
        The value of an answer is pickled.
    """
    start = time.monotonic()
    try:
        with _memory_limit(parcel.memory):
            module, _, name = parcel.function.partition(":")
            function = getattr(importlib.import_module(module), name)
            argument = pickle.loads(parcel.argument)  # noqa: S301, from the process that started this one
            start = time.monotonic()
            value = function(argument)
            seconds = time.monotonic() - start
        return Answer(pickle.dumps(value, pickle.HIGHEST_PROTOCOL), seconds)
    except SystemExit as end:
        # here and now: the interpreter would wait for threads that the task left behind
        os._exit(end.code if isinstance(end.code, int) else int(end.code is not None))
    except BaseException as error:  # noqa: BLE001 - the outermost frame: the parent puts a fresh process in place
        return _failed(error, parcel.memory, time.monotonic() - start)


def _failed(error: BaseException, memory: int | None, seconds: float) -> TaskOutcome:
    if _ran_out_of_memory(error, limited=memory is not None):
        needed = "needed more memory than there is" if memory is None else f"needed more than {_size(memory)} of memory"
        return Lost("memory", needed, seconds)
    text = _one_line(error)
    if isinstance(error, SetrlError):
        return Refused(text, seconds)
    trace = "".join(traceback.format_exception(error))
    return Broken(f"{type(error).__name__}: {text}" if text else type(error).__name__, trace, seconds)


def _ran_out_of_memory(error: BaseException, *, limited: bool) -> bool:
    """Whether an exception, or one that it followed from, says so: wrong input is no explanation then."""
    seen: set[int] = set()
    cause: BaseException | None = error
    while cause is not None and id(cause) not in seen:
        seen.add(id(cause))
        if isinstance(cause, MemoryError) or (isinstance(cause, OSError) and cause.errno == errno.ENOMEM):
            return True
        if limited and any(words in _one_line(cause) for words in _SHORTAGE):
            return True
        cause = cause.__cause__ or cause.__context__
    return False


def _one_line(error: BaseException) -> str:
    """The text of an exception, even of one whose own method fails."""
    return " ".join(str(traceback.TracebackException(type(error), error, None)).split())


def _size(memory: int) -> str:
    return f"{memory / 2**30:.1f} GiB" if memory >= 2**30 else f"{memory / 2**20:.0f} MiB"


@contextmanager
def _memory_limit(memory: int | None) -> Iterator[None]:
    """Within, what needs more than so many bytes of data, with those that the process already holds, fails."""
    if memory is None:
        yield
        return
    import resource

    before = resource.getrlimit(resource.RLIMIT_DATA)
    soft = memory if before[1] == resource.RLIM_INFINITY else min(memory, before[1])
    resource.setrlimit(resource.RLIMIT_DATA, (soft, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_DATA, before)


def _end_with(parent: int) -> None:
    """Have the kernel end this process with its parent, even while a task never lets another thread run."""
    if sys.platform != "linux":
        return
    import ctypes

    ctypes.CDLL(None, use_errno=True).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it ended before the kernel was told
        os._exit(1)


def _read_tasks(tasks: int, inbox: Any) -> None:
    """Hand tasks to the main thread; the pipe closes when the parent is gone, and then this process ends."""
    try:
        while True:
            inbox.put(receive(tasks))
    except ClosedError:
        if os.getpgrp() == os.getpid():
            os.killpg(os.getpid(), signal.SIGKILL)  # with the processes that a task started
        os._exit(1)


if __name__ == "__main__":
    # by its own name: what is pickled must not belong to a module called __main__
    from setrl.verify.executors.worker import serve as serve_tasks

    serve_tasks(*map(int, sys.argv[1:]))
