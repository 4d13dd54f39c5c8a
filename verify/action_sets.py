"""The set of actions of one period, by one enclosure of the policy or cell by cell by the better of two."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from .network import merge_rows
from .quadratic_map import Products
from .zonotope import Zonotope

Array = NDArray[np.float64]
Indices = NDArray[np.intp]

OBSERVATION_PRODUCT, OBSERVATION_BOX, PERTURBATION, NEURON, CLIPPED = range(5)
"""Where a private row of an action set comes from."""
PARALLEL, TWO_LINES = range(2)
"""Forms of a certificate: the policy is followed forward with one slope per neuron, or backward with two lines."""


@dataclass(frozen=True)
class ActionSet:
    """What one enclosure makes of a set of observations.

    Attributes
    ----------
    output : Zonotope, shape (B, m)
        The shared rows, the private rows that were kept, and m rows of a box; radius zero.
    kept : array of int, shape (B, p)
        Positions of the private rows among all of them.
    error : array, shape (B, m)
        e_L, already included; zero when only exact arithmetic is covered.
    noise_share : array, shape (B,)
        Share of the private part that comes from the observation perturbation.
    lines : tuple of array, shape (B, n) each
        What a certificate says about the neurons, in its order.
    neurons : array of int
        Whose relaxation error the private rows behind the observation's are.
    """

    output: Zonotope
    kept: Indices
    error: Array
    noise_share: Array
    lines: tuple[Array, ...]
    neurons: Indices


@dataclass(frozen=True)
class ActionChoices:
    """Choices in the enclosure of the policy's action; nothing in here is a bound.

    Attributes
    ----------
    products : Products or None
        Of the observation's map; None where plain states are observed.
    seen : Zonotope or None, shape (B, n_obs)
        What the map made of the states.
    lines : tuple of array, shape (B, n) each
        Of every activation the slopes, of a smooth one also offsets and errors; last the slopes of the specification's
        clip where there is one.
    two_lines : tuple of array, shape (B, n) each
        The same for cells whose form is `TWO_LINES`: of every activation slopes and offsets of the lines below, then
        of those above.
    forms : array of int, shape (B,), or None
        `PARALLEL` or `TWO_LINES`; None where the certificate knows only the first.
    origins : array of int, shape (k, 2)
        What each private row of the unmerged action set is: a kind, one of `OBSERVATION_PRODUCT` to `CLIPPED`, and
        which of that kind; neurons are counted through all activations.
    kept : array of int, shape (B, p)
        Positions in `origins` of the private rows that were not merged.
    """

    products: Products | None
    seen: Zonotope | None
    lines: tuple[Array, ...]
    two_lines: tuple[Array, ...]
    forms: Indices | None
    origins: Indices
    kept: Indices


def merged_set(
    z: Zonotope, shared: int, rows: int, noise: slice, error: Array, lines: tuple[Array, ...], neurons: Indices
) -> ActionSet:
    """An action set from all its rows.

    Parameters
    ----------
    z : Zonotope, shape (B, m)
    shared : int
        Number of leading rows that keep their identity.
    rows : int
        Private rows to keep where there are several actions.
    noise : slice
        Where the perturbation is among the private rows.
    error, lines, neurons
        As in `ActionSet`.
    """
    private = np.abs(z.generators[:, shared:])
    whole = private.sum((1, 2)) + z.radius.sum(1)
    share = private[:, noise].sum((1, 2)) / np.where(whole > 0.0, whole, 1.0)
    merged, kept = merge_rows(z, shared, rows)
    return ActionSet(merged, kept, error, share, lines, neurons)


def better_set(forward: ActionSet, backward: ActionSet, shared: int) -> tuple[ActionSet, Indices]:
    """Cell by cell the set that adds less to the plant's: with less private spread, in units of the whole spread.

    Both are enclosures, and a certificate says for every period which one it is, so any choice is sound.

    Parameters
    ----------
    forward, backward : ActionSet
    shared : int
        Number of leading rows that keep their identity.

    Returns
    -------
    ActionSet
        Lines are those of `forward`.
    array of int, shape (B,)
        `TWO_LINES` where `backward` was taken.
    """
    unit = np.abs(forward.output.generators).sum(1)
    unit = np.where((unit > 0.0) & np.isfinite(unit), unit, 1.0)
    first, second = ((np.abs(s.output.generators[:, shared:]).sum(1) / unit).sum(1) for s in (forward, backward))
    taken = (second < first) | (~np.isfinite(first) & np.isfinite(second))
    width = max(forward.kept.shape[1], backward.kept.shape[1])
    one, other = _padded(forward, shared, width), _padded(backward, shared, width)

    def chosen(a: Array, b: Array) -> Array:
        return np.where(taken.reshape(-1, *(1,) * (a.ndim - 1)), b, a)

    output = Zonotope(
        chosen(one.output.center, other.output.center),
        chosen(one.output.generators, other.output.generators),
        chosen(one.output.radius, other.output.radius),
    )
    kept = np.where(taken[:, None], other.kept, one.kept)
    error, share = chosen(one.error, other.error), chosen(one.noise_share, other.noise_share)
    return ActionSet(output, kept, error, share, forward.lines, forward.neurons), np.where(taken, TWO_LINES, PARALLEL)


def _padded(given: ActionSet, shared: int, width: int) -> ActionSet:
    """With rows of zeros behind the private rows, up to a number of them; evidence leaves rows of zeros out."""
    missing = width - given.kept.shape[1]
    if not missing:
        return given
    z, end = given.output, shared + given.kept.shape[1]
    zeros = np.zeros((z.batch, missing, z.dimension))
    generators = np.concatenate([z.generators[:, :end], zeros, z.generators[:, end:]], 1)
    kept = np.concatenate([given.kept, np.zeros((z.batch, missing), dtype=np.intp)], 1)
    return replace(given, output=replace(z, generators=generators), kept=kept)
