"""Set losses: the fast backward pass equals dense automatic differentiation, the forward pass equals the engine."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from set_training import actor_loss, critic_loss, dense, points, stack_of_networks

from setrl.train.losses import (
    Networks,
    Penalty,
    critic_columns,
    differentiate,
    point_actor,
    point_critic,
    set_actor,
    set_critic,
    targets,
)
from setrl.train.networks import forward, layers_of
from setrl.train.set_propagation import enclose, merged, merged_count
from setrl.verify.network import enclose_layers
from setrl.verify.zonotope import Zonotope

torch.set_num_threads(1)

SHAPES = [((8, 6), 2, 1), ((64, 32), 2, 1), ((7,), 3, 1), ((9, 8, 7), 2, 1), ((8, 6), 4, 2), ((6, 5, 4), 3, 3)]
"""Hidden widths, observations, actions."""
TOLERANCE = {torch.float64: 1e-9, torch.float32: 1e-4}

by_shape = pytest.mark.parametrize("shape", SHAPES, ids=str)
by_precision = pytest.mark.parametrize("dtype", list(TOLERANCE), ids=str)


def observations(networks: Networks, count: int = 16) -> torch.Tensor:
    seeds, width = len(networks.actor), networks.actor_layout.sizes[0]
    values = np.random.default_rng(7).normal(size=(seeds, count, width))
    return torch.from_numpy(values).to(networks.actor.dtype)


def perturbation(networks: Networks, epsilon: float = 0.2) -> torch.Tensor:
    """Directions that are no unit vectors, as behind an affine map of the observation."""
    width = networks.actor_layout.sizes[0]
    mixed = np.eye(width) + 0.1 * np.random.default_rng(3).normal(size=(width, width))
    return torch.from_numpy(epsilon * mixed).to(networks.actor.dtype)


def require_equal(found: torch.Tensor, expected: torch.Tensor) -> None:
    """To the tolerance of the precision, relative to the largest number."""
    scale = float(expected.abs().max())
    assert scale > 0.0
    assert float((found - expected).abs().max()) <= TOLERANCE[found.dtype] * scale


@by_precision
@by_shape
@pytest.mark.parametrize("omega", [1.0, 0.5, 0.0])
@pytest.mark.parametrize("floor", [0.0, 0.1])
def test_the_gradient_of_a_set_actor_is_that_of_all_columns(shape, omega, floor, dtype):
    networks = stack_of_networks(*shape, dtype=dtype)
    x, rows, penalty = observations(networks), perturbation(networks), Penalty(0.3, floor)
    gradient = torch.full_like(networks.actor, np.nan)
    loss = set_actor(networks, x, rows, penalty, omega, gradient)
    expected = torch.zeros_like(gradient)
    truth = differentiate(lambda flat: actor_loss(networks, flat, x, rows, penalty, omega), networks.actor, expected)
    require_equal(loss, truth)
    require_equal(gradient, expected)


@by_precision
@by_shape
@pytest.mark.parametrize("critics", [1, 2])
def test_the_gradient_of_a_set_critic_is_that_of_all_columns(shape, critics, dtype):
    networks = stack_of_networks(*shape, critics=critics, dtype=dtype)
    x, rows, penalty = observations(networks), perturbation(networks), Penalty(0.2)
    found = enclose(networks.actor_layout, networks.actor, x, rows)
    inputs, y = torch.cat([x, found.center], -1), x[..., :1].square()
    columns = critic_columns(rows, merged(found))
    gradient = torch.full_like(networks.critic, np.nan)
    loss = set_critic(networks, inputs, columns, y, penalty, gradient)
    by_set = columns.transpose(1, 2)
    expected = torch.zeros_like(gradient)

    def both(flat):
        seeds = len(x)
        parts = flat.split(seeds)
        return torch.cat([critic_loss(networks, part, inputs, by_set, y, penalty) for part in parts])

    require_equal(loss, differentiate(both, networks.critic, expected))
    require_equal(gradient, expected)


@by_shape
@pytest.mark.parametrize("omega", [1.0, 0.5])
def test_exact_gradients_differentiate_the_relaxations_too(shape, omega):
    networks = stack_of_networks(*shape, seeds=1, dtype=torch.float64)
    x, rows = observations(networks, 4), perturbation(networks)
    gradient = torch.zeros_like(networks.actor)
    set_actor(networks, x, rows, Penalty(0.3, 0.01, exact=True), omega, gradient)
    direction = torch.from_numpy(np.random.default_rng(5).normal(size=networks.actor.shape))
    step, sides, unused = 1e-6, [], torch.zeros_like(gradient)
    for sign in (-1.0, 1.0):
        moved = Networks(
            networks.actor_layout,
            networks.critic_layout,
            networks.actor + sign * step * direction,
            networks.critic,
            networks.target_actor,
            networks.target_critic,
        )
        sides.append(float(set_actor(moved, x, rows, Penalty(0.3, 0.01), omega, unused)))
    slope = (sides[1] - sides[0]) / (2.0 * step)
    assert float((gradient * direction).sum()) == pytest.approx(slope, rel=1e-4, abs=1e-6)


@by_precision
@by_shape
def test_a_set_in_training_is_the_engines_enclosure(shape, dtype):
    networks = stack_of_networks(*shape, dtype=dtype)
    x, rows = observations(networks), perturbation(networks)
    found = enclose(networks.actor_layout, networks.actor, x, rows)
    rounding = 1e-9 if dtype == torch.float64 else 2e-5
    for seed in range(len(x)):
        centers = x[seed].double().numpy()
        generators = np.broadcast_to(rows.double().numpy(), (len(centers), *rows.shape))
        inputs = Zonotope(centers, generators, np.zeros_like(centers))
        output = enclose_layers(layers_of(networks.actor_layout, networks.actor[seed]), inputs).output
        assert np.abs(found.center[seed].double().numpy() - output.center).max() < rounding
        assert np.abs(found.radius[seed].double().numpy() - output.spread).max() < rounding
        shared = found.shared[seed].permute(2, 1, 0).double().numpy()
        assert np.abs(shared - output.generators[:, : len(rows)]).max() < rounding


@by_shape
def test_the_merged_columns_are_the_set(shape):
    networks = stack_of_networks(*shape, dtype=torch.float64)
    x, rows = observations(networks), perturbation(networks)
    found = enclose(networks.actor_layout, networks.actor, x, rows)
    columns = merged(found)
    assert columns.shape[1] == merged_count(networks.actor_layout, len(rows))
    _, every = dense(networks.actor_layout, networks.actor, x, rows.expand(*x.shape[:2], *rows.shape))
    # the same support in every direction: the same set
    directions = torch.from_numpy(np.random.default_rng(2).normal(size=(x.shape[-1] + 4, found.center.shape[-1])))
    for direction in directions:
        support = (columns @ direction).abs().sum(1)
        assert torch.allclose(support, (every @ direction).abs().sum(2), rtol=1e-9)


@by_shape
def test_a_set_in_training_encloses_every_sample(shape):
    networks = stack_of_networks(*shape, dtype=torch.float64)
    x, rows = observations(networks), perturbation(networks)
    found = enclose(networks.actor_layout, networks.actor, x, rows)
    generator = np.random.default_rng(11)
    for corner in range(60):
        beta = generator.uniform(-1.0, 1.0, size=(len(x), x.shape[1], len(rows)))
        beta = np.sign(beta) if corner % 2 else beta
        action = forward(networks.actor_layout, networks.actor, x + torch.from_numpy(beta) @ rows)
        assert ((action - found.center).abs() <= found.radius * (1.0 + 1e-9)).all()


@by_shape
def test_a_small_set_is_a_point(shape):
    """Center, loss and gradient of sa-pc and sa-sc without penalties go to those of pa-pc as eps goes to 0."""
    networks = stack_of_networks(*shape, dtype=torch.float64)
    x, rows = observations(networks), perturbation(networks, 1e-9)
    point, by_set = torch.zeros_like(networks.actor), torch.zeros_like(networks.actor)
    expected = point_actor(networks, x, point)
    for omega in (1.0, 0.5):
        loss = set_actor(networks, x, rows, Penalty(0.0), omega, by_set)
        assert torch.allclose(loss, expected, atol=1e-7)
        assert torch.allclose(by_set, point, atol=1e-6)


def test_a_radius_of_zero_has_no_gradient():
    networks = stack_of_networks((8, 6), 2, 1, dtype=torch.float64)
    for flat in (networks.actor, networks.critic):
        flat.zero_()  # dead networks: every set is a point
    x, rows = observations(networks), perturbation(networks)
    gradient = torch.full_like(networks.actor, np.nan)
    for omega in (1.0, 0.5, 0.0):
        loss = set_actor(networks, x, rows, Penalty(0.3), omega, gradient)
        assert torch.isfinite(loss).all()
        assert (gradient == 0.0).all()


@by_precision
@by_shape
@pytest.mark.parametrize("critics", [1, 2])
def test_point_gradients_are_those_of_automatic_differentiation(shape, critics, dtype):
    networks = stack_of_networks(*shape, critics=critics, dtype=dtype)
    x = observations(networks)
    gradient, expected = torch.full_like(networks.actor, np.nan), torch.zeros_like(networks.actor)

    def climbed(flat):
        action = points(networks.actor_layout, flat, x)
        return -points(networks.critic_layout, networks.first_critic, torch.cat([x, action], -1)).mean((1, 2))

    loss = point_actor(networks, x, gradient)
    require_equal(loss, differentiate(climbed, networks.actor, expected))
    require_equal(gradient, expected)
    inputs = torch.cat([x, points(networks.actor_layout, networks.actor, x)], -1)
    y = x[..., :1].square()
    gradient, expected = torch.full_like(networks.critic, np.nan), torch.zeros_like(networks.critic)

    def regressed(flat):
        every = points(networks.critic_layout, flat, inputs.repeat(critics, 1, 1))
        return 0.5 * (every - y.repeat(critics, 1, 1)).square().mean((1, 2))

    loss = point_critic(networks, inputs, y, gradient)
    require_equal(loss, differentiate(regressed, networks.critic, expected))
    require_equal(gradient, expected)


@pytest.mark.parametrize("critics", [1, 2])
def test_targets_are_bellmans_with_the_lowest_critic(critics):
    networks = stack_of_networks((8, 6), 2, 1, critics=critics, dtype=torch.float64)
    x = observations(networks)
    terminal = (x[..., 1:2] > 0.5).double()
    noise = 0.4 * x[..., :1]
    y = targets(networks, x, x[..., :1], terminal, 0.9, noise)
    action = (points(networks.actor_layout, networks.target_actor, x) + noise).clamp(-1.0, 1.0)
    joint = torch.cat([x, action], -1)
    parts = networks.target_critic.split(len(x))
    lowest = torch.stack([points(networks.critic_layout, part, joint) for part in parts]).amin(0)
    assert torch.allclose(y, x[..., :1] + 0.9 * (1.0 - terminal) * lowest, atol=1e-12)
