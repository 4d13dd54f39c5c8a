"""What a verification run found, as data."""

from __future__ import annotations

from dataclasses import dataclass, field
from enum import StrEnum
from fractions import Fraction
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

if TYPE_CHECKING:
    from matplotlib.figure import Figure

    from ..models.closed_loop import ClosedLoop
    from .falsifier import Candidate

Array = NDArray[np.float64]


class Verdict(StrEnum):
    """VERIFIED, FALSIFIED, UNKNOWN or CLAIMED.

    VERIFIED needs a certificate that the checker accepted, FALSIFIED a witness whose violation it proved. CLAIMED is
    what the engine alone says.
    """

    VERIFIED = "VERIFIED"
    CLAIMED = "CLAIMED"
    FALSIFIED = "FALSIFIED"
    UNKNOWN = "UNKNOWN"

    @property
    def positive(self) -> bool:
        """Whether the engine proved everything: VERIFIED, or CLAIMED where the checker was not asked."""
        return self in (Verdict.VERIFIED, Verdict.CLAIMED)

    @property
    def exit_code(self) -> int:
        """0 verified, 10 falsified, 5 unknown or claimed."""
        return {"VERIFIED": 0, "FALSIFIED": 10, "UNKNOWN": 5, "CLAIMED": 5}[self.value]


@dataclass(frozen=True)
class RequirementResult:
    """One requirement's outcome.

    Attributes
    ----------
    name, kind : str
    proved : bool
        For the whole initial set and all perturbations.
    margin : float
        Smallest signed margin over the whole cover, in the requirement's unit; > 0 is proof.
    time : float or None
        Seconds at which it is smallest.
    facet : str
        The facet that decides it.
    line : int
        Line in the specification.
    """

    name: str
    kind: str
    proved: bool
    margin: float
    time: float | None
    facet: str
    line: int


@dataclass(frozen=True)
class Reason:
    """Why a verdict is UNKNOWN.

    Attributes
    ----------
    sentence : str
        What could not be proved, and when.
    requirement : str
        Name of the requirement, empty where the enclosure itself ended.
    time : float or None
    source : str
        Dominant source of growth.
    shares : dict of source to share
    remedy : str
        What to try.
    verified_until : float
        Seconds up to which everything is proved for the whole initial set.
    verified_part : float
        Share of the initial set's volume (in its free states) that is proved.
    largest_box : dict of state to (lower, upper), or None
        Largest part of the initial set that is proved.
    stopped : str
        "time limit" or "interrupted" where the search or the check was ended; empty where it ended by itself.
    """

    sentence: str
    requirement: str = ""
    time: float | None = None
    source: str = ""
    shares: dict[str, float] = field(default_factory=dict)
    remedy: str = ""
    verified_until: float = 0.0
    verified_part: float = 0.0
    largest_box: dict[str, tuple[float, float]] | None = None
    stopped: str = ""


@dataclass(frozen=True)
class Value:
    """Verified performance: lower bounds of the return over all perturbations, -inf where there is none.

    Attributes
    ----------
    discounted : float
        With the specification's discount.
    undiscounted : float
    discount : float
    """

    discounted: float
    undiscounted: float
    discount: float


@dataclass(frozen=True)
class Flowpipe:
    """Hulls of the reachable sets of a cover of the initial set.

    Attributes
    ----------
    period : float
        Seconds.
    states : tuple of str
    points : array, shape (cells, T + 1, 2, n)
        Lower and upper bounds of the time-point sets; NaN after a failure.
    intervals : array, shape (cells, P, 2, n)
        The same of the time-interval sets, P a multiple of T: equal parts of the horizon. NaN for discrete-time plants.
    margins : array, shape (cells, requirements, T + 1)
        What the engine found, before the checker: the smallest margin at time 0 and of every control period; NaN where
        nothing was looked at.
    """

    period: float
    states: tuple[str, ...]
    points: Array
    intervals: Array
    margins: Array


@dataclass(frozen=True)
class ProvedWitness:
    """A witness that the checker proved.

    Attributes
    ----------
    requirement, kind : str
    time : Fraction or None
        Seconds, exact; None for `reach`, which is missed at every sampling instant of its window.
    grade : str
        What is proved of which semantics, "proved (real)".
    sentence : str
    depth : float
        Violation in the requirement's unit, a lower bound.
    radius : float
        Of the state's enclosure where the violation is read off, an upper bound.
    precision : int
        Bits of the ball arithmetic.
    content : str
        Text of the witness file: all numbers exact.
    """

    requirement: str
    kind: str
    time: Fraction | None
    grade: str
    sentence: str
    depth: float
    radius: float
    precision: int
    content: str


@dataclass(frozen=True)
class Result:
    """Outcome of `verify`.

    Attributes
    ----------
    verdict : Verdict
    reason : Reason or None
        None where the verdict is VERIFIED or CLAIMED.
    requirements : tuple of RequirementResult
    value : Value or None
        None where the specification has no reward.
    flowpipe : Flowpipe
    semantics : tuple of str
        "real", and "float32" (or "float64") where the deployed execution is covered.
    deployed_error : float
        Largest e_L on an action.
    cells, leaves : int
        Cells that were enclosed, cells of the final cover.
    candidate : Candidate or None
        A simulated violation; not a proof.
    witness : ProvedWitness or None
        What makes the verdict FALSIFIED.
    certificate : bytes or None
        What makes the verdict VERIFIED: the content of a certificate file.
    cover : tuple
        Cells of the initial set in preorder, proved or not: (state, cut) before its lower and its upper half, None for
        a leaf.
    timings : dict of phase to seconds
    claim : str
        What exactly is claimed, in a sentence.
    notes : tuple of str
    loop : ClosedLoop
    observation_radius : tuple of float
    """

    verdict: Verdict
    reason: Reason | None
    requirements: tuple[RequirementResult, ...]
    value: Value | None
    flowpipe: Flowpipe
    semantics: tuple[str, ...]
    deployed_error: float
    cells: int
    leaves: int
    candidate: Candidate | None
    timings: dict[str, float]
    claim: str
    notes: tuple[str, ...]
    loop: ClosedLoop
    observation_radius: tuple[float, ...]
    witness: ProvedWitness | None = None
    certificate: bytes | None = field(default=None, repr=False)
    cover: tuple[Any, ...] = field(default=(), repr=False)

    def plot(self, path: str | None = None, states: tuple[str, str] | None = None) -> Figure:
        """Draw the flowpipe with the specification's regions; see `verify.plot.plot_result`."""
        from .plot import plot_result

        return plot_result(self, path, states)

    def to_json(self) -> dict[str, Any]:
        """The result as plain data for `--json`; infinite numbers become null."""
        from .report import result_to_json

        return result_to_json(self)
