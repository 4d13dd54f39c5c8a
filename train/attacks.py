"""Observation adversaries that ascend through the networks: what the policy is shown instead of x.

All choose from ``{x + beta @ rows : beta in [-1, 1]^q}`` and see the clean x as a candidate too, so that none is ever
worse, for the criterion it optimises, than doing nothing. `naive` and `grad` [1]_ look for the observation whose action
has the lowest value Q(x, mu(x_adv)); `mad` [2]_ for the one whose action is farthest from mu(x), and needs no critic.

They run in every environment step of a training, so gradients are written out by hand: one pass forward, one backward,
no graph. The derivative of tanh is computed from its argument without cancellation: a saturated policy keeps a gradient
(in float32, 1 - tanh(z)^2 is zero from |z| = 9 on, and an attack that follows it would stand still).

Stacks of networks and points as in `train.networks`: x (S, B, inputs); rows (q, inputs), or (B, q, inputs) where every
point has a set of its own.

References
----------
.. [1] Pattanaik et al., "Robust deep reinforcement learning with adversarial attacks", AAMAS 2018.
.. [2] Zhang et al., "Robust deep reinforcement learning against adversarial perturbations on state observations", 2020.
"""

from __future__ import annotations

import torch

from .networks import Layout, Tensor

SHARES = tuple(step / 8 for step in range(1, 9))
"""How far `grad` goes along its direction: up to a vertex of the set."""

STRIDE = 2.5
"""`mad`: all steps together cover so many radii."""


def naive(
    actor_layout: Layout,
    actor: Tensor,
    critic_layout: Layout,
    critic: Tensor,
    x: Tensor,
    rows: Tensor,
    draws: Tensor,
) -> Tensor:
    """Random search: the one of x and ``x + (2 draws - 1) @ rows`` with the lowest Q(x, mu(x_adv)).

    Parameters
    ----------
    actor_layout : Layout
    actor : Tensor, shape (S, P)
    critic_layout : Layout
    critic : Tensor, shape (S, P')
        Takes ``cat([x, action])``.
    x : Tensor, shape (S, B, inputs)
    rows : Tensor, shape (q, inputs) or (B, q, inputs)
        Generators of the set, the radius included.
    draws : Tensor, shape (S, B, K, q)
        Uniform in [0, 1).

    Returns
    -------
    Tensor, shape (S, B, inputs)
    """
    candidates = x[:, :, None] + (2.0 * draws - 1.0) @ rows
    return _lowest_value(Stack(actor_layout, actor), Stack(critic_layout, critic), x, candidates)


def grad(actor_layout: Layout, actor: Tensor, critic_layout: Layout, critic: Tensor, x: Tensor, rows: Tensor) -> Tensor:
    """Descend: the one of x and ``x - t sign(rows dQ/dx) @ rows``, t in `SHARES`, with the lowest Q(x, mu(x_adv)).

    Parameters
    ----------
    actor_layout : Layout
    actor : Tensor, shape (S, P)
    critic_layout : Layout
    critic : Tensor, shape (S, P')
    x : Tensor, shape (S, B, inputs)
    rows : Tensor, shape (q, inputs) or (B, q, inputs)

    Returns
    -------
    Tensor, shape (S, B, inputs)
    """
    mu, q = Stack(actor_layout, actor), Stack(critic_layout, critic)
    shift = _shift(_along(_value_gradient(mu, q, x, x), rows).sign_(), rows)
    candidates = x[:, :, None] - x.new_tensor(SHARES)[:, None] * shift[:, :, None]
    return _lowest_value(mu, q, x, candidates)


def mad(actor_layout: Layout, actor: Tensor, x: Tensor, rows: Tensor, draws: Tensor, steps: int) -> Tensor:
    """Maximal action difference: projected sign-gradient ascent of |mu(x_adv) - mu(x)|^2, the best iterate.

    ``beta_0 = 2 draws - 1, beta_{k+1} = clip(beta_k + (2.5 / steps) sign(rows d|.|^2/dx), -1, 1)``; a gradient at x
    itself would be zero, hence the random start.

    Parameters
    ----------
    actor_layout : Layout
    actor : Tensor, shape (S, P)
    x : Tensor, shape (S, B, inputs)
    rows : Tensor, shape (q, inputs) or (B, q, inputs)
    draws : Tensor, shape (S, B, q)
        Uniform in [0, 1).
    steps : int
        At least 1.

    Returns
    -------
    Tensor, shape (S, B, inputs)
    """
    mu, stride = Stack(actor_layout, actor), x.new_tensor(STRIDE / steps)
    clean = mu.layer_inputs(x)[-1]
    beta = 2.0 * draws - 1.0
    tried, reached = [], []
    for step in range(steps + 1):
        shown = x + _shift(beta, rows)
        inputs = mu.layer_inputs(shown)
        tried.append(shown)
        reached.append(inputs[-1])
        if step < steps:
            if clean.shape[-1] == 1:  # only the sign counts, and tanh is increasing
                slope = mu.pulled_back_affine(inputs, inputs[-1] - clean)
            else:
                slope = mu.pulled_back(inputs, mu.difference(inputs[-1], clean))
            beta = (beta + stride * _along(slope, rows).sign_()).clamp_(-1.0, 1.0)
    # the latest iterate first: where a saturated action does not move at all, it is the one that went farthest
    points = torch.stack([*reversed(tried), x], 2)
    ends = torch.stack([*reversed(reached), clean], 2)
    return _chosen(points, mu.difference(ends, clean[:, :, None]).square().sum(-1).argmax(2))


