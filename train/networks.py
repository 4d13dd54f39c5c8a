"""Policies and critics of all seeds as one flat tensor: a stack of small networks that one array program moves.

``h_0 = x, h_k = relu(W_k h_{k-1} + b_k)``, and the last layer is affine, followed by tanh where the network is squashed
(a policy, whose action is in [-1, 1]). Row s of a flat tensor (S, P) holds W_1, b_1, W_2, b_2, ... of seed s.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
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

    def views(self, flat: Tensor) -> list[Pair]:
        """Weights (S, outputs, inputs) and biases (S, outputs) of every layer, as views into a flat tensor (S, P)."""
        pairs, start = [], 0
        for inputs, outputs in pairwise(self.sizes):
            middle, stop = start + inputs * outputs, start + (inputs + 1) * outputs
            weight = flat[:, start:middle].unflatten(1, (outputs, inputs))
            pairs.append((weight, flat[:, middle:stop]))
            start = stop
        return pairs


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


def layers_of(layout: Layout, row: Tensor) -> list[Layer]:
    """The network of one seed, flat (P,), as layers for `models.onnx_writer.write_policy`."""
    layers: list[Layer] = []
    for weight, bias in layout.views(row.detach().cpu()[None]):
        if layers:
            layers.append(Activation("relu"))
        layers.append(Affine(weight[0].double().numpy(), bias[0].double().numpy()))
    return [*layers, Activation("tanh")] if layout.squashed else layers
