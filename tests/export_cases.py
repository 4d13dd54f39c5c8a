"""Certificates of many kinds of closed loops as sources of exports, and queries evaluated at points."""

from __future__ import annotations

from collections.abc import Sequence
from fractions import Fraction
from functools import lru_cache
from typing import Any

import numpy as np
import onnxruntime
import pytest
from certificates import Case, case_of

from setrl.models.binding import bind
from setrl.models.closed_loop import ClosedLoop
from setrl.models.onnx_reader import read_policy
from setrl.specs.queries import Query
from setrl.specs.reader import parse_specification
from setrl.verify.export.period_network import Controller, PeriodNetwork, period_network
from setrl.verify.export.sources import Source, read_source
from setrl.verify.export.tracked import tracked_sets

NUMBERS = (3, 7, 22, 24, 29)
"""Delays, clips, maps before and after, nonlinear observations, both methods, discrete time."""
ALL = [*NUMBERS, *(pytest.param(number, marks=pytest.mark.slow) for number in (1, 14, 16, 19, 31, 35, 38, 39))]


@lru_cache(maxsize=64)
def case(number: int) -> Case:
    return case_of(number)


@lru_cache(maxsize=64)
def source(number: int) -> Source:
    given = case(number)
    return read_source(given.certificate, given.policy, given.specification)


@lru_cache(maxsize=64)
def loop(number: int) -> ClosedLoop:
    given = case(number)
    return bind(parse_specification(given.specification), read_policy(given.policy))


@lru_cache(maxsize=64)
def networks(number: int) -> list[PeriodNetwork]:
    """Of the first leaf."""
    return networks_of(source(number))


def networks_of(given: Source) -> list[PeriodNetwork]:
    controller = Controller.of(given)
    return [period_network(given, controller, *entry) for entry in tracked_sets(given.layout, given.leaf(0))]


def run(content: bytes, rows: Any) -> Any:
    """A network on rows of numbers, as onnxruntime does it; float64 results."""
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    session = onnxruntime.InferenceSession(content, options, providers=["CPUExecutionProvider"])
    (given,) = session.get_inputs()
    dtype = np.float32 if given.type == "tensor(float)" else np.float64
    rows = np.atleast_2d(np.asarray(rows)).astype(dtype)
    batches = [rows] if isinstance(given.shape[0], str) else [row[None] for row in rows]
    return np.concatenate([session.run(None, {given.name: batch})[0] for batch in batches]).astype(np.float64)


def factors(network: PeriodNetwork, count: int, generator: np.random.Generator) -> Any:
    """Points of the box [-1, 1]^q, half of them corners; float32 numbers."""
    points = generator.uniform(-1.0, 1.0, (count, len(network.factors)))
    points[count // 2 :] = np.sign(points[count // 2 :])
    return points.astype(np.float32).astype(np.float64)


def observations(network: PeriodNetwork, points: Any) -> Any:
    """What the points stand for, (N, o)."""
    rows = np.array([[float(x) for x in factor.row] for factor in network.factors])
    return np.array(network.center) + points @ rows


def satisfied(query: Query, inputs: Sequence[Any], outputs: Sequence[Any]) -> bool:
    """Whether a point is a violation, exactly."""
    x, y = ([Fraction(value) for value in group] for group in (inputs, outputs))
    assert np.prod(query.inputs) == len(x) and np.prod(query.outputs) == len(y)
    for one in query.cases:
        inside = all(b.lower <= v <= b.upper for b, v in zip(one.box, x, strict=True))
        if inside and all(
            sum((c * x[i] for i, c in k.inputs), Fraction(0)) + sum((c * y[i] for i, c in k.outputs), Fraction(0))
            <= k.bound
            for k in one.constraints
        ):
            return True
    return False
