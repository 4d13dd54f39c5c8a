"""Evaluation of policies: V(s0) below every attack, adversaries in order, statistics, collapse, tables and pictures."""

from __future__ import annotations

import csv
import io
import itertools
import json
from dataclasses import replace
from fractions import Fraction as F
from pathlib import Path
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is part of the extra `train`")

from loops import plant_of, specification_of  # noqa: E402
from scipy import stats  # noqa: E402

from setrl.models.onnx_reader import read_policy  # noqa: E402
from setrl.models.onnx_writer import policy_bytes  # noqa: E402
from setrl.models.policy import Activation, Affine, Policy  # noqa: E402
from setrl.models.simulation import returns, simulate  # noqa: E402
from setrl.specs.errors import UsageError  # noqa: E402
from setrl.specs.reader import find_specification, read_specification  # noqa: E402
from setrl.specs.specification import AffineMap, Bounds, Penalty, Reward  # noqa: E402
from setrl.train.adversary import AdversaryOptions, adapt  # noqa: E402
from setrl.train.attacked_returns import Agents, Returns, attacked, initial_states, undisturbed  # noqa: E402
from setrl.train.certified_radius import certified_radius  # noqa: E402
from setrl.train.collapse import collapses  # noqa: E402
from setrl.train.evaluation import Evaluation, EvaluationOptions, compare, evaluate  # noqa: E402
from setrl.train.evaluation_report import (  # noqa: E402
    comparison_lines,
    evaluation_csv,
    evaluation_lines,
    evaluation_to_json,
)
from setrl.train.networks import Layout, forward, initial_parameters, layers_of  # noqa: E402
from setrl.train.plot_evaluation import plot_evaluation  # noqa: E402
from setrl.train.statistics import paired_test, summary  # noqa: E402
from setrl.train.task import Task, task_of  # noqa: E402
from setrl.train.tensor_loop import TensorLoop  # noqa: E402
from setrl.verify.verifier import verify  # noqa: E402

torch.set_num_threads(1)

ACTOR, CRITIC = Layout((2, 16, 8, 1), True), Layout((3, 16, 8, 1), False)
RADII = (F(0), F(1, 10), F(3, 10))
QUICK = AdversaryOptions(restarts=1, steps=15, hidden=8)


def policies_of(layout: Layout, count: int, gain: float = 1.0) -> list[Policy]:
    generators = [np.random.default_rng(seed) for seed in range(count)]
    rows = gain * initial_parameters(layout, generators, torch.float32)
    return [read_policy(policy_bytes(layers_of(layout, row))) for row in rows]


def constant_policy(action: float) -> Policy:
    layers = [Affine(np.zeros((4, 2)), np.zeros(4)), Activation("relu")]
    layers += [Affine(np.zeros((1, 4)), np.array([np.arctanh(action)])), Activation("tanh")]
    return read_policy(policy_bytes(layers))


def critics(layout: Layout, count: int) -> Any:
    return initial_parameters(layout, [np.random.default_rng(100 + seed) for seed in range(count)], torch.float32)


@pytest.fixture(scope="module")
def hover() -> Task:
    return task_of(read_specification(find_specification("quadrotor1d.yaml")))


@pytest.fixture(scope="module")
def evaluation(hover: Task) -> Evaluation:
    options = EvaluationOptions(RADII, resolution=F(1, 5), adversary=QUICK)
    policies = [*policies_of(ACTOR, 3), *policies_of(ACTOR, 1, gain=1.5)]
    found: list[tuple[int, int, str]] = []
    result = evaluate(
        hover,
        policies,
        options,
        seeds=(3, 4, 5, 6),
        critic_layout=CRITIC,
        critic=critics(CRITIC, 4),
        progress=lambda *words: found.append(words),
    )
    assert found[0][0] == 0 and found[-1][0] == found[-1][1] == len(found) - 1
    return result


# What is proved and what is attacked -------------------------------------------------------------


