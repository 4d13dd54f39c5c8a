"""A foreign program as a subprocess: in a session and a folder of its own, with hard limits of time and memory."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Sequence

from .tool import Ended

MOST_OUTPUT = 1 << 20
"""Bytes of output that are read; a verifier's answer stands in the last lines."""

_LIMITED = """\
import os, resource, sys
memory = int(sys.argv[1])
resource.setrlimit(resource.RLIMIT_DATA, (memory, memory))
resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
os.execv(sys.argv[2], sys.argv[2:])
"""


def run_limited(command: Sequence[str], seconds: float, memory: int) -> Ended:
    """Run a program until it ends, or its time is up.

    Parameters
    ----------
    command : sequence of str
        An absolute path and arguments.
    seconds : float
        Then the program and everything it started is killed.
    memory : int
        Bytes of data that it may hold, where the platform enforces that.

    Returns
    -------
    Ended
    """
    environment = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
    environment |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1", "MKL_NUM_THREADS": "1"}
    started = time.monotonic()
    with tempfile.TemporaryDirectory(prefix="setrl-tool-") as folder, tempfile.TemporaryFile() as out:
        with tempfile.TemporaryFile() as err:
            process = subprocess.Popen(
                [sys.executable, "-I", "-c", _LIMITED, str(memory), *command],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=err,
                cwd=folder,
                env=environment,
                start_new_session=True,
            )
            code: int | None
            try:
                code = process.wait(seconds)
            except subprocess.TimeoutExpired:
                code = None
            finally:
                _kill_session(process.pid)
                process.wait()
            return Ended(code, _tail(out), _tail(err), time.monotonic() - started)


def _kill_session(leader: int) -> None:
    """End the program and whatever it left behind."""
    try:
        os.killpg(leader, signal.SIGKILL)
    except (ProcessLookupError, PermissionError):
        return


def _tail(file: object) -> str:
    size = file.seek(0, os.SEEK_END)  # type: ignore[attr-defined]
    file.seek(max(0, size - MOST_OUTPUT))  # type: ignore[attr-defined]
    content: bytes = file.read()  # type: ignore[attr-defined]
    return content.decode("utf-8", "replace")
