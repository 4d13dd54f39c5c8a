"""Batched branch and bound over the initial set.

A cell is a box in the factors of the initial set: ``x0 = c0 + diag(g0) beta`` with beta in [lower, upper], dyadic
numbers in [-1, 1], so that children cover their parent exactly. All open cells move through one array program; verified
cells are leaves; a cell that fails is cut in half where the failing margin says it helps most.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from . import rounding
from .closed_loop import SOURCES, Engine, Period
from .deadline import Deadline
from .evidence import LeafEvidence, Recorder
from .model import initial_box
from .watch import Watch
from .zonotope import Zonotope

Array = NDArray[np.float64]
Bools = NDArray[np.bool_]
Indices = NDArray[np.intp]

SMALLEST_CELL = 2.0**-40
"""Cells are not cut below this width in factor space."""


@dataclass(frozen=True)
class CellTree:
    """Cells in factor space, the cover of the initial set.

    Attributes
    ----------
    lower, upper : array, shape (M, p)
    parent : array of int, shape (M,)
        -1 for roots.
    problem : array of int, shape (M,)
        Which of the problems that run together (perturbation radii) the cell belongs to.
    """

    lower: Array
    upper: Array
    parent: Indices
    problem: Indices

    def select(self, index: Indices) -> CellTree:
        """Some cells."""
        return CellTree(self.lower[index], self.upper[index], self.parent[index], self.problem[index])


@dataclass(frozen=True)
class InitialSet:
    """The initial set as a zonotope with one factor per state that is not fixed.

    Attributes
    ----------
    center, radius : array, shape (n,)
        Enclosure of the exact box.
    free : array of int, shape (p,)
        States with a factor.
    """

    center: Array
    radius: Array
    free: Indices

    @classmethod
    def of(cls, low: Array, high: Array) -> InitialSet:
        """Initial set from outward-rounded bounds."""
        center, radius = rounding.center_radius(low, high)
        return cls(center, radius, np.flatnonzero(radius > 0.0))

    def cells(self, lower: Array, upper: Array) -> tuple[Array, Array, Array]:
        """Zonotopes of cells of factor space, (B, p): center, rows (B, p, n), radius, rounded outward."""
        batch, factors = lower.shape
        middle, half = 0.5 * (lower + upper), 0.5 * (upper - lower)  # exact: dyadic numbers with few bits
        center = np.tile(self.center, (batch, 1))
        shift = self.radius[self.free] * middle
        moved = center[:, self.free] + shift
        error = rounding.relative_error(shift, 1) + rounding.relative_error(moved, 1)
        center[:, self.free] = moved
        rows = np.zeros((batch, factors, self.center.size))
        # the whole cell is one factor wide; its rounding goes with it
        width = rounding.enlarged(self.radius[self.free] * half + error, 3)
        rows[:, np.arange(factors), self.free] = width
        return center, rows, np.zeros((batch, self.center.size))

    def box(self, lower: Array, upper: Array) -> tuple[Array, Array]:
        """Bounds of cells in state space, for messages and plots, shape (B, n)."""
        center, rows, _ = self.cells(lower, upper)
        return center - rows.sum(1), center + rows.sum(1)


@dataclass
class Exploration:
    """State and result of branch and bound for several problems at once.

    Attributes
    ----------
    tree : CellTree
        Every cell ever opened.
    status : array of int, shape (M,)
        OPEN, PROVED, FAILED (a leaf that was not proved) or CUT.
    margins, times : array, shape (M, requirements)
    value, undiscounted : array, shape (M,)
    reached : array of int, shape (M,)
        Periods that were enclosed without a failure.
    failing : dict of cell to (requirement number, set)
    growth : array, shape (M, sources)
    hulls : dict of cell to (points, intervals, curves)
        As in `Watch`, and `Monitor.curve` of every requirement.
    action_lower, action_upper, deployed_error : array, shape (M, m)
        Hull of a cell's actions, and its largest e_L: for the refusal of ill-conditioned networks.
    """

    tree: CellTree
    status: Indices
    margins: Array
    times: Array
    value: Array
    undiscounted: Array
    reached: Indices
    failing: dict[int, tuple[int, Zonotope]]
    growth: Array
    hulls: dict[int, tuple[Array, Array, Array]]
    action_lower: Array
    action_upper: Array
    deployed_error: Array
    periods_enclosed: int = 0
    stopped: str = ""
    evidence: dict[int, LeafEvidence] = field(default_factory=dict)
    """Of every cell that was proved: what its certificate says."""

    def cells_of(self, problem: int, *statuses: int) -> Indices:
        """Cells of one problem with one of the given statuses."""
        return np.flatnonzero((self.tree.problem == problem) & np.isin(self.status, statuses))

    @property
    def open_cells(self) -> Indices:
        """Cells that wait for their run."""
        return np.flatnonzero(self.status == OPEN)


OPEN, PROVED, FAILED, CUT = range(4)

Progress = Callable[["Exploration"], None]
Doubt = Callable[[int, NDArray[np.float64]], bool]
"""Asked once per problem when a proof failed: (problem, factors at which to look), True stops the cutting."""


def explore(
    engine: Engine,
    observation_radii: Array,
    deadline: Deadline,
    progress: Progress | None = None,
    doubt: Doubt | None = None,
) -> Exploration:
    """Verify the initial set for several perturbation radii in one array program.

    Parameters
    ----------
    engine : Engine
    observation_radii : array, shape (problems, n_obs)
    deadline : Deadline
    progress : callable, optional
        Called after every batch.
    doubt : callable, optional
        Asks the falsifier before the first cut of a problem.

    Returns
    -------
    Exploration
    """
    model, options = engine.model, engine.options
    initial = InitialSet.of(*initial_box(model.loop))
    problems, factors = observation_radii.shape[0], initial.free.size
    state = _first_cells(engine, problems, factors)
    doubted: set[int] = set()
    given_up: set[int] = set()
    while state.open_cells.size and not deadline.expired:
        cells = state.open_cells[: options.batch]
        # sets that explode end as bounds that are not finite, which prove nothing
        with np.errstate(over="ignore", invalid="ignore"):
            _run_batch(engine, initial, state, cells, observation_radii, deadline)
        failed = cells[state.status[cells] == FAILED]
        for problem in np.unique(state.tree.problem[failed]):
            if doubt is not None and int(problem) not in doubted and not _over(deadline):
                doubted.add(int(problem))
                if doubt(int(problem), _extreme_factors(engine, state, failed[state.tree.problem[failed] == problem])):
                    given_up.add(int(problem))
        if options.splits > 1 and factors and not _over(deadline):
            _cut(engine, state, failed[~np.isin(state.tree.problem[failed], list(given_up))], options.splits)
        state.status[np.isin(state.tree.problem, list(given_up)) & (state.status == OPEN)] = FAILED
        if progress is not None:
            progress(state)
    state.status[state.status == OPEN] = FAILED
    if _over(deadline) and (state.status == FAILED).any():
        state.stopped = deadline.word
    return state


def _over(deadline: Deadline) -> bool:
    """Whether time is up by now (it may have been left a moment ago)."""
    return deadline.expired


def _first_cells(engine: Engine, problems: int, factors: int) -> Exploration:
    tree = CellTree(
        -np.ones((problems, factors)),
        np.ones((problems, factors)),
        -np.ones(problems, dtype=np.intp),
        np.arange(problems),
    )
    loop = engine.model.loop
    inputs = len(loop.plant.inputs)
    return _with_empty_results(
        Exploration(
            tree,
            np.zeros(0, dtype=np.intp),
            np.zeros((0, len(loop.requirements))),
            np.zeros((0, len(loop.requirements))),
            np.zeros(0),
            np.zeros(0),
            np.zeros(0, dtype=np.intp),
            {},
            np.zeros((0, len(SOURCES))),
            {},
            np.zeros((0, inputs)),
            np.zeros((0, inputs)),
            np.zeros((0, inputs)),
        )
    )


def _with_empty_results(state: Exploration) -> Exploration:
    """Grow the result arrays to the size of the tree."""
    missing = state.tree.parent.size - state.status.size
    state.status = np.concatenate([state.status, np.full(missing, OPEN, dtype=np.intp)])
    state.margins = np.concatenate([state.margins, np.full((missing, state.margins.shape[1]), -np.inf)])
    state.times = np.concatenate([state.times, np.full((missing, state.times.shape[1]), np.nan)])
    state.value = np.concatenate([state.value, np.full(missing, -np.inf)])
    state.undiscounted = np.concatenate([state.undiscounted, np.full(missing, -np.inf)])
    state.reached = np.concatenate([state.reached, np.zeros(missing, dtype=np.intp)])
    state.growth = np.concatenate([state.growth, np.zeros((missing, state.growth.shape[1]))])
    inputs = state.deployed_error.shape[1]
    state.action_lower = np.concatenate([state.action_lower, np.full((missing, inputs), np.inf)])
    state.action_upper = np.concatenate([state.action_upper, np.full((missing, inputs), -np.inf)])
    state.deployed_error = np.concatenate([state.deployed_error, np.zeros((missing, inputs))])
    return state


MOST_HULLS = 4096
"""Flowpipe hulls are kept for so many cells at most."""


def _run_batch(
    engine: Engine,
    initial: InitialSet,
    state: Exploration,
    cells: Indices,
    observation_radii: Array,
    deadline: Deadline,
) -> None:
    """Run cells through the horizon and enter what was found."""
    loop, options = engine.model.loop, engine.options
    tree = state.tree.select(cells)
    count = cells.size
    center, rows, radius = initial.cells(tree.lower, tree.upper)
    batch = engine.start(center, rows, radius, observation_radii[tree.problem])
    watch = Watch.over(loop, options, batch.tracked.coordinates(slice(0, engine.model.states)))
    # a root runs on after a failure: its V(s0), its plot and its reason are what the user gets to see
    whole = tree.parent < 0
    sound = np.zeros(count, dtype=np.intp)
    recorder = Recorder(engine.model)

    def observer(period: Period) -> Bools:
        index = period.index
        watch.see(period)
        recorder.see(period)
        sound[index[period.sound]] += 1
        action, own = period.action.interval, cells[index]
        state.growth[own] = period.growth
        state.action_lower[own] = np.minimum(state.action_lower[own], action.lower)
        state.action_upper[own] = np.maximum(state.action_upper[own], action.upper)
        state.deployed_error[own] = np.maximum(state.deployed_error[own], period.deployed_error)
        state.periods_enclosed += int(index.size)
        if deadline.expired:
            return np.zeros(index.size, dtype=bool)
        return ~watch.failed[index] | whole[index]

    final = engine.run(batch, observer)
    arrived = np.zeros(count, dtype=bool)
    arrived[final.index] = True
    arrived &= sound == loop.periods
    watch.flush()
    for monitor in watch.monitors:
        monitor.finish()
    proved = arrived.copy()
    first_failure: dict[int, float] = {}
    for number, monitor in enumerate(watch.monitors):
        proved &= monitor.proved
        state.margins[cells, number] = np.where(arrived | monitor.failed, monitor.margin, -np.inf)
        state.times[cells, number] = monitor.time
        for local, place in monitor.failing.items():
            earlier = first_failure.get(local, np.inf)
            if monitor.failed[local] and not (monitor.failed_at[local] >= earlier):
                first_failure[local] = float(monitor.failed_at[local])
                state.failing[int(cells[local])] = (number, place)
    if watch.performance is not None:
        value, undiscounted = watch.performance.value()
        state.value[cells], state.undiscounted[cells] = value, undiscounted
    state.reached[cells] = np.minimum(sound, watch.periods_before_failure())
    state.status[cells] = np.where(proved, PROVED, FAILED)
    clear = {} if watch.performance is None else watch.performance.clear
    for local in np.flatnonzero(proved).tolist():
        state.evidence[int(cells[local])] = recorder.leaf(local, watch.monitors, clear)
    for local in range(count):
        if len(state.hulls) < MOST_HULLS:
            curves = np.array([monitor.curve[local] for monitor in watch.monitors])
            state.hulls[int(cells[local])] = watch.points[local], watch.intervals[local], curves


def _cut(engine: Engine, state: Exploration, cells: Indices, most: int) -> None:
    """Cut failed cells in half; the children are open."""
    room = most - int(np.isin(state.status, (OPEN, PROVED, FAILED)).sum())
    cells = cells[: max(room, 0)]
    if cells.size == 0:
        return
    tree = state.tree
    dimension = _cut_dimensions(engine, state, cells)
    width = tree.upper[cells, dimension] - tree.lower[cells, dimension]
    wide = width > SMALLEST_CELL
    cells, dimension = cells[wide], dimension[wide]
    if cells.size == 0:
        return
    lower, upper = np.repeat(tree.lower[cells], 2, 0), np.repeat(tree.upper[cells], 2, 0)
    middle = 0.5 * (tree.lower[cells, dimension] + tree.upper[cells, dimension])
    upper[0::2][np.arange(cells.size), dimension] = middle
    lower[1::2][np.arange(cells.size), dimension] = middle
    state.status[cells] = CUT
    for cell in cells:
        state.failing.pop(int(cell), None)
        state.hulls.pop(int(cell), None)
    state.tree = CellTree(
        np.concatenate([tree.lower, lower]),
        np.concatenate([tree.upper, upper]),
        np.concatenate([tree.parent, np.repeat(cells, 2)]),
        np.concatenate([tree.problem, np.repeat(tree.problem[cells], 2)]),
    )
    _with_empty_results(state)


def _cut_dimensions(engine: Engine, state: Exploration, cells: Indices) -> Indices:
    """Factor with the largest generator in the failing margin's direction; else the widest one."""
    tree = state.tree
    width = tree.upper[cells] - tree.lower[cells]
    effect = width * 2.0**-30
    for position, cell in enumerate(cells):
        if int(cell) in state.failing:
            number, place = state.failing[int(cell)]
            direction = failing_direction(engine, number, place)
            effect[position] += np.abs(place.generators[0, : width.shape[1]] @ direction)
    return np.asarray(np.where(width > SMALLEST_CELL, effect, -1.0).argmax(1), dtype=np.intp)


