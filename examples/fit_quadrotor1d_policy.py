"""Fit the shipped example policy: a small network that imitates a saturated LQR controller of the 1D quadrotor.

    python examples/fit_quadrotor1d_policy.py [output.onnx]

No reinforcement learning and no torch: a least-squares fit with numpy and scipy, so that `setrl verify` has something
to verify out of the box. The weight decay keeps slopes moderate, which is what keeps enclosures tight.
"""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import expm, solve_discrete_are
from scipy.optimize import minimize

from setrl.models.onnx_writer import write_policy
from setrl.models.plant import load_plant
from setrl.models.policy import Activation, Affine, Layer

Floats = NDArray[np.float64]

SIZES = (2, 16, 16, 1)
SEED = 3
SAMPLES = 2000
RANGES = np.array([5.0, 6.0])  # m, m/s
WEIGHT_DECAY = 1e-3
PERIOD = 0.1
STATE_COST = np.diag([1.0, 0.15])
ACTION_COST = np.array([[1.5]])


def lqr_gain() -> tuple[Floats, float]:
    """Gain of the sampled double integrator, and the action that hovers."""
    values = {name: float(value) for name, (value, _) in load_plant("quadrotor1d").description.parameters.items()}
    strength = 1.0 / (2.0 * values["m"])  # acceleration per unit of action
    continuous = np.array([[0.0, 1.0, 0.0], [0.0, 0.0, strength], [0.0, 0.0, 0.0]])
    step = expm(PERIOD * continuous)
    a, b = step[:2, :2], step[:2, 2:]
    cost = solve_discrete_are(a, b, STATE_COST, ACTION_COST)
    gain = np.linalg.solve(ACTION_COST + b.T @ cost @ b, b.T @ cost @ a)
    return gain[0], values["g"] / strength - 1.0


def unpack(flat: Floats) -> list[tuple[Floats, Floats]]:
    """Flat parameters as (weight, bias) per layer."""
    layers, start = [], 0
    for rows, columns in zip(SIZES[1:], SIZES[:-1], strict=True):
        stop = start + rows * columns
        layers.append((flat[start:stop].reshape(rows, columns), flat[stop : stop + rows]))
        start = stop + rows
    return layers


def loss_and_gradient(flat: Floats, points: Floats, targets: Floats) -> tuple[float, Floats]:
    """Mean squared error of ``tanh(W3 relu(W2 relu(W1 x + b1) + b2) + b3)`` plus weight decay, and its gradient."""
    layers = unpack(flat)
    values = [points]
    for weight, bias in layers[:-1]:
        values.append(np.maximum(values[-1] @ weight.T + bias, 0.0))
    output = np.tanh(values[-1] @ layers[-1][0].T + layers[-1][1])
    error = output - targets[:, None]
    slope = 2.0 * error * (1.0 - output**2) / len(points)
    gradients: list[Floats] = []
    for (weight, _), value in zip(reversed(layers), reversed(values), strict=True):
        gradients += [slope.sum(axis=0), (slope.T @ value + 2.0 * WEIGHT_DECAY * weight).ravel()]
        slope = (slope @ weight) * (value > 0.0)
    decay = sum(float((weight**2).sum()) for weight, _ in layers)
    return float((error**2).mean()) + WEIGHT_DECAY * decay, np.concatenate(gradients[::-1])


def fit() -> list[Layer]:
    """Fit the network from a fixed seed."""
    generator = np.random.default_rng(SEED)
    gain, hover = lqr_gain()
    points = generator.uniform(-RANGES, RANGES, size=(SAMPLES, 2))
    points[: SAMPLES // 4] *= 0.1  # where the controller ends up
    targets = np.clip(hover - points @ gain, -1.0, 1.0)
    start = np.concatenate(
        [
            part
            for rows, columns in zip(SIZES[1:], SIZES[:-1], strict=True)
            for part in (generator.normal(scale=np.sqrt(2.0 / columns), size=rows * columns), np.zeros(rows))
        ]
    )
    options = {"maxiter": 2000, "maxfun": 4000}
    result = minimize(loss_and_gradient, start, (points, targets), method="L-BFGS-B", jac=True, options=options)
    weights = [Affine(weight, bias) for weight, bias in unpack(result.x)]
    print(f"LQR gain {np.round(gain, 3)}, hover {hover:.3f}, loss {result.fun:.5f}")
    return [weights[0], Activation("relu"), weights[1], Activation("relu"), weights[2], Activation("tanh")]


def main() -> None:
    """Fit and write."""
    target = Path(sys.argv[1] if len(sys.argv) > 1 else "quadrotor1d-example.onnx")
    digest = write_policy(target, fit(), name="quadrotor1d-example", description="Imitates a saturated LQR controller.")
    print(f"{target}: sha256 {digest}")


if __name__ == "__main__":
    main()
