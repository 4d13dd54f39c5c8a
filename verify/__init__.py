"""What can be proved: sets, enclosures, requirement checks, verdicts.

The package is callable: ``setrl.verify(policy, specification)`` is `verifier.verify`, the one front door. Three
islands in here do not import each other, because a shared bug must not confirm itself: the engine, the falsifier and
the checker.
"""

from __future__ import annotations

import sys
from types import ModuleType
from typing import Any


class _Callable(ModuleType):
    """A module that can be called: the name `setrl.verify` is both the room and its front door."""

    def __call__(self, *arguments: Any, **options: Any) -> Any:
        """`verifier.verify`."""
        from .verifier import verify

        return verify(*arguments, **options)


sys.modules[__name__].__class__ = _Callable
