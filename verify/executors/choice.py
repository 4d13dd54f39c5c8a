"""Which executor: by name, with as many workers as there are processors where nobody says how many."""

from __future__ import annotations

from ...specs.errors import UsageError
from .processors import available_processors
from .task import Executor

KINDS = ("local", "ray")
"""Names of the executors."""


def executor_of(kind: str, workers: int | None) -> Executor:
    """The executor of that name; enter its context.

    Parameters
    ----------
    kind : str
        "local": processes on this machine. "ray": a cluster, see `ray_cluster.RayExecutor`.
    workers : int or None
        Tasks that run side by side. None: the processors that this process may use, or the cluster has.

    Raises
    ------
    UsageError
        Another name, fewer than one worker, or no such cluster.
    """
    if kind == "local":
        from .local import LocalExecutor

        return LocalExecutor(available_processors() if workers is None else workers)
    if kind == "ray":
        from .ray_cluster import RayExecutor

        return RayExecutor(workers)
    raise UsageError(f"there is no executor {kind!r}", remedy=f"one of: {', '.join(KINDS)}")
