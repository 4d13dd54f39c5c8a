"""How many processors there are for this process."""

from __future__ import annotations

import os


def available_processors() -> int:
    """Processors that this process may use: those it is bound to, where the system knows such a thing."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1
