"""What the commands return: never 1, which is a Python crash."""

from __future__ import annotations

OK, FALSIFIED, UNKNOWN, BAD_INPUT, INTERNAL = 0, 10, 5, 2, 6
ABORTED, PIPE_CLOSED = 130, 141
"""What a shell reports for a program that SIGINT or SIGPIPE ended."""
