"""What an executor is given and what it answers: tasks with limits, outcomes that name what was lost."""

from __future__ import annotations

from dataclasses import dataclass
from types import TracebackType
from typing import Any, Protocol, Self, TypeAlias


@dataclass(frozen=True)
class Task:
    """A call in another process.

    Attributes
    ----------
    function : str
        ``package.module:name``; called with `argument` alone.
    argument : object
        Anything that pickles; so is what the function returns.
    seconds : float or None
        Wall-clock limit: the process is killed then. None is no limit.
    memory : int or None
        Bytes of data (heap, stacks, private mappings) that the process may hold. None is no limit.
    name : str
        For messages.
    """

    function: str
    argument: Any
    seconds: float | None = None
    memory: int | None = None
    name: str = ""


@dataclass(frozen=True)
class Answer:
    """What the function returned.

    Attributes
    ----------
    value : object
    seconds : float
        Wall time of the call.
    """

    value: Any
    seconds: float = 0.0


@dataclass(frozen=True)
class Refused:
    """The function raised a `SetrlError`: the input is wrong.

    Attributes
    ----------
    sentence : str
        The error's text, one line.
    seconds : float
    """

    sentence: str
    seconds: float = 0.0


@dataclass(frozen=True)
class Broken:
    """The function raised anything else: a broken invariant, a bug.

    Attributes
    ----------
    sentence : str
        Type and text of the exception, one line.
    traceback : str
    seconds : float
    """

    sentence: str
    traceback: str = ""
    seconds: float = 0.0


@dataclass(frozen=True)
class Lost:
    """There is no answer, for want of a resource.

    Attributes
    ----------
    kind : str
        "time" (killed at its limit), "memory" (it reached its limit), "signal" (killed by someone else), "exit" (it
        ended by itself) or "cluster" (the machine it ran on was lost, again and again).
    sentence : str
        For people: "needed more than 2.0 GiB of memory", "was killed by SIGSEGV".
    seconds : float
    """

    kind: str
    sentence: str
    seconds: float = 0.0


TaskOutcome: TypeAlias = Answer | Refused | Broken | Lost


class Executor(Protocol):
    """Runs tasks side by side; tasks may be added while others run.

    A context: leaving it ends every process that still runs, whatever it does.
    """

    @property
    def workers(self) -> int:
        """How many tasks run side by side."""

    def submit(self, task: Task) -> int:
        """Queue a task; returns its number, 0 for the first one."""

    def wait(self, seconds: float) -> list[tuple[int, TaskOutcome]]:
        """Outcomes that have come in since the last call, after at most so many seconds; [] where none has."""

    def running(self) -> list[tuple[int, float]]:
        """Numbers of the tasks that are being worked on, and since how many seconds."""

    def __enter__(self) -> Self: ...

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None: ...
