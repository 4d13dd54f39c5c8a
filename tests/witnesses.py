"""Small plants, specifications and witnesses in a few words, for tests of the checker's proofs."""

from __future__ import annotations

import hashlib
from fractions import Fraction
from typing import Any

import numpy as np
from loops import network

from setrl.models.onnx_writer import policy_bytes
from setrl.models.policy import Affine
from setrl.verify.checker.contract import read_contract
from setrl.verify.checker.witness import Witness

F = Fraction

BASE = """
setrl: 1
plant: PLANT
controller: CONTROLLER
horizon: HORIZON
initial: INITIAL
perturbation: PERTURBATION
requirements:
  - REQUIREMENT
    name: it
"""


def text_of(plant: str, requirement: str, **given: str) -> bytes:
    parts = {"controller": "{period: 0.1}", "horizon": "0.5", "perturbation": "{observation: 0.05}", **given}
    text = BASE.replace("PLANT", plant).replace("REQUIREMENT", requirement)
    for key, value in parts.items():
        text = text.replace(key.upper(), value)
    return text.encode()


def linear(*rows: Any) -> bytes:
    weight = np.array(rows, dtype=np.float64)
    return policy_bytes((Affine(weight, np.zeros(len(weight))),), precision="float64")


def witness_of(
    policy: bytes,
    specification: bytes,
    initial: Any,
    time: Any,
    noise: Any = None,
    disturbances: Any = None,
    name: str = "it",
) -> Witness:
    contract = read_contract(specification)
    periods, seen = contract.periods, len(contract.observe)
    return Witness(
        name,
        None if time is None else F(time),
        tuple(map(F, initial)),
        tuple(tuple(map(F, row)) for row in (noise if noise is not None else [[0] * seen] * periods)),
        tuple(
            tuple(map(F, row))
            for row in (disturbances if disturbances is not None else [[0] * len(contract.disturbances)] * periods)
        ),
        hashlib.sha256(policy).hexdigest(),
        hashlib.sha256(specification).hexdigest(),
        contract.plant_digest,
    )


HOLD = "{states: {x: m}, inputs: {u: m/s}, dynamics: {x: u}}"
KEEP = linear([-1.0])


PENDULUM = "{states: {theta: rad, omega: rad/s}, inputs: {a: N}, disturbances: {d: N}, parameters: {g: 9.81}, "
PENDULUM += "dynamics: {theta: omega, omega: g*sin(theta) + 15*a + d}}"
MAP = "{states: {x: m, y: m}, inputs: {u: m}, disturbances: {d: m}, "
MAP += 'dynamics: {"x+": 0.5*x + 0.3*sin(y) + u + d, "y+": 0.9*y - 0.2*x*y}}'


GOOD_TEXT = text_of(
    PENDULUM,
    "stay: {theta: [-9, 0.2]}\n    during: [0.1, 0.5]",
    initial="{theta: [0.1, 0.3], omega: 0}",
    perturbation="{observation: {theta: 0.05}, disturbance: {d: {range: [-1, 0.5], varies: never}}}",
)
GOOD_POLICY = policy_bytes(network([2, 4, 1], ["tanh", "tanh"], 3, 0.1).layers)


def good() -> Witness:
    noise = [[F("0.05"), 0]] * 5
    return witness_of(GOOD_POLICY, GOOD_TEXT, [F("0.3"), 0], "0.3", noise, [[F("0.5")]] * 5)