def value_gradient(
    actor_layout: Layout, actor: Tensor, critic_layout: Layout, critic: Tensor, x: Tensor, shown: Tensor
) -> Tensor:
    """Gradient of ``sum Q(x, mu(x'))`` with respect to x', at x' = `shown`.

    Parameters
    ----------
    actor_layout : Layout
    actor : Tensor, shape (S, P)
    critic_layout : Layout
    critic : Tensor, shape (S, P')
    x, shown : Tensor, shape (S, B, inputs)

    Returns
    -------
    Tensor, shape (S, B, inputs)
    """
    return _value_gradient(Stack(actor_layout, actor), Stack(critic_layout, critic), x, shown)


def difference_gradient(actor_layout: Layout, actor: Tensor, x: Tensor, shown: Tensor) -> Tensor:
    """Gradient of ``sum |mu(x') - mu(x)|^2`` with respect to x', at x' = `shown`.

    Parameters
    ----------
    actor_layout : Layout
    actor : Tensor, shape (S, P)
    x, shown : Tensor, shape (S, B, inputs)

    Returns
    -------
    Tensor, shape (S, B, inputs)
    """
    mu = Stack(actor_layout, actor)
    inputs = mu.layer_inputs(shown)
    return mu.pulled_back(inputs, 2.0 * mu.difference(inputs[-1], mu.layer_inputs(x)[-1]))


class Stack:
    """Networks of all seeds, unpacked once: unpacking costs as much as running them.

    Parameters
    ----------
    layout : Layout
    flat : Tensor, shape (S, P)
    """

    def __init__(self, layout: Layout, flat: Tensor) -> None:
        self.squashed = layout.squashed
        self.layers = [(weight, weight.mT, bias[:, None]) for weight, bias in layout.views(flat)]

    def layer_inputs(self, x: Tensor) -> list[Tensor]:
        """Inputs of all layers, and last what the last one returns, before tanh."""
        inputs = [x]
        for _, transposed, bias in self.layers[:-1]:
            inputs.append(torch.baddbmm(bias, inputs[-1], transposed).relu_())
        _, transposed, bias = self.layers[-1]
        return [*inputs, torch.baddbmm(bias, inputs[-1], transposed)]

    def __call__(self, x: Tensor) -> Tensor:
        last = self.layer_inputs(x)[-1]
        return last.tanh_() if self.squashed else last

    def pulled_back(self, inputs: list[Tensor], seed: Tensor) -> Tensor:
        """Gradient of ``sum seed * network(x)`` with respect to x; `seed` (S, B, outputs) is constant."""
        if self.squashed:
            missing = _missing(inputs[-1])
            seed = seed * missing * (2.0 - missing)
        return self.pulled_back_affine(inputs, seed)

    def pulled_back_affine(self, inputs: list[Tensor], seed: Tensor) -> Tensor:
        """The same for what the last affine map returns."""
        *hidden, (weight, _, _) = self.layers
        v = torch.bmm(seed, weight)
        for (weight, _, _), reached in zip(reversed(hidden), reversed(inputs[1:-1]), strict=True):
            v = torch.bmm(v * (reached > 0.0), weight)
        return v

    def difference(self, z: Tensor, clean: Tensor) -> Tensor:
        """``tanh z - tanh c = tanh(z - c) (1 - tanh z tanh c)``, to full relative precision next to +-1 too."""
        if not self.squashed:
            return z - clean
        first, second = _missing(z), _missing(clean)
        same, other = first + (1.0 - first) * second, 1.0 + (1.0 - first) * (1.0 - second)
        return (z - clean).tanh_() * torch.where((z > 0.0) == (clean > 0.0), same, other)


def _shift(beta: Tensor, rows: Tensor) -> Tensor:
    """``beta @ rows``, (S, B, q) to (S, B, inputs)."""
    return beta @ rows if rows.ndim == 2 else (beta[:, :, None] @ rows)[:, :, 0]


def _along(slope: Tensor, rows: Tensor) -> Tensor:
    """``slope @ rows'``, (S, B, inputs) to (S, B, q)."""
    return slope @ rows.mT if rows.ndim == 2 else (slope[:, :, None] @ rows.mT)[:, :, 0]


def _missing(z: Tensor) -> Tensor:
    """``1 - |tanh z|``, to full relative precision."""
    e = (-2.0 * z.abs()).exp_()
    return 2.0 * e / (1.0 + e)


def _value_gradient(mu: Stack, q: Stack, x: Tensor, shown: Tensor) -> Tensor:
    inputs = mu.layer_inputs(shown)
    action = inputs[-1].tanh() if mu.squashed else inputs[-1]
    values = q.layer_inputs(torch.cat([x, action], -1))
    joint = q.pulled_back(values, torch.ones_like(values[-1]))
    return mu.pulled_back(inputs, joint[..., x.shape[-1] :])


def _lowest_value(mu: Stack, q: Stack, x: Tensor, candidates: Tensor) -> Tensor:
    """The one of x and candidates (S, B, K, inputs) whose action has the lowest value at x."""
    tried = torch.cat([x[:, :, None], candidates], 2)
    joint = torch.cat([x[:, :, None].expand_as(tried).flatten(1, 2), mu(tried.flatten(1, 2))], -1)
    return _chosen(tried, q(joint).view(tried.shape[:3]).argmin(2))


def _chosen(candidates: Tensor, which: Tensor) -> Tensor:
    """Candidates (S, B, K, inputs), one of the K for each `which` (S, B)."""
    return candidates.gather(2, which[:, :, None, None].expand(-1, -1, 1, candidates.shape[-1]))[:, :, 0]
