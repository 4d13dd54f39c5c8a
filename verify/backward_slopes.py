"""Slopes of the two lines per neuron that leave little between the bounds of the output: a search, nothing is proved.

The bounds of the output are differentiated by the slopes. Row k of the lower functions is least at an input x*; what
comes in front of a layer there is found by moving x* forward through the very lines that the row takes. A line below
with slope m, ``m x + c(m)``, which touches its function at t, changes by (x - t) per unit of m, times the row's entry.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Literal, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..models.policy import Activation, Affine, Layer
from .backward import Choice, follow, usual
from .backward_lines import Lines, chord, lines_with, ratio, sensible_slopes, usual_slopes
from .network import LayerBounds
from .relaxations import residual_bounds
from .zonotope import Zonotope

Array = NDArray[np.float64]
Slopes: TypeAlias = tuple[Array, Array]
"""Of the lines below and above an activation, shape (B, n) each."""
Objective: TypeAlias = Literal["width", "gap"]

CHANGE = 2.0**-20
"""Of a slope, for differences."""
STEPS = (0.5, 0.25, 0.125)
"""How far slopes move, in units of the interval that is sensible for them."""


@dataclass(frozen=True)
class _Trial:
    """One pass.

    Attributes
    ----------
    score : array, shape (B,)
    unit : array, shape (B, m)
        What the score is measured in.
    slopes : tuple of Slopes
    moves : tuple of Slopes
        The sensible interval's length, in the direction in which the score falls; nothing for the last trial.
    """

    score: Array
    unit: Array
    slopes: tuple[Slopes, ...]
    moves: tuple[Slopes, ...]


def searched_slopes(
    layers: Sequence[Layer], inputs: Zonotope, objective: Objective = "width", steps: Sequence[float] = STEPS
) -> tuple[Slopes, ...]:
    """For every cell the best slopes of a short search; it starts with the usual lines, and with parallel ones.

    Parameters
    ----------
    layers : sequence of Affine and Activation
    inputs : Zonotope, shape (B, n)
    objective : {"width", "gap"}
        What is to be small: the interval of the output, or the largest distance between its two linear bounds; the
        sum over the outputs, each in units of what the usual lines leave.
    steps : sequence of float
        Lengths of the moves.

    Returns
    -------
    tuple of pairs of arrays, shape (B, k) each
        Of every activation the slopes below and above.
    """
    with np.errstate(invalid="ignore", over="ignore", divide="ignore"):
        usual_ = _trial(layers, inputs, usual, objective, None)
        best = _better(usual_, _trial(layers, inputs, _parallel, objective, usual_.unit))
        for number, step in enumerate(steps):
            slopes = tuple(
                (below + step * up, above + step * down)
                for (below, above), (up, down) in zip(best.slopes, best.moves, strict=True)
            )
            last = number + 1 == len(steps)
            best = _better(best, _trial(layers, inputs, chosen(slopes), objective, usual_.unit, last))
    return best.slopes


def chosen(slopes: Sequence[Slopes]) -> Choice:
    """The choice of given slopes, with the offsets that the ranges ask for."""

    def choose(position: int, activation: Activation, low: Array, high: Array) -> Lines:
        ends = sensible_slopes(activation, low, high)
        below, above = (np.clip(slope, *pair) for slope, pair in zip(slopes[position], ends, strict=True))
        return lines_with(activation, below, above, low, high)

    return choose


def _parallel(position: int, activation: Activation, low: Array, high: Array) -> Lines:
    """Both lines of the chord's slope."""
    slope = np.where(high > low, chord(activation, low, high), usual_slopes(activation, low, high)[0])
    return lines_with(activation, slope, slope, low, high)


def _trial(
    layers: Sequence[Layer],
    inputs: Zonotope,
    choose: Choice,
    objective: Objective,
    unit: Array | None,
    last: bool = False,
) -> _Trial:
    chain, bounds, lines = follow(layers, inputs, choose)
    entries: list[Array] = []
    rows = np.eye(chain.size)
    matrix, offset = chain.lower_functions(np.concatenate([rows, -rows]), entries)
    # of the inputs' factors: lower and minus upper bounds, and where they are least
    mapped = matrix @ np.swapaxes(chain.inputs.generators, 1, 2)
    lower, upper = mapped[:, : chain.size], mapped[:, chain.size :]
    decisive = mapped if objective == "width" else np.tile(lower + upper, (1, 2, 1))
    place = chain.inputs.center[:, None] - np.sign(decisive) @ chain.inputs.generators
    ends = -((matrix * place).sum(2) + offset.mid)
    sizes = ends[:, : chain.size] + ends[:, chain.size :]
    unit = sizes if unit is None else unit
    share = 1.0 / np.where(unit > 0.0, unit, 1.0)
    slopes = tuple((line.lower_slope, line.upper_slope) for line in lines)
    score = (sizes * share).sum(1)
    if last:
        return _Trial(score, unit, slopes, ())
    activations = [layer for layer in layers if isinstance(layer, Activation)]
    ranges = [seen for layer, seen in zip(layers, bounds, strict=True) if isinstance(layer, Activation)]
    moves = []
    waiting = zip(activations, ranges, strict=True)
    for link, entry in zip(chain.links, reversed(entries), strict=True):
        if isinstance(link.layer, Affine):
            place = place @ link.layer.weight.T + link.layer.bias
            continue
        activation, seen = next(waiting)
        moves.append(_moves(activation, link.layer, seen, entry * np.tile(share, 2)[:, :, None], place))
        place = _through(link.layer, entry, place)
    return _Trial(score, unit, slopes, tuple(moves))


def _through(lines: Lines, entry: Array, place: Array) -> Array:
    """Behind an activation, by the line that each entry takes."""
    below = lines.lower_slope[:, None] * place + lines.lower_offset[:, None]
    above = lines.upper_slope[:, None] * place + lines.upper_offset[:, None]
    return np.where(entry >= 0.0, below, above)


def _moves(activation: Activation, lines: Lines, seen: LayerBounds, entry: Array, place: Array) -> Slopes:
    """Steps of full length, uphill for lower functions with the given entries."""
    moves = []
    ends = sensible_slopes(activation, seen.lower, seen.upper)
    sides = ((lines.lower_slope, np.maximum(entry, 0.0)), (lines.upper_slope, np.minimum(entry, 0.0)))
    for side, ((slope, part), (low, high)) in enumerate(zip(sides, ends, strict=True)):
        # differences towards the inside: at an end of the interval the offset may have a bend
        pair = np.stack([np.maximum(slope - CHANGE, low), np.minimum(slope + CHANGE, high)])
        offsets = residual_bounds(activation, pair, seen.lower, seen.upper)[side]
        rise = ratio(offsets[1] - offsets[0], pair[1] - pair[0])
        moves.append(np.sign((part * (place + rise[:, None])).sum(1)) * (high - low))
    return moves[0], moves[1]


def _better(first: _Trial, second: _Trial) -> _Trial:
    """Cell by cell the one with the smaller score."""
    better = (second.score < first.score) | np.isnan(first.score)

    def merged(old: Array, new: Array) -> Array:
        return np.where(better if new.ndim == 1 else better[:, None], new, old)

    def chosen_of(old: tuple[Slopes, ...], new: tuple[Slopes, ...]) -> tuple[Slopes, ...]:
        return tuple((merged(a, c), merged(b, d)) for (a, b), (c, d) in zip(old, new, strict=True))

    slopes = chosen_of(first.slopes, second.slopes)
    moves = chosen_of(first.moves, second.moves) if second.moves else ()
    return _Trial(merged(first.score, second.score), first.unit, slopes, moves)
