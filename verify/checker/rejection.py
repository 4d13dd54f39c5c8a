"""Why a certificate is not accepted."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any


class Rejected(Exception):
    """An obligation of a certificate that was not proved; the text says which."""


def require_within(needed: Sequence[Any], room: Sequence[float], what: str) -> None:
    """Reject unless every ball is provably at most its float."""
    for position, (need, most) in enumerate(zip(needed, room, strict=True)):
        if not bool(need <= most):
            raise Rejected(f"{what}: component {position} needs {float(need.mid()):.6g}, more than {most:.6g}")
