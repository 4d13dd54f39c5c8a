"""Dense oracle of set training: every column of every set is there, and automatic differentiation does the rest."""

from __future__ import annotations

import numpy as np
import torch

from setrl.models.policy import Activation
from setrl.train.losses import Networks, Penalty
from setrl.train.networks import Layout, initial_parameters
from setrl.verify.relaxations import relax

Tensor = torch.Tensor


def dense(layout: Layout, flat: Tensor, center: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
    """Center (S, B, m) and all columns (S, B, q, m) of an enclosure of columns (S, B, q, n), relaxations detached."""
    pairs = layout.views(flat)
    for k, (weight, bias) in enumerate(pairs):
        center = center @ weight.mT + bias[:, None]
        columns = columns @ weight.mT[:, None]
        last = k == len(pairs) - 1
        if last and not layout.squashed:
            break
        center, columns = activated("tanh" if last else "relu", center, columns)
    return center, columns


def activated(kind: str, center: Tensor, columns: Tensor) -> tuple[Tensor, Tensor]:
    """One activation with the engine's relaxation in float64."""
    radius = columns.abs().sum(-2)
    bounds = [(center + sign * radius).detach().double().numpy() for sign in (-1, 1)]
    found = relax(Activation(kind), *bounds)
    slope, offset, error = (torch.from_numpy(np.array(x)).to(center) for x in (found.slope, found.offset, found.error))
    return slope * center + offset, torch.cat([slope[..., None, :] * columns, torch.diag_embed(error)], -2)


def log_volume(columns: Tensor, floor: float) -> Tensor:
    """Mean over the batch of sum_j ln(2 (|G| 1 + floor)_j), (S,); where that is ln(0), a constant 0."""
    size = columns.abs().sum(-2) + floor
    return torch.where(size > 0.0, torch.log(2.0 * torch.where(size > 0.0, size, 1.0)), 0.0).sum(-1).mean(1)


def actor_loss(networks: Networks, actor: Tensor, x: Tensor, rows: Tensor, penalty: Penalty, omega: float) -> Tensor:
    """Losses (S,) of sa-pc (omega = 1) and sa-sc by their formulas."""
    seeds, batch, _ = x.shape
    columns = rows.expand(seeds, batch, *rows.shape)
    center, made = dense(networks.actor_layout, actor, x, columns)
    volume = omega * log_volume(made, penalty.floor)
    joint = torch.cat([x, center], -1)
    if omega == 1.0:
        value = points(networks.critic_layout, networks.first_critic, joint)
        return penalty.weight * volume - value.mean((1, 2))
    extra = made.shape[2] - rows.shape[0]
    observed = torch.cat([columns, torch.zeros((seeds, batch, extra, rows.shape[1]), dtype=x.dtype)], 2)
    value, judged = dense(networks.critic_layout, networks.first_critic, joint, torch.cat([observed, made], -1))
    return penalty.weight * (volume + (1.0 - omega) * log_volume(judged, penalty.floor)) - value.mean((1, 2))


def critic_loss(
    networks: Networks, critic: Tensor, inputs: Tensor, columns: Tensor, y: Tensor, penalty: Penalty
) -> Tensor:
    """Losses (S,) of the set critic; columns (S, B, q, n + m)."""
    center, made = dense(networks.critic_layout, critic, inputs, columns)
    return 0.5 * (center - y).square().mean((1, 2)) + penalty.weight * log_volume(made, penalty.floor)


def points(layout: Layout, flat: Tensor, x: Tensor) -> Tensor:
    """A plain forward pass."""
    pairs = layout.views(flat)
    for k, (weight, bias) in enumerate(pairs):
        x = x @ weight.mT + bias[:, None]
        if k + 1 < len(pairs):
            x = torch.relu(x)
    return torch.tanh(x) if layout.squashed else x


def stack_of_networks(
    hidden: tuple[int, ...], inputs: int, actions: int, *, seeds: int = 3, critics: int = 1, dtype: torch.dtype
) -> Networks:
    """Random networks with biases that are not zero, most of them positive: no layer is dead."""
    actor_layout = Layout((inputs, *hidden, actions), True)
    critic_layout = Layout((inputs + actions, *hidden, 1), False)
    generators = [np.random.default_rng(100 + seed) for seed in range(seeds * critics)]
    found = []
    for layout, count in ((actor_layout, seeds), (critic_layout, seeds * critics)) * 2:
        flat = initial_parameters(layout, generators[:count], torch.float64)
        for _, bias in layout.views(flat):
            for row, generator in zip(bias, generators[:count], strict=True):
                row += torch.from_numpy(generator.normal(0.3, 0.1, size=len(row)))
        found.append(flat.to(dtype))
    return Networks(actor_layout, critic_layout, *found)