def test_verified_performance_is_never_above_an_attack(evaluation: Evaluation) -> None:
    assert set(evaluation.attacked) == {"naive", "grad", "mad", "adaptive"}
    for name, found in evaluation.attacked.items():
        assert (evaluation.verified.discounted <= found.discounted).all(), name
        assert (evaluation.verified.undiscounted <= found.undiscounted).all(), name
    assert np.isfinite(evaluation.verified.discounted).all()


def test_the_adaptive_adversary_is_never_weaker_and_mostly_stronger(evaluation: Evaluation) -> None:
    adaptive = evaluation.attacked["adaptive"].discounted
    assert (adaptive <= evaluation.nominal.discounted[:, None]).all()
    others = np.stack([evaluation.attacked[name].discounted for name in ("naive", "grad", "mad")])
    assert (adaptive <= others).all()
    assert (adaptive[:, 1:] < others.min(0)[:, 1:] - 0.1).mean() >= 0.5


def test_without_a_perturbation_every_attack_is_the_undisturbed_run(evaluation: Evaluation) -> None:
    for name, found in evaluation.attacked.items():
        assert found.discounted[:, 0] == pytest.approx(evaluation.nominal.discounted, abs=1e-6), name


def test_undisturbed_returns_are_those_of_the_simulation(hover: Task, evaluation: Evaluation) -> None:
    policies = [*policies_of(ACTOR, 3), *policies_of(ACTOR, 1, gain=1.5)]
    for position, policy in enumerate(policies):
        loop = hover.bound(policy)
        expected = returns(loop, simulate(loop, [-4.0, 0.0]))[0]
        assert evaluation.nominal.discounted[position] == pytest.approx(expected, abs=1e-6)


def test_verified_performance_is_that_of_the_verifier(evaluation: Evaluation) -> None:
    result = verify(policies_of(ACTOR, 3)[1], "quadrotor1d.yaml", epsilon=0.1, check=False)
    assert result.value is not None
    assert evaluation.verified.discounted[1, 1] == result.value.discounted


def test_a_policy_is_attacked_as_if_it_were_alone(hover: Task) -> None:
    policies, value, radii = policies_of(ACTOR, 3), critics(CRITIC, 3), np.array([0.1, 0.4])
    starts = initial_states(hover.loop)

    def run(some: list[Policy], critic: Any) -> dict[str, Returns]:
        agents = Agents.of(some, CRITIC, critic)
        return attacked(hover, agents, radii, starts, draws=4, steps=3, adversary=QUICK, seed=1)

    together, alone = run(policies, value), run(policies[1:2], value[1:2])
    for name, found in alone.items():
        assert found.discounted[0] == pytest.approx(together[name].discounted[1], rel=1e-6), name


def test_certified_radius_is_verified_and_the_next_one_is_not(hover: Task) -> None:
    policy = policies_of(Layout((2, 64, 32, 1), True), 5)[4]
    found = certified_radius(hover, policy, (F(0), F(1, 5), F(3, 10)), F(1, 50))
    assert found is not None and F(1, 5) <= found < F(3, 10) and (found * 50).denominator == 1
    assert verify(policy, "quadrotor1d.yaml", epsilon=found).verdict.value == "VERIFIED"
    assert not verify(policy, "quadrotor1d.yaml", epsilon=found + F(1, 50), check=False).verdict.positive


def test_nothing_is_certified_where_no_radius_verifies_or_nothing_is_required(hover: Task) -> None:
    falls = constant_policy(-0.9)
    assert certified_radius(hover, falls, (F(0), F(1, 10)), F(1, 10)) is None
    free = replace(hover.loop.specification, requirements=())
    assert certified_radius(task_of(free), constant_policy(0.1), (F(0),), F(1, 10)) is None


# Adversary ---------------------------------------------------------------------------------------


