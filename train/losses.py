"""Gradients of every loss, as pure functions of stacked networks: point losses, set losses, targets.

With lnDia(G) = ln(2 |G| 1) per row, eps the perturbation radius and means over the batch:

    point critic   1/2 (Q(s, a) - y)^2
    set critic     1/2 (c_Q - y)^2 + (eta_Q/eps) lnDia(G_Q)                                              Prop. 3.1
    point actor    -Q(s, mu(s))
    sa-pc actor    -Q(s, c_A) + (eta_mu/eps) sum_j lnDia(G_A)_j                                          Def. 3.3
    sa-sc actor    -c_Q + (eta_mu/eps) [ omega sum_j lnDia(G_A)_j + (1 - omega) lnDia(G_Q) ]             Def. 3.2

of "Training verifiably robust agents using set-based reinforcement learning"; the stray prime of Def. 3.2 is not
followed. A radius of zero has no penalty and no gradient.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch

from .networks import Layout, Tensor, backward, forward, input_gradient, pack, trace
from .set_propagation import Enclosure, enclose, merged, set_gradient, weights_of_merged


@dataclass(frozen=True)
class Networks:
    """Actors (S, P) and critics (C S, P) with their targets; C critics per seed, those of one kind side by side."""

    actor_layout: Layout
    critic_layout: Layout
    actor: Tensor
    critic: Tensor
    target_actor: Tensor
    target_critic: Tensor

    @property
    def critics(self) -> int:
        """Critics per seed: 1 (DDPG) or 2 (TD3)."""
        return len(self.critic) // len(self.actor)

    @property
    def first_critic(self) -> Tensor:
        """The critics that the actors climb."""
        return self.critic[: len(self.actor)]


@dataclass(frozen=True)
class Penalty:
    """Weights of the volume terms.

    Attributes
    ----------
    weight : float
        eta / eps.
    floor : float
        Added to every radius inside the logarithm.
    exact : bool
        Whether relaxations are differentiated too.
    """

    weight: float
    floor: float = 0.0
    exact: bool = False


def targets(
    networks: Networks, following: Tensor, reward: Tensor, terminal: Tensor, discount: float, noise: Tensor | None
) -> Tensor:
    """``y = r + gamma (1 - terminal) min_i Q_i'(s', clip(mu'(s') + noise))``, Eq. (3); shape (S, B, 1).

    Parameters
    ----------
    networks : Networks
    following : Tensor, shape (S, B, n)
    reward, terminal : Tensor, shape (S, B, 1)
    discount : float
    noise : Tensor or None, shape (S, B, m)
        TD3's smoothing of the target action.
    """
    action = forward(networks.actor_layout, networks.target_actor, following)
    if noise is not None:
        action = (action + noise).clamp_(-1.0, 1.0)
    value = _values(networks, networks.target_critic, torch.cat([following, action], -1))
    return torch.addcmul(reward, 1.0 - terminal, value, value=discount)


def _values(networks: Networks, critic: Tensor, inputs: Tensor) -> Tensor:
    if networks.critics == 1:
        return forward(networks.critic_layout, critic, inputs)
    found = forward(networks.critic_layout, critic, inputs.repeat(networks.critics, 1, 1))
    return found.unflatten(0, (networks.critics, -1)).amin(0)


def point_critic(networks: Networks, inputs: Tensor, y: Tensor, gradient: Tensor) -> Tensor:
    """Gradient of the point critic's loss, into `gradient` (C S, P); the loss per critic, shape (C S,).

    `inputs` (S, B, n + m), `y` (S, B, 1).
    """
    inputs, y = _per_critic(networks, inputs, y)
    kept = trace(networks.critic_layout, networks.critic, inputs)
    error = kept.output - y
    pack(backward(networks.critic_layout, networks.critic, kept, error / y.shape[1]), gradient)
    return 0.5 * error.square().mean((1, 2))


def _per_critic(networks: Networks, *tensors: Tensor) -> list[Tensor]:
    count = networks.critics
    return [t if count == 1 else t.repeat(count, *[1] * (t.ndim - 1)) for t in tensors]


def point_actor(networks: Networks, x: Tensor, gradient: Tensor) -> Tensor:
    """Gradient of the point actor's loss at observations (S, B, n), into `gradient` (S, P); the loss, shape (S,)."""
    kept = trace(networks.actor_layout, networks.actor, x)
    value, slope = _climb(networks, x, kept.output)
    pack(backward(networks.actor_layout, networks.actor, kept, slope), gradient)
    return -value.mean((1, 2))


def _climb(networks: Networks, x: Tensor, action: Tensor) -> tuple[Tensor, Tensor]:
    """Q at (x, action), and the gradient of the mean of -Q with respect to the action."""
    critic = networks.first_critic
    kept = trace(networks.critic_layout, critic, torch.cat([x, action], -1))
    seed = torch.full_like(kept.output, -1.0 / x.shape[1])
    slope = input_gradient(networks.critic_layout, critic, kept, seed)
    return kept.output, slope[..., x.shape[-1] :]


