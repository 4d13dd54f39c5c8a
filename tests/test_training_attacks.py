"""Observation adversaries: their gradients, their sets, and that none is weaker than doing nothing."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is part of the extra `train`")

from setrl.train import attacks  # noqa: E402
from setrl.train.networks import Layout, forward, initial_parameters  # noqa: E402

torch.set_num_threads(1)

SEEDS, BATCH, INPUTS, ACTIONS = 3, 5, 4, 2
ACTOR = Layout((INPUTS, 16, 8, ACTIONS), True)
CRITIC = Layout((INPUTS + ACTIONS, 16, 8, 1), False)


def problem(dtype: Any = torch.float64, gain: float = 1.0, radius: float = 0.3) -> tuple[Any, ...]:
    """Random actor and critic, points, and generators of a skewed set."""
    generators = [np.random.default_rng(seed) for seed in range(SEEDS)]
    actor = gain * initial_parameters(ACTOR, generators, dtype)
    critic = initial_parameters(CRITIC, generators, dtype)
    actor += 0.1 * torch.from_numpy(generators[0].normal(size=actor.shape)).to(dtype)
    critic += 0.1 * torch.from_numpy(generators[0].normal(size=critic.shape)).to(dtype)
    x = torch.from_numpy(generators[1].normal(size=(SEEDS, BATCH, INPUTS))).to(dtype)
    rows = torch.from_numpy(radius * (np.eye(INPUTS) + 0.3 * generators[2].normal(size=(INPUTS, INPUTS)))).to(dtype)
    return actor, critic, x, rows


def value_of(actor: Any, critic: Any, x: Any, shown: Any) -> Any:
    return forward(CRITIC, critic, torch.cat([x, forward(ACTOR, actor, shown)], -1))[..., 0]


def deviation(actor: Any, x: Any, shown: Any) -> Any:
    return (forward(ACTOR, actor, shown) - forward(ACTOR, actor, x)).square().sum(-1)


def differentiable(layout: Layout, flat: Any, x: Any) -> Any:
    """The same network without the in-place operations that autograd cannot follow."""
    *hidden, (weight, bias) = layout.views(flat)
    for w, b in hidden:
        x = (x @ w.mT + b[:, None]).relu()
    x = x @ weight.mT + bias[:, None]
    return x.tanh() if layout.squashed else x


def all_attacks(actor: Any, critic: Any, x: Any, rows: Any) -> dict[str, Any]:
    draw = np.random.default_rng(7)
    many = torch.from_numpy(draw.random((SEEDS, BATCH, 10, INPUTS))).to(x.dtype)
    return {
        "naive": attacks.naive(ACTOR, actor, CRITIC, critic, x, rows, many),
        "grad": attacks.grad(ACTOR, actor, CRITIC, critic, x, rows),
        "mad": attacks.mad(ACTOR, actor, x, rows, many[:, :, 0], 10),
    }


def test_the_value_gradient_is_that_of_autograd() -> None:
    actor, critic, x, rows = problem()
    shown = (x + 0.5 * rows.sum(0)).requires_grad_()
    action = differentiable(ACTOR, actor, shown)
    differentiable(CRITIC, critic, torch.cat([x, action], -1)).sum().backward()
    ours = attacks.value_gradient(ACTOR, actor, CRITIC, critic, x, shown.detach())
    torch.testing.assert_close(ours, shown.grad, rtol=1e-12, atol=1e-12)
    assert ours.abs().max() > 0.01


def test_the_gradient_of_the_action_difference_is_that_of_autograd() -> None:
    actor, _, x, rows = problem()
    shown = (x + 0.5 * rows.sum(0)).requires_grad_()
    (differentiable(ACTOR, actor, shown) - differentiable(ACTOR, actor, x)).square().sum().backward()
    ours = attacks.difference_gradient(ACTOR, actor, x, shown.detach())
    torch.testing.assert_close(ours, shown.grad, rtol=1e-12, atol=1e-12)
    assert ours.abs().max() > 0.01


def test_a_saturated_policy_keeps_the_direction_of_its_gradients_in_float32() -> None:
    actor, critic, x, rows = problem(gain=2.5)
    shown = x + 0.5 * rows.sum(0)
    single = [tensor.float() for tensor in (actor, critic, x, shown)]
    assert (forward(ACTOR, single[0], single[2]).abs() == 1.0).any()
    value, difference = attacks.value_gradient, attacks.difference_gradient
    exact = value(ACTOR, actor, CRITIC, critic, x, shown), difference(ACTOR, actor, x, shown)
    found = (
        value(ACTOR, single[0], CRITIC, single[1], single[2], single[3]),
        difference(ACTOR, single[0], single[2], single[3]),
    )
    for double, rounded in zip(exact, found, strict=True):
        error = (double - rounded.double()).abs().amax(-1)
        assert (error <= 1e-3 * double.abs().amax(-1)).all()
        assert (rounded.abs().amax(-1) > 0.0).all()


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("gain", [1.0, 4.0])
def test_no_attack_leaves_its_set(dtype: Any, gain: float) -> None:
    actor, critic, x, rows = problem(dtype, gain)
    for name, shown in all_attacks(actor, critic, x, rows).items():
        beta = (shown - x).double() @ torch.linalg.inv(rows.double())
        assert beta.abs().max() <= 1.0 + (1e-5 if dtype == torch.float32 else 1e-12), name
        assert beta.abs().max() > 0.5, name


@pytest.mark.parametrize("gain", [1.0, 2.0])
def test_no_attack_is_weaker_than_the_clean_observation(gain: float) -> None:
    actor, critic, x, rows = problem(gain=gain)
    shown = all_attacks(actor, critic, x, rows)
    clean = value_of(actor, critic, x, x)
    for name in ("naive", "grad"):
        attacked = value_of(actor, critic, x, shown[name])
        assert (attacked <= clean).all() and attacked.mean() < clean.mean(), name
    assert (deviation(actor, x, shown["mad"]) > 0.0).all()


def test_attacks_stay_put_where_nothing_is_lower() -> None:
    actor, critic, x, rows = problem()
    flat = torch.zeros_like(critic)  # all values are equal: the clean observation comes first
    draws = torch.full((SEEDS, BATCH, 3, INPUTS), 0.9, dtype=x.dtype)
    assert torch.equal(attacks.naive(ACTOR, actor, CRITIC, flat, x, rows, draws), x)
    assert torch.equal(attacks.grad(ACTOR, actor, CRITIC, flat, x, rows), x)
    assert torch.equal(attacks.grad(ACTOR, actor, CRITIC, critic, x, 0.0 * rows), x)


def test_the_gradient_descends_where_values_are_negative() -> None:
    """Seeded with Q instead of 1, the backward pass climbs as soon as Q < 0."""
    actor, critic, x, rows = problem()
    CRITIC.views(critic)[-1][1].sub_(100.0)
    clean = value_of(actor, critic, x, x)
    assert (clean < -50.0).all()
    small = 1e-3 * rows
    assert (
        value_of(actor, critic, x, attacks.grad(ACTOR, actor, CRITIC, critic, x, small)) < clean
    ).float().mean() > 0.9


def test_random_candidates_are_two_sided() -> None:
    actor, critic, x, rows = problem()
    draws = torch.zeros((SEEDS, BATCH, 1, INPUTS), dtype=x.dtype)
    low = attacks.naive(ACTOR, actor, CRITIC, critic, x, rows, draws)
    moved = (low != x).any(-1)
    assert moved.any()
    torch.testing.assert_close(low[moved], (x - rows.sum(0))[moved])


@pytest.mark.parametrize("actions", [1, 2])
def test_ascent_finds_more_than_as_many_random_observations(actions: int) -> None:
    layout = Layout((INPUTS, 16, 8, actions), True)
    draw = np.random.default_rng(3)
    actor = initial_parameters(layout, [draw, draw, draw], torch.float64)
    x = torch.from_numpy(draw.normal(size=(SEEDS, 50, INPUTS)))
    rows = problem()[-1]
    start = torch.from_numpy(draw.random((SEEDS, 50, INPUTS)))

    def moved(shown: Any) -> Any:
        return (forward(layout, actor, shown) - forward(layout, actor, x)).square().sum(-1)

    found = moved(attacks.mad(layout, actor, x, rows, start, 10))
    samples = torch.from_numpy(draw.uniform(-1.0, 1.0, (11, INPUTS)))
    random = torch.stack([moved(x + beta @ rows) for beta in samples]).amax(0)
    assert (found > random).double().mean() > 0.7 and found.mean() > 1.25 * random.mean()


def test_every_seed_is_attacked_as_if_it_were_alone() -> None:
    actor, critic, x, rows = problem()
    together = all_attacks(actor, critic, x, rows)
    draws = torch.from_numpy(np.random.default_rng(7).random((SEEDS, BATCH, 10, INPUTS)))
    for seed in range(SEEDS):
        one = [tensor[seed, None] for tensor in (actor, critic, x, draws)]
        alone = {
            "naive": attacks.naive(ACTOR, one[0], CRITIC, one[1], one[2], rows, one[3]),
            "grad": attacks.grad(ACTOR, one[0], CRITIC, one[1], one[2], rows),
            "mad": attacks.mad(ACTOR, one[0], one[2], rows, one[3][:, :, 0], 10),
        }
        for name, shown in alone.items():
            torch.testing.assert_close(shown[0], together[name][seed], rtol=1e-12, atol=1e-12)


def test_points_may_have_sets_of_their_own() -> None:
    actor, critic, x, rows = problem()
    own = torch.stack([share * rows for share in (0.0, 0.1, 0.5, 1.0, 2.0)])
    together = all_attacks(actor, critic, x, own)
    draws = torch.from_numpy(np.random.default_rng(7).random((SEEDS, BATCH, 10, INPUTS)))
    for point in range(BATCH):
        one, some = x[:, point, None], draws[:, point, None]
        alone = {
            "naive": attacks.naive(ACTOR, actor, CRITIC, critic, one, own[point], some),
            "grad": attacks.grad(ACTOR, actor, CRITIC, critic, one, own[point]),
            "mad": attacks.mad(ACTOR, actor, one, own[point], some[:, :, 0], 10),
        }
        for name, shown in alone.items():
            torch.testing.assert_close(shown[:, 0], together[name][:, point], rtol=1e-12, atol=1e-12)
