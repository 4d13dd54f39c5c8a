"""Subjects of the laws: sets with operations, activations, plants, integrator steps, closed loops."""

from __future__ import annotations

from collections.abc import Callable
from fractions import Fraction
from importlib.util import find_spec
from pathlib import Path
from typing import Any

import numpy as np
from laws import FlowCase, Image, LoopCase, random_set
from loops import affine_map, box_region, gain, loop_of, network, plant_of, requirement, specification_of

from setrl.models.float_algebra import FloatAlgebra
from setrl.models.plant import compile_plant, load_plant
from setrl.models.policy import Activation, activate, forward
from setrl.models.tape import Tape, run
from setrl.specs.reader import find_specification, read_specification
from setrl.specs.specification import Bounds, Penalty, Reward
from setrl.verify import balls, flow, zonotope
from setrl.verify import network as network_enclosure
from setrl.verify.balls import Ball
from setrl.verify.options import Options
from setrl.verify.zonotope import Zonotope

F = Fraction
Array = Any

EVERYTHING = plant_of(
    {
        "x": "tanh(y) - x/(2 + sin(x)) + u",
        "y": "exp(-x**2)*cos(y) + sqrt(3 + x) - log(2 + y) + tan(x/4) - d*y**3",
    },
    disturbances="d",
)
"""A plant that uses every operation and every function."""

PLANTS: dict[str, Any] = {
    **{name: load_plant(name) for name in ("navigation", "pendulum", "quadrotor1d", "quadrotor2d", "unicycle")},
    "everything": compile_plant(EVERYTHING),
    "quotient": compile_plant(plant_of({"x": "y/(1 + x**2)", "y": "-x**3 + u/(2 + cos(y))**2"})),
}
CENTERS = {
    "navigation": [1.0, 2.0, 0.7, 1.5, 0.4, -0.3],
    "pendulum": [2.0, -1.0, 0.3],
    "quadrotor1d": [-1.0, 0.5, 0.2],
    "quadrotor2d": [0.1, 0.2, -0.1, 0.1, 0.3, -0.4, 0.2, -0.1],
    "unicycle": [1.0, 2.0, 1.5, 0.7, -0.3, 0.4],
    "everything": [0.4, 0.3, -0.2, 0.1],
    "quotient": [0.5, -0.3, 0.4],
}
METHODS = ["jets"] + (["linearization"] if find_spec("setrl.verify.linearization") else [])


def joint_set(name: str, size: float, seed: int = 0) -> Zonotope:
    """States, inputs and disturbances around a plant's working point, correlated, with a small boxed part."""
    center = np.array([CENTERS[name]])
    dimension = center.shape[1]
    generator = np.random.default_rng(seed)
    rows = np.concatenate([np.eye(dimension), 0.5 * generator.normal(size=(3, dimension))])
    return Zonotope(center, size * rows[None], 0.05 * size * generator.random((1, dimension)))


def flow_case(name: str, size: float, duration: Fraction, order: int, method: str = "jets", rows: int = 8) -> FlowCase:
    """One step of a plant from a set of a given size."""
    return FlowCase(f"{name}-{size}", PLANTS[name].tape, joint_set(name, size), duration, order, method, rows)


def flow_cases(method: str) -> list[FlowCase]:
    """Points, small sets and large sets on every plant."""
    cases = []
    for name in PLANTS:
        for size, duration, order in ((0.0, F(1, 5), 2), (1e-3, F(1, 5), 3), (0.05, F(1, 10), 4), (0.2, F(1, 20), 5)):
            if size < 0.2 or name not in ("everything", "quadrotor2d"):
                cases.append(flow_case(name, size, duration, order, method))
    return cases


# Set operations ----------------------------------------------------------------------------------

KINDS = ("relu", "leaky_relu", "tanh", "sigmoid", "clip")
ACTIVATIONS = [
    Activation("relu"),
    Activation("leaky_relu", slope=0.01),
    Activation("leaky_relu", slope=1.5),
    Activation("leaky_relu", slope=-0.25),
    Activation("tanh"),
    Activation("sigmoid"),
    Activation("clip", lower=-0.75, upper=1.0),
    Activation("clip", lower=0.0, upper=6.0),
    Activation("clip", upper=0.5),
    Activation("clip", lower=-0.1),
]


def tape_function(tape: Tape) -> Callable[[Array], Array]:
    """A tape on points."""

    def function(points: Array) -> Array:
        values = run(tape, FloatAlgebra(), list(points.T))
        return np.stack([np.broadcast_to(v, len(points)) for v in values], 1)

    return function


