"""The laws of a sound engine, as functions that raise AssertionError.

`test_laws` calls them on the engine as it is, `test_teeth` on an engine that was broken on purpose. They reach every
engine function through its module, so that a replaced function is the one that is judged.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from fractions import Fraction
from itertools import product
from typing import Any

import numpy as np
from scipy.integrate import solve_ivp

from setrl.models.closed_loop import ClosedLoop
from setrl.models.float_algebra import FloatAlgebra
from setrl.models.onnx_runtime import deployed_runner
from setrl.models.policy import Activation, activate, forward
from setrl.models.sampling import corner_states, sample_disturbances, sample_noise, uniform_states
from setrl.models.simulation import act, observe, returns, simulate
from setrl.models.tape import Tape, run
from setrl.verify import (
    closed_loop,
    deployed,
    flow,
    integrator,
    network,
    performance,
    relaxations,
    separation,
    splitting,
    watch,
    zonotope,
)
from setrl.verify.balls import Ball
from setrl.verify.deadline import Deadline
from setrl.verify.model import initial_box, observation_radius, prepare
from setrl.verify.options import Options
from setrl.verify.splitting import InitialSet
from setrl.verify.zonotope import Zonotope

Array = Any
F = Fraction
DEFAULT = Options()


# Points and directions ---------------------------------------------------------------------------


def directions(dimension: int, count: int = 70) -> Array:
    """Axes both ways, then fixed random directions, half of them sparse."""
    generator = np.random.default_rng(dimension)
    lines = generator.normal(size=(count, dimension))
    lines[::2] *= generator.random((len(lines[::2]), dimension)) < 0.5
    lines[~lines.any(1)] = 1.0
    lines /= np.abs(lines).max(1, keepdims=True)
    return np.concatenate([np.eye(dimension), -np.eye(dimension), lines])[:count]


def points_of(z: Zonotope, factors: Array, cell: int = 0) -> Array:
    """Members of a set from factors (k, q + n): the generators' first, then those of the boxed part."""
    count = z.generators.shape[1]
    return z.center[cell] + factors[:, :count] @ z.generators[cell] + factors[:, count:] * z.radius[cell]


def factors_of(z: Zonotope) -> int:
    """Number of factors of a set."""
    return int(z.generators.shape[1]) + z.dimension


def extreme_factors(z: Zonotope, function: Callable[[Array], Array], lines: Array, sweeps: int = 1) -> Array:
    """Corners of the factors that drive a function far into every direction: linear guess, then coordinate ascent."""
    count = factors_of(z)
    base = function(z.center[:1])
    step = 1e-6
    slopes = (function(points_of(z, step * np.eye(count))) - base) / step
    chosen = np.where(slopes @ lines.T >= 0.0, 1.0, -1.0).T
    best = (function(points_of(z, chosen)) * lines).sum(1)
    for _ in range(sweeps):
        for position in range(count):
            trial = chosen.copy()
            trial[:, position] *= -1.0
            value = (function(points_of(z, trial)) * lines).sum(1)
            better = value > best
            chosen[better], best = trial[better], np.maximum(value, best)
    return chosen


def random_factors(z: Zonotope, count: int, seed: int = 0) -> Array:
    """Half random corners, half uniform."""
    generator = np.random.default_rng(seed)
    factors = generator.uniform(-1.0, 1.0, size=(count, factors_of(z)))
    factors[::2] = np.sign(factors[::2])
    return factors


def assert_inside(z: Zonotope, points: Array, tolerance: float = 0.0, cell: int = 0) -> None:
    """No point is beyond the set's support in any of the directions."""
    lines = directions(z.dimension)
    bound = z.support(lines)[cell]
    assert np.isfinite(bound).all(), "the set has no finite support"
    reached = points @ lines.T
    slack = tolerance + 1e-13 * (np.abs(points) @ np.abs(lines).T)
    excess = (reached - slack - bound).max(0)
    worst = int(excess.argmax())
    assert (reached <= bound + slack).all(), f"a point is {excess[worst]:.3g} outside in direction {lines[worst]}"


def assert_no_separation(first: Zonotope, second: Zonotope, tolerance: float = 1e-12) -> None:
    """Two enclosures of one set: no direction separates them."""
    lines = directions(first.dimension)
    gap = -(first.support(lines) + second.support(-lines))
    assert (gap <= tolerance).all(), f"the sets are {gap.max():.3g} apart"


def random_set(dimension: int, rows: int, seed: int, size: float = 1.0, boxed: float = 0.1) -> Zonotope:
    """A zonotope with a boxed part."""
    generator = np.random.default_rng(seed)
    return Zonotope(
        generator.normal(size=(1, dimension)),
        size * generator.normal(size=(1, rows, dimension)),
        boxed * size * generator.random((1, dimension)),
    )


# Set operations ----------------------------------------------------------------------------------


@dataclass(frozen=True)
class Image:
    """A set, an operation of the engine on it, and the function that the operation encloses."""

    name: str
    given: Zonotope
    operation: Callable[[Zonotope], Zonotope]
    function: Callable[[Array], Array]

    def __str__(self) -> str:
        return self.name