def test_the_adversary_finds_the_worst_constant_push() -> None:
    """x' = tanh(x + e): the worst perturbation pushes away from the target, at its full radius, all the time."""
    reward = Reward({"x": F(1)}, {"x": F(0)}, F(1))
    task = task_of(
        specification_of(plant_of({"x": "u"}), {"x": (0.5, 0.5)}, periods=10, observation=F(1, 5), reward=reward)
    )
    layout = Layout((1, 1), True)
    actor = torch.tensor([[1.0, 0.0]], dtype=torch.float64)
    given = np.zeros((1, 1, 1, 10, 1))
    found = adapt(task, layout, actor, np.array([0.2]), np.array([[[0.5]]]), given, np.random.default_rng(0))
    assert found.betas.shape == (1, 1, 8, 10, 1) and found.forces.shape == (1, 1, 8, 10, 0)
    assert np.abs(found.betas).max() <= 1.0
    assert (found.betas[0, 0, 4:, :-1] == 1.0).all()


def test_disturbances_are_the_adversarys_too_and_constant_ones_stay_constant() -> None:
    specification = specification_of(
        plant_of({"x": "u + d + e"}, disturbances="d e"),
        {"x": (1, 1)},
        periods=6,
        disturbances={"d": (F(-1, 10), F(3, 10), False), "e": (F(-1, 5), F(1, 5), True)},
        reward=Reward({"x": F(1)}, {"x": F(0)}, F(1)),
        delay=2,
        delayed_action={"u": F(1, 4)},
    )
    task, agents = task_of(specification), Agents(Layout((1, 1), True), torch.tensor([[-0.1, 0.0]]).double())
    starts = initial_states(task.loop)
    given = np.zeros((1, 1, 0, 6, 1))
    found = adapt(task, agents.layout, agents.actor, np.zeros(1), starts[None], given, np.random.default_rng(0))
    constant = found.forces[..., 1]
    assert (constant == constant[..., :1]).all()
    assert (found.forces[0, 0, 3:] == [0.3, 0.2]).all()  # up, away from the target
    lost = attacked(task, agents, np.zeros(1), starts, draws=2, steps=1, adversary=QUICK, seed=0)
    assert lost["adaptive"].discounted[0, 0] < lost["mad"].discounted[0, 0] - 0.1
    best, _ = undisturbed(task, agents, starts)
    assert lost["mad"].discounted == pytest.approx(best.discounted)


@pytest.mark.parametrize(("delay", "learns"), [(0, True), (6, False)])
def test_nothing_is_learnt_where_every_action_comes_after_the_end(delay: int, learns: bool) -> None:
    reward = Reward({"x": F(1)}, {"x": F(0)}, F(1))
    specification = specification_of(plant_of({"x": "u"}), {"x": (1, 1)}, periods=6, reward=reward, delay=delay)
    task, options = task_of(specification), AdversaryOptions(restarts=0, steps=5)
    actor, given = torch.tensor([[1.0, 0.0]]).double(), np.zeros((1, 1, 1, 6, 1))
    radius, start = np.array([0.2]), np.ones((1, 1, 1))
    found = adapt(task, Layout((1, 1), True), actor, radius, start, given, np.random.default_rng(0), options)
    learnt = found.betas[0, 0, 0, :, 0]
    assert (learnt > 0.1).all() if learns else (learnt == 0.0).all()


def test_the_tensor_loop_is_the_simulated_loop() -> None:
    """Observation, maps around the network and clipping, against models.simulation."""
    specification = specification_of(
        plant_of({"x": "y", "y": "u - sin(x)"}),
        {"x": (F(1, 2), F(1, 2)), "y": (0, 0)},
        periods=5,
        observe={"s": "sin(x)", "y": "y"},
        before=AffineMap(None, F(2), F(1, 10)),
        after=AffineMap(None, F(3), F(-3)),
        clip=Bounds(F(-1, 5), F(1, 2)),
    )
    specification = replace(specification, reward=Reward({"x": F(1), "y": F(1, 10)}, {"y": F(1, 5)}, F(9, 10)))
    task = task_of(specification)
    policy = policies_of(ACTOR, 1, gain=1.5)[0]
    agents, loop = Agents.of([policy]), TensorLoop(task)
    state, total, actions = torch.tensor([[0.5, 0.0]], dtype=torch.float64), 0.0, []
    for discount in loop.discounts.tolist():
        action = loop.act(forward(agents.layout, agents.actor, loop.observe(state)[None])[0])
        actions.append(float(action))
        state = loop.advance(state, action, state[:, :0])
        total -= discount * float(loop.cost(state))
    bound = task.bound(policy)
    expected = simulate(bound, [0.5, 0.0])
    assert total == pytest.approx(returns(bound, expected)[0], abs=1e-6)
    assert actions == pytest.approx(expected.actions[0, :, 0].tolist(), abs=1e-6)
    assert -0.2 in actions and max(actions) > -0.2


