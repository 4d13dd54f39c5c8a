"""Why a verdict is UNKNOWN: which requirement, when, what made the sets grow, what does verify, and what to try."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import ClosedLoop
from .closed_loop import SOURCES
from .model import initial_box
from .options import Options
from .result import Reason
from .splitting import FAILED, PROVED, Exploration, InitialSet
from .wording import number

if TYPE_CHECKING:
    from .falsifier import Candidate

Array = NDArray[np.float64]

REMEDIES = {
    "initial set": "allow more splits (--splits) or make the initial set smaller",
    "observation perturbation": "lower the perturbation radius, or train a policy that depends less on it",
    "disturbances": "tighten the bounds of the disturbances",
    "network relaxation": "allow more splits (--splits), or train a policy with smaller slopes",
    "flow remainder": "allow more splits (--splits), or raise the Taylor order",
    "order reduction": "keep more generators per state",
}


def explain(
    loop: ClosedLoop, options: Options, found: Exploration, problem: int, candidate: Candidate | None
) -> Reason:
    """Build the reason of an UNKNOWN verdict."""
    failed, proved = found.cells_of(problem, FAILED), found.cells_of(problem, PROVED)
    growth = found.growth[failed] if failed.size else np.zeros((1, len(SOURCES)))
    shares = growth[int(growth.sum(1).argmax())] if growth.size else np.zeros(len(SOURCES))
    total = float(shares.sum())
    named = {SOURCES[i]: float(shares[i]) / total if total > 0 else 0.0 for i in np.argsort(-shares)}
    source = next(iter(named)) if total > 0 else "initial set"
    remedy = REMEDIES[source]
    requirement, when = "", None
    cells = failed if failed.size else proved
    reached = int(found.reached[cells].min()) if cells.size else 0
    until = reached * float(loop.period)
    if candidate is not None:
        requirement, when = candidate.requirement, candidate.time
        sentence = (
            f"a simulated trajectory violates `{requirement}` at {number(when)} s by {number(candidate.violation)}; "
            "it is a candidate, not a proved witness"
        )
        remedy = "look at the trajectory (`setrl simulate`); retrain the policy or change the specification"
    elif found.stopped:
        sentence = (
            f"{found.stopped} after {number(found.periods_enclosed)} enclosed periods; {failed.size} cell(s) undecided"
        )
        remedy = "give it more time (--timeout)"
    elif reached < loop.periods and not _has_failing_requirement(found, failed):
        sentence = f"the reachable set could not be enclosed beyond {number(until)} s"
        when = until
    else:
        requirement, when, margin = _worst(loop, found, failed)
        moment = "" if when is None else f" at {number(when)} s"
        sentence = f"`{requirement}` could not be proved{moment} (margin {number(margin)})"
        if options.splits <= 1:
            remedy = "allow splitting (--splits)" if source in ("initial set", "network relaxation") else remedy
    part, box = _verified_part(loop, found, proved)
    return Reason(sentence, requirement, when, source, named, remedy, until, part, box, found.stopped)


def _has_failing_requirement(found: Exploration, cells: NDArray[np.intp]) -> bool:
    return any(int(cell) in found.failing for cell in cells)


def _worst(loop: ClosedLoop, found: Exploration, cells: NDArray[np.intp]) -> tuple[str, float | None, float]:
    """Requirement, time and margin of the cell that is furthest from a proof."""
    if not loop.requirements or not cells.size:
        return "V(s0)", None, float("nan")
    margins = found.margins[cells]
    cell, number_ = np.unravel_index(int(margins.argmin()), margins.shape)
    when = float(found.times[cells[cell], number_])
    return loop.requirements[int(number_)].name, None if np.isnan(when) else when, float(margins[cell, number_])


def _verified_part(
    loop: ClosedLoop, found: Exploration, proved: NDArray[np.intp]
) -> tuple[float, dict[str, tuple[float, float]] | None]:
    """Proved share of the initial set's volume and the largest proved box."""
    if not proved.size:
        return 0.0, None
    initial = InitialSet.of(*initial_box(loop))
    volume = ((found.tree.upper[proved] - found.tree.lower[proved]) / 2.0).prod(1)
    largest = proved[int(volume.argmax())]
    low, high = initial.box(found.tree.lower[[largest]], found.tree.upper[[largest]])
    box = {state: (float(low[0, i]), float(high[0, i])) for i, state in enumerate(loop.plant.states)}
    return float(volume.sum()), box