def law_image(subject: Image, sweeps: int = 1) -> None:
    """The image of every member is a member of the result, extreme corners first."""
    result = subject.operation(subject.given)
    lines = directions(result.dimension)
    factors = np.concatenate(
        [extreme_factors(subject.given, subject.function, lines, sweeps), random_factors(subject.given, 400)]
    )
    assert_inside(result, subject.function(points_of(subject.given, factors)))


def law_hull(subject: Image) -> None:
    """The enclosing interval contains the support along every axis, and the sum of generators."""
    result = subject.operation(subject.given)
    axes = np.eye(result.dimension)
    interval = result.interval
    exact = np.abs(result.generators).sum(1) + result.radius
    assert (interval.upper >= result.center + exact).all() and (interval.lower <= result.center - exact).all()
    wide = np.abs(result.center) + exact
    assert (interval.upper >= result.support(axes) - 1e-12 * (1 + wide)).all()
    assert (-interval.lower >= result.support(-axes) - 1e-12 * (1 + wide)).all()


def law_exact_affine(z: Zonotope, weight: Array, bias: Array, weight_error: Array, signs: Array) -> None:
    """``W z + b`` in rationals, at a corner of factors, lies in the engine's result."""
    result = zonotope.linear_map(z, Ball(weight, weight_error), Ball(bias, np.zeros_like(bias)))
    count = z.generators.shape[1]
    point = [
        F(float(z.center[0, i]))
        + sum((F(float(z.generators[0, j, i])) * int(signs[j]) for j in range(count)), F(0))
        + F(float(z.radius[0, i])) * int(signs[count + i])
        for i in range(z.dimension)
    ]
    for row in range(len(weight)):
        turn = 1 if row % 2 else -1
        exact = F(float(bias[row]))
        for i in range(z.dimension):
            exact += (F(float(weight[row, i])) + turn * F(float(weight_error[row, i]))) * point[i]
        own = F(float(result.center[0, row]))
        own += sum((F(float(result.generators[0, j, row])) * int(signs[j]) for j in range(count)), F(0))
        assert abs(exact - own) <= F(float(result.radius[0, row])), "the boxed part does not cover the rounding"


def law_reduction(z: Zonotope, protected: int, rows: int) -> None:
    """Order reduction contains the set, exactly, keeps the protected rows, and has the promised number of rows."""
    result, boxed, _ = zonotope.reduce_order(z, protected, rows, np.where(z.spread > 0, z.spread, 1.0))
    assert result.generators.shape[1] == rows
    assert (result.generators[:, :protected] == z.generators[:, :protected]).all()
    assert (boxed >= 0).all()
    assert_dominates(result, z)


def law_merge(z: Zonotope, shared: int, rows: int) -> None:
    """Merging private rows contains the set and keeps the shared rows."""
    result, _ = network.merge_rows(z, shared, rows)
    assert (result.generators[:, :shared] == z.generators[:, :shared]).all()
    assert not result.radius.any()
    assert_dominates(result, z)


def assert_dominates(large: Zonotope, small: Zonotope) -> None:
    """The support function of one set is nowhere below that of another; in rationals, generator by generator."""
    for cell in range(small.batch):
        for line in directions(small.dimension, 24):
            exact = [F(float(x)) for x in line]
            assert exact_support(large, cell, exact) >= exact_support(small, cell, exact), "smaller support"


def exact_support(z: Zonotope, cell: int, line: Sequence[Fraction]) -> Fraction:
    """Support function in rationals."""
    total = sum((F(float(c)) * x for c, x in zip(z.center[cell], line, strict=True)), F(0))
    for row in z.generators[cell]:
        total += abs(sum((F(float(g)) * x for g, x in zip(row, line, strict=True)), F(0)))
    return total + sum((F(float(r)) * abs(x) for r, x in zip(z.radius[cell], line, strict=True)), F(0))


# Activations -------------------------------------------------------------------------------------


def exact_activation(activation: Activation, x: float) -> tuple[Fraction, Fraction]:
    """Rational bounds of an activation at a float."""
    import flint

    point = F(x)
    match activation.kind:
        case "relu":
            value = max(point, F(0))
        case "leaky_relu":
            value = point if x >= 0 else F(activation.slope) * point
        case "clip":
            low, high = activation.lower, activation.upper
            value = point
            value = F(low) if np.isfinite(low) and value < F(low) else value
            value = F(high) if np.isfinite(high) and value > F(high) else value
        case _:
            flint.ctx.prec = 200
            if activation.kind == "sigmoid" and abs(x) > 1e3:  # between 0 and 2^-1000, or 1 - 2^-1000 and 1
                return (F(0), F(1, 2**1000)) if x < 0 else (1 - F(1, 2**1000), F(1))
            ball = flint.arb(x)
            return rational_bounds(ball.tanh() if activation.kind == "tanh" else 1 / (1 + (-ball).exp()))
    return value, value


