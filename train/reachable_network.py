"""Action sets of stacked policies on affine forms, differentiable through slopes and errors.

Every hidden layer is an affine function of the network's input x plus the relaxation errors so far,

    W_k h_{k-1} + b_k = A_k x + a_k + sum_{j<k} C_kj diag(d_j) e_j,
    A_k = W_k diag(m_{k-1}) A_{k-1},  C_kj = W_k diag(m_{k-1}) W_{k-1} ... diag(m_{j+1}) W_{j+1},

with slopes m and errors d of `relaxation_gradients`. The columns of the set are mapped by the small matrices A_k, never
layer by layer; |C_kj| d_j needs no columns at all.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from .networks import Layout, Pair, Tensor
from .relaxation_gradients import center_and_radius, relaxed_relu, relaxed_tanh, with_center


@dataclass(frozen=True)
class ActionSet:
    """Outputs of S policies on P sets each; m outputs.

    Attributes
    ----------
    terms : Tensor, shape (S, m, P, 1 + q)
        Center, and the columns of the input's generators in their order.
    private : Tensor, shape (S, m, P, k)
        Columns of relaxation errors. For m = 1 they are parallel: one column, exactly.
    """

    terms: Tensor
    private: Tensor


@dataclass(frozen=True)
class Weights:
    """Parameters of stacked policies, taken apart once for all periods.

    Attributes
    ----------
    pairs : list of (Tensor, Tensor)
        Weights (S, outputs, inputs) and biases (S, outputs) of every layer.
    sizes : list of Tensor
        Absolute values of the weights.
    squashed : bool
        Whether tanh follows.
    """

    pairs: list[Pair]
    sizes: list[Tensor]
    squashed: bool

    @classmethod
    def of(cls, layout: Layout, flat: Tensor) -> Weights:
        """Parameters (S, N)."""
        pairs = layout.views(flat)
        return cls(pairs, [weight.abs() for weight, _ in pairs], layout.squashed)


def enclose_actions(weights: Weights, terms: Tensor) -> ActionSet:
    """Enclose the outputs of all networks on sets of inputs.

    Parameters
    ----------
    weights : Weights
    terms : Tensor, shape (S, n, P, 1 + q)
        Centers and generators of the sets.

    Returns
    -------
    ActionSet
    """
    (weight, bias), *later = weights.pairs
    sets = terms.shape[2]
    maps, offset = weight[:, :, None].expand(-1, -1, sets, -1), bias[:, :, None].expand(-1, -1, sets)
    image = torch.bmm(weight, terms.flatten(2)).unflatten(2, terms.shape[2:])
    by_cell = terms.transpose(1, 2)  # (S, P, n, 1 + q)
    slopes: list[Tensor] = []
    errors: list[Tensor] = []
    for weight, bias in later:
        center, radius = center_and_radius(image)
        center = center + offset
        for column in _error_columns(weights, slopes, errors, apart=False):
            radius = radius + column
        slope, half = relaxed_relu(center - radius, center + radius)
        slopes.append(slope)
        errors.append(half)
        maps = torch.bmm(weight, (maps * slope[..., None]).flatten(2)).unflatten(2, maps.shape[2:])
        offset = torch.baddbmm(bias[:, :, None], weight, torch.addcmul(half, slope, offset))
        image = torch.matmul(maps.transpose(1, 2), by_cell).transpose(1, 2)
    center, radius = center_and_radius(image)
    center = center + offset
    single = center.shape[1] == 1
    columns = _error_columns(weights, slopes, errors, apart=not single)
    own = sum((column if single else column.abs().sum(-1) for column in columns), torch.zeros_like(radius))
    slope, error = torch.ones_like(radius), torch.zeros_like(radius)
    if weights.squashed:
        radius = radius + own
        slope, shift, error = relaxed_tanh(center - radius, center + radius)
        center, own = torch.addcmul(shift, slope, center), own * slope
        columns = [] if single else [column * slope[..., None] for column in columns]
    whole = with_center(image, slope, center)
    if single:
        return ActionSet(whole, (own + error)[..., None])
    diagonal = torch.diag_embed(error.transpose(1, 2)).transpose(1, 2)
    return ActionSet(whole, torch.cat([*columns, diagonal], -1))


def _error_columns(
    weights: Weights, slopes: Sequence[Tensor], errors: Sequence[Tensor], *, apart: bool
) -> list[Tensor]:
    """What relaxation errors so far add to the next layer, from the latest to the first.

    ``|C_kj| d_j``, shape (S, width, P); where `apart`, the columns ``C_kj diag(d_j)``, (S, width, P, width_j).
    """
    if not errors:
        return []
    last = len(errors)
    weight = weights.pairs[last][0]
    if apart:
        found = [weight[:, :, None] * errors[-1].transpose(1, 2)[:, None]]
    else:
        found = [torch.bmm(weights.sizes[last], errors[-1])]
    row = weight[:, :, None]  # C_kj, (S, width, 1 or P, width_j)
    for j in range(last - 2, -1, -1):
        row = row * slopes[j + 1].transpose(1, 2)[:, None]
        row = torch.bmm(row.flatten(1, 2), weights.pairs[j + 1][0]).unflatten(1, row.shape[1:3])
        error = errors[j].transpose(1, 2)[:, None]
        found.append(row * error if apart else (row.abs() * error).sum(-1))
    return found
