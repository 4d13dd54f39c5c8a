"""Functions for worker processes, most of which misbehave."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import threading
import time
import types
from pathlib import Path
from typing import Any

from setrl.specs.errors import PolicyError

STATE: list[int] = []


def double(value: Any) -> Any:
    return 2 * value


def sleep(seconds: float) -> str:
    time.sleep(seconds)
    return "slept"


def never_yields(_: Any) -> None:
    """No other thread of the process runs meanwhile: the engine of regular expressions keeps the lock."""
    re.match(r"(a+)+b", "a" * 60)


def pid(_: Any) -> int:
    return os.getpid()


def name_and(action: tuple[str, float]) -> None:
    """Write the process's number to a file, then sleep; 0 is forever and lets no other thread run."""
    path, seconds = action
    write(path, os.getpid())
    if seconds:
        time.sleep(seconds)
    else:
        never_yields(None)


def write(path: str, number: int) -> None:
    temporary = Path(f"{path}.{os.getpid()}")
    temporary.write_text(str(number))
    temporary.replace(path)


def leave(code: Any) -> None:
    sys.exit(code)


def leave_with_thread(code: int) -> None:
    threading.Thread(target=time.sleep, args=(60,)).start()
    sys.exit(code)


def killed(number: int) -> None:
    os.kill(os.getpid(), number)
    time.sleep(10)


def interrupted(_: Any) -> str:
    os.kill(os.getpid(), signal.SIGINT)
    time.sleep(0.05)
    return "went on"


def hold(mebibytes: int) -> int:
    """Hold so much memory at once."""
    return len([bytearray(2**20) for _ in range(mebibytes)])


def hold_array(mebibytes: int) -> int:
    import numpy

    return int(numpy.ones(mebibytes * 2**17).size)


def hold_and_blame_the_input(mebibytes: int) -> int:
    try:
        return hold(mebibytes)
    except MemoryError as error:
        raise PolicyError("the policy cannot be read") from error


def library_out_of_memory(_: Any) -> None:
    raise RuntimeError("[ONNXRuntimeError] : 6 : RUNTIME_EXCEPTION : std::bad_alloc")


def refuse(_: Any) -> None:
    raise PolicyError("an input of two numbers\nis needed", where="p.onnx", remedy="give it one")


def violate(_: Any) -> None:
    raise AssertionError("lower bound above upper bound")


class _MuteError(Exception):
    def __str__(self) -> str:
        raise ValueError


def raise_mute(_: Any) -> None:
    raise _MuteError


def count(fail: bool) -> int:
    STATE.append(1)
    if fail:
        raise ValueError("broken")
    return len(STATE)


def local_function(_: Any) -> Any:
    return lambda: None


def unknown_here(_: Any) -> Any:
    """An object of a class that only this process has."""
    module = types.ModuleType("only_there")
    sys.modules["only_there"] = module
    exec("class Thing: pass", module.__dict__)  # noqa: S102
    return module.Thing()


class Unreadable:
    """Pickles, and is no pickle that can be read."""

    def __reduce__(self) -> Any:
        return int, ("no number",)


def chatter(text: str) -> str:
    print(text)
    os.write(1, f"{text} 1\n".encode())
    subprocess.run(["/bin/sh", "-c", f"echo {text} child"], check=True)
    return text


def blob(size: int) -> bytes:
    return b"x" * size


def size(content: bytes) -> int:
    return len(content)


def started(path: str) -> float:
    with open(path, "a") as file:
        file.write(".")
    return time.monotonic()


def environment(_: Any) -> tuple[str | None, list[str], bool]:
    return os.environ.get("OMP_NUM_THREADS"), sorted(sys.modules), os.getsid(0) == os.getpid()


def child_of_task(path: str) -> None:
    """Start a process, note it, and go on forever."""
    child = subprocess.Popen(["sleep", "60"])
    write(path, child.pid)
    time.sleep(60)


def orphan(path: str) -> None:
    """End while a copy of the process, with all its pipes, goes on."""
    child = os.fork()
    if not child:
        time.sleep(60)
        os._exit(0)
    write(path, child)
    os._exit(4)


def where(_: Any) -> str:
    import whereabouts  # type: ignore[import-not-found]

    return str(whereabouts.PLACE)


def first_try_sleeps(path: str) -> int:
    """On the first try note the process that started this one and sleep; later, answer."""
    if not Path(path).exists():
        write(path, os.getppid())
        time.sleep(60)
    return os.getppid()


def kill_parent(_: Any) -> None:
    os.kill(os.getppid(), signal.SIGKILL)
    time.sleep(60)
