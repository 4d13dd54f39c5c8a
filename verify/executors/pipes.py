"""Messages through a pipe: eight bytes of length, then that many bytes; the side that waits can give up."""

from __future__ import annotations

import math
import os
import select
import time
from collections.abc import Callable

POLL = 0.5
"""Seconds between two questions whether the other side still lives; its end is usually seen at once, see `receive`."""


class LateError(Exception):
    """Time is up."""


class ClosedError(Exception):
    """The other side is gone."""


def send(descriptor: int, message: bytes, until: float = math.inf, lives: Callable[[], bool] | None = None) -> None:
    """Write one message.

    Parameters
    ----------
    descriptor : int
        Not blocking, where there is a time limit.
    message : bytes
    until : float
        Of `time.monotonic`.
    lives : callable, optional
        Whether the other side is still there.

    Raises
    ------
    LateError
    ClosedError
    """
    for part in (len(message).to_bytes(8, "big"), message):
        rest = memoryview(part)
        while rest:
            _wait(descriptor, select.POLLOUT, until, lives)
            try:
                rest = rest[os.write(descriptor, rest) :]
            except BlockingIOError:  # less room than was announced
                continue
            except BrokenPipeError as error:
                raise ClosedError from error


def receive(descriptor: int, until: float = math.inf, lives: Callable[[], bool] | None = None) -> bytearray:
    """Read one message.

    Parameters
    ----------
    descriptor : int
    until : float
        Of `time.monotonic`.
    lives : callable, optional
        Whether the other side is still there. A process that ends closes its end of the pipe, which is seen at once,
        but one that it forked may still hold it.

    Raises
    ------
    LateError
    ClosedError
        Before the end of the message.
    """
    length = int.from_bytes(_read(descriptor, 8, until, lives), "big")
    return _read(descriptor, length, until, lives)


def _read(descriptor: int, length: int, until: float, lives: Callable[[], bool] | None) -> bytearray:
    content = bytearray(length)
    rest = memoryview(content)
    while rest:
        _wait(descriptor, select.POLLIN, until, lives)
        count = os.readv(descriptor, [rest])
        if not count:
            raise ClosedError
        rest = rest[count:]
    return content


def _wait(descriptor: int, event: int, until: float, lives: Callable[[], bool] | None) -> None:
    """Until the pipe has bytes or room, or the other side has closed it."""
    poll = select.poll()
    poll.register(descriptor, event)
    while True:
        left = until - time.monotonic()
        if left <= 0:
            raise LateError
        alive = lives is None or lives()
        # asked after `lives`: what a process wrote before it ended is there
        if poll.poll(1000 * min(left, POLL) if alive else 0):
            return
        if not alive:
            raise ClosedError