def set_critic(
    networks: Networks, inputs: Tensor, columns: Tensor, y: Tensor, penalty: Penalty, gradient: Tensor
) -> Tensor:
    """Gradient of the set critic's loss, into `gradient` (C S, P); the loss per critic, shape (C S,).

    Parameters
    ----------
    networks : Networks
    inputs : Tensor, shape (S, B, n + m)
        Centers: observation and action.
    columns : Tensor, shape (S, q, B, n + m)
        Generators; the observation's are shared with the action, never an independent product.
    y : Tensor, shape (S, B, 1)
    penalty : Penalty
    gradient : Tensor, shape (C S, P)
    """
    inputs, columns, y = _per_critic(networks, inputs, columns, y)
    layout = networks.critic_layout
    if penalty.exact:

        def loss(flat: Tensor) -> Tensor:
            found = enclose(layout, flat, inputs, columns)
            return 0.5 * (found.center - y).square().mean((1, 2)) + penalty.weight * _volume(found, penalty)

        return differentiate(loss, networks.critic, gradient)
    found = enclose(layout, networks.critic, inputs, columns)
    error, batch = found.center - y, y.shape[1]
    weight = volume_weight(found, penalty).mT / batch
    shared = found.shared.sign() * weight[:, :, None]
    private = [part.sign() * weight[..., None] for part in found.private]
    pack(set_gradient(layout, networks.critic, found, error / batch, shared, private), gradient)
    return 0.5 * error.square().mean((1, 2)) + penalty.weight * _volume(found, penalty)


def _volume(found: Enclosure, penalty: Penalty) -> Tensor:
    """Mean over the batch of ``sum_j ln(2 (radius_j + floor))``, (S,); a radius of zero counts 0."""
    size = found.radius + penalty.floor
    logarithm = torch.log(2.0 * size.clamp(min=torch.finfo(size.dtype).tiny))  # no infinite derivative at 0
    return torch.where(size > 0.0, logarithm, 0.0).sum(-1).mean(1)


def volume_weight(found: Enclosure, penalty: Penalty) -> Tensor:
    """d penalty / d radius = weight / (radius + floor), shape (S, B, m); 0 where that has no value."""
    return (penalty.weight / (found.radius + penalty.floor)).nan_to_num_(0.0, 0.0, 0.0)


def set_actor(networks: Networks, x: Tensor, rows: Tensor, penalty: Penalty, omega: float, gradient: Tensor) -> Tensor:
    """Gradient of a set actor's loss, into `gradient` (S, P); the loss, shape (S,).

    Parameters
    ----------
    networks : Networks
    x : Tensor, shape (S, B, n)
        Observations: the centers of the sets.
    rows : Tensor, shape (q, n)
        Generators of every perturbation set.
    penalty : Penalty
    omega : float
        1: sa-pc, the critic is a point function of the action's center. Below: sa-sc, the critic encloses
        ``<[x; c_A], [rows, G_A]>``.
    gradient : Tensor, shape (S, P)
    """
    layout = networks.actor_layout
    if penalty.exact:

        def loss(flat: Tensor) -> Tensor:
            found = enclose(layout, flat, x, rows)
            if omega == 1.0:
                joint = torch.cat([x, found.center], -1)
                value = forward_gradient(networks.critic_layout, networks.first_critic, joint)
                return penalty.weight * _volume(found, penalty) - value.mean((1, 2))
            judged = _judged(networks, x, rows, found)
            volume = omega * _volume(found, penalty) + (1.0 - omega) * _volume(judged, penalty)
            return penalty.weight * volume - judged.center.mean((1, 2))

        return differentiate(loss, networks.actor, gradient)
    found = enclose(layout, networks.actor, x, rows)
    batch = x.shape[1]
    weight = volume_weight(found, penalty).mT * (omega / batch)
    volume = omega * _volume(found, penalty)
    shared = found.shared.sign() * weight[:, :, None]
    private = [part.sign() * weight[..., None] for part in found.private]
    if omega == 1.0:
        value, slope = _climb(networks, x, found.center)
    else:
        judged = _judged(networks, x, rows, found)
        value, direction = judged.center, judged.input_coefficients[:, 0, :, x.shape[-1] :]
        slope = -direction / batch
        more = judged.shared.sign()[:, 0] * (volume_weight(judged, penalty).mT * ((1.0 - omega) / batch))
        other, others = weights_of_merged(found, more[..., None] * direction[:, None])
        shared = shared + other
        private = [mine + its for mine, its in zip(private, others, strict=True)]
        volume = volume + (1.0 - omega) * _volume(judged, penalty)
    pack(set_gradient(layout, networks.actor, found, slope, shared, private), gradient)
    return penalty.weight * volume - value.mean((1, 2))


def _judged(networks: Networks, x: Tensor, rows: Tensor, found: Enclosure) -> Enclosure:
    """What the first critics say about observation and action sets together."""
    columns = critic_columns(rows, merged(found))
    return enclose(networks.critic_layout, networks.first_critic, torch.cat([x, found.center], -1), columns)


def critic_columns(rows: Tensor, action: Tensor) -> Tensor:
    """Generators ``[ [rows, 0]; G_A ]`` of the critic's input, (S, columns, B, n + m); `action` is G_A (S, ., B, m)."""
    shape = (*action.shape[:3], rows.shape[1])
    observation = torch.zeros(shape, dtype=rows.dtype, device=rows.device)
    observation[:, : len(rows)] = rows[:, None]
    return torch.cat([observation, action], -1)


def forward_gradient(layout: Layout, flat: Tensor, x: Tensor) -> Tensor:
    """`networks.forward` without the operations in place that automatic differentiation forbids."""
    pairs = layout.views(flat)
    for k, (w, b) in enumerate(pairs):
        x = torch.baddbmm(b[:, None], x, w.mT)
        if k + 1 < len(pairs):
            x = x.relu()
    return x.tanh() if layout.squashed else x


def differentiate(loss: Callable[[Tensor], Tensor], flat: Tensor, gradient: Tensor) -> Tensor:
    """Gradient of the sum of ``loss(flat)``, shape (S,), by automatic differentiation, into `gradient`."""
    leaf = flat.detach().clone().requires_grad_()
    with torch.enable_grad():
        value = loss(leaf)
        (found,) = torch.autograd.grad(value.sum(), leaf)
    gradient.copy_(found)
    return value.detach()
