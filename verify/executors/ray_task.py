"""What a process of Ray does with a task: it has it done by a worker process, as on any machine.

What the caller pickled is passed on as it is, so that nothing which tasks need is imported here.
"""

from __future__ import annotations

import functools
import os

from .parcel import Parcel
from .process import WorkerProcess
from .task import TaskOutcome


def run_parcel(parcel: Parcel, path: tuple[str, ...]) -> TaskOutcome:
    """Have a task done by the worker process that this process of Ray keeps.

    Parameters
    ----------
    parcel : Parcel
        Its limits are counted here, where it runs.
    path : tuple of str
        Folders of this machine, put in front of those from which Ray imports.

    Returns
    -------
    outcome
        The value of an answer is pickled.
    """
    return _keeper(path).run(parcel)


class _Keeper:
    """One worker process, kept from task to task, and replaced when it is lost."""

    def __init__(self, path: tuple[str, ...]) -> None:
        # not sys.path: Ray puts the folder there that the caller happens to be in
        inherited = os.environ.get("PYTHONPATH", "").split(os.pathsep)
        self._search = [folder for folder in (*path, *inherited) if folder]
        self._process: WorkerProcess | None = None

    def run(self, parcel: Parcel) -> TaskOutcome:
        outcome: TaskOutcome | None = None
        while outcome is None:
            if self._process is None or not self._process.lives():
                self._drop()
                self._process = WorkerProcess(self._search)
            outcome = self._process.run(parcel)
            if not self._process.lives():
                self._drop()
        return outcome

    def _drop(self) -> None:
        if self._process is not None:
            self._process.close()
            self._process = None


_keeper = functools.cache(_Keeper)
"""The one of this process; Ray calls a function, and there is nobody else to keep it."""
