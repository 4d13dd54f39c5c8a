"""Time limits and interruption: asked between array programs, so that a partial result is always whole."""

from __future__ import annotations

import time
from dataclasses import dataclass


@dataclass
class Deadline:
    """A point in time after which no new work starts.

    Attributes
    ----------
    end : float or None
        Value of `time.monotonic` at which time is up; None is never.
    interrupted : bool
        Set by whoever catches Ctrl-C.
    """

    end: float | None
    interrupted: bool = False

    @classmethod
    def after(cls, seconds: float | None) -> Deadline:
        """A deadline so many seconds from now."""
        return cls(None if seconds is None else time.monotonic() + seconds)

    @property
    def expired(self) -> bool:
        """Whether to stop now."""
        return self.interrupted or (self.end is not None and time.monotonic() >= self.end)

    @property
    def word(self) -> str:
        """Why time is up: for a verdict's reason."""
        return "interrupted" if self.interrupted else "time limit"
