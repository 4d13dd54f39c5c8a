"""Tasks on a cluster of Ray, or on one that is started on this machine."""

from __future__ import annotations

import logging
import os
import socket
import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from types import TracebackType
from typing import Any, Self

from ... import __version__
from ...specs.errors import UsageError
from .parcel import opened, packed
from .process import search_path
from .processors import available_processors
from .ray_task import run_parcel
from .task import Broken, Lost, Task, TaskOutcome

RETRIES = 3
"""How often a task is given to another process of the cluster when the one that had it, or its machine, was lost."""

_REACH = 10.0
"""Seconds within which the cluster's address has to accept a connection."""

_PROBE = 60.0
"""Seconds within which a machine of the cluster has to say which setrl it has."""


class RayExecutor:
    """Tasks of one processor each on a cluster of Ray; each is done by a worker process, as by `LocalExecutor`.

    Limits, and what an outcome means, are the same as on this machine. A task whose process of Ray, or whose machine,
    is lost is done again elsewhere; its time limit then starts again. Ray starts tasks in the order of submission. It
    does not say which of them it has started: `running` takes them to be the oldest without an outcome, as many as
    there are processors.

    Parameters
    ----------
    workers : int, optional
        Processors of a cluster that is started on this machine, and ended with the context; as many as there are where
        it is not given.
    address : str, optional
        Of a cluster that exists, on whose machines this version of setrl has to be installed. Otherwise the
        environment's ``RAY_ADDRESS``; without either, or with "local", a cluster is started.
    path : sequence of str, optional
        Folders, on the machines of the cluster, that tasks import from first.

    Raises
    ------
    UsageError
        Fewer than one worker, or a number of them for a cluster that has its own. On entering the context: Ray is not
        installed, the process is connected to a cluster already, there is no such cluster, or setrl is not the same
        there.
    """

    def __init__(self, workers: int | None = None, *, address: str | None = None, path: Sequence[str] = ()) -> None:
        given = address or os.environ.get("RAY_ADDRESS") or "local"
        if workers is not None and workers < 1:
            raise UsageError(f"at least one worker is needed, received {workers}")
        if workers is not None and given != "local":
            raise UsageError(
                f"the cluster at {given} has as many workers as it has processors, received {workers}",
                remedy="leave the number out",
            )
        self._address = given
        self._workers = workers or available_processors()
        self._path = tuple(os.path.abspath(folder) for folder in path)
        self._ray: Any = None
        self._function: Any = None
        self._count = 0
        self._pending: dict[Any, int] = {}
        self._since: dict[int, float] = {}

    @property
    def workers(self) -> int:
        """How many tasks run side by side: processors of the cluster when the context was entered."""
        return self._workers

    def submit(self, task: Task) -> int:
        """Queue a task; what does not pickle raises here what pickle raises."""
        parcel = packed(task)
        if self._ray is None:
            raise RuntimeError("a task was submitted outside the executor's context")
        number = self._count
        self._count += 1
        self._pending[self._function.options(name=task.name or task.function).remote(parcel, self._path)] = number
        self._mark()
        return number

    def wait(self, seconds: float) -> list[tuple[int, TaskOutcome]]:
        """As the protocol says; returns at once where no task is left."""
        references = list(self._pending)
        if not references:
            return []
        ready, _ = self._ray.wait(references, num_returns=1, timeout=max(0.0, min(seconds, 1e6)))
        if ready:
            ready, _ = self._ray.wait(references, num_returns=len(references), timeout=0)
        found = []
        for reference in ready:
            number = self._pending.pop(reference)
            seconds = time.monotonic() - self._since.pop(number, time.monotonic())
            found.append((number, self._outcome(reference, seconds)))
        self._mark()
        return found

    def running(self) -> list[tuple[int, float]]:
        """As the protocol says, by number."""
        now = time.monotonic()
        return sorted((number, now - start) for number, start in self._since.items())

    def __enter__(self) -> Self:
        ray = _ray()
        if ray.is_initialized():
            raise UsageError("this process is connected to a cluster already", remedy="ray.shutdown() disconnects it")
        self._ray = ray
        _print_messages(ray, False)
        try:
            self._connect()
            if self._address != "local":
                _require_same_setrl(self._ray, self._address)
            self._workers = int(self._ray.cluster_resources().get("CPU", 1))
            self._function = self._ray.remote(num_cpus=1, max_retries=RETRIES)(run_parcel)
        except BaseException:
            self._leave()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._leave()

    def _connect(self) -> None:
        quiet = {"log_to_driver": False, "logging_level": logging.ERROR}
        if self._address == "local":
            with _environment_of_cluster():
                self._ray.init(
                    "local",
                    num_cpus=self._workers,
                    include_dashboard=False,
                    _node_ip_address="127.0.0.1",  # nobody else's business
                    **quiet,
                )
            return
        try:
            _require_reachable(self._address)
            self._ray.init(self._address, **quiet)
        except (OSError, OverflowError, RuntimeError, ValueError, self._ray.exceptions.RayError) as error:
            text = " ".join(str(error).split())
            raise UsageError(
                f"there is no cluster to be used at {self._address}: {text}",
                remedy="start one with `ray start --head`, or unset RAY_ADDRESS to have one started",
            ) from error

    def _leave(self) -> None:
        if self._ray is None:
            return
        try:
            for reference in self._pending:
                self._ray.cancel(reference, force=True)
        finally:
            self._ray.shutdown()
            _print_messages(self._ray, True)
            self._pending.clear()
            self._since.clear()
            self._ray = None

    def _mark(self) -> None:
        """Since when the oldest tasks are taken to run."""
        oldest = sorted(self._pending.values())[: self._workers]
        now = time.monotonic()
        self._since = {number: self._since.get(number, now) for number in oldest}

    def _outcome(self, reference: Any, seconds: float) -> TaskOutcome:
        errors = self._ray.exceptions
        try:
            return opened(self._ray.get(reference))
        except errors.RayTaskError as error:  # outside the worker process: setrl is broken or missing there
            text = " ".join(str(error.cause).split())
            return Broken(f"in a process of the cluster: {type(error.cause).__name__}: {text}", str(error), seconds)
        except errors.OutOfMemoryError:
            return Lost("memory", "needed more memory than a machine of the cluster has", seconds)
        except errors.RayError as error:
            return Lost("cluster", f"was lost with its process {RETRIES + 1} times ({type(error).__name__})", seconds)


