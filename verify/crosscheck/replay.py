"""A tool's counterexample, looked at again: is it in the box, and does the network really do it?

Exact where the checker reads the network: balls that are narrowed until every comparison is decided. Otherwise what
onnxruntime computes is compared, which proves nothing; the answer says which it was.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import Any

import numpy as np
from flint import arb, ctx, fmpq

from ...specs.errors import InputError
from ...specs.queries import Case, LinearConstraint, Query
from ..checker.network import read_network

BITS = (64, 128, 256, 512)


@dataclass(frozen=True)
class Replay:
    """What a counterexample is worth.

    Attributes
    ----------
    violates : bool or None
        Whether the query is satisfied there, by more than nothing; None where that could not be decided.
    exact : bool
        Whether that is proved; else onnxruntime was asked.
    sentence : str
    """

    violates: bool | None
    exact: bool
    sentence: str


def replay(content: bytes, query: Query, witness: Sequence[float]) -> Replay:
    """Evaluate a query at an input.

    Parameters
    ----------
    content : bytes
        Of the ONNX file.
    query : Query
    witness : sequence of float
        As the tool printed it: a number that its rounding took out of the box is taken back to the bound.

    Returns
    -------
    Replay
    """
    if len(witness) != int(np.prod(query.inputs)) or not np.isfinite(witness).all():
        return Replay(None, True, "the tool gave no input of the network")
    point = [Fraction(x) for x in witness]
    try:
        network = read_network(content)
    except InputError:
        return _by_runtime(content, query, point)
    for bits in BITS:
        answers = [_case(network, case, point, bits) for case in query.cases]
        if any(answer is True for answer in answers):
            return Replay(True, True, "the network does it at the tool's input, in exact arithmetic")
        if all(answer is False for answer in answers):
            return Replay(False, True, "the network does not do it at the tool's input, in exact arithmetic")
    return Replay(None, True, f"{BITS[-1]} bits do not decide whether the network does it at the tool's input")


def _clipped(case: Case, point: Sequence[Fraction]) -> list[Fraction]:
    return [min(max(x, bound.lower), bound.upper) for x, bound in zip(point, case.box, strict=True)]


def _case(network: Any, case: Case, point: Sequence[Fraction], bits: int) -> bool | None:
    """Whether all constraints hold; None where the precision does not decide it."""
    inputs = _clipped(case, point)
    with ctx.workprec(bits):
        balls = [arb(fmpq(x.numerator, x.denominator)) for x in inputs]
        outputs = network(balls)
        left = [_left(constraint, balls, outputs) for constraint in case.constraints]
        # strictly: at the bound itself a claim still holds, and VNN-LIB has no strict comparison to say so
        if all(bool(value < 0) for value in left):
            return True
        return False if any(bool(value > 0) for value in left) else None


def _left(constraint: LinearConstraint, inputs: Sequence[Any], outputs: Sequence[Any]) -> Any:
    """By how much a constraint is missed; it holds where this is at most 0."""
    total = -_ball(constraint.bound)
    for entries, values in ((constraint.inputs, inputs), (constraint.outputs, outputs)):
        for index, coefficient in entries:
            total = total + _ball(coefficient) * values[index]
    return total


def _ball(number: Fraction) -> Any:
    return arb(fmpq(number.numerator, number.denominator))


def _by_runtime(content: bytes, query: Query, point: Sequence[Fraction]) -> Replay:
    """The same with what onnxruntime computes, in the network's own precision."""
    import onnxruntime

    session = onnxruntime.InferenceSession(content, providers=["CPUExecutionProvider"])
    (entry,) = session.get_inputs()
    precision = np.float64 if "double" in entry.type else np.float32
    for case in query.cases:
        inputs = _clipped(case, point)
        values = np.array([float(x) for x in inputs], dtype=precision).reshape(query.inputs)
        (result,) = session.run(None, {entry.name: values})
        outputs = [Fraction(float(y)) for y in np.ravel(result)]
        misses = []
        for constraint in case.constraints:
            terms = [c * inputs[i] for i, c in constraint.inputs] + [c * outputs[j] for j, c in constraint.outputs]
            misses.append(sum(terms, Fraction(0)) - constraint.bound)
        if all(miss < 0 for miss in misses):
            return Replay(True, False, "the network does it at the tool's input, as onnxruntime computes it")
    return Replay(False, False, "the network does not do it at the tool's input, as onnxruntime computes it")
