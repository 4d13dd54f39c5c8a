"""The certified radius: the largest perturbation for which a policy provably keeps the whole specification."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction

from ..models.closed_loop import Plant
from ..models.perturbation import radii_by_name as scaled_radii
from ..models.policy import Policy
from ..verify.options import Options
from ..verify.radius import largest_verified
from ..verify.radius_claims import QUIET
from .task import Task


def certified_radius(
    task: Task,
    policy: Policy,
    radii: Sequence[Fraction],
    resolution: Fraction,
    *,
    options: Options | None = None,
    plant: Plant | None = None,
) -> Fraction | None:
    """Search the largest radius at which every requirement is VERIFIED; see `verify.radius.largest_verified`.

    Parameters
    ----------
    task : Task
    policy : Policy
        Read from a file: a certificate is about its bytes.
    radii : sequence of Fraction
        Grid, in any order; the largest component of the perturbation.
    resolution : Fraction
        The search ends when the radii it could still find are closer than this; positive.
    options : Options, optional
        Of every verification; ``Options(splits=1)`` by default: the initial set is not split.
    plant : Plant, optional
        Instead of the plant that the specification names. Then there is no evidence, hence no radius.

    Returns
    -------
    Fraction or None
        None where no radius of the grid is VERIFIED, 0 included if it is in the grid; and where the specification
        requires nothing.
    """
    specification = task.loop.specification
    if not specification.requirements:
        return None
    return largest_verified(policy, specification, radii, resolution, options=options or Options(splits=1), plant=plant)


def radii_by_name(task: Task, policy: Policy, radius: Fraction) -> dict[str, Fraction]:
    """Observation radius by name where the largest is `radius`: the specification's proportions, exact."""
    return scaled_radii(task.bound(policy), radius)


__all__ = ["QUIET", "certified_radius", "radii_by_name"]
