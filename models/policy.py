"""The policy network as data: a sequence of affine maps and activations, exactly as stored in the ONNX file."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any, TypeAlias

import numpy as np
from numpy.typing import NDArray

FloatArray: TypeAlias = NDArray[np.float64]


@dataclass(frozen=True, eq=False)
class Affine:
    """``y = weight @ x + bias``, each layer one (or one fused) operator of the file.

    Never composed with its neighbours, so that the numbers are exactly the stored ones. Compared and hashed by
    identity: what is derived from a layer is cached by the layer.

    Attributes
    ----------
    weight : array, shape (outputs, inputs), float64
        float32 weights widened exactly.
    bias : array, shape (outputs,)
    weight_error, bias_error : array of the same shape, or None
        Upper bounds of ``|true - stored|`` where the file's exact number is not a float64 (a division by a constant);
        None where the stored numbers are exact.
    """

    weight: FloatArray
    bias: FloatArray
    weight_error: FloatArray | None = None
    bias_error: FloatArray | None = None


@dataclass(frozen=True)
class Activation:
    """An elementwise function.

    Attributes
    ----------
    kind : {"relu", "leaky_relu", "tanh", "sigmoid", "clip"}
    slope : float
        leaky_relu: slope for negative arguments.
    lower, upper : float
        clip: the bounds; may be -inf or inf.
    """

    kind: str
    slope: float = 0.0
    lower: float = -np.inf
    upper: float = np.inf


Layer: TypeAlias = Affine | Activation


@dataclass(frozen=True)
class Policy:
    """A policy network.

    Attributes
    ----------
    layers : tuple of Affine and Activation
    inputs, outputs : int
    precision : {"float32", "float64"}
        Type in which the deployed runtime computes.
    name : str
        File name, for messages.
    digest : str
        sha256 of the file's bytes.
    content : bytes
        The bytes that were read (onnxruntime runs these same bytes).
    operators : tuple of str
        ONNX operators in graph order, for `inspect`.
    opset : int
        Version of the ONNX operator set, 0 where the policy does not come from a file.
    """

    layers: tuple[Layer, ...]
    inputs: int
    outputs: int
    precision: str = "float32"
    name: str = ""
    digest: str = ""
    content: bytes = field(default=b"", repr=False)
    operators: tuple[str, ...] = ()
    opset: int = 0

    def __call__(self, x: Any) -> FloatArray:
        """Forward pass in float64, ``x`` of shape (..., inputs)."""
        return forward(self.layers, np.asarray(x, dtype=np.float64))


def activate(activation: Activation, x: FloatArray) -> FloatArray:
    """Point function of an activation, float64."""
    match activation.kind:
        case "relu":
            return np.maximum(x, 0.0)
        case "leaky_relu":
            return np.where(x >= 0.0, x, activation.slope * x)
        case "tanh":
            return np.tanh(x)
        case "sigmoid":
            return 0.5 + 0.5 * np.tanh(0.5 * x)
        case "clip":
            return np.clip(x, activation.lower, activation.upper)
    raise AssertionError(f"unknown activation {activation.kind}")


def forward(layers: tuple[Layer, ...], x: FloatArray) -> FloatArray:
    """Run layers on points ``x`` of shape (..., n), float64."""
    for layer in layers:
        x = x @ layer.weight.T + layer.bias if isinstance(layer, Affine) else activate(layer, x)
    return x
