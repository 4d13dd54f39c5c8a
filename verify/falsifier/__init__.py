"""Proposes trajectories that violate a requirement. It proves nothing: simulation in float64 only."""

from __future__ import annotations

from .candidates import Candidate, violations
from .search import propose, propose_all

__all__ = ["Candidate", "propose", "propose_all", "violations"]
