"""The policy as it is deployed: onnxruntime's CPU provider on the same bytes, and the reader's check against it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, TypeAlias

import numpy as np

from ..specs.errors import PolicyError
from .policy import Activation, FloatArray, Policy, activate

Runner: TypeAlias = Callable[[FloatArray], FloatArray]

SAMPLES = 256
"""Points on which a policy is compared with onnxruntime when it is read."""

SLACK = 4.0
"""Multiple of the first-order rounding budget that the comparison allows."""


def runtime_version() -> str:
    """Version of the installed onnxruntime."""
    import onnxruntime

    return str(onnxruntime.__version__)


def deployed_runner(policy: Policy) -> Runner:
    """The network as onnxruntime runs it.

    Parameters
    ----------
    policy : Policy
        With the bytes it was read from.

    Returns
    -------
    callable
        Maps observations (B, inputs) to actions (B, outputs), float64 arrays; inside, numbers are rounded to the
        file's type. One thread, CPU provider. A file with a fixed batch runs once per row.

    Raises
    ------
    PolicyError
        The policy has no bytes or onnxruntime refuses them.
    """
    import onnxruntime

    if not policy.content:
        raise PolicyError(
            "the policy was built in memory and has no ONNX bytes to run",
            where=policy.name or None,
            remedy="write it with write_policy and read it again",
        )
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = options.inter_op_num_threads = 1
    options.log_severity_level = 4
    try:
        session = onnxruntime.InferenceSession(policy.content, options, providers=["CPUExecutionProvider"])
    except Exception as error:  # onnxruntime's own exceptions share no base but Exception
        raise PolicyError(
            f"onnxruntime {runtime_version()} cannot load the model: {_first_line(error)}",
            where=policy.name,
            remedy="export it again with another opset_version",
        ) from error
    (declared,) = session.get_inputs()
    dtype = np.float64 if declared.type == "tensor(double)" else np.float32
    dynamic = not isinstance(declared.shape[0], int)
    sample = tuple(declared.shape[1:]) if dynamic else tuple(declared.shape)

    def execute(rows: FloatArray) -> FloatArray:
        shaped = rows.astype(dtype).reshape((-1, *sample) if dynamic else sample)
        try:
            (result,) = session.run(None, {declared.name: shaped})
        except Exception as error:
            raise PolicyError(
                f"onnxruntime cannot run the model: {_first_line(error)}", where=policy.name, remedy="export it again"
            ) from error
        return np.asarray(result, dtype=np.float64).reshape(len(rows), -1)

    def run(observations: FloatArray) -> FloatArray:
        rows = np.atleast_2d(np.asarray(observations, dtype=np.float64))
        if dynamic or len(rows) == 1:
            return execute(rows)
        return np.concatenate([execute(row[None]) for row in rows])

    return run


def _first_line(error: Exception) -> str:
    return (str(error).splitlines() or [type(error).__name__])[0]


def require_agreement(policy: Policy) -> None:
    """Compare the own forward pass with onnxruntime on fixed random points.

    A sanity check of the reader, not a proof: the difference must stay within `SLACK` times a first-order estimate
    of the rounding in the file's own precision.

    Raises
    ------
    PolicyError
        The two disagree, or onnxruntime cannot run the file.
    """
    generator = np.random.default_rng(20240229)
    scales = generator.choice([0.1, 1.0, 10.0], size=(SAMPLES, 1))
    points = generator.uniform(-1.0, 1.0, size=(SAMPLES, policy.inputs)) * scales
    with np.errstate(over="ignore", invalid="ignore"):
        expected, budget = rounding_budget(policy, points)
    received = deployed_runner(policy)(points)
    if received.shape != expected.shape:
        raise PolicyError(
            f"onnxruntime returns {received.shape[1]} actions, the reader found {expected.shape[1]}", where=policy.name
        )
    with np.errstate(invalid="ignore"):
        wrong = ~(np.abs(received - expected) <= SLACK * budget)
    if wrong.any():
        row, column = np.argwhere(wrong)[0]
        raise PolicyError(
            f"onnxruntime {runtime_version()} and the reader disagree: output {column} is "
            f"{received[row, column]:.9g} against {expected[row, column]:.9g} at {points[row].tolist()}, "
            f"rounding explains {SLACK * budget[row, column]:.1e}",
            where=policy.name,
            remedy="report this file as a bug",
        )


def rounding_budget(policy: Policy, points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Forward pass and a first-order estimate of what rounding may change, both (B, outputs).

    ``e <- |W| e + (k + 2) u (|W| |x| + |b|)`` for an affine layer, times the largest slope (plus a constant for the
    runtime's own tanh) for an activation; u = 2^-24 for float32, 2^-53 for float64.
    """
    unit, tiny = (2.0**-24, 2.0**-126) if policy.precision == "float32" else (2.0**-53, 2.0**-1022)
    value, error = points, unit * np.abs(points)
    for layer in policy.layers:
        if isinstance(layer, Activation):
            value = activate(layer, value)
            error = error * max(1.0, layer.slope) + _activation_error(layer, unit) + unit * np.abs(value)
        else:
            weight = np.abs(layer.weight)
            magnitude = np.abs(value) @ weight.T + np.abs(layer.bias)
            # numbers below the normal ones may be flushed to zero
            error = (error + tiny) @ weight.T + (weight.shape[1] + 2) * (unit * magnitude + tiny)
            value = value @ layer.weight.T + layer.bias
    return value, error + tiny


def _activation_error(layer: Activation, unit: float) -> float:
    return 16.0 * unit if layer.kind in ("tanh", "sigmoid") else 0.0


def runtime_facts(policy: Policy) -> dict[str, Any]:
    """What a report says about the deployed semantics of a policy."""
    return {"runtime": f"onnxruntime {runtime_version()}", "precision": policy.precision, "digest": policy.digest}