def network_image(kind: str, size: float, seed: int) -> Image:
    """A network of one activation kind, on a set with a boxed part."""
    policy = network([3, 6, 5, 2], [kind, kind, "none"], seed, scale=1.5)
    z = random_set(3, 4, seed, size)
    return Image(
        f"network-{kind}-{size}",
        z,
        lambda given: network_enclosure.enclose_layers(policy.layers, given).output,
        lambda points: forward(policy.layers, points),
    )


def images() -> list[Image]:
    """Every operation on sets, with the function it encloses."""
    generator = np.random.default_rng(11)
    weight, bias = generator.normal(size=(3, 4)), generator.normal(size=3)
    error = 0.1 * generator.random((3, 4))
    z = random_set(4, 5, 1)
    cases = [
        Image(
            "linear_map",
            z,
            lambda given: zonotope.linear_map(given, balls.exact(weight), balls.exact(bias)),
            lambda points: points @ weight.T + bias,
        ),
        Image(
            "linear_map-uncertain",
            z,
            lambda given: zonotope.linear_map(given, Ball(weight, error), Ball(bias, np.full(3, 0.1))),
            lambda points: points @ (weight + error * np.sign(weight)).T + bias - 0.1,
        ),
        Image("coordinates", z, lambda given: given.coordinates(np.array([2, 0])), lambda points: points[:, [2, 0]]),
        Image("unbox", z, zonotope.unbox, lambda points: points),
        Image(
            "append_rows",
            z,
            lambda given: zonotope.append_rows(given, zonotope.diagonal_rows(np.full((1, 4), 0.1))),
            lambda points: points + 0.1,
        ),
        Image(
            "concatenate",
            z,
            lambda given: zonotope.concatenate(
                given.coordinates(slice(0, 2)), zonotope.unbox(given).coordinates(slice(2, 4))
            ),
            lambda points: points,
        ),
        Image(
            "reduce_order",
            random_set(3, 20, 2),
            lambda given: zonotope.reduce_order(given, 2, 8, given.spread)[0],
            lambda points: points,
        ),
        Image(
            "merge_rows", random_set(2, 14, 3), lambda given: network_enclosure.merge_rows(given, 4, 3)[0], lambda p: p
        ),
        Image(
            "merge_rows-one",
            random_set(1, 9, 4),
            lambda given: network_enclosure.merge_rows(given, 4, 3)[0],
            lambda p: p,
        ),
    ]
    for name in PLANTS:
        tape = PLANTS[name].tape
        cases.append(
            Image(
                f"image_of-{name}",
                joint_set(name, 0.1),
                lambda given, tape=tape: flow.image_of(tape, given, 6)[0],
                tape_function(tape),
            )
        )
    for kind in KINDS:
        cases += [network_image(kind, size, seed) for seed, size in enumerate((0.02, 0.5, 3.0))]
    for activation in ACTIVATIONS:
        cases.append(
            Image(
                f"activation-{activation.kind}-{activation.slope}-{activation.lower}",
                random_set(3, 4, 5),
                lambda given, layer=activation: network_enclosure.enclose_layers((layer,), given).output,
                lambda points, layer=activation: activate(layer, points),
            )
        )
    two = (Activation("relu"), Activation("tanh"), Activation("clip", lower=-0.5, upper=0.25))
    cases.append(
        Image(
            "activation-after-activation",
            random_set(3, 4, 6),
            lambda given: network_enclosure.enclose_layers(two, given).output,
            lambda points: forward(two, points),
        )
    )
    return cases


# Closed loops ------------------------------------------------------------------------------------


def reward_of(weights: dict[str, Any], target: dict[str, Any] | None = None, penalty: Penalty | None = None) -> Reward:
    """A reward from texts, discount 0.99."""
    return Reward(
        {k: F(v) for k, v in weights.items()}, {k: F(v) for k, v in (target or {}).items()}, F("0.99"), penalty
    )


def shipped(name: str, policy: Any, epsilon: Any = None) -> Any:
    """A shipped specification, bound."""
    return loop_of(policy, read_specification(find_specification(name)), epsilon)


def small_policy(name: str, seed: int = 0, kinds: tuple[str, str] = ("relu", "tanh")) -> Any:
    """A network of moderate gain for a shipped specification."""
    inputs, outputs = {
        "nav": (4, 2),
        "navigation": (4, 2),
        "pendulum": (2, 1),
        "quadrotor1d": (2, 1),
        "quadrotor2d": (6, 2),
    }[name]
    return network([inputs, 8, outputs], list(kinds), seed, scale=0.7)


