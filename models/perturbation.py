"""The observation's perturbation at another size: one number, and the specification's own proportions."""

from __future__ import annotations

from fractions import Fraction

from .closed_loop import ClosedLoop


def proportions(radii: tuple[Fraction, ...]) -> tuple[Fraction, ...]:
    """Shares of the largest radius, one per component of the observation; ones where every radius is zero."""
    largest = max(radii, default=Fraction(0))
    return tuple(radius / largest for radius in radii) if largest > 0 else (Fraction(1),) * len(radii)


def radii_by_name(loop: ClosedLoop, largest: Fraction) -> dict[str, Fraction]:
    """Radius of every component of the observation where the largest one is given.

    Parameters
    ----------
    loop : ClosedLoop
        Bound at the specification's own radii, whose proportions are kept: ``largest * radius / max(radii)``.
    largest : Fraction

    Returns
    -------
    dict of observation name to Fraction
        Exact. Every component has the same radius where the specification perturbs nothing.
    """
    shares = proportions(loop.observation_radius)
    return {name: largest * share for name, share in zip(loop.observation_names, shares, strict=True)}
