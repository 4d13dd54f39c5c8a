"""The recorded half of a witness, run again: does onnxruntime return these actions, to the last bit?

Outside the checker's island, which runs no network but its own. Rows are run one by one, because a runtime may sum in
another order in a larger batch.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from fractions import Fraction
from typing import TypeAlias

import numpy as np

from ..models.onnx_runtime import deployed_runner, runtime_version
from ..models.policy import Policy

Numbers: TypeAlias = tuple[Fraction, ...]

LARGEST = Fraction(2) ** 1024


def runtime_name() -> str:
    """Name and version of the installed runtime, as witnesses have it."""
    return f"onnxruntime {runtime_version()}"


def exact_runner(policy: Policy) -> Callable[[Numbers], Numbers | None]:
    """The ONNX file as onnxruntime executes it, on exact numbers.

    Parameters
    ----------
    policy : Policy
        With the bytes it was read from.

    Returns
    -------
    callable
        From one row of float64 numbers, given as rationals, to the output; None where the row is not made of `inputs`
        such numbers, or the output is not finite.

    Raises
    ------
    PolicyError
        The policy has no bytes, or onnxruntime refuses them.
    """
    execute = deployed_runner(policy)

    def run(row: Numbers) -> Numbers | None:
        if len(row) != policy.inputs or any(abs(value) >= LARGEST for value in row):
            return None
        numbers = [float(value) for value in row]
        if any(Fraction(number) != value for number, value in zip(numbers, row, strict=True)):
            return None
        result = execute(np.array([numbers]))[0]
        return tuple(map(Fraction, result.tolist())) if np.isfinite(result).all() else None

    return run


def replay(observations: Sequence[Numbers], actions: Sequence[Numbers], policy: Policy) -> bool:
    """Whether onnxruntime returns exactly the recorded actions on the recorded observations.

    Parameters
    ----------
    observations : sequence of tuples of Fraction, periods x inputs
    actions : sequence of tuples of Fraction, periods x outputs
    policy : Policy

    Returns
    -------
    bool
    """
    if len(observations) != len(actions):
        return False
    run = exact_runner(policy)
    return all(run(given) == returned for given, returned in zip(observations, actions, strict=True))
