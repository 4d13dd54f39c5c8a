"""Which policy of a training is kept, and what a run that begins with another one's policies begins with."""

from __future__ import annotations

import numpy as np
import pytest
import torch
from command_line import QUICK

from setrl.train import checkpoints
from setrl.train.launch import create_run
from setrl.train.progress import training_progress
from setrl.train.session import Interrupted, Session

torch.set_num_threads(1)

SMALL = {"seeds": 2, "episodes": 3, "hidden": [4], "batch": 8, "warmup": 8, "validation_every": 1}


def session(tmp_path, stop=lambda: False, **options) -> Session:
    specification = tmp_path / "spec.yaml"
    specification.write_text(QUICK)
    run = create_run(str(specification), {**SMALL, **options}, folder=tmp_path / "runs", name="run")
    with training_progress(False, 3) as progress:
        return Session(run, progress, stop, lambda _: None)


@pytest.mark.parametrize(
    ("answers", "kept"),
    [
        ([[-3, -1], [-2, -9], [-4, 0]], 1),  # the highest at the validation radius
        ([[-np.inf, -5], [-np.inf, -4], [-np.inf, -6]], 1),  # without a bound there: the highest without perturbation
        ([[-np.inf, -np.inf]] * 3, 2),  # without any bound: the last, never the untrained one
        ([[-2, -1], [-2, -1], [-3, -1]], 1),
    ],
)
def test_the_policy_that_is_kept_is_the_best_one_by_what_is_proved(tmp_path, monkeypatch, answers, kept):
    found = session(tmp_path)
    seen, told = [], iter(answers)

    def answer(actor):
        seen.append(actor.clone())
        return np.tile(np.array(next(told, answers[-1]), dtype=float), (2, 1))

    monkeypatch.setattr(found, "_verified", answer)
    for _ in range(3):
        found.trainer.run_episode()
        found._validate()
    assert torch.equal(found.best_actor, seen[kept])
    assert (found.best == answers[kept]).all()


def test_weights_that_are_no_numbers_are_no_policy(tmp_path):
    found = session(tmp_path)
    actor = found.trainer.actor.clone()
    actor[0] = torch.nan
    values = found.values(actor)
    assert values[0] == -np.inf and np.isfinite(values[1])


def test_a_stopped_session_has_a_checkpoint_of_where_it_was(tmp_path):
    asked = []

    def stop() -> bool:
        asked.append(True)
        return len(asked) == 2

    found = session(tmp_path, stop)
    with pytest.raises(Interrupted):
        found.train()
    _, numbers, _ = checkpoints.load(found.run.checkpoints)
    assert (numbers["phase"], numbers["trainer"]["episode"]) == ("episodes", 2)


def test_a_run_from_another_begins_with_its_best_policies_and_critics(tmp_path):
    first = session(tmp_path)
    first.train()
    options = {"episodes": 0, "flowpipe.steps": 1, "flowpipe.pairs": 1}
    run = create_run(str(tmp_path / "spec.yaml"), options, folder=tmp_path / "runs", name="two", source=first.run.path)
    with training_progress(False, 0) as progress:
        second = Session(run, progress, lambda: False, lambda _: None)
    assert torch.equal(second.trainer.actor, first.best_actor)
    assert torch.equal(second.trainer.networks.target_actor, first.best_actor)
    assert torch.equal(second.trainer.critic, first.best_critic)
    assert second.options.hidden == (4,)
    outcome = second.train()
    assert all(outcome.values[seed] >= first.best[seed, 0] for seed in (0, 1))
