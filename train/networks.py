"""Policies and critics of all seeds as one flat tensor: a stack of small networks that one array program moves.

``h_0 = x, h_k = relu(W_k h_{k-1} + b_k)``, and the last layer is affine, followed by tanh where the network is squashed
(a policy, whose action is in [-1, 1]). Row s of a flat tensor (S, P) holds W_1, b_1, W_2, b_2, ... of seed s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, TypeAlias

import numpy as np
import torch

from ..models.policy import Activation, Affine, Layer

Tensor: TypeAlias = torch.Tensor
Pair: TypeAlias = "tuple[Tensor, Tensor]"


@dataclass(frozen=True)
class Layout:
    """Shape of a network.

    Attributes
    ----------
    sizes : tuple of int
        Inputs, hidden widths, outputs.
    squashed : bool
        Whether tanh follows the last affine map.
    """

    sizes: tuple[int, ...]
    squashed: bool

    @property
    def parameters(self) -> int:
        """Numbers per seed."""
        return sum((inputs + 1) * outputs for inputs, outputs in pairwise(self.sizes))

    @cached_property
    def _pieces(self) -> list[int]:
        return [size for inputs, outputs in pairwise(self.sizes) for size in (inputs * outputs, outputs)]

    def views(self, flat: Tensor) -> list[Pair]:
        """Weights (S, outputs, inputs) and biases (S, outputs) of every layer, as views into a flat tensor (S, P)."""
        pieces, sizes = flat.split(self._pieces, 1), self.sizes
        return [(pieces[2 * k].view(-1, sizes[k + 1], sizes[k]), pieces[2 * k + 1]) for k in range(len(sizes) - 1)]


def initial_parameters(layout: Layout, generators: Sequence[np.random.Generator], dtype: torch.dtype) -> Tensor:
    """Glorot-uniform weights and zero biases, shape (S, P): W ~ U(-a, a), a = sqrt(6 / (inputs + outputs)) [1]_.

    Parameters
    ----------
    layout : Layout
    generators : sequence of numpy.random.Generator
        One per seed.
    dtype : torch.dtype

    Returns
    -------
    Tensor

    References
    ----------
    .. [1] Glorot and Bengio, "Understanding the difficulty of training deep feedforward neural networks", 2010.
    """
    rows = []
    for generator in generators:
        parts: list[Any] = []
        for inputs, outputs in pairwise(layout.sizes):
            bound = np.sqrt(6.0 / (inputs + outputs))
            parts += [generator.uniform(-bound, bound, inputs * outputs), np.zeros(outputs)]
        rows.append(np.concatenate(parts))
    return torch.from_numpy(np.stack(rows)).to(dtype)


def forward(layout: Layout, flat: Tensor, x: Tensor) -> Tensor:
    """Run all networks: x (S, B, inputs) to (S, B, outputs)."""
    *hidden, (weight, bias) = layout.views(flat)
    for w, b in hidden:
        x = torch.baddbmm(b[:, None], x, w.mT).relu_()
    x = torch.baddbmm(bias[:, None], x, weight.mT)
    return x.tanh_() if layout.squashed else x


@dataclass(frozen=True)
class Trace:
    """A forward pass with what its backward pass needs.

    Attributes
    ----------
    inputs : list of Tensor, shape (S, B, width)
        Input h_{k-1} of every affine map.
    slopes : list of Tensor, shape (S, B, width)
        d h_k / d (W_k h_{k-1} + b_k) of every hidden layer.
    output : Tensor, shape (S, B, outputs)
    final : Tensor or None
        d output / d (last affine map); None: 1.
    """

    inputs: list[Tensor]
    slopes: list[Tensor]
    output: Tensor
    final: Tensor | None


def trace(layout: Layout, flat: Tensor, x: Tensor) -> Trace:
    """`forward`, kept for `backward`."""
    *hidden, (weight, bias) = layout.views(flat)
    inputs, slopes = [x], []
    for w, b in hidden:
        x = torch.baddbmm(b[:, None], x, w.mT).relu_()
        inputs.append(x)
        slopes.append(x.sign())
    x = torch.baddbmm(bias[:, None], x, weight.mT)
    if not layout.squashed:
        return Trace(inputs, slopes, x, None)
    x = x.tanh_()
    return Trace(inputs, slopes, x, 1.0 - x.square())


def backward(layout: Layout, flat: Tensor, kept: Trace, delta: Tensor) -> list[Pair]:
    """Gradient of ``sum(delta * output)`` with respect to every layer's weight and bias."""
    if kept.final is not None:
        delta = delta * kept.final
    pairs = layout.views(flat)
    found: list[Pair] = []
    for k in range(len(pairs) - 1, -1, -1):
        found.append((torch.bmm(delta.mT, kept.inputs[k]), delta.sum(1)))
        if k:
            delta = torch.bmm(delta, pairs[k][0]).mul_(kept.slopes[k - 1])
    return found[::-1]


def pack(pairs: list[Pair], gradient: Tensor) -> None:
    """Write what `backward` found into a flat tensor (S, P); bmm straight into its views would run seed by seed."""
    torch.cat([part.flatten(1) for pair in pairs for part in pair], 1, out=gradient)


def input_gradient(layout: Layout, flat: Tensor, kept: Trace, delta: Tensor) -> Tensor:
    """Gradient of ``sum(delta * output)`` with respect to the network's input, shape (S, B, inputs)."""
    if kept.final is not None:
        delta = delta * kept.final
    pairs = layout.views(flat)
    for k in range(len(pairs) - 1, -1, -1):
        delta = torch.bmm(delta, pairs[k][0])
        if k:
            delta.mul_(kept.slopes[k - 1])
    return delta


def layers_of(layout: Layout, row: Tensor) -> list[Layer]:
    """The network of one seed, flat (P,), as layers for `models.onnx_writer.write_policy`."""
    layers: list[Layer] = []
    for weight, bias in layout.views(row.detach().cpu()[None]):
        if layers:
            layers.append(Activation("relu"))
        layers.append(Affine(weight[0].double().numpy(), bias[0].double().numpy()))
    return [*layers, Activation("tanh")] if layout.squashed else layers
