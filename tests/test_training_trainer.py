"""The training loop: seeds do not know each other, a resumed run is the undisturbed one, sets that weigh nothing are
points.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch

from setrl.specs.reader import find_specification, read_specification
from setrl.train.optimiser import Adam, Mask
from setrl.train.options import ALGORITHMS, TrainingOptions
from setrl.train.replay import Replay
from setrl.train.task import Task, start_bounds, task_of
from setrl.train.trainer import Trainer, make_lanes

torch.set_num_threads(1)

SMALL = TrainingOptions(seeds=2, episodes=4, hidden=(8, 6), batch=8, warmup=8, precision="float64", actor_weight=0.02)
BASES = ["ddpg", "td3"]

by_algorithm = pytest.mark.parametrize("algorithm", ALGORITHMS)
by_base = pytest.mark.parametrize("base", BASES)


@pytest.fixture(scope="module")
def task() -> Task:
    return task_of(read_specification(find_specification("quadrotor1d")), start_bounds({"z": [-4, 4], "zdot": 0}))


def trainer(task: Task, options: TrainingOptions) -> Trainer:
    return Trainer(make_lanes(task, options), options)


def trained(task: Task, options: TrainingOptions) -> Trainer:
    found = trainer(task, options)
    for _ in range(options.episodes):
        found.run_episode()
    return found


@by_algorithm
@by_base
def test_a_seed_trains_the_same_alone_and_beside_others(task, algorithm, base):
    options = replace(SMALL, algorithm=algorithm, base=base, seeds=5, episodes=6, goal_stop=0.5)
    together, alone = trained(task, options), trained(task, replace(options, seeds=1, first_seed=3))
    assert together.updates[3] >= 100
    assert together.updates[3] == alone.updates[0]
    for name, value in alone.networks.__dict__.items():
        if isinstance(value, torch.Tensor):
            rows = getattr(together.networks, name).unflatten(0, (-1, 5))[:, 3]
            assert (rows - value).abs().max() <= 1e-9, name


@by_algorithm
@by_base
def test_every_algorithm_changes_actor_and_critic_and_stays_finite(task, algorithm, base):
    options = replace(SMALL, algorithm=algorithm, base=base, episodes=2, precision="float32")
    before = trainer(task, options)
    after = trained(task, options)
    for name in ("actor", "critic", "target_actor", "target_critic"):
        moved = (getattr(after.networks, name) - getattr(before.networks, name)).abs().amax(1)
        assert (moved > 0.0).all() and torch.isfinite(moved).all(), name


@by_base
@pytest.mark.parametrize("algorithm", ["sa-pc", "sa-sc"])
@pytest.mark.parametrize("change", [{"epsilon": 0.0}, {"actor_weight": 0.0, "critic_weight": 0.0}])
def test_sets_without_radius_or_weight_are_points(task, algorithm, base, change):
    options = replace(SMALL, base=base, episodes=3, **change)
    by_set, point = (trained(task, replace(options, algorithm=name)) for name in (algorithm, "pa-pc"))
    assert torch.equal(by_set.actor, point.actor)
    assert torch.equal(by_set.critic, point.critic)


@by_algorithm
@by_base
def test_a_restored_run_continues_bit_for_bit(task, algorithm, base):
    options = replace(SMALL, algorithm=algorithm, base=base, precision="float32")
    undisturbed, first, second = (trainer(task, options) for _ in range(3))
    for _ in range(4):
        undisturbed.run_episode()
    for _ in range(2):
        first.run_episode()
    tensors = {name: value.clone() for name, value in first.tensors().items()}
    numbers = first.numbers()
    first.run_episode()  # what goes on in the old one is not the new one's
    second.restore(tensors, numbers)
    for _ in range(2):
        second.run_episode()
    expected, found = undisturbed.tensors(), second.tensors()
    assert expected.keys() == found.keys()
    for name in expected:
        assert torch.equal(expected[name], found[name]), name
    assert undisturbed.numbers() == second.numbers()


def test_every_step_after_the_warmup_is_one_update(task):
    options = replace(SMALL, algorithm="pa-pc", goal_stop=0.0, warmup=45, episodes=3)
    found = trained(task, options)
    assert (found.updates == 3 * task.horizon - 44).all()
    delayed = trained(task, replace(options, base="td3"))
    assert (delayed.actor_adam.steps == delayed.updates // 2).all()


def test_an_episode_that_ends_early_stores_no_more(task):
    options = replace(SMALL, algorithm="pa-pc", goal_stop=1.0, episodes=12)
    found = trainer(task, options)
    steps = sum(found.run_episode().steps for _ in range(12))
    assert (found.replay.stored == steps).all()
    assert (steps < 12 * task.horizon).any()
    ends = found.replay.table[:, :-1, -1]
    for seed, stored in enumerate(found.replay.stored):
        assert 1 <= int(ends[seed, :stored].sum()) <= 12
        assert (ends[seed, stored:] == 0.0).all()


@pytest.mark.parametrize("limit", ["terminal", "bootstrap"])
def test_the_time_limit_is_terminal_only_where_it_is_said(task, limit):
    found = trained(task, replace(SMALL, algorithm="pa-pc", goal_stop=0.0, time_limit=limit, episodes=4))
    assert found.replay.table[:, :-1, -1].sum(1).tolist() == ([4.0, 4.0] if limit == "terminal" else [0.0, 0.0])


def test_the_stored_action_is_the_noisy_clipped_center_with_its_columns(task):
    options = replace(SMALL, algorithm="sa-sc", exploration=3.0, episodes=1, warmup=10**4, buffer=10**4)
    found = trained(task, options)
    batch = found.replay.sample(np.tile(np.linspace(0.0, 0.999, 30), (2, 1)))
    assert (batch.action.abs() <= 1.0).all() and (batch.action.abs() == 1.0).any()
    assert batch.columns.shape == (2, 30, 3, 1)
    assert (batch.columns.abs().sum(2) > 0.0).all()


def test_the_oldest_transition_is_overwritten_and_only_stored_ones_are_sampled():
    replay = Replay(2, 4, 1, 1, 0, dtype=torch.float64)
    draws = np.tile(np.linspace(0.0, 1.0 - 1e-9, 64), (2, 1))
    for number in range(6):
        value = torch.full((2, 1), float(number), dtype=torch.float64)
        replay.add([value] * 5, np.array([True, number < 4]))
    batch = replay.sample(draws)
    assert sorted(set(batch.observation[0].flatten().tolist())) == [2.0, 3.0, 4.0, 5.0]
    assert sorted(set(batch.observation[1].flatten().tolist())) == [0.0, 1.0, 2.0, 3.0]


@pytest.mark.parametrize("decay", [0.0, 0.01])
def test_the_optimiser_is_torchs_for_active_seeds_and_stands_still_for_others(decay):
    generator = np.random.default_rng(1)
    start = torch.from_numpy(generator.normal(size=(3, 7)))
    ours, theirs = start.clone(), [start[row].clone().requires_grad_() for row in range(3)]
    stacked = Adam(ours, 1e-3, decay)
    others = [torch.optim.Adam([row], lr=1e-3, weight_decay=decay) for row in theirs]
    for number in range(20):
        gradient = torch.from_numpy(generator.normal(size=(3, 7)))
        active = np.array([True, number % 2 == 0, number >= 10])
        stacked.step(gradient, Mask(active if number > 4 else np.ones(3, dtype=bool), ours))
        for row in np.flatnonzero(active if number > 4 else np.ones(3)):
            theirs[row].grad = gradient[row].clone()
            others[row].step()
    assert torch.allclose(ours, torch.stack([row.detach() for row in theirs]), rtol=0.0, atol=1e-14)


def test_td3_takes_the_smoothing_and_both_critics(task):
    options = replace(SMALL, algorithm="pa-pc", base="td3", episodes=2)
    smooth, rough = trained(task, options), trained(task, replace(options, smoothing=0.0))
    assert smooth.networks.critics == 2
    first, second = smooth.networks.critic.unflatten(0, (2, -1))
    assert not torch.equal(first, second)
    assert not torch.equal(smooth.networks.critic, rough.networks.critic)