def everything_loop(delay: int = 0, varying: bool = True, seed: int = 5) -> Any:
    """Nonlinear observation, maps, clip, delay, noise and a disturbance at once."""
    specification = specification_of(
        EVERYTHING,
        {"x": ("0.3", "0.45"), "y": ("0.2", "0.4")},
        period="0.1",
        periods=4,
        observation="0.02",
        disturbances={"d": ("-0.1", "0.3", not varying)},
        observe={"s": "sin(x)", "c": "cos(x)*y", "y": "y"},
        before=affine_map([["0.5", "0.1", 0], [0, "1.1", "-0.3"]], ["0.1", 0]),
        after=affine_map([["0.7"]], ["0.05"]),
        clip=Bounds(F("-0.015"), F("0.02")),  # both bounds are reached, and neither always
        delay=delay,
        delayed_action={"u": F("0.1")},
        requirements=[requirement("stay", box_region(x=(-9, 9), y=(-9, 9)), 0, F("0.4"))],
        reward=reward_of({"x": "1", "y": "0.3"}, {"y": "0.2"}),
    )
    return loop_of(network([2, 6, 1], ["tanh", "none"], seed, scale=2.0), specification)


def discrete_loop(delay: int = 0) -> Any:
    """A discrete-time plant with both kinds of disturbance."""
    plant = plant_of(
        {"x": "0.9*x + 0.2*sin(y) - u + d", "y": "y/(1 + x**2) + 0.3*u*w"}, disturbances="d w", discrete=True
    )
    specification = specification_of(
        plant,
        {"x": ("-0.5", "0.5"), "y": ("0.1", "0.4")},
        period=1,
        periods=4,
        observation="0.1",
        disturbances={"d": ("-0.1", "0.2", False), "w": ("0.5", "1.5", True)},
        delay=delay,
        requirements=[requirement("stay", box_region(x=(-9, 9)), 1, 4)],
        reward=reward_of({"x": "1", "y": "0.3"}),
    )
    return loop_of(network([2, 5, 1], ["relu", "none"], 3), specification)


def correlated_loop(delay: int) -> Any:
    """x+ = x - u + d with u = the perturbed x: the disturbance and the noise are of the same size."""
    plant = plant_of({"x": "x - u + d"}, disturbances="d", discrete=True)
    specification = specification_of(
        plant, {"x": (0, 1)}, period=1, periods=3, observation=1, disturbances={"d": (-1, 1, False)}, delay=delay
    )
    return loop_of(gain([1.0]), specification)


def loop_cases() -> list[LoopCase]:
    """Closed loops with every kind of wiring; without a delay."""
    cases = [
        LoopCase("quadrotor1d", shipped("quadrotor1d", small_policy("quadrotor1d"), "0.05"), least=30),
        LoopCase("pendulum", shipped("pendulum", small_policy("pendulum"), "0.01"), least=8),
        LoopCase("navigation", shipped("navigation", small_policy("navigation"), "0.01"), least=5),
        LoopCase("quadrotor2d", shipped("quadrotor2d", small_policy("quadrotor2d"), "0.01"), least=3),
        LoopCase("nav-sigmoid", shipped("nav", small_policy("nav", 1, ("sigmoid", "clip")), "0.01"), least=5),
        LoopCase("everything", everything_loop(), least=4),
        LoopCase("everything-constant", everything_loop(varying=False), least=4),
        LoopCase("discrete", discrete_loop(), least=4),
        LoopCase("correlated", correlated_loop(0), least=3),
    ]
    if "linearization" in METHODS:
        options = Options(method="linearization")
        cases += [
            LoopCase("pendulum-linearization", cases[1].loop, options, 4),
            LoopCase("everything-linearization", cases[5].loop, options, 4),
        ]
    return cases


def delayed_cases() -> list[LoopCase]:
    """Closed loops with a delay."""
    return [
        LoopCase("everything-delay-1", everything_loop(1), least=4),
        LoopCase("everything-delay-2", everything_loop(2), least=4),
        LoopCase("discrete-delay-1", discrete_loop(1), least=4),
        LoopCase("correlated-delay-1", correlated_loop(1), least=3),
    ]


def splitting_problem(bound: str = "2", width: str = "0.3") -> Any:
    """The pendulum under a steep network, from a box that needs some cuts."""
    specification = specification_of(
        "pendulum",
        {"theta": (F("0.4") - F(width), F("0.4") + F(width)), "thetadot": (-F(width), F(width))},
        periods=8,
        observation="0.005",
        requirements=[requirement("stay", box_region(theta=("-1.5", bound)), 0, F("0.8"))],
        reward=reward_of({"theta": "1"}),
    )
    return loop_of(network([2, 8, 1], ["tanh", "none"], 1, 2.0), specification)


def repository() -> Path:
    """Root of the repository."""
    return Path(__file__).resolve().parents[1]
