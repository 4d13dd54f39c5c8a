"""One control period of a batch of joint sets: as many integrator steps as each cell needs."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import Plant
from . import rounding
from .flow import image_of, jet_step
from .options import Options
from .quadratic_map import Products
from .steps import Step
from .zonotope import Zonotope, concatenate, pad_rows, reduce_order

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]


@dataclass(frozen=True)
class StepGroup:
    """Cells of a batch that took the same number of steps.

    Attributes
    ----------
    cells : array of int
    steps : tuple of Step
        In order.
    kept : tuple of array of int, shape (B, k) each
        Per step but the first: which rows of the end before it are its start's.
    products : Products or None
        Of a discrete-time plant's map.
    """

    cells: Indices
    steps: tuple[Step, ...]
    kept: tuple[Indices, ...] = ()
    products: Products | None = None


@dataclass(frozen=True)
class PeriodFlow:
    """Flow of one control period.

    Attributes
    ----------
    groups : tuple of StepGroup
        Every cell is in one group; a discrete-time plant has groups without steps.
    end : Zonotope, shape (B, d)
    added : array, shape (B, n)
        Half-width that the steps added in all.
    sound : array of bool, shape (B,)
    substeps : array of int, shape (B,)
        Guess for the next period: log2 of the number of steps.
    rate : array, shape (2, B, n), or None
        Guess for the next period: growth of the a-priori box per second.
    """

    groups: tuple[StepGroup, ...]
    end: Zonotope
    added: Array
    sound: Bools
    substeps: Indices
    rate: Array | None


def integrate(
    plant: Plant,
    joint: Zonotope,
    period: Fraction,
    options: Options,
    guess: Indices,
    rate: Array | None = None,
) -> PeriodFlow:
    """Enclose the flow over one control period.

    Each cell starts with the number of steps it needed last; while their time remainders exceed `remainder_share` of
    the set's spread, or the enclosure does not exist, the steps of that cell are halved.

    Parameters
    ----------
    plant : Plant
    joint : Zonotope, shape (B, d)
        States, inputs, disturbances.
    period : Fraction
    options : Options
    guess : array of int, shape (B,)
        log2 of the number of steps to begin with.
    rate : array, shape (2, B, n), optional
        Guess for the a-priori enclosures.

    Returns
    -------
    PeriodFlow
    """
    states = len(plant.states)
    rows = options.quadratic_rows * states
    if plant.discrete:
        image, added, products = image_of(plant.tape, joint, rows)
        end = concatenate(image, joint.coordinates(slice(states, joint.dimension)))
        sound = np.asarray(np.isfinite(end.spread).all(1) & np.isfinite(end.center).all(1))
        return PeriodFlow((StepGroup(np.arange(joint.batch), (), (), products),), end, added, sound, guess, None)
    take_step = _method(plant, options, rows)
    most = options.max_substeps.bit_length() - 1
    # a step of twice the length has about 2^decay times the truncation
    decay = options.taylor_order if options.method == "jets" else 2
    level = np.minimum(guess, most)
    groups: list[StepGroup] = []
    rates = np.zeros((2, joint.batch, states))
    results: list[tuple[Indices, Zonotope, Array, Bools]] = []
    following = level.copy()
    pending = np.ones(joint.batch, dtype=bool)
    while pending.any():
        current = int(level[pending].min())
        cells = np.flatnonzero(pending & (level == current))
        whole = cells.size == joint.batch
        steps, kept, end, added, truncation, sound = _steps(
            take_step,
            joint if whole else joint[cells],
            rate if whole or rate is None else rate[:, cells],
            period,
            2**current,
            rows,
        )
        spread = end.spread[:, :states]
        size = np.abs(end.center[:, :states])
        allowed = options.remainder_share * spread + options.remainder_floor * np.maximum(size, 1.0)
        good = sound & (truncation <= allowed).all(1)
        final = good if current < most else np.ones_like(good)
        if final.any():
            chosen = np.flatnonzero(final)
            done = cells[chosen]
            rates[:, done] = steps[-1].rate[:, chosen]
            if chosen.size < cells.size:
                steps, kept = tuple(step.select(chosen) for step in steps), tuple(rows[chosen] for rows in kept)
                end, added, sound = end[chosen], added[chosen], sound[chosen]
            groups.append(StepGroup(done, steps, kept))
            results.append((done, end, added, sound))
            easy = (truncation[chosen] <= 2.0**-decay * allowed[chosen]).all(1)
            following[done] = np.maximum(current - easy, 0)
        level[cells[~final]] += 1
        pending[cells[final]] = False
    end, added, sound = _assemble(results, joint, states)
    return PeriodFlow(tuple(groups), end, added, sound, following, rates)


TakeStep = Callable[[Zonotope, Fraction, Array | None], Step]


def _method(plant: Plant, options: Options, rows: int) -> TakeStep:
    if options.method == "linearization":
        from .linearization import linear_step

        return lambda z, duration, rate: linear_step(plant.tape, z, duration, options.taylor_order, rate)
    return lambda z, duration, rate: jet_step(plant.tape, z, duration, options.taylor_order, rows, rate)


def _steps(
    take_step: TakeStep, z: Zonotope, rate: Array | None, period: Fraction, count: int, rows: int
) -> tuple[tuple[Step, ...], tuple[Indices, ...], Zonotope, Array, Array, Bools]:
    """`count` equal steps. All rows that came in keep their identity (the inputs depend on them)."""
    given = z.generators.shape[1]
    steps: list[Step] = []
    kept: list[Indices] = []
    sound = np.ones(z.batch, dtype=bool)
    added = truncation = np.zeros(())
    for _ in range(count):
        if steps:
            scale = z.spread
            z, _, chosen = reduce_order(z, given, given + 2 * rows, np.where(scale > 0.0, scale, 1.0))
            kept.append(chosen)
        step = take_step(z, period / count, rate)
        rate = step.rate
        steps.append(step)
        sound &= step.sound
        added = rounding.enlarged(added + step.added, 1)
        truncation = truncation + step.truncation
        z = step.end
        if not sound.any():
            break
    return tuple(steps), tuple(kept), z, added, truncation, sound


def _assemble(
    results: list[tuple[Indices, Zonotope, Array, Bools]], joint: Zonotope, states: int
) -> tuple[Zonotope, Array, Bools]:
    """Put the groups' results back into the order of the batch."""
    if len(results) == 1:  # all cells, in their order
        return results[0][1:]
    rows = max(end.generators.shape[1] for _, end, _, _ in results)
    order = np.argsort(np.concatenate([cells for cells, _, _, _ in results]))
    end = Zonotope(
        np.concatenate([r[1].center for r in results])[order],
        np.concatenate([pad_rows(r[1].generators, rows) for r in results])[order],
        np.concatenate([r[1].radius for r in results])[order],
    )
    return end, np.concatenate([r[2] for r in results])[order], np.concatenate([r[3] for r in results])[order]
