"""Closed loops in great variety, as files, with requirements placed just outside what is reachable.

A case is generated from its number. Its regions are placed around the hulls of a run that asks for nothing, so that the
engine proves it; the checker has to accept what the engine proves.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import numpy as np
from laws import planted_boundary
from loops import network

from setrl.models.onnx_writer import policy_bytes
from setrl.verify.options import Options
from setrl.verify.result import Result
from setrl.verify.verifier import verify

EVERYTHING = (
    "{states: {x: m, y: m}, inputs: {u: m}, disturbances: {d: m}, dynamics: {x: tanh(y) - x/(2 + sin(x)) + u, "
    "y: exp(-x**2)*cos(y) + sqrt(3 + x) - log(2 + y) + tan(x/4) - d*y**3}}"
)
MAP = (
    "{states: {x: m, y: m}, inputs: {u: m}, disturbances: {d: m, w: m}, "
    "dynamics: {'x+': 0.9*x + 0.2*sin(y) - u + d, 'y+': y/(1 + x**2) + 0.3*u*w}}"
)
QUOTIENT = "{states: {x: m, y: m}, inputs: {u: m}, dynamics: {x: y/(1 + x**2), y: -x**3 + u/(2 + cos(y))**2}}"
CART = (
    "{states: {p: m, v: m/s}, inputs: {u: N, b: N}, disturbances: {f: N}, parameters: {k: 1/3}, "
    "dynamics: {p: v, v: (u - b + f)/2 - k*v}}"
)


@dataclass(frozen=True)
class Subject:
    """A plant with a working point, a way of observing it nonlinearly, and what may disturb it."""

    text: str
    start: dict[str, float]
    inputs: tuple[str, ...]
    seen: str
    views: int
    period: str = "0.1"
    force: str = ""
    clip: str = "[-0.4, 0.5]"
    scale: float = 0.7

    @property
    def discrete(self) -> bool:
        return "+'" in self.text


SUBJECTS = {
    "pendulum": Subject("pendulum", {"theta": 0.4, "thetadot": -0.2}, ("a",), "[sin(theta), cos(theta), thetadot]", 3),
    "everything": Subject(
        EVERYTHING, {"x": 0.4, "y": 0.3}, ("u",), "{s: sin(x), c: cos(x)*y}", 2, force="d: [-0.1, 0.3]"
    ),
    "map": Subject(
        MAP,
        {"x": 0.1, "y": 0.3},
        ("u",),
        "[y, tanh(x)]",
        2,
        "1",
        "d: [-0.1, 0.2], w: {range: [0.5, 1.5], varies: never}",
    ),
    "unicycle": Subject(
        "unicycle", {"x": 3, "y": 3, "v": 0.5, "theta": 0.1}, ("a", "omega"), "[x, y, v, sin(theta), cos(theta)]", 5
    ),
    "quotient": Subject(QUOTIENT, {"x": 0.5, "y": -0.3}, ("u",), "[x*y, y]", 2, "0.2"),
    "quadrotor1d": Subject("quadrotor1d", {"z": -4, "zdot": 0}, ("a",), "[exp(-z**2), zdot]", 2),
    "cart": Subject(CART, {"p": 0.2, "v": -0.1}, ("u", "b"), "[v, p, 2*p - v]", 3, force="f: 0.05"),
    "quadrotor2d": Subject(
        "quadrotor2d",
        {"x": 0.1, "xdot": 0, "z": 0, "zdot": 0.1, "theta": 0.05, "thetadot": 0},
        ("a1", "a2"),
        "[x, xdot, z, zdot, tan(theta), thetadot]",
        6,
        scale=0.4,
    ),
    "navigation": Subject(
        "navigation",
        {"x": 3, "y": 3, "theta": 0.2, "v": 0.4},
        ("a1", "a2"),
        "[sqrt(x**2 + y**2), log(1 + x**2), theta, v]",
        4,
        "0.2",
    ),
}
KINDS = ("relu", "tanh", "leaky_relu", "sigmoid", "clip", "none")


@dataclass(frozen=True)
class Case:
    """One question: the bytes of both files, and options."""

    name: str
    policy: bytes
    specification: bytes
    options: Options = field(default_factory=Options)

    def __str__(self) -> str:
        return self.name

    def verify(self, check: bool = True) -> Result:
        """Its verdict, from files."""
        with TemporaryDirectory() as folder:
            policy, specification = Path(folder, "policy.onnx"), Path(folder, "specification.yaml")
            policy.write_bytes(self.policy)
            specification.write_bytes(self.specification)
            return verify(str(policy), str(specification), options=self.options, check=check, workers=1)

    @property
    def certificate(self) -> bytes:
        """What the engine claims; the same object every time."""
        return certificate_of(self)


@lru_cache(maxsize=256)
def certificate_of(case: Case) -> bytes:
    """What the engine claims about a case that it proves."""
    result = case.verify(check=False)
    assert result.certificate is not None, (case.name, result.verdict, result.reason)
    return result.certificate


def case_of(number: int, subject: str = "", **given: Any) -> Case:
    """The case with a number; options of its own over the number's.

    Parameters
    ----------
    number : int
        Decides everything that `given` does not name, in digits of different lengths, so that all pairs come up.
    subject : str, optional
    given : optional
        ``kind``, ``precision``, ``periods``, ``requirements``, ``tight``, ``wide``, and fields of Options.
    """
    generator = np.random.default_rng(number)
    names = list(SUBJECTS)
    name = subject or names[number % len(names)]
    plant = SUBJECTS[name]
    kind = given.pop("kind", KINDS[number // len(names) % len(KINDS)])
    periods = given.pop("periods", 2 + number % (2 if len(plant.start) > 4 else 4))
    # onnxruntime has no LeakyRelu for float64
    precision = given.pop("precision", "float64" if number % 11 == 3 and kind != "leaky_relu" else "float32")
    tight, wanted, wide = given.pop("tight", 0.0), given.pop("requirements", None), given.pop("wide", 1.0)
    view = generator.choice(["", "expressions", "reversed"], p=[0.4, 0.4, 0.2])
    views = plant.views if view == "expressions" else len(plant.start)
    hidden = [6] if number % 3 else [5, 4]
    last = ("none", "tanh", "none", "clip", "sigmoid")[number % 5]
    sizes = [views, *hidden, len(plant.inputs)]
    layers = network(sizes, [kind] * len(hidden) + [last], number, plant.scale, precision).layers
    method = given.pop("method", "linearization" if number % 5 == 4 and not plant.discrete else "jets")
    options = {"method": method, "deployed": given.pop("deployed", number % 4 != 1), "splits": 1}
    if number % 7 == 2:
        options |= {"taylor_order": 3, "remainder_share": 0.002}  # several steps per period
    options |= given
    head = "\n".join(_head(plant, periods, view, views, number, wide, generator))
    policy = policy_bytes(layers, precision=precision)
    asked = _placed(plant, periods, head, policy, Options(**options), number, generator, tight, wanted)
    label = f"{number}-{name}-{kind}-{method}" + ("" if options["deployed"] else "-real")
    return Case(label, policy, (head + "\n" + asked).encode(), Options(**options))


def _head(
    plant: Subject, periods: int, view: str, views: int, number: int, wide: float, generator: Any
) -> Iterator[str]:
    """Lines of the specification without what is asked for."""
    yield f"setrl: 1\nplant: {plant.text}\ncontroller:\n  period: {plant.period}"
    observed = {"expressions": plant.seen, "reversed": "[" + ", ".join([*plant.start][::-1]) + "]"}.get(view)
    if observed:
        yield f"  observe: {observed}"
    if generator.random() < 0.3:
        yield f"  before: {{scale: {generator.uniform(0.5, 1, views).round(2).tolist()}, offset: 0.1}}"
    if generator.random() < 0.3:
        size = len(plant.inputs)
        rows = [[round(float(x), 2) for x in row] for row in 0.7 * np.eye(size) + 0.1]
        yield f"  after: {{matrix: {rows}, offset: 0.07}}"
    if number % 3 == 1:
        yield f"  clip: {plant.clip}"
    if number % 4 == 3:
        delay = 1 + number % 2
        held = f"{{periods: {delay}, action: {{{plant.inputs[0]}: 0.1}}}}"
        yield f"  delay: {held if delay < periods else 1}"
    length = float(plant.period) * periods
    yield f"horizon: {length:.10g}"
    sides = []
    for position, (state, middle) in enumerate(plant.start.items()):
        half = 0.0 if position == number % 5 else wide * (0.02, 0.05, 0.1)[number % 3] * generator.uniform(0.3, 1)
        sides.append(f"{state}: [{middle - half:.4f}, {middle + half:.4f}]" if half else f"{state}: {middle}")
    yield f"initial: {{{', '.join(sides)}}}"
    noise = ["0", "0.02", "0.005"][number % 3]
    if noise != "0" and view == "":
        first, *others = plant.start
        noise = f"{{{first}: {noise}, {others[-1]}: 0.0033}}"
    force = plant.force
    if force and "varies" not in force and number % 2:
        key, value = force.split(": ", 1)
        value = value if value.startswith("[") else f"[-{value}, {value}]"
        force = f"{key}: {{range: {value}, varies: never}}"
    yield f"perturbation: {{observation: {noise}" + (f", disturbance: {{{force}}}" if force else "") + "}"


def _placed(
    plant: Subject,
    periods: int,
    head: str,
    policy: bytes,
    options: Options,
    number: int,
    generator: Any,
    tight: float,
    wanted: list[str] | None,
) -> str:
    """Requirements and reward, just outside the hulls of a run that asks for nothing.

    With `tight` the only requirement is a bound at the end, between the worst simulated state (0) and the hull (1).
    """
    period, names = float(plant.period), [*plant.start]
    free = f"requirements:\n  - stay: {{{names[0]}: [-1.0e6, 1.0e6]}}"
    found = Case("", policy, (head + "\n" + free).encode(), options).verify(check=False)
    if tight:
        line = np.eye(len(names))[0]
        best = planted_boundary(found.loop, line, number)
        bound = best + tight * (found.flowpipe.points[0, -1, 1, 0] - best)
        return f"requirements:\n  - stay: '{names[0]} <= {bound:.12f}'\n    at: {periods * period:.10g}"
    low, high = _hulls(found)
    kinds = wanted or [
        _TEMPLATES[(number + step * (1 + number // 7)) % len(_TEMPLATES)] for step in range(1 + number % 3)
    ]
    lines = ["requirements:"]
    for kind in kinds:
        first, last = sorted(generator.integers(0, periods + 1, 2).tolist())
        first, last = {"at": (max(last, 1),) * 2, "whole": (0, periods)}.get(kind.split("-")[2], (first, last))
        rows = slice(max(first, 0), last + 1)
        low_, high_ = low[rows].min(0), high[rows].max(0)
        text = _region(kind, names, low_, high_)
        begin, end = first * period, last * period
        if kind.endswith("part") and not plant.discrete and first < last and not kind.startswith("reach"):
            begin, end = begin + 0.3 * period, end - 0.4 * period
        lines.append(f"  - {kind.split('-')[0]}: {text}\n    name: {kind} {len(lines)}")
        lines.append(f"    at: {end:.10g}" if first == last else f"    during: [{begin:.10g}, {end:.10g}]")
    if number % 2:
        lines.append(f"reward:\n  weights: {{{names[0]}: 1, {names[-1]}: 0.3}}\n  target: {{{names[-1]}: 0.2}}")
        lines.append("  discount: 0.99")
        inside = {1: f"{names[0]} >= {high[:, 0].max() + 0.5:.4f}", 3: f"{names[0]} >= {low[:, 0].min():.4f}"}
        if number % 8 in inside:
            lines.append(f"  penalty: {{amount: 0.7, inside: '{inside[number % 8]}'}}")
    return "\n".join(lines)


_TEMPLATES = [
    "stay-box-whole",
    "avoid-box-part",
    "reach-box-at",
    "avoid-union-whole",
    "stay-halfspace-part",
    "avoid-halfspace-at",
    "reach-union-part",
    "stay-union-whole",
    "stay-box-at",
    "avoid-box-whole",
]


def _hulls(found: Result) -> tuple[Any, Any]:
    """Lower and upper ends per sampling instant; each reaches over the motion on both sides of it."""
    points = found.flowpipe.points
    low, high = points[:, :, 0].min(0), points[:, :, 1].max(0)
    between = found.flowpipe.intervals
    if np.isfinite(between).all():
        count = len(low) - 1
        below = between[:, :, 0].min(0).reshape(count, -1, low.shape[1]).min(1)
        above = between[:, :, 1].max(0).reshape(count, -1, low.shape[1]).max(1)
        low[:-1], low[1:] = np.minimum(low[:-1], below), np.minimum(low[1:], below)
        high[:-1], high[1:] = np.maximum(high[:-1], above), np.maximum(high[1:], above)
    return low, high


def _region(kind: str, names: list[str], low: Any, high: Any) -> str:
    """A region that a box of states meets, by a hundredth of the box."""
    gap = 0.01 * (high - low) + 1e-3
    a, b = names[0], names[-1]
    what, shape, _ = kind.split("-")
    if what == "avoid":
        beyond = f"{{{a}: [{high[0] + gap[0]:.8f}, {high[0] + 9:.4f}], {b}: [{low[-1] - 1:.4f}, {high[-1] + 1:.4f}]}}"
        plane = f'"{a} - 2*{b} >= {high[0] - 2 * low[-1] + gap[0] + 2 * gap[-1]:.8f}"'
        return {"box": beyond, "halfspace": plane, "union": f"{{union: [{plane}, {beyond}]}}"}[shape]
    box = f"{{{a}: [{low[0] - 1:.8f}, {high[0] + gap[0]:.8f}], {b}: [{low[-1] - gap[-1]:.8f}, null]}}"
    plane = f'"{a} + 3*{b} <= {high[0] + 3 * high[-1] + gap[0] + 3 * gap[-1]:.8f}"'
    return {"box": box, "halfspace": plane, "union": f"{{union: [{{{a}: [90, 99]}}, {box}]}}"}[shape]


def digest_of(case: Case) -> str:
    """sha256 of the certificate of a fresh run."""
    return hashlib.sha256(case.verify(check=False).certificate or b"").hexdigest()