def _ray() -> Any:
    try:
        import ray
    except ImportError as error:
        raise UsageError("Ray is not installed", remedy="pip install 'setrl[ray]'") from error
    return ray


def _print_messages(ray: Any, wanted: bool) -> None:
    """Ray prints to stdout, which belongs to the caller's output, what an outcome says: that a process was lost."""
    ray._private.worker._worker_logs_enabled = wanted  # the switch that its own debugger uses; there is no public one


@contextmanager
def _environment_of_cluster() -> Iterator[None]:
    """Within, a process that is started imports what this one does, and reports its use to nobody unless told to.

    Ray could set this up for each task, but then the processes that it has started in advance are of no use.
    """
    before = dict(os.environ)
    os.environ["PYTHONPATH"] = os.pathsep.join(search_path())
    os.environ.setdefault("RAY_USAGE_STATS_ENABLED", "0")
    try:
        yield
    finally:
        for name in ("PYTHONPATH", "RAY_USAGE_STATS_ENABLED"):
            os.environ.pop(name, None)
            if name in before:
                os.environ[name] = before[name]


def _require_reachable(address: str) -> None:
    """Raise OSError where nothing listens: Ray itself would go on asking for minutes."""
    host, _, port = address.removeprefix("ray://").rpartition(":")
    if port.isdigit():  # "auto" is no address: Ray knows what runs on this machine
        socket.create_connection((host.strip("[]"), int(port)), _REACH).close()


def _require_same_setrl(ray: Any, address: str) -> None:
    """Ask every machine of the cluster which setrl it has."""

    def version() -> str:  # in here, so that it travels as code: there may be no setrl to import it from
        try:
            import setrl
        except ImportError:
            return ""
        return str(setrl.__version__)

    from ray.util.scheduling_strategies import NodeAffinitySchedulingStrategy

    probe = ray.remote(num_cpus=0)(version)
    nodes = [node for node in ray.nodes() if node["Alive"]]
    on = [NodeAffinitySchedulingStrategy(node["NodeID"], soft=False) for node in nodes]
    try:
        found = ray.get([probe.options(scheduling_strategy=strategy).remote() for strategy in on], timeout=_PROBE)
    except ray.exceptions.RayError as error:
        raise UsageError(f"the cluster at {address} does not answer: {type(error).__name__}") from error
    for node, other in zip(nodes, found, strict=True):
        if other != __version__:
            has = f"setrl {other}" if other else "no setrl"
            raise UsageError(
                f"setrl {__version__} is needed on the cluster at {address}, machine {node['NodeManagerAddress']} "
                f"has {has}",
                remedy=f"pip install setrl=={__version__} on it",
            )