def rational_bounds(ball: Any) -> tuple[Fraction, Fraction]:
    """Rational bounds of a flint ball."""
    mid, rad = ball.mid().man_exp(), ball.rad().man_exp()
    center, radius = (F(int(m)) * F(2) ** int(e) for m, e in (mid, rad))
    return center - radius, center + radius


def law_relaxation(activation: Activation, lower: float, upper: float, samples: int = 41) -> None:
    """slope x + offset +- error encloses the activation, in rationals, on a dense grid and at the critical points."""
    low, high = np.array([[lower]]), np.array([[upper]])
    relaxation = relaxations.relax(activation, low, high)
    slope, offset, error = (float(x[0, 0]) for x in (relaxation.slope, relaxation.offset, relaxation.error))
    assert np.isfinite([slope, offset, error]).all() and error >= 0.0
    grid = {lower, upper, *np.linspace(0.5 * lower, 0.5 * upper, samples) * 2.0}
    grid |= {float(np.nextafter(lower, upper)), float(np.nextafter(upper, lower)), 0.5 * lower + 0.5 * upper}
    grid |= {x for x in (0.0, activation.lower, activation.upper) if np.isfinite(x)}
    if activation.kind in ("tanh", "sigmoid"):
        factor = 1.0 if activation.kind == "tanh" else 4.0
        with np.errstate(all="ignore"):
            place = float(np.arctanh(np.sqrt(max(0.0, 1.0 - factor * slope)))) * (1.0 if factor == 1.0 else 2.0)
        grid |= {s * place * (1 + d) for s in (-1, 1) for d in (-1e-8, 0.0, 1e-8) if np.isfinite(place)}
    for x in grid:
        if lower <= x <= upper:
            least, most = exact_activation(activation, float(x))
            line = F(slope) * F(float(x)) + F(offset)
            assert line - F(error) <= least and most <= line + F(error), (activation, x, lower, upper)


def law_relaxation_without_bounds(activation: Activation) -> None:
    """No finite error where there are no bounds."""
    for low, high in ((np.nan, np.nan), (-np.inf, np.inf), (np.nan, 1.0), (-1.0, np.nan)):
        with np.errstate(all="ignore"):
            relaxation = relaxations.relax(activation, np.array([[low]]), np.array([[high]]))
            value = relaxation.slope * 0.0 + relaxation.offset + relaxation.error
        assert not np.isfinite(value).any(), f"{activation.kind} on [{low}, {high}] looks bounded"


# Flow steps --------------------------------------------------------------------------------------


@dataclass(frozen=True)
class FlowCase:
    """One integrator step of one plant from one set of joint states (states, inputs, disturbances)."""

    name: str
    tape: Tape
    given: Zonotope
    duration: Fraction
    order: int
    method: str = "jets"
    rows: int = 8

    def __str__(self) -> str:
        return f"{self.name}-{self.method}"

    def step(self) -> Any:
        """The engine's step."""
        if self.method == "linearization":
            from setrl.verify import linearization

            return linearization.linear_step(self.tape, self.given, self.duration, self.order)
        return flow.jet_step(self.tape, self.given, self.duration, self.order, self.rows)


def true_flow(tape: Tape, starts: Array, times: Array) -> Array:
    """Trajectories by DOP853: (N, d) to (len(times), N, n)."""
    states = len(tape.outputs)
    constants = starts[:, states:]

    def slope(_: float, flat: Array) -> Array:
        x = flat.reshape(len(starts), states)
        values = run(tape, FloatAlgebra(), [*x.T, *constants.T])
        return np.stack([np.broadcast_to(v, len(x)) for v in values], 1).ravel()

    result = solve_ivp(
        slope,
        (0.0, float(times[-1])),
        starts[:, :states].ravel(),
        method="DOP853",
        t_eval=times,
        rtol=1e-12,
        atol=1e-14,
    )
    assert result.success
    return result.y.T.reshape(len(times), len(starts), states)


SIMULATION = 2e-11
"""Tolerance for DOP853's own error, relative to 1 + |x|: far below what any broken step misses by."""