def test_a_penalty_has_a_soft_edge_with_a_gradient() -> None:
    region = read_specification(find_specification("navigation.yaml")).reward.penalty.region  # type: ignore[union-attr]
    specification = read_specification(find_specification("navigation.yaml"))
    reward = replace(specification.reward, penalty=Penalty(F(7), region))  # type: ignore[type-var]
    loop = TensorLoop(task_of(replace(specification, reward=reward)))
    state = torch.tensor(
        [[1.5, 1.5, 0, 0], [3.0, 1.5, 0, 0], [1.02, 1.5, 0, 0]], dtype=torch.float64, requires_grad=True
    )
    charged = loop.cost(state) - (state - loop.target).abs() @ loop.weights
    assert charged.tolist()[:2] == pytest.approx([7.0, 0.0], abs=1e-3) and 3.5 < charged[2] < 7.0
    charged[2].backward()
    assert state.grad[2, 0] > 1.0


def test_a_box_of_starts_is_its_middle_and_its_corners() -> None:
    task = task_of(read_specification(find_specification("quadrotor2d.yaml")))
    assert initial_states(task.loop).shape == (33, 6)
    point = task_of(read_specification(find_specification("quadrotor1d.yaml")))
    assert initial_states(point.loop).tolist() == [[-4.0, 0.0]]


def test_policies_of_other_kinds_are_refused() -> None:
    wide, narrow = policies_of(ACTOR, 1), policies_of(Layout((2, 4, 1), True), 1)
    with pytest.raises(UsageError, match="one shape"):
        Agents.of([*wide, *narrow])
    odd = Policy((Affine(np.eye(2), np.zeros(2)), Activation("sigmoid"), Affine(np.ones((1, 2)), np.zeros(1))), 2, 1)
    with pytest.raises(UsageError, match="ReLU"):
        Agents.of([odd])


@pytest.mark.parametrize(
    "wrong",
    [{"radii": ()}, {"radii": (F(-1),)}, {"radii": (F(1), F(1))}, {"resolution": F(0)}, {"draws": 0}, {"steps": 0}],
)
def test_impossible_options_are_errors(wrong: dict[str, Any]) -> None:
    with pytest.raises(UsageError):
        EvaluationOptions(**{"radii": (F(0),), **wrong})


# Collapse ----------------------------------------------------------------------------------------


def test_a_constant_policy_has_collapsed_and_the_message_has_the_numbers(hover: Task) -> None:
    agents = Agents.of([constant_policy(0.1), *policies_of(Layout((2, 4, 1), True), 1, gain=2.0)])
    starts = initial_states(hover.loop)
    _, visited = undisturbed(hover, agents, starts)
    flat = Returns(np.array([[-112.0, -112.5], [-112.0, -112.5]]), np.zeros((2, 2)))
    first, second = collapses(hover, agents, starts, visited, (F(0), F(1, 2)), flat)
    assert first.collapsed and first.span == 0.0 and "0 % of [-1, 1]" in first.reasons[0]
    assert len(second.reasons) == 1 and second.span > 0.02
    assert "-112 at 0 and -112.5 at 0.5" in second.reasons[0] and f"{second.constant_return:.6g}" in second.reasons[0]


