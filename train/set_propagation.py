"""Zonotopes through stacked networks, and the gradient of what is said about their generators.

A set <c, G> goes through an affine map as <W c + b, W G>, and through an activation as <m c + o, [m G, diag(d)]> with
slope m, offset o and error d of `verify.relaxations`: Prop. 2.3 of the paper, with one column per unstable or curved
neuron. Slopes, offsets and errors are constants of the gradient, so that at a network's output

    G = [ X A',  C_1' diag(d_1), ..., C_K' diag(d_K), diag(d_tanh) ],

with the columns X of the input (one per row), the coefficients ``C_K = W_{K+1}``, ``C_{k-1} = C_k diag(m_k) W_k``,
A = C_0, scaled by tanh's slope. The matrices of columns are never formed: |G| 1 needs only C_k and d_k, and for weights
w_j on the columns the gradient of ``sum_j w_j' G_j`` is one vector pass per output,

    dW_k += v_k (G_{k-1} w)',  v_k = C_k[j] diag(m_k),

because the backward vector is the same for every column. The dense computation over all columns is the oracle of the
tests.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch

from ..models.policy import Activation
from ..verify.relaxations import estimate
from .networks import Layout, Pair, Tensor, Trace, backward

RELU, TANH = Activation("relu"), Activation("tanh")


@dataclass(frozen=True)
class Enclosure:
    """Enclosure of the outputs of stacked networks on zonotopes; S seeds, B sets each, m outputs.

    Columns and outputs come before the batch, so that sums over them run over whole blocks of memory.

    Attributes
    ----------
    center : Tensor, shape (S, B, m)
    radius : Tensor, shape (S, B, m)
        |G| 1, all columns.
    shared : Tensor, shape (S, m, q, B)
        Output columns of the input's, in their order.
    private : tuple of Tensor, shape (S, m, B, width_k)
        Output columns of the relaxation errors of hidden layer k.
    last : Tensor or None, shape (S, B, m)
        Error of the final tanh: a diagonal of columns.
    columns : Tensor, shape (q, n) or (S, q, B, n)
        The input's.
    slopes, errors : tuple of Tensor
        m_k and d_k of the hidden layers, shape (S, B, width_k).
    coefficients : tuple of Tensor, shape (S, m, B, width_k)
        C_k before tanh, of the hidden layers.
    input_coefficients : Tensor, shape (S, m, B, n)
        A before tanh: also the gradient of the center with respect to the input's center.
    kept : Trace
        The center's pass.
    """

    center: Tensor
    radius: Tensor
    shared: Tensor
    private: tuple[Tensor, ...]
    last: Tensor | None
    columns: Tensor
    slopes: tuple[Tensor, ...]
    errors: tuple[Tensor, ...]
    coefficients: tuple[Tensor, ...]
    input_coefficients: Tensor
    kept: Trace


def enclose(layout: Layout, flat: Tensor, center: Tensor, columns: Tensor) -> Enclosure:
    """Enclose the outputs of all networks on the zonotopes ``{center + sum_j beta_j columns_j : beta in [-1, 1]^q}``.

    Parameters
    ----------
    layout : Layout
    flat : Tensor, shape (S, P)
    center : Tensor, shape (S, B, n)
    columns : Tensor, shape (q, n), the same for all sets, or (S, q, B, n)

    Returns
    -------
    Enclosure
        Differentiable with respect to every argument, relaxations included.
    """
    *hidden, (weight, bias) = layout.views(flat)
    inputs: list[Tensor] = [center]
    slopes: list[Tensor] = []
    errors: list[Tensor] = []
    rows: Tensor | None = None  # columns of the set, as far as a later hidden layer needs them
    for k, (w, b) in enumerate(hidden):
        middle = torch.baddbmm(b[:, None], inputs[-1], w.mT)
        if rows is None:
            rows = _mapped(columns, w)
            radius = rows.abs().sum(1)
        else:
            rows = _mapped(rows * slopes[-1][:, None], w)
            radius = torch.baddbmm(rows.abs().sum(1), errors[-1], w.abs().mT)
            if k + 1 < len(hidden):
                rows = torch.cat([rows, errors[-1].mT[..., None] * w.mT[:, :, None]], 1)
        relaxation = estimate(RELU, middle - radius, middle + radius, torch)
        slopes.append(relaxation.slope)
        errors.append(relaxation.error)
        inputs.append(torch.addcmul(relaxation.offset, relaxation.slope, middle))
    output = torch.baddbmm(bias[:, None], inputs[-1], weight.mT)
    coefficients, first = _coefficients(hidden, weight, slopes, output.shape[1])
    if columns.ndim == 2:
        shared = torch.matmul(columns, first.mT)
    else:
        shared = (columns[:, None] * first[:, :, None]).sum(-1)
    private = [c * d[:, None] for c, d in zip(coefficients, errors, strict=True)]
    radius = shared.abs().sum(2)
    for part in private:
        radius = radius + part.abs().sum(-1)
    radius = radius.mT
    final, last = None, None
    if layout.squashed:
        tanh = estimate(TANH, output - radius, output + radius, torch)
        final, last = tanh.slope, tanh.error
        output = torch.addcmul(tanh.offset, final, output)
        shared = shared * final.mT[:, :, None]
        private = [part * final.mT[..., None] for part in private]
        radius = torch.addcmul(last, final, radius)
    return Enclosure(
        output,
        radius,
        shared,
        tuple(private),
        last,
        columns,
        tuple(slopes),
        tuple(errors),
        tuple(coefficients),
        first,
        Trace(inputs, slopes, output, final),
    )


def _mapped(rows: Tensor, weight: Tensor) -> Tensor:
    """Columns times W', (q, n) or (S, q, B, n) to (S, q, 1 or B, outputs)."""
    if rows.ndim == 2:
        return torch.matmul(rows, weight.mT)[:, :, None]
    return torch.bmm(rows.flatten(1, 2), weight.mT).unflatten(1, rows.shape[1:3])