def extreme_starts(case: FlowCase, end: Zonotope) -> Array:
    """Members of the start set that the end set's own generators call extreme, and random corners."""
    given = case.given
    states, count = len(case.tape.outputs), given.generators.shape[1]
    lines = directions(states)
    signs = np.where(end.generators[0, :count, :states] @ lines.T >= 0.0, 1.0, -1.0).T
    boxed = np.tile(np.where(lines >= 0.0, 1.0, -1.0), (1, 1 + given.dimension // states))[:, : given.dimension]
    factors = np.concatenate([np.concatenate([signs, boxed], 1), random_factors(given, 200, 3)])
    return points_of(given, factors)


def law_flow_end(case: FlowCase) -> None:
    """Every true trajectory from the start set ends inside the end set."""
    step = case.step()
    assert step.sound.all(), "the case proves nothing"
    starts = extreme_starts(case, step.end)
    ends = true_flow(case.tape, starts, np.array([float(case.duration)]))[0]
    joint = np.concatenate([ends, starts[:, ends.shape[1] :]], 1)
    assert_inside(step.end, joint, SIMULATION * (1 + np.abs(ends).max()))


def law_flow_between(case: FlowCase, slabs: int = 3) -> None:
    """At every time of every part of the step, true trajectories are inside that part's set."""
    step = case.step()
    assert step.sound.all()
    sets = step.time_intervals(slabs)
    assert len(sets) == slabs
    samples = 4
    starts = extreme_starts(case, step.end)
    times = float(case.duration) * np.arange(1, slabs * samples + 1) / (slabs * samples)
    path = np.concatenate([starts[None, :, : len(case.tape.outputs)], true_flow(case.tape, starts, times)])
    for part, z in enumerate(sets):
        for moment in range(part * samples, (part + 1) * samples + 1):
            assert_inside(z, path[moment], SIMULATION * (1 + np.abs(path).max()))


def law_steps_intersect(first: FlowCase, second: FlowCase) -> None:
    """Two sound enclosures of one reachable set cannot be separated, at the end and in between."""
    one, two = first.step(), second.step()
    assert one.sound.all() and two.sound.all()
    assert_no_separation(one.end, two.end)
    for a, b in zip(one.time_intervals(2), two.time_intervals(2), strict=True):
        assert_no_separation(a, b)


# Closed loops ------------------------------------------------------------------------------------


@dataclass(frozen=True)
class LoopCase:
    """A bound closed loop, the options it is enclosed with, and how many periods must be enclosed."""

    name: str
    loop: ClosedLoop
    options: Options = DEFAULT
    least: int = 1

    def __str__(self) -> str:
        return self.name


def engine_of(loop: ClosedLoop, options: Options) -> tuple[closed_loop.Engine, InitialSet]:
    """Engine and initial set of a loop."""
    model = prepare(loop)
    initial = InitialSet.of(*initial_box(loop))
    return closed_loop.Engine(model, options, initial.free.size + model.constant.size), initial


def first_cells(
    engine: closed_loop.Engine, initial: InitialSet, lower: Array = None, upper: Array = None
) -> closed_loop.Cells:
    """Cells from boxes of factors, the whole set by default."""
    whole = np.ones((1, initial.free.size))
    lower, upper = -whole if lower is None else lower, whole if upper is None else upper
    radius = np.tile(observation_radius(engine.model.loop), (len(lower), 1))
    return engine.start(*initial.cells(lower, upper), radius)


def periods_of(loop: ClosedLoop, options: Options) -> list[tuple[closed_loop.Cells, closed_loop.Period]]:
    """Run one cell through the horizon: the cells before each sound period, and the period."""
    engine, initial = engine_of(loop, options)
    cells = first_cells(engine, initial)
    found = []
    with np.errstate(all="ignore"):
        for number in range(loop.periods):
            period, after = engine.advance(number, cells)
            if not period.sound.all():
                break
            found.append((cells, period))
            cells = after
    return found


def rollouts(loop: ClosedLoop, count: int, seed: int, samples: int = 1) -> Any:
    """Simulated trajectories under corner and uniform perturbations, held ones among them."""
    generator = np.random.default_rng(seed)
    corners = corner_states(loop, 64)
    starts = np.concatenate([corners[generator.integers(0, len(corners), count // 2)]])
    starts = np.concatenate([starts, uniform_states(loop, count - len(starts), generator)])
    half = count // 2
    noise = np.concatenate(
        [sample_noise(loop, "corner", half, generator), sample_noise(loop, "uniform", count - half, generator)]
    )
    held = slice(0, count // 4)
    noise[held] = noise[held, :1]
    forces = np.concatenate(
        [
            sample_disturbances(loop, "corner", half, generator),
            sample_disturbances(loop, "uniform", count - half, generator),
        ]
    )
    forces[held] = forces[held, :1]
    return simulate(loop, starts, noise, forces, samples_per_period=samples)


def law_flowpipe(case: LoopCase, count: int = 60, seed: int = 1) -> None:
    """Simulated trajectories stay inside time-point sets, time-interval sets and action sets."""
    found = periods_of(case.loop, case.options)
    assert len(found) >= case.least, f"only {len(found)} periods were enclosed"
    samples = 1 if case.loop.plant.discrete else 4
    simulated = rollouts(case.loop, count, seed, samples)
    for number, (_, period) in enumerate(found):
        states = simulated.states[:, number * samples : (number + 1) * samples + 1]
        tolerance = 1e-8 * (1 + np.abs(states).max())
        assert_inside(period.end, states[:, -1], tolerance)
        assert_inside(period.action, simulated.actions[:, number], tolerance)
        for group in period.flow.groups:
            length = len(group.steps)
            for moment in range(samples + 1):
                fitting = [s for s in range(length) if s * samples <= moment * length <= (s + 1) * samples]
                for s in fitting:
                    z = group.steps[s].time_intervals(1)[0]
                    assert_inside(z, states[:, moment], tolerance)


def law_one_period(case: LoopCase, every: int = 1) -> None:
    """From the extreme points of each claimed set, one true control period ends inside the next claimed set."""
    found = periods_of(case.loop, case.options)
    assert len(found) >= case.least
    loop = case.loop
    states, inputs = len(loop.plant.states), len(loop.plant.inputs)
    model = prepare(loop)
    generator = np.random.default_rng(5)
    for cells, period in found[::every]:
        z = cells.tracked
        count = z.generators.shape[1]
        lines = directions(states)
        signs = np.where(period.end.generators[0, :count] @ lines.T >= 0.0, 1.0, -1.0).T
        boxed = np.where(generator.random((len(lines), z.dimension)) < 0.5, -1.0, 1.0)
        boxed[:, :states] = np.where(lines >= 0.0, 1.0, -1.0)
        factors = np.concatenate([np.concatenate([signs, boxed], 1)] * 6 + [random_factors(z, 120, 7)])
        tracked = points_of(z, factors)
        own = tracked[:, :states]
        radius = np.array([float(r) for r in loop.observation_radius]) * (1 - 1e-15)
        noise = np.sign(generator.normal(size=(len(own), radius.size))) * radius
        computed = act(loop, observe(loop, own) + noise)
        queue = tracked[:, states + model.constant.size :]
        action = queue[:, :inputs] if loop.delay else computed
        forces = np.zeros((len(own), len(loop.disturbances)))
        forces[:, model.constant] = tracked[:, states : states + model.constant.size]
        for i in model.varying:
            bounds = float(loop.disturbances[i].lower), float(loop.disturbances[i].upper)
            forces[:, i] = np.where(generator.random(len(own)) < 0.5, *bounds)
        joint = np.concatenate([own, action, forces], 1)
        if loop.plant.discrete:
            values = run(loop.plant.tape, FloatAlgebra(), list(joint.T))
            ends = np.stack([np.broadcast_to(v, len(joint)) for v in values], 1)
        else:
            ends = true_flow(loop.plant.tape, joint, np.array([float(loop.period)]))[0]
        tolerance = 1e-10 * (1 + np.abs(ends).max())
        assert_inside(period.computed, computed, tolerance)
        assert_inside(period.action, action, tolerance)
        assert_inside(period.end, ends, tolerance)
        if loop.delay:
            law_queue(case, cells, period, tracked, ends, computed, tolerance)


def law_queue(
    case: LoopCase, cells: Any, period: Any, tracked: Array, ends: Array, computed: Array, slack: float
) -> None:
    """With a delay, end states and waiting actions are *jointly* inside the next tracked set."""
    engine, _ = engine_of(case.loop, case.options)
    with np.errstate(all="ignore"):
        _, after = engine.advance(period.number, cells)
    model = engine.model
    first = model.states + model.constant.size
    waiting = tracked[:, first + model.inputs :]
    joint = np.concatenate([ends, tracked[:, model.states : first], waiting, computed], 1)
    assert_inside(after.tracked, joint, slack)


def final_set(loop: ClosedLoop, options: Options) -> Zonotope:
    """The last time-point set of a loop that must be enclosed to its end."""
    found = periods_of(loop, options)
    assert len(found) == loop.periods, f"only {len(found)} of {loop.periods} periods were enclosed"
    return found[-1][1].end


def law_final_sets_intersect(first: LoopCase, second: LoopCase, ratio: float | None = None) -> None:
    """Two runs of the same closed loop cannot be separated; `ratio` bounds the quotient of their widths."""
    one, two = final_set(first.loop, first.options), final_set(second.loop, second.options)
    assert_no_separation(one, two)
    if ratio is not None:
        quotient = one.spread / two.spread
        assert (quotient <= ratio).all() and (quotient >= 1 / ratio).all(), f"widths differ by {quotient}"


def law_subset(small: LoopCase, large: LoopCase, tolerance: float = 0.02) -> None:
    """The hull from a part of the initial set lies in the hull from the whole of it (up to a share of its width)."""
    for (_, inner), (_, outer) in zip(
        periods_of(small.loop, small.options), periods_of(large.loop, large.options), strict=True
    ):
        a, b = inner.end.interval, outer.end.interval
        assert (a.upper <= b.upper + tolerance * b.rad).all() and (a.lower >= b.lower - tolerance * b.rad).all()


def law_batch(loop: ClosedLoop, options: Options, lower: Array, upper: Array) -> int:
    """Each cell of a batch gets what it gets alone, whatever the others do; the number of cells that survived."""
    engine, initial = engine_of(loop, options)

    def ends(low: Array, high: Array) -> dict[tuple[int, int], tuple[Array, Array]]:
        found = {}

        def observer(period: Any) -> Array:
            for position, cell in enumerate(period.index):
                if period.sound[position]:
                    z = period.end[position : position + 1]
                    found[int(cell), period.number] = z.center[0], z.spread[0]
            return np.ones(period.index.size, dtype=bool)

        with np.errstate(all="ignore"):
            engine.run(first_cells(engine, initial, low, high), observer)
        return found

    together = ends(lower, upper)
    for cell in range(len(lower)):
        alone = ends(lower[cell : cell + 1], upper[cell : cell + 1])
        assert {k for c, k in together if c == cell} == {k for _, k in alone}, "another cell ended this one"
        for (_, number), (center, spread) in alone.items():
            other = together[cell, number]
            np.testing.assert_allclose(other[0], center, rtol=1e-10, atol=1e-12 * (1 + np.abs(spread).max()))
            np.testing.assert_allclose(other[1], spread, rtol=1e-9, atol=1e-13)
    return len({c for c, k in together if k == loop.periods - 1})


# Splitting ---------------------------------------------------------------------------------------


def law_children_cover(initial: InitialSet, lower: Array, upper: Array, dimension: int) -> None:
    """In rationals: a cell's set contains its exact box, and two halves cover their parent."""
    middle = 0.5 * (lower[dimension] + upper[dimension])
    left, right = upper.copy(), lower.copy()
    left[dimension] = right[dimension] = middle
    parts = [(lower, upper), (lower, left), (right, upper)]
    sets = []
    for low, high in parts:
        center, rows, radius = initial.cells(low[None], high[None])
        width = np.abs(rows).sum(1) + radius
        for i, state in enumerate(initial.free):
            exact = F(float(initial.center[state])), F(float(initial.radius[state]))
            bounds = [exact[0] + exact[1] * F(float(side[i])) for side in (low, high)]
            own = F(float(center[0, state])), F(float(width[0, state]))
            assert own[0] - own[1] <= bounds[0] and bounds[1] <= own[0] + own[1], "a cell misses a part of its box"
        sets.append((center, rows))
    assert left[dimension] == right[dimension]


def law_tree_covers(tree: Any, status: Array, cut: int) -> None:
    """Every cell that was cut has exactly two children that share its bounds but for one halved side."""
    for cell in np.flatnonzero(status == cut):
        children = np.flatnonzero(tree.parent == cell)
        assert len(children) == 2
        one, two = children
        differs = np.flatnonzero(tree.upper[one] != tree.upper[cell])
        assert differs.size == 1
        d = int(differs[0])
        assert tree.upper[one, d] == tree.lower[two, d], "a gap between two children"
        assert (np.delete(tree.upper[one], d) == np.delete(tree.upper[cell], d)).all()
        assert (np.delete(tree.lower[two], d) == np.delete(tree.lower[cell], d)).all()
        assert (tree.lower[one] == tree.lower[cell]).all() and (tree.upper[two] == tree.upper[cell]).all()


# Requirements and performance --------------------------------------------------------------------


NOTHING = (np.nan, np.inf, -np.inf)


def broken_sets(dimension: int) -> list[Zonotope]:
    """Sets with a NaN or an infinity in the center, a generator or the boxed part."""
    good = random_set(dimension, 4, 1, size=1e-3)
    made = []
    for value, part in product(NOTHING, ("center", "generators", "radius")):
        if part == "radius" and value == -np.inf:
            continue
        array = getattr(good, part).copy()
        array.reshape(-1)[0] = value
        made.append(replace(good, **{part: array}))
    return made


def law_nan_never_proves(case: LoopCase) -> None:
    """Whoever watches a set without finite bounds has proved nothing, and V is minus infinity."""
    loop = case.loop
    for z in broken_sets(len(loop.plant.states)):
        with np.errstate(all="ignore"):
            watch = watched(loop, case.options, z)
        for monitor in watch.monitors:
            assert not monitor.proved.any(), f"{monitor.requirement.kind} was proved of nothing"
        if watch.performance is not None:
            assert all((value == -np.inf).all() for value in watch.performance.value())


def watched(loop: ClosedLoop, options: Options, z: Zonotope) -> Any:
    """What is found of a loop whose reachable set is always the same; everything else is as in a real run."""
    engine, initial = engine_of(loop, options)
    real, _ = engine.advance(0, first_cells(engine, initial))
    watcher = watch.Watch.over(loop, options, z)
    steps = () if loop.plant.discrete else (Frozen(z, loop.period),)
    joint = replace(real.flow, groups=(integrator.StepGroup(np.array([0]), steps),), end=z)
    for number in range(loop.periods):
        watcher.see(replace(real, number=number, start=z, end=z, flow=joint))
    watcher.flush()
    for monitor in watcher.monitors:
        monitor.finish()
    return watcher


class Frozen:
    """A step that never moves."""

    def __init__(self, z: Zonotope, duration: Fraction) -> None:
        self.end, self.duration = z, duration
        self.added = self.truncation = np.zeros_like(z.center)
        self.sound = np.ones(z.batch, dtype=bool)

    @classmethod
    def join(cls, steps: Sequence[Frozen]) -> Frozen:
        return cls(zonotope.stack_cells([step.end for step in steps]), steps[0].duration)

    def select(self, cells: Any) -> Frozen:
        return Frozen(self.end[cells], self.duration)

    def time_intervals(self, slabs: int) -> list[Zonotope]:
        return [self.end] * slabs


def law_worst_cost(z: Zonotope, weights: Array, target: Array, tight: bool = True) -> None:
    """The worst cost is the maximum over the vertices: never below, and above by rounding only."""
    found = float(performance.worst_cost(z, Ball(weights, 0 * weights), Ball(target, 0 * target))[0])
    corners = np.array(list(product((-1.0, 1.0), repeat=factors_of(z))))
    truth = float((np.abs(points_of(z, corners) - target) @ weights).max())
    assert found >= truth * (1 - 1e-14), f"claimed {found}, a vertex costs {truth}"
    if tight:
        assert found <= truth * (1 + 1e-12) + 1e-200


def value_of(loop: ClosedLoop, options: Options) -> float:
    """V(s0) of one unsplit cell, discounted."""
    engine, _ = engine_of(loop, replace(options, splits=1))
    with np.errstate(all="ignore"):
        found = splitting.explore(engine, observation_radius(loop)[None], Deadline.after(None))
    return float(found.value[0])


def law_value(case: LoopCase, count: int = 200, seed: int = 2) -> None:
    """V(s0) is a number, and never above the return of any simulated perturbed rollout."""
    value = value_of(case.loop, case.options)
    assert value > -np.inf
    worst = float(returns(case.loop, rollouts(case.loop, count, seed)).min())
    assert value <= worst + 1e-7 * (1 + abs(worst)), f"V is {value}, a rollout returns {worst}"


def law_value_is_the_return(case: LoopCase, relative: float) -> None:
    """From one start, without perturbation, V(s0) is the return itself."""
    value = value_of(case.loop, case.options)
    center = np.array([[float(low) for low, _ in case.loop.initial]])
    truth = float(returns(case.loop, simulate(case.loop, center, rtol=1e-12, atol=1e-13))[0])
    assert abs(value - truth) <= relative * abs(truth), f"V is {value}, the return {truth}"


def law_network_bounds(policy: Any, z: Zonotope) -> None:
    """Forward passes lie in the output set and inside the bounds that every layer claims to have seen."""
    enclosure = network.enclose_layers(policy.layers, z)
    points = points_of(z, random_factors(z, 300))
    assert_inside(enclosure.output, forward(policy.layers, points))
    values = points
    for layer, seen in zip(policy.layers, enclosure.bounds, strict=True):
        slack = 1e-12 * (1 + np.abs(values))
        assert (values >= seen.lower - slack).all() and (values <= seen.upper + slack).all()
        values = activate(layer, values) if isinstance(layer, Activation) else forward((layer,), values)


def law_no_relaxation(activation: Activation, lower: float, upper: float) -> None:
    """There is no finite relaxation: the bounds overflow."""
    relaxation = relaxations.relax(activation, np.array([[lower]]), np.array([[upper]]))
    assert not np.isfinite(relaxation.slope + relaxation.offset + relaxation.error).any()


def law_separation(z: Zonotope, normals: Array, bounds: Array) -> None:
    """Margins are below the distance that the true support gives; and no member of the set is in the polytope."""
    facets = separation.Facets(
        Ball(normals, 0 * normals), Ball(bounds, 0 * bounds), np.eye(len(bounds)), ("",) * len(bounds), 0.25
    )
    corners = np.array(list(product((-1.0, 1.0), repeat=factors_of(z))))
    points = points_of(z, np.concatenate([corners, random_factors(z, 2000)]))
    best = float(separation.facet_separation(z, facets)[0][0])
    program = separation.program_separation(z, facets)[0]
    if best > 0.0 or program > 0.0:
        assert not (points @ normals.T <= bounds).all(1).any(), "a member is in the polytope"
    weights = np.abs(np.random.default_rng(0).normal(size=(5, len(bounds))))
    margins = separation.separation_margins(z, facets, weights)[0]
    truth = (points @ (weights @ normals).T).min(0) - weights @ bounds
    assert (margins <= truth + 1e-12).all(), "a margin is larger than the distance"
    contained = separation.containment_margins(z, facets)[0]
    assert (contained <= (bounds - points @ normals.T).min(0) + 1e-12).all(), "a margin is larger than the distance"


def law_worst_cost_sampled(z: Zonotope, weights: Array, target: Array, seed: int) -> None:
    """The bound for many states is above every sampled cost."""
    found = float(performance.worst_cost(z, Ball(weights, 0 * weights), Ball(target, 0 * target))[0])
    costs = np.abs(points_of(z, random_factors(z, 2000, seed)) - target) @ weights
    assert found >= costs.max() * (1 - 1e-14)


def law_close_below(value: float, truth: float, relative: float) -> None:
    """A lower bound, and a tight one."""
    assert value <= truth + 1e-13 * abs(truth), f"V is {value}, above {truth}"
    assert value >= truth - relative * abs(truth), f"V is {value}, far below {truth}"


# Deployed arithmetic ------------------------------------------------------------------------------------------------


def real_forward(layers: Sequence[Any], point: Array) -> list[Any]:
    """Exact forward pass of one point as balls of 200 bits."""
    import flint

    flint.ctx.prec = 200
    values = [flint.arb(float(x)) for x in point]
    for layer in layers:
        if isinstance(layer, Activation):
            values = [real_activation(layer, value) for value in values]
        else:
            values = [
                sum((flint.arb(float(w)) * v for w, v in zip(row, values, strict=True)), flint.arb(float(b)))
                for row, b in zip(layer.weight, layer.bias, strict=True)
            ]
    return values


def real_activation(activation: Activation, value: Any) -> Any:
    """An activation of a thin ball."""
    import flint

    match activation.kind:
        case "relu":
            return value.max(flint.arb(0))
        case "leaky_relu":
            return value.max(flint.arb(0)) + flint.arb(activation.slope) * value.min(flint.arb(0))
        case "clip":
            low = value.max(flint.arb(activation.lower)) if np.isfinite(activation.lower) else value
            return low.min(flint.arb(activation.upper)) if np.isfinite(activation.upper) else low
        case "tanh":
            return value.tanh()
    return 1 / (1 + (-value).exp())


def law_deployed(policy: Any, lower: Array, upper: Array, count: int = 60, seed: int = 0) -> float:
    """The runtime differs from exact arithmetic by at most e_L, in batches of any size; the largest share of it."""
    import flint

    generator = np.random.default_rng(seed)
    points = generator.uniform(lower, upper, size=(count, len(lower)))
    points[: count // 3] = np.where(generator.random((count // 3, len(lower))) < 0.5, lower, upper)
    z = zonotope.from_box(np.array([lower]), np.array([upper]))
    bounds = network.enclose_layers(policy.layers, z).bounds
    error = deployed.deployed_error(policy.layers, bounds, policy.precision)[0]
    runner = deployed_runner(policy)
    share = 0.0
    for size in (count, 1, 7):
        outputs = np.concatenate([runner(points[i : i + size]) for i in range(0, count, size)])
        for point, output in zip(points, outputs, strict=True):
            for value, exact, most in zip(output, real_forward(policy.layers, point), error, strict=True):
                distance = abs(flint.arb(float(value)) - exact)
                assert distance <= flint.arb(float(most)), f"off by {distance}, claimed {most}"
                share = max(share, float(distance.mid()) / float(most))
    return share


# Planted violations -------------------------------------------------------------------------------------------------


def planted_boundary(loop: ClosedLoop, line: Array, seed: int, rounds: int = 6, count: int = 60) -> float:
    """The largest ``line . x(T)`` that sampling and local search find."""
    generator = np.random.default_rng(seed)
    bounds = np.array([[float(low), float(high)] for low, high in loop.initial])
    radius = np.array([float(r) for r in loop.observation_radius])
    starts = np.concatenate([corner_states(loop, count // 2), uniform_states(loop, count - count // 2, generator)])
    count = len(starts)
    noise = sample_noise(loop, "corner", count, generator)
    forces = sample_disturbances(loop, "corner", count, generator)
    best = -np.inf
    for turn in range(rounds):
        run_ = simulate(loop, starts, noise, forces, rtol=1e-11, atol=1e-13)
        reached = run_.states[:, -1] @ line
        top = np.argsort(-reached)[: max(count // 8, 1)]
        best = max(best, float(reached[top[0]]))
        parents = top[generator.integers(0, len(top), count)]
        parents[: len(top)] = top
        spread = 0.5**turn
        change = generator.normal(size=starts.shape) * (bounds[:, 1] - bounds[:, 0]) * spread * 0.3
        flips = generator.random(noise.shape) < 0.3 * spread
        starts = np.clip(starts[parents] + change, bounds[:, 0], bounds[:, 1])
        noise = np.where(flips, -noise[parents], noise[parents])
        noise = np.clip(noise, -radius, radius)
        again = sample_disturbances(loop, "corner", count, generator)
        held = generator.random((count, 1, 1)) < 0.7
        forces = np.where(held, forces[parents], again)
    return best


def law_never_verified(loop: ClosedLoop, options: Options) -> None:
    """The engine alone, without the falsifier, does not prove every cell of a violated specification."""
    engine, _ = engine_of(loop, options)
    with np.errstate(all="ignore"):
        found = splitting.explore(engine, observation_radius(loop)[None], Deadline.after(None))
    leaves = found.status != splitting.CUT
    assert not (found.status[leaves] == splitting.PROVED).all(), "a violated requirement was proved"


def law_deadline(loop: ClosedLoop, limit: float) -> None:
    """A run that needs longer stops within a tenth of its limit, or one batch."""
    from setrl import verify

    moments: list[float] = []
    started = time.monotonic()
    with np.errstate(all="ignore"):
        result = verify(
            loop.policy,
            loop.specification,
            options=Options(batch=2, splits=10**6),
            progress=lambda state: moments.append(time.monotonic()),
            deadline=Deadline.after(limit),
        )
    elapsed = time.monotonic() - started
    assert result.reason is not None, "the run was not stopped"
    longest = max(np.diff([started, *moments]))
    assert 0.9 * limit <= elapsed <= 1.1 * limit + longest + 0.1, f"{elapsed} s instead of {limit}"
