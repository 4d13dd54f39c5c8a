"""Every numerical option of the engine and its default: one frozen dataclass, passed down."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

from ..specs.errors import UsageError

LEAST_GENERATORS = 48
"""Small systems keep so many generators: they cost nothing there."""


@dataclass(frozen=True)
class Options:
    """Options of a verification run.

    Attributes
    ----------
    method : {"jets", "linearization"}
        Flow enclosure: 2-jets of the flow map with the quadratic map, or classic conservative linearisation.
    enclosure : {"zonotope", "crown", "best"}
        Policy enclosure: one affine form of all neurons, two linear bounds of the action by backward substitution, or
        for every cell and period the one of both whose set of actions adds less.
    taylor_order : int
        Time order K of the flow enclosure.
    generators : int
        Generators per tracked dimension that are kept by order reduction (at least `LEAST_GENERATORS` in all).
    quadratic_rows : int
        Products of two factors per state dimension and step that stay generators in the quadratic map.
    action_rows : int
        Generators kept for what is private to one period's action (more than one action only).
    max_substeps : int
        Largest number of integrator steps per control period, a power of two.
    remainder_share : float
        A step is halved while its time remainder exceeds this share of the set's spread.
    remainder_floor : float
        ... plus this share of the state's magnitude (or of 1): thin sets need no more than that.
    slabs : int
        Most time slabs per integrator step in a requirement check.
    batch : int
        Most cells per array program.
    splits : int
        Most cells of the initial set; 1 means no splitting.
    deployed : bool
        Cover float32 execution as well as exact real arithmetic.
    timeout : float or None
        Seconds.
    """

    method: Literal["jets", "linearization"] = "jets"
    enclosure: Literal["zonotope", "crown", "best"] = "zonotope"
    taylor_order: int = 5
    generators: int = 14
    quadratic_rows: int = 4
    action_rows: int = 6
    max_substeps: int = 64
    remainder_share: float = 0.02
    remainder_floor: float = 1e-9
    slabs: int = 16
    batch: int = 128
    splits: int = 20000
    deployed: bool = True
    timeout: float | None = None

    def __post_init__(self) -> None:
        if self.method not in ("jets", "linearization"):
            raise UsageError(f"method must be jets or linearization, got {self.method!r}")
        if self.enclosure not in ("zonotope", "crown", "best"):
            raise UsageError(f"enclosure must be zonotope, crown or best, got {self.enclosure!r}")
        limits = {"taylor_order": (2, 30), "generators": (2, 1000), "quadratic_rows": (0, 100), "action_rows": (0, 100)}
        limits |= {"max_substeps": (1, 4096), "slabs": (1, 1024), "batch": (1, 65536), "splits": (1, 10**7)}
        for name, (least, most) in limits.items():
            value = getattr(self, name)
            if not (isinstance(value, int) and least <= value <= most):
                raise UsageError(f"{name} must be a whole number from {least} to {most}, got {value!r}")
        if not (0.0 < self.remainder_share < 1.0):
            raise UsageError(f"remainder_share must be between 0 and 1, got {self.remainder_share!r}")
        if self.timeout is not None and not (self.timeout > 0.0):
            raise UsageError(f"timeout must be a positive number of seconds, got {self.timeout!r}")