def _coefficients(
    hidden: Sequence[Pair], weight: Tensor, slopes: Sequence[Tensor], batch: int
) -> tuple[list[Tensor], Tensor]:
    """C_1 ... C_K and A: gradients of every output with respect to every layer's values and to the input."""
    row = weight[:, :, None].expand(-1, -1, batch, -1)
    found = []
    for (w, _), slope in zip(reversed(hidden), reversed(slopes), strict=True):
        found.append(row)
        row = torch.bmm((row * slope[:, None]).flatten(1, 2), w).unflatten(1, row.shape[1:3])
    return found[::-1], row


def set_gradient(
    layout: Layout,
    flat: Tensor,
    found: Enclosure,
    delta: Tensor,
    shared: Tensor,
    private: Sequence[Tensor],
) -> list[Pair]:
    """Gradient of ``sum(delta * center) + sum(weights * columns)`` with detached relaxations, by layer.

    Parameters
    ----------
    layout : Layout
    flat : Tensor, shape (S, P)
    found : Enclosure
    delta : Tensor, shape (S, B, m)
    shared : Tensor, shape (S, m, q, B)
        Weights of the columns `found.shared`.
    private : sequence of Tensor, shape (S, m, B, width_k)
        Weights of the columns `found.private`. Those of `found.last` are constants: they have no gradient.

    Returns
    -------
    list of (Tensor, Tensor)
        As `networks.backward`.
    """
    gradient = backward(layout, flat, found.kept, delta)
    *hidden, _ = layout.views(flat)
    if found.kept.final is not None:
        final = found.kept.final.mT
        shared = shared * final[:, :, None]
        private = [part * final[..., None] for part in private]
    # the sum over the columns at this layer's input, weighted: (S, m, B, width)
    if found.columns.ndim == 2:
        combined = torch.matmul(shared.mT, found.columns)
    else:
        combined = (shared[..., None] * found.columns[:, None]).sum(2)
    for k, (w, _) in enumerate(hidden):
        slope = found.slopes[k][:, None]
        vector = found.coefficients[k] * slope
        gradient[k][0].baddbmm_(vector.flatten(1, 2).mT, combined.flatten(1, 2))
        combined = torch.bmm(combined.flatten(1, 2), w.mT).unflatten(1, combined.shape[1:3])
        combined = torch.addcmul(private[k] * found.errors[k][:, None], combined, slope)
    gradient[-1][0].add_(combined.sum(2))
    return gradient


def merged(found: Enclosure) -> Tensor:
    """Output columns (S, columns, B, m), in the order: shared, private by layer, tanh.

    Of a one-dimensional output all private columns are parallel: they are one column, exactly.
    """
    shared = found.shared.permute(0, 2, 3, 1)
    if found.center.shape[-1] == 1:
        return torch.cat([shared, (found.radius.mT - found.shared.abs().sum(2))[..., None]], 1)
    parts = [shared, *(part.permute(0, 3, 2, 1) for part in found.private)]
    if found.last is not None:
        parts.append(torch.diag_embed(found.last).transpose(1, 2))
    return torch.cat(parts, 1)


def merged_count(layout: Layout, columns: int) -> int:
    """Columns that `merged` returns for an input of so many."""
    if layout.sizes[-1] == 1:
        return columns + 1
    return columns + sum(layout.sizes[1:-1]) + (layout.sizes[-1] if layout.squashed else 0)


def weights_of_merged(found: Enclosure, weights: Tensor) -> tuple[Tensor, list[Tensor]]:
    """Weights on the columns of `merged`, (S, columns, B, m), as weights on shared and private columns."""
    count = found.shared.shape[2]
    shared = weights[:, :count].permute(0, 3, 1, 2)
    if found.center.shape[-1] == 1:
        one = weights[:, count:]
        return shared, [one * part.sign() for part in found.private]
    sizes = [part.shape[-1] for part in found.private]
    parts = weights[:, count : count + sum(sizes)].split(sizes, 1)
    return shared, [part.permute(0, 3, 2, 1) for part in parts]
