"""Random closed loops as files, with a requirement whose boundary is a little inside what they reach.

What is reached is found without the falsifier: many simulations, then a search along coordinates that needs no
derivative. How far it got does not matter to the law (the point that it found violates the requirement), only to how
hard the question is.
"""

from __future__ import annotations

import hashlib
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from fractions import Fraction
from functools import lru_cache
from itertools import count, pairwise
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from loops import network

from setrl.models.binding import bind
from setrl.models.closed_loop import ClosedLoop
from setrl.models.onnx_reader import read_policy
from setrl.models.onnx_writer import policy_bytes
from setrl.models.sampling import inner_bounds
from setrl.models.simulation import act, derivative, observe, simulate
from setrl.specs.reader import parse_specification
from setrl.verify.checker.contract import read_contract
from setrl.verify.checker.witness import Proof, Witness, prove
from setrl.verify.options import Options
from setrl.verify.result import Result
from setrl.verify.verifier import verify

Array = Any
F = Fraction

WIDE, NARROW = (1e-2, 3e-3, 1e-3), (1e-4, 1e-5, 1e-6, 1e-7, 1e-8, 1e-9)
"""Fractions of the reachable set's radius: where a violation has to be found, and where it may be missed."""

PLANTS = {
    "oscillator": "x: y - {0}*x**3, y: -sin(x) + {1}*u + {2}*d",
    "functions": "x: tanh(y) - {0}*x/(2 + sin(x)) + tanh(u), "
    "y: exp(-x**2)*cos(y) + sqrt(3 + x) - log(2 + y) + {1}*tan(x/4) - d*y**3",
    "quotient": "x: {0}*y/(1 + x**2) + d, y: -x**3 + {1}*u/(2 + cos(y))**2",
    "chain": "x: y + {0}*d, y: z - x*y, z: u - {1}*z - {2}*cos(x)",
    "car": "x: z*cos(y), y: {0}*u, z: v - {1}*z + d",
    "map": "'x+': {0}*x + 0.3*sin(y) + {1}*u + d, 'y+': {2}*y - 0.2*x*y + 0.1*u**2",
    "product": "'x+': {0}*x + 0.2*sin(y) - u, 'y+': y/(1 + x**2) + {1}*u*d",
    "turn": "'x+': cos(y)*x - {0}*sin(y)*z, 'y+': y + {1}*u, 'z+': {2}*z + 0.3*v + d*x",
}
KINDS = ("relu", "tanh", "leaky_relu", "sigmoid", "clip", "none")
GRID, TENTHS = 200, 10
"""Times per control period at which the worst state is measured, and looked for; windows begin and end at these."""


# Loops --------------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Pair:
    """A plant with a network: the policy's bytes, the specification without requirements, and options."""

    name: str
    policy: bytes
    head: str
    options: Options

    def loop(self) -> ClosedLoop:
        """The closed loop, with a requirement that says nothing."""
        specification = parse_specification((self.head + "requirements: [{avoid: {x: [1.0e6, 1.1e6]}}]\n").encode())
        return bind(specification, read_policy(self.policy))


