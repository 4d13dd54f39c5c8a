"""What a search for the radius found, as data."""

from __future__ import annotations

from dataclasses import dataclass
from fractions import Fraction

from .result import Result, Verdict


@dataclass(frozen=True)
class RadiusSearch:
    """What a search for the radius found.

    The radius is the largest component of the observation's perturbation; the components keep the specification's
    proportions, and are equal where it perturbs nothing.

    Attributes
    ----------
    verified : Fraction or None
        Largest radius found that is VERIFIED (CLAIMED where the checker was not asked).
    verified_result : Result or None
        With the certificate.
    falsified : Fraction or None
        Smallest radius found that is FALSIFIED; always above `verified`.
    falsified_result : Result or None
        With the proved witness.
    unproved_result : Result or None
        Of the radius `least`, where it is not VERIFIED: it says why not.
    tried : tuple of (radius, verdict), ascending
        CLAIMED is what the engine alone says; UNKNOWN is no answer with the effort that was made.
    least, most, resolution : Fraction
        Where the search began and ended, and the distance of two radii that it does not tell apart.
    stopped : str
        "time limit" or "interrupted"; empty where the search came to its end.
    timings : dict of phase to seconds
        "engine" (the engine alone), "falsification", "cells" (with cut initial sets), "verification" (of what is
        reported).
    """

    verified: Fraction | None
    verified_result: Result | None
    falsified: Fraction | None
    falsified_result: Result | None
    unproved_result: Result | None
    tried: tuple[tuple[Fraction, Verdict], ...]
    least: Fraction
    most: Fraction
    resolution: Fraction
    stopped: str
    timings: dict[str, float]

    @property
    def exit_code(self) -> int:
        """0 where a radius is VERIFIED, 10 where already the least one is FALSIFIED, else 5."""
        if self.verified_result is not None:
            return self.verified_result.verdict.exit_code
        already = self.falsified is not None and self.falsified <= self.least
        return (Verdict.FALSIFIED if already else Verdict.UNKNOWN).exit_code