def failing_direction(engine: Engine, number: int, place: Zonotope) -> Array:
    """Normal of the facet that decides a failed margin, pointing the way the set should not go."""
    from .separation import containment_margins, facet_separation, prepare_polytope

    requirement = engine.model.loop.requirements[number]
    best, direction = -np.inf, np.zeros(place.dimension)
    for member in requirement.region:
        facets = prepare_polytope(member)
        if requirement.kind == "avoid":
            margin, which = facet_separation(place, facets)
            value, normal = float(margin[0]), -facets.normals.mid[which[0]]
        else:
            margins = containment_margins(place, facets)[0]
            value, normal = float(margins.min()), facets.normals.mid[margins.argmin()]
        if value > best or not direction.any():
            best, direction = value, normal
    return direction


def _extreme_factors(engine: Engine, state: Exploration, cells: Indices) -> Array:
    """Initial factors of the failing sets' extreme points, shape (k, p): where a witness is most likely."""
    tree = state.tree
    found = []
    for cell in cells[:64]:
        if int(cell) not in state.failing:
            continue
        number, place = state.failing[int(cell)]
        direction = failing_direction(engine, number, place)
        signs = np.sign(place.generators[0, : tree.lower.shape[1]] @ direction)
        middle, half = 0.5 * (tree.lower[cell] + tree.upper[cell]), 0.5 * (tree.upper[cell] - tree.lower[cell])
        found.append(middle + half * signs)
    return np.array(found).reshape(len(found), tree.lower.shape[1])


def total_growth(growth: Array) -> dict[str, float]:
    """Growth by source, largest first."""
    order = np.argsort(-growth)
    return {SOURCES[i]: float(growth[i]) for i in order}