def pair_of(number: int) -> Pair:
    """The pair with a number: plants and activations in turn, everything else random."""
    generator = np.random.default_rng([41, number])
    name = [*PLANTS][number % len(PLANTS)]
    kind = KINDS[number // len(PLANTS) % len(KINDS)]
    states = "xyz" if "z" in PLANTS[name] else "xy"
    inputs = "uv" if "v" in PLANTS[name] else "u"
    views = int(generator.choice([0, 0, 0, 2, 3]))
    hidden = generator.integers(3, 8, int(generator.integers(1, 3))).tolist()
    last = str(generator.choice(["none", "none", "tanh", "sigmoid", "clip"]))
    sizes = [views or len(states), *hidden, len(inputs)]
    # onnxruntime has no LeakyRelu for float64
    precision = "float64" if generator.random() < 0.1 and kind != "leaky_relu" else "float32"
    scale = float(generator.choice([0.7, 1.5, 3.0]))
    layers = network(sizes, [kind] * len(hidden) + [last], number, scale, precision).layers
    method = "linearization" if "+'" not in PLANTS[name] and generator.random() < 0.1 else "jets"
    options = Options(method=method, deployed=generator.random() < 0.8, splits=16, timeout=30.0)
    head = "\n".join(_head(name, states, inputs, views, generator)) + "\n"
    return Pair(f"{number}-{name}-{kind}", policy_bytes(layers, precision=precision), head, options)


def _head(name: str, states: str, inputs: str, views: int, generator: Any) -> Iterator[str]:
    discrete = "+'" in PLANTS[name]
    parts = {"states": states, "inputs": inputs, "disturbances": "d"}
    units = ", ".join(f"{key}: {{{', '.join(f'{n}: m' for n in names)}}}" for key, names in parts.items())
    numbers = [f"{x:.3f}" for x in generator.uniform(0.2, 0.9, 3)]
    yield f"setrl: 1\nplant: {{{units}, dynamics: {{{PLANTS[name].format(*numbers)}}}}}"
    period = F(1) if discrete else F(str(generator.choice(["0.1", "0.2", "0.25"])))
    periods = int(generator.integers(2, 7))
    yield f"controller:\n  period: {float(period)}"
    if views:
        yield "  observe: " + ["[x - y, sin(y)]", "[x*y, cos(x), y]"][views - 2]
    if generator.random() < 0.25:
        yield f"  before: {{scale: {generator.uniform(0.5, 1.5):.2f}, offset: 0.1}}"
    if generator.random() < 0.25:
        yield f"  after: {{scale: {generator.uniform(0.5, 1.5):.2f}, offset: -0.05}}"
    if generator.random() < 0.3:
        low, high = sorted(generator.uniform(-0.8, 0.8, 2))
        yield f"  clip: [{low:.2f}, {high + 0.2:.2f}]"
    if generator.random() < 0.3:
        yield f"  delay: {{periods: {int(generator.integers(1, min(periods, 3)))}, action: {{u: 0.1}}}}"
    yield f"horizon: {float(period * periods):.10g}"
    middle, width = generator.uniform(-0.5, 0.5, len(states)), generator.uniform(0.01, 0.2, len(states))
    width[generator.integers(len(states))] *= generator.random() < 0.6
    sides = (f"{s}: [{m:.3f}, {m + w:.3f}]" for s, m, w in zip(states, middle, width, strict=True))
    yield f"initial: {{{', '.join(sides)}}}"
    noise = str(generator.choice(["0", "0.01", "0.05", "some"]))
    noise = noise if noise != "some" else "{x: 0.03}" if not views else "0.03"
    varies = generator.choice(["every period", "never"])
    force = f"{{range: [-0.05, {generator.uniform(0, 0.1):.3f}], varies: {varies}}}"
    force = force if generator.random() < 0.75 else "[0.05, 0.05]"
    yield f"perturbation: {{observation: {noise}, disturbance: {{d: {force}}}}}"


# What is asked for --------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Aim:
    """What the worst trajectory is worst in: ``line . x``, at some time of a window, or (reach) all through it."""

    kind: str
    shape: str
    line: tuple[float, ...]
    start: Fraction
    end: Fraction

    def requirement(self, states: Sequence[str], bound: float) -> str:
        """The requirement that is violated by ``line . x`` beyond a bound."""
        beyond = self.kind == "avoid"
        plane = " + ".join(f"{weight}*{state}" for weight, state in zip(self.line, states, strict=True) if weight)
        region = f'"{plane} {">=" if beyond else "<="} {bound:.17f}"'
        axis = int(np.argmax(np.abs(self.line)))
        if self.shape == "box":
            low, high = "null", f"{self.line[axis] * bound:.17f}"
            if (self.line[axis] > 0.0) == beyond:
                low, high = high, low
            region = f"{{{states[axis]}: [{low}, {high}]}}"
        elif self.shape == "polytope":
            region = f"[{region}, {{x: [-1.0e5, 1.0e5], y: [-1.0e5, 1.0e5]}}]"
        elif self.shape == "union":
            region = f"{{union: [{{x: [2.0e5, 2.1e5]}}, {region}]}}"
        return f"requirements:\n  - {self.kind}: {region}\n    during: [{_number(self.start)}, {_number(self.end)}]\n"

    def amounts(self, times: Sequence[Fraction], states: Array) -> tuple[Array, Array]:
        """How far trajectories (N, S, n) get beyond 0, and at which sample."""
        counted = np.array([self.start <= time <= self.end for time in times])
        values = states @ np.array(self.line)
        values = np.where(np.isfinite(values), values, -np.inf)
        if self.kind == "reach":
            values = np.where(counted, values, np.inf)
            return values.min(1), values.argmin(1)
        values = np.where(counted, values, -np.inf)
        return values.max(1), values.argmax(1)


def _turn(number: int) -> int:
    """A count that meets every plant and activation with every remainder."""
    return number + number // (len(PLANTS) * len(KINDS))


def _number(value: Fraction) -> str:
    return f"{float(value):.10g}"


def aim_of(loop: ClosedLoop, number: int, attempt: int = 0) -> Aim:
    """What the pair with a number is asked."""
    generator = np.random.default_rng([43, number, attempt])
    kind = ("stay", "avoid", "reach")[_turn(number) % 3]
    shape = str(generator.choice(["plane", "box", "polytope", "union"]))
    size, parts = len(loop.plant.states), int(generator.choice([TENTHS, TENTHS, GRID]))
    parts = 1 if loop.plant.discrete or kind == "reach" else parts
    line = generator.choice([-1.0, -0.5, 0.5, 1.0], size)
    line[generator.integers(size)] *= generator.random() < 0.5
    if shape == "box":
        line = np.eye(size)[generator.integers(size)] * generator.choice([-1.0, 1.0])
    last = loop.periods * parts
    first, end = sorted(generator.integers(1, last + 1, 2).tolist())
    window = str(generator.choice(["end", "some time", "part", "whole"], p=[0.35, 0.15, 0.4, 0.1]))
    first, end = {"end": (last, last), "some time": (end, end), "whole": (0, last)}.get(window, (first, end))
    step = loop.period / parts
    return Aim(kind, shape, tuple(float(x) for x in line), first * step, end * step)


# What is reached ----------------------------------------------------------------------------------------------------


class Cube:
    """What an adversary chooses as points of ``[-1, 1]^D``: only what is free, a constant disturbance once."""

    def __init__(self, loop: ClosedLoop) -> None:
        periods = loop.periods
        noise = [(-radius, radius) for radius in loop.observation_radius]
        forces = [(entry.lower, entry.upper) for entry in loop.disturbances]
        self.sizes = (len(loop.initial), periods * len(noise), periods * len(forces))
        self.shapes = ((len(loop.initial),), (periods, len(noise)), (periods, len(forces)))
        self.exact = [*loop.initial, *noise * periods, *forces * periods]
        self.sides = np.array([inner_bounds(*bounds) for bounds in self.exact])
        own = np.arange(len(self.exact))
        first = len(self.exact) - self.sizes[2]
        for position, entry in enumerate(loop.disturbances):
            if entry.constant:
                own[first + position :: len(forces)] = first + position
        self.free = self.sides[:, 1] > self.sides[:, 0]
        chosen, self.place = np.unique(own[self.free], return_inverse=True)
        self.size = chosen.size

    def values(self, points: Array) -> Array:
        """All numbers of points (N, D)."""
        low, high = self.sides.T
        values = np.tile(0.5 * (low + high), (len(points), 1))
        values[:, self.free] += 0.5 * (high - low)[self.free] * points[:, self.place]
        return np.clip(values, low, high)

    def choices(self, points: Array) -> list[Array]:
        """Initial states (N, n), noise (N, T, k), disturbances (N, T, d)."""
        parts = np.split(self.values(points), np.cumsum(self.sizes)[:-1], axis=1)
        return [part.reshape(len(points), *shape) for part, shape in zip(parts, self.shapes, strict=True)]

    def numbers(self, point: Array) -> list[list[Fraction]]:
        """Exact numbers of one point (D,), within their exact bounds: the initial state, noise, disturbances."""
        exact = [
            min(max(F(x), a), b) for x, (a, b) in zip(self.values(point[None])[0].tolist(), self.exact, strict=True)
        ]
        parts = np.split(np.array(exact, dtype=object), np.cumsum(self.sizes)[:-1])
        return [part.reshape(shape).tolist() for part, shape in zip(parts, self.shapes, strict=True)]


@dataclass(frozen=True)
class Extreme:
    """The worst that was found: how far, half of the range of all that was simulated, and what was chosen for it."""

    amount: float
    radius: float
    time: Fraction
    numbers: list[list[Any]]


def extreme_of(loop: ClosedLoop, aim: Aim, seed: int, kept: int = 6, rounds: int = 14) -> Extreme:
    """The largest amount over all choices, by trying coordinates; no derivatives, nothing of the falsifier."""
    generator, cube = np.random.default_rng([47, seed]), Cube(loop)
    points = generator.uniform(-1.0, 1.0, (480, cube.size))
    points[::2] = np.sign(points[::2])
    held = cube.size - len(loop.initial)
    if held > 0:  # the same sign all through
        points[::6, -held:] = points[::6, -1:]
    amounts = _coarse(loop, aim, cube, points)
    lowest = float(amounts.min())
    points = points[np.argsort(-amounts)[:kept]]
    best, step = _coarse(loop, aim, cube, points), np.full(kept, 0.5)
    for _ in range(rounds):
        moves = np.concatenate([np.broadcast_to([-2.0, 2.0], (kept, 2)), step[:, None] * [-1.0, 1.0]], 1)
        trials = np.repeat(points[:, None, None], cube.size, 1).repeat(4, 2)  # (kept, D, 4, D)
        place = np.arange(cube.size)
        trials[:, place, :, place] = np.clip(points.T[:, :, None] + moves, -1.0, 1.0)
        found = _coarse(loop, aim, cube, trials.reshape(-1, cube.size)).reshape(kept, cube.size, 4)
        pick = found.argmax(2)
        gain = np.take_along_axis(found, pick[:, :, None], 2)[:, :, 0] - best[:, None]
        moved = np.take_along_axis(trials, pick[:, :, None, None], 2)[:, :, 0]  # (kept, D, D)
        alone = np.take_along_axis(moved, gain.argmax(1)[:, None, None], 1)[:, 0]
        all_ = np.where(gain > 0.0, np.diagonal(moved, axis1=1, axis2=2), points)
        some = np.where(generator.random(all_.shape) < 0.5, all_, points)
        offers = np.stack([points, alone, all_, some], 1)
        values = _coarse(loop, aim, cube, offers.reshape(-1, cube.size)).reshape(kept, 4)
        which = values.argmax(1)
        step = np.where(values.max(1) > best + 1e-3 * np.abs(gain).max(1), step, 0.3 * step)
        points, best = offers[np.arange(kept), which], values.max(1)
    return _finely(loop, aim, cube, points, lowest)


def _coarse(loop: ClosedLoop, aim: Aim, cube: Cube, points: Array) -> Array:
    """Amounts by Runge-Kutta steps of a tenth of a period, and to where the window begins and ends."""
    state, noise, forces = cube.choices(points)
    ends = {F(i, TENTHS) for i in range(1, TENTHS)} | {aim.start / loop.period % 1, aim.end / loop.period % 1}
    shares = [F(0), F(1)] if loop.plant.discrete else sorted({F(0), F(1), *ends})
    times = [F(0)]
    actions = [np.tile([float(x) for x in loop.delayed_action], (len(points), 1))] * loop.delay
    states = [state]
    with np.errstate(all="ignore"):
        for k in range(loop.periods):
            actions.append(act(loop, observe(loop, state) + noise[:, k]))
            held = actions[k], forces[:, k]
            for share, after in pairwise(shares):
                h = float((after - share) * loop.period)
                first = derivative(loop, state, *held)
                if loop.plant.discrete:
                    state = first
                else:
                    second = derivative(loop, state + 0.5 * h * first, *held)
                    third = derivative(loop, state + 0.5 * h * second, *held)
                    last = derivative(loop, state + h * third, *held)
                    state = state + h / 6.0 * (first + 2.0 * (second + third) + last)
                states.append(state)
                times.append((k + after) * loop.period)
    return aim.amounts(times, np.stack(states, 1))[0]


def _finely(loop: ClosedLoop, aim: Aim, cube: Cube, points: Array, lowest: float) -> Extreme:
    samples = 1 if loop.plant.discrete else GRID
    run = simulate(loop, *cube.choices(points), rtol=1e-12, atol=1e-14, samples_per_period=samples)
    times = [loop.period * F(i, samples) for i in range(len(run.times))]
    amounts, when = aim.amounts(times, run.states)
    top = int(amounts.argmax())
    amount = float(amounts[top])
    return Extreme(amount, 0.5 * (amount - lowest), times[int(when[top])], cube.numbers(points[top]))


# Questions ----------------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Question:
    """A pair and a requirement that a known trajectory violates by a fraction of the reachable set's radius."""

    pair: Pair
    aim: Aim
    extreme: Extreme
    fraction: float
    specification: bytes

    @property
    def gap(self) -> float:
        """How far the boundary is inside."""
        return self.fraction * self.extreme.radius

    def truth(self) -> Proof | str:
        """The proof that the known trajectory violates the requirement, or why there is none."""
        contract = read_contract(self.specification)
        initial, noise, forces = self.extreme.numbers
        digests = hashlib.sha256(self.pair.policy).hexdigest(), hashlib.sha256(self.specification).hexdigest()
        time = None if self.aim.kind == "reach" else self.extreme.time
        rows = [tuple(map(tuple, part)) for part in (noise, forces)]
        name = contract.requirements[0].name
        witness = Witness(name, time, tuple(initial), *rows, *digests, contract.plant_digest)
        return prove(witness, self.pair.policy, self.specification)

    def ask(self) -> tuple[Result, float]:
        """What the front door says about the two files, and how many seconds it took."""
        with TemporaryDirectory() as folder:
            policy, specification = Path(folder, "policy.onnx"), Path(folder, "specification.yaml")
            policy.write_bytes(self.pair.policy)
            specification.write_bytes(self.specification)
            started = time.perf_counter()
            result = verify(str(policy), str(specification), options=self.pair.options, workers=1)
            return result, time.perf_counter() - started


@lru_cache(maxsize=4)
def _reached(number: int) -> tuple[Pair, Aim, Extreme]:
    pair = pair_of(number)
    loop = pair.loop()
    for attempt in count():
        aim = aim_of(loop, number, attempt)
        extreme = extreme_of(loop, aim, number)
        if extreme.radius > 1e-6:  # else nothing that is free has an effect on it, as at the start
            return pair, aim, extreme


def fraction_of(number: int) -> float:
    """Every second one wide."""
    fractions = WIDE if _turn(number) % 2 else NARROW
    return fractions[np.random.default_rng([53, number]).integers(len(fractions))]


def question_of(number: int, fraction: float = 0.0) -> Question:
    """The question with a number, with a fraction of its own unless one is given; below 0: beyond what was reached."""
    pair, aim, extreme = _reached(number)
    fraction = fraction or fraction_of(number)
    requirement = aim.requirement(pair.loop().plant.states, extreme.amount - fraction * extreme.radius)
    return Question(pair, aim, extreme, fraction, (pair.head + requirement).encode())