@pytest.mark.parametrize("curve", [[-30.0, -30.1], [-112.0, -150.0], [-112.0, -np.inf]])
def test_a_good_or_a_falling_curve_is_no_collapse(hover: Task, curve: list[float]) -> None:
    agents = Agents.of(policies_of(ACTOR, 1, gain=2.0))
    starts = initial_states(hover.loop)
    _, visited = undisturbed(hover, agents, starts)
    verified = Returns(np.array([curve]), np.zeros((1, 2)))
    (found,) = collapses(hover, agents, starts, visited, (F(0), F(1, 2)), verified)
    assert not found.collapsed
    assert found.constant_return == pytest.approx(-63.5, abs=1.0)  # the best constant thrust, from (-4, 0)


# Statistics --------------------------------------------------------------------------------------


def test_the_interval_of_five_values_is_students() -> None:
    sample = [-30.0, -28.0, -35.0, -29.5, -31.0]
    found = summary(sample)
    assert found.interval is not None and found.half_width is not None
    factor = found.half_width / (np.std(sample, ddof=1) / np.sqrt(5))
    assert factor == pytest.approx(2.776, abs=1e-3)
    assert (found.count, found.median, found.mean) == (5, -30.0, pytest.approx(-30.7))


def test_one_value_has_no_interval_and_neither_has_an_infinite_one() -> None:
    assert summary([-3.0]).interval is None
    lost = summary([-3.0, -np.inf, -4.0])
    assert (lost.interval, lost.median, lost.mean) == (None, -4.0, -np.inf)
    with pytest.raises(ValueError, match="sample"):
        summary([])


@pytest.mark.parametrize("size", [1, 5, 10, 20])
def test_paired_tests_are_those_of_scipy_without_ties(size: int) -> None:
    generator = np.random.default_rng(size)
    first, second = generator.normal(0.4, 1.0, size), generator.normal(size=size)
    found = paired_test(first, second)
    expected = stats.wilcoxon(first, second, alternative="greater", method="exact").pvalue
    assert found.wilcoxon == pytest.approx(expected, abs=1e-12)
    assert found.higher + found.lower == size and found.equal == 0
    assert found.sign == pytest.approx(sum(stats.binom.pmf(k, size, 0.5) for k in range(found.higher, size + 1)))


def test_the_signed_rank_test_is_exact_with_ties_too() -> None:
    differences = np.array([1.0, 1.0, -1.0, 2.0, 3.0, 3.0])
    ranks = stats.rankdata(np.abs(differences))
    observed = ranks[differences > 0].sum()
    sums = [ranks[list(signs)].sum() for signs in itertools.product([False, True], repeat=6)]
    assert paired_test(differences, np.zeros(6)).wilcoxon == pytest.approx(np.mean(np.array(sums) >= observed))


def test_two_bounds_that_are_missing_are_equal() -> None:
    found = paired_test([-np.inf, -1.0, -2.0], [-np.inf, -2.0, -np.inf])
    assert (found.higher, found.lower, found.equal) == (2, 0, 1)
    assert (found.wilcoxon, found.sign) == (0.25, 0.25)
    nothing = paired_test([1.0], [1.0])
    assert (nothing.wilcoxon, nothing.sign) == (1.0, 1.0)


def test_twenty_wins_are_significant_and_five_are_as_good_as_they_can_be() -> None:
    assert paired_test(np.ones(5), np.zeros(5)).wilcoxon == pytest.approx(1 / 32)
    assert paired_test(np.ones(20), np.zeros(20)).sign == pytest.approx(2.0**-20)


# Reports -----------------------------------------------------------------------------------------


