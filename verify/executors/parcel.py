"""A task on its way to another process and its outcome on the way back: what the caller gave and gets is pickled."""

from __future__ import annotations

import pickle
from dataclasses import dataclass

from .task import Answer, Broken, Task, TaskOutcome

_UNREADABLE = (
    pickle.UnpicklingError,
    AttributeError,
    EOFError,
    ImportError,
    LookupError,
    TypeError,
    ValueError,
)
"""What reading a pickle raises where a class is missing on this side or does not take what it wrote."""


@dataclass(frozen=True)
class Parcel:
    """A task whose argument is bytes: only the process that calls the function imports what they need.

    Attributes
    ----------
    function : str
    argument : bytes
        Pickled.
    seconds : float or None
    memory : int or None
        Bytes.
    """

    function: str
    argument: bytes
    seconds: float | None = None
    memory: int | None = None


def packed(task: Task) -> Parcel:
    """Pickle the argument of a task, as it is now.

    Parameters
    ----------
    task : Task

    Raises
    ------
    pickle.PicklingError, TypeError, AttributeError
        As `pickle.dumps` does.
    """
    argument = pickle.dumps(task.argument, pickle.HIGHEST_PROTOCOL)
    return Parcel(task.function, argument, task.seconds, task.memory)


def opened(outcome: TaskOutcome) -> TaskOutcome:
    """The same outcome with the value of an answer, which came as bytes, read; Broken where that is impossible."""
    if not isinstance(outcome, Answer):
        return outcome
    try:
        value = pickle.loads(outcome.value)  # noqa: S301, from a process of our own
    except _UNREADABLE as error:
        text = " ".join(str(error).split())
        return Broken(f"the answer cannot be read here: {type(error).__name__}: {text}", seconds=outcome.seconds)
    return Answer(value, outcome.seconds)