def test_the_table_names_every_radius_seed_and_collapse(evaluation: Evaluation) -> None:
    collapsed = replace(evaluation.collapses[0], reasons=("its action takes 0.1 % of [-1, 1] over 3 states",))
    text = "\n".join(evaluation_lines(replace(evaluation, collapses=(collapsed, *evaluation.collapses[1:]))))
    for word in (
        "quadrotor1d.yaml",
        "0.1 ",
        "0.3 ",
        "median",
        "adaptive",
        "certified radius",
        "3.182",
        "COLLAPSED: seed 3",
    ):
        assert word in text, word
    assert "its action takes 0.1 %" in text
    certified = (F(3, 10), F(1, 5), None, None)
    shown = evaluation_lines(replace(evaluation, certified=certified))
    seeds = {line.split()[0]: line for line in shown if line.startswith(("3 ", "4 ", "5 ", "median "))}
    assert (
        ">= 0.3" in seeds["3"]
        and seeds["4"].split()[-1] == "0.2"
        and "none" in seeds["5"]
        and "none" in seeds["median"]
    )
    table = [line.split() for line in text.splitlines() if line.startswith("0.3 ")]
    assert float(table[0][1]) <= float(np.median(evaluation.verified.discounted[:, 2]))


def test_one_seed_has_no_interval_in_the_table(evaluation: Evaluation) -> None:
    def first(found: Returns) -> Returns:
        return Returns(found.discounted[:1], found.undiscounted[:1])

    alone = replace(
        evaluation,
        seeds=(3,),
        nominal=first(evaluation.nominal),
        attacked={name: first(found) for name, found in evaluation.attacked.items()},
        verified=first(evaluation.verified),
        certified=evaluation.certified[:1],
        collapses=evaluation.collapses[:1],
    )
    text = "\n".join(evaluation_lines(alone))
    assert "one seed: no interval" in text and "Student" not in text
    assert plot_evaluation(alone).axes


def test_the_csv_has_a_row_per_seed_radius_and_quantity(evaluation: Evaluation) -> None:
    rows = list(csv.DictReader(io.StringIO(evaluation_csv(evaluation))))
    found = [row for row in rows if row["epsilon"]]
    assert len(found) == 4 * 3 * 5
    one = next(row for row in found if (row["seed"], row["epsilon"], row["quantity"]) == ("4", "0.3", "verified"))
    assert float(one["discounted"]) == evaluation.verified.discounted[1, 2]
    assert float(one["undiscounted"]) == evaluation.verified.undiscounted[1, 2]
    assert {row["quantity"] for row in rows if not row["epsilon"]} == {"nominal", "certified_radius", "collapsed"}


def test_the_json_has_no_infinite_numbers(evaluation: Evaluation) -> None:
    lost = Returns(np.full((4, 3), -np.inf), np.full((4, 3), -np.inf))
    data = json.loads(json.dumps(evaluation_to_json(replace(evaluation, verified=lost)), allow_nan=False))
    assert data["policies"][0]["verified"]["discounted"] == [None] * 3
    assert [entry["seed"] for entry in data["policies"]] == [3, 4, 5, 6]


def test_a_run_compared_with_itself_is_no_better(evaluation: Evaluation) -> None:
    assert all(found.wilcoxon == 1.0 and found.equal == 4 for found in compare(evaluation, evaluation))
    better = Returns(evaluation.verified.discounted + 1.0, evaluation.verified.undiscounted)
    lines = comparison_lines(replace(evaluation, verified=better), evaluation, ("sa-pc", "pa-pc"))
    assert "sa-pc higher" in lines[0] and "0.0625" in lines[1]
    with pytest.raises(UsageError, match="same seeds"):
        compare(evaluation, replace(evaluation, seeds=(1, 2, 3, 4)))


def test_the_picture_is_written_and_the_same_evaluation_gives_the_same_bytes(
    evaluation: Evaluation, tmp_path: Path
) -> None:
    values = evaluation.verified.discounted.copy()
    values[0, 1:] = -np.inf
    lost = replace(evaluation, verified=Returns(values, values))
    paths = [tmp_path / "one.svg", tmp_path / "two.svg"]
    for path in paths:
        plot_evaluation(lost, str(path))
    assert paths[0].read_bytes() == paths[1].read_bytes() and len(paths[0].read_bytes()) > 1000
    low, high = plot_evaluation(lost).axes[0].get_ylim()
    assert low < np.median(values[:, 1]) < high
