"""Differentiable reachable sets contain what can be reached, agree with the verifier, and give its gradient."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from fractions import Fraction
from typing import Any

import numpy as np
import pytest

torch = pytest.importorskip("torch", reason="torch is part of the extra `train`")

from cases import correlated_loop, discrete_loop, everything_loop  # noqa: E402
from loops import box_region, plant_of, requirement, specification_of  # noqa: E402

from setrl.models.onnx_reader import read_policy  # noqa: E402
from setrl.models.onnx_writer import policy_bytes  # noqa: E402
from setrl.models.simulation import returns, simulate  # noqa: E402
from setrl.specs.errors import UsageError  # noqa: E402
from setrl.specs.reader import find_specification, read_specification  # noqa: E402
from setrl.specs.specification import Reward  # noqa: E402
from setrl.train.affine_forms import AffineForm, AffineFormAlgebra, shifted  # noqa: E402
from setrl.train.algorithms.flowpipe import FlowpipeTrainer, ascend  # noqa: E402
from setrl.train.networks import Layout, initial_parameters, layers_of  # noqa: E402
from setrl.train.options import FlowpipeOptions  # noqa: E402
from setrl.train.reachable import ReachableSets  # noqa: E402
from setrl.train.relaxation_gradients import enclosed_sincos, relaxed_relu, relaxed_tanh  # noqa: E402
from setrl.train.task import Task, start_bounds, task_of  # noqa: E402
from setrl.verify.options import Options  # noqa: E402
from setrl.verify.verifier import verify_radii  # noqa: E402

torch.set_num_threads(1)

STARTS = {
    "quadrotor1d": {"z": [-4, 4], "zdot": 0},
    "pendulum": {"theta": [-3, 3], "thetadot": 0},
    "navigation": {"x": 3, "y": 3, "theta": 0, "v": 0},
}
SHIPPED = ("quadrotor1d", "pendulum", "navigation", "quadrotor2d")
WIRED: dict[str, Callable[[], Any]] = {
    "everything": everything_loop,
    "everything-constant": lambda: everything_loop(varying=False),
    "everything-delay-1": lambda: everything_loop(1),
    "everything-delay-2": lambda: everything_loop(2),
    "discrete": discrete_loop,
    "discrete-delay-1": lambda: discrete_loop(1),
    "correlated-delay-1": lambda: correlated_loop(1),
}


def shipped(name: str, periods: int | None = None) -> Task:
    specification = read_specification(find_specification(name))
    if periods is not None:
        limit = specification.controller.period * periods
        specification = replace(specification, horizon=limit, requirements=())
    return task_of(specification, start_bounds(STARTS[name]) if name in STARTS else None)


def task_named(name: str) -> Task:
    if name in SHIPPED:
        return shipped(name)
    specification = WIRED[name]().specification
    if specification.reward is None:
        specification = replace(specification, reward=everything_loop().specification.reward)
        specification = replace(specification, reward=replace(specification.reward, weights={"x": 1}, target={}))
    return task_of(specification)


def policies(task: Task, seeds: int = 1, gain: float = 1.0, hidden: tuple[int, ...] = (8, 6)) -> tuple[Layout, Any]:
    """Random policies; numbers that float32 has, because that is what is exported."""
    layout = Layout((task.inputs, *hidden, task.actions), True)
    flat = initial_parameters(layout, [np.random.default_rng(seed) for seed in range(seeds)], torch.float32)
    return layout, gain * flat.double()


def policy_of(layout: Layout, row: Any) -> Any:
    return read_policy(policy_bytes(layers_of(layout, row)))


def start_of(task: Task, sets: int) -> tuple[Any, Any]:
    """The initial set, (1, P, n) each."""
    box = np.array([[float(low), float(high)] for low, high in task.loop.initial])
    shape = (1, sets, len(box))
    return np.broadcast_to(box.mean(1), shape), np.broadcast_to(0.5 * (box[:, 1] - box[:, 0]), shape)


def verified(task: Task, layout: Layout, flat: Any, epsilons: Any) -> Any:
    """V of the verifier, (S, radii)."""
    specification = replace(task.loop.specification, requirements=())
    rows = []
    for row in flat:
        radii = [float(epsilon) for epsilon in epsilons]
        results = verify_radii(
            policy_of(layout, row), specification, radii, options=Options(splits=1), check=False, plant=task.loop.plant
        )
        rows.append([result.value.discounted for result in results if result.value is not None])
    return np.array(rows)


def runs_of(task: Task, layout: Layout, row: Any, epsilon: float, count: int) -> Any:
    """Simulated trajectories with extreme starts, perturbations and disturbances."""
    generator = np.random.default_rng(0)
    loop = task.bound(policy_of(layout, row), epsilon)

    def extreme(low: Any, high: Any, shape: tuple[int, ...]) -> Any:
        # a share of every trajectory's numbers lies inside
        corners = np.where(generator.random(shape) < 0.5, low, high)
        return np.where(generator.random(shape) < 0.8, corners, low + generator.random(shape) * (high - low))

    box = np.array([[float(low), float(high)] for low, high in loop.initial]).T
    radius = np.array([float(entry) for entry in loop.observation_radius])
    bounds = np.array([[float(d.lower), float(d.upper)] for d in loop.disturbances]).reshape(-1, 2).T
    noise = extreme(-radius, radius, (count, loop.periods, len(radius)))
    noise[: count // 2] = noise[: count // 2, :1]
    forces = extreme(*bounds, (count, loop.periods, bounds.shape[1]))
    constant = [entry.constant for entry in loop.disturbances]
    forces[:, :, constant] = forces[:, :1, constant]
    return loop, simulate(loop, extreme(*box, (count, box.shape[1])), noise, forces)


def operands(positive: bool) -> Iterator[AffineForm]:
    """Forms from points to wide sets; a quarter of the radius is remainder."""
    generator = np.random.default_rng(0)
    for scale in (0.0, 1e-9, 1e-3, 0.1, 0.7, 2.0, 9.0):
        terms = generator.normal(size=(60, 6)) * scale / 5
        terms[:, 0] = generator.uniform(-4, 4, 60)
        remainder = generator.uniform(0, 0.25, 60) * scale
        if positive:
            terms[:, 0] = (np.abs(terms[:, 1:]).sum(1) + remainder) * generator.uniform(1.01, 4, 60) + 0.02
        yield AffineForm(torch.tensor(terms, requires_grad=True), torch.tensor(remainder))


OPERATIONS: dict[str, tuple[Callable[..., Any], Callable[..., Any], bool]] = {
    "add": (AffineFormAlgebra().add, lambda x, y: x + y, False),
    "subtract": (AffineFormAlgebra().subtract, lambda x, y: x - y, False),
    "multiply": (AffineFormAlgebra().multiply, lambda x, y: x * y, False),
    "divide": (AffineFormAlgebra().divide, lambda x, y: x / y, True),
    "divide-negative": (
        lambda x, y: AffineFormAlgebra().divide(x, AffineFormAlgebra().negate(y)),
        lambda x, y: -x / y,
        True,
    ),
    "negate": (lambda x, _: AffineFormAlgebra().negate(x), lambda x, _: -x, False),
    "square": (lambda x, _: AffineFormAlgebra().square(x), lambda x, _: x * x, False),
    "sin": (lambda x, _: AffineFormAlgebra().sincos(x)[0], lambda x, _: x.sin(), False),
    "cos": (lambda x, _: AffineFormAlgebra().sincos(x)[1], lambda x, _: x.cos(), False),
    "exp": (lambda x, _: AffineFormAlgebra().exp(x), lambda x, _: x.exp(), False),
    "log": (lambda x, _: AffineFormAlgebra().log(x), lambda x, _: x.log(), True),
    "sqrt": (lambda x, _: AffineFormAlgebra().sqrt(x), lambda x, _: x.sqrt(), True),
    "tanh": (lambda x, _: AffineFormAlgebra().tanh(x), lambda x, _: x.tanh(), False),
    "scaled": (lambda x, _: AffineFormAlgebra().multiply(-2.0, x), lambda x, _: -2 * x, False),
    "from-number": (lambda x, _: AffineFormAlgebra().subtract(2.0, x), lambda x, _: 2 - x, False),
    "shifted": (lambda x, y: shifted(x, y, -0.3), lambda x, y: x - 0.3 * y, False),
}


@pytest.mark.parametrize("name", OPERATIONS)
def test_an_operation_on_affine_forms_encloses_every_sample_with_finite_gradients(name: str) -> None:
    operation, function, positive = OPERATIONS[name]
    generator = np.random.default_rng(1)
    for x in operands(positive):
        y = AffineForm(x.terms.detach().flip(0).requires_grad_(), torch.as_tensor(x.remainder).flip(0))
        result = operation(x, y)
        factors = generator.uniform(-1, 1, (400, *x.generators.shape))
        factors[::2] = np.sign(factors[::2])
        own = np.sign(generator.uniform(-1, 1, (2, 400, 60)))
        b, e = torch.from_numpy(factors), torch.from_numpy(own)
        points = [
            form.center + (form.generators * b).sum(-1) + form.remainder * error
            for form, error in zip((x, y), e, strict=True)
        ]
        rest = function(*points) - result.center - (result.generators * b).sum(-1)
        scale = 1.0 + result.center.abs() + result.radius
        assert (rest.abs() <= result.remainder + 1e-14 * scale).all()
        (result.radius.sum() + result.center.sum()).backward()
        assert all(form.terms.grad is None or form.terms.grad.isfinite().all() for form in (x, y))


@pytest.mark.parametrize("function", [relaxed_relu, relaxed_tanh, enclosed_sincos])
def test_a_written_derivative_is_the_limit_of_differences(function: Any) -> None:
    generator = np.random.default_rng(0)
    first = torch.from_numpy(generator.uniform(-4, 3, 60)).requires_grad_()
    width = torch.from_numpy(generator.uniform(0.01, 3, 60)).requires_grad_()
    wired = {enclosed_sincos: lambda x, r: sum(function(x, r), ())}.get(function, lambda x, w: function(x, x + w))
    assert torch.autograd.gradcheck(wired, (first, width), eps=1e-7, atol=1e-5, rtol=1e-5)


@pytest.mark.parametrize("name", [*SHIPPED, *WIRED])
def test_the_sets_contain_simulated_states_and_v_is_no_more_than_their_worst_return(name: str) -> None:
    task = task_named(name)
    layout, flat = policies(task, gain=0.3)
    epsilon = 0.5 * task.epsilon
    center, radius = start_of(task, 1)
    found = ReachableSets(task, layout, substeps=4).outcome(flat, center, radius, np.full((1, 1), epsilon), keep=True)
    loop, runs = runs_of(task, layout, flat[0], epsilon, 60)
    generator = np.random.default_rng(2)
    states = np.concatenate([runs.states[:, :1], runs.period_ends], 1)
    for k, terms in enumerate(found.ends):
        size = len(terms[0])
        directions = np.concatenate([np.eye(size), generator.normal(size=(20, size))])
        image = np.einsum("dn,nq->dq", directions, terms[0, :, 0].numpy())
        offset = states[:, k] @ directions.T - image[:, 0]
        tolerance = 1e-6 * (1.0 + np.abs(image[:, 0]))
        assert (np.abs(offset) <= np.abs(image[:, 1:]).sum(1) + tolerance).all(), k
    worst = returns(loop, runs).min()
    assert float(found.value[0, 0]) <= worst + 1e-5 * abs(worst)
    assert float(found.value[0, 0]) >= 3.0 * worst - 1.0, "an enclosure that says nothing"


@pytest.mark.parametrize(("name", "substeps"), [("quadrotor1d", 1), ("pendulum", 8), ("navigation", 2)])
def test_the_value_of_points_is_their_simulated_return(name: str, substeps: int) -> None:
    task = shipped(name, 15)
    layout, flat = policies(task, seeds=2)
    starts = np.random.default_rng(0).uniform(-1, 1, (2, 3, len(task.loop.initial))) * 0.5
    value = ReachableSets(task, layout, substeps).outcome(flat, starts, 0.0 * starts, np.zeros((2, 3))).value
    for s in range(2):
        loop = task.bound(policy_of(layout, flat[s]), 0)
        expected = returns(loop, simulate(loop, starts[s], rtol=1e-11, atol=1e-12))
        np.testing.assert_allclose(value[s].numpy(), expected, rtol=1e-6)


def test_the_value_is_the_verifiers_on_a_linear_plant_and_close_to_it_on_others() -> None:
    for name, epsilons, tolerance in (("quadrotor1d", (0, 0.1, 0.3), 1e-3), ("navigation", (0, 0.01), 1e-2)):
        task = shipped(name)
        layout, flat = policies(task, seeds=2, hidden=(16, 16))
        center, radius = start_of(task, len(epsilons))
        center, radius = np.repeat(center, 2, 0), np.repeat(radius, 2, 0)
        value = ReachableSets(task, layout).outcome(flat, center, radius, np.array([epsilons] * 2)).value.numpy()
        np.testing.assert_allclose(value, verified(task, layout, flat, epsilons), rtol=tolerance)


def test_a_set_that_touches_the_penalised_region_is_charged_and_feels_its_edge() -> None:
    task = shipped("navigation")
    layout, flat = policies(task, gain=0.3)
    center = np.array([[[1.5, 1.5, 0.0, 0.0], [3.0, 3.0, 0.0, 0.0]]])
    sets = ReachableSets(task, layout)
    charged = sets.outcome(flat, center, 0.0 * center, np.zeros((1, 2))).value
    sets.costs.region.clear()
    free = sets.outcome(flat, center, 0.0 * center, np.zeros((1, 2))).value
    assert (free - charged)[0, 0] > 0.99
    assert (free - charged)[0, 1] == 0.0
    region = ReachableSets(task, layout).costs
    near = torch.tensor([[0.95], [1.5], [0.0], [0.0]], dtype=torch.float64)[None, :, None].requires_grad_()
    region(near).backward()
    assert near.grad[0, 0, 0, 0] > float(task.loop.reward.weights[0]), "moving into the region costs more"


def test_margins_are_the_verifiers_at_instants() -> None:
    """Where a requirement speaks of an instant, both look at the same set."""
    base = shipped("quadrotor1d", 10).loop.specification
    inside = box_region(z=(-6, -3), zdot=(-4, 4))
    requirements = (
        requirement("reach", inside, 0, "0.5", "reach"),
        requirement("stay", inside, "0.7", "0.7", "stay"),
        requirement("avoid", box_region(z=(0, 1)), 1, 1, "avoid"),
    )
    task = task_of(replace(base, requirements=requirements))
    layout, flat = policies(task)
    center, radius = start_of(task, 1)
    margins = ReachableSets(task, layout).outcome(flat, center, radius, np.full((1, 1), 0.1)).margins[0, 0]
    policy = policy_of(layout, flat[0])
    result = verify_radii(policy, task.loop.specification, [0.1], options=Options(splits=1), check=False)[0]
    np.testing.assert_allclose(margins.numpy(), [entry.margin for entry in result.requirements], rtol=1e-3, atol=1e-4)


@pytest.mark.parametrize("name", ["quadrotor1d", "pendulum", "quadrotor2d", "everything-delay-1"])
def test_the_gradient_is_the_limit_of_differences(name: str) -> None:
    task = shipped(name, 5) if name in SHIPPED else task_named(name)
    layout, flat = policies(task, seeds=2)
    options = FlowpipeOptions(steps=1, pairs=3, epsilon=0.02)
    trainer = FlowpipeTrainer(task, layout, flat, options, (0, 1))
    pairs = trainer.pairs(0)
    _, _, gradient = trainer.gradient(pairs)
    direction = torch.from_numpy(np.random.default_rng(0).normal(size=flat.shape))
    step, sides = 1e-7, []
    for sign in (1.0, -1.0):
        trainer.parameters = flat + sign * step * direction
        sides.append(trainer.gradient(pairs)[1])
    expected = (sides[0] - sides[1]) / (2 * step)
    assert (expected.abs() > 1e-3).any(), "a direction in which nothing changes shows nothing"
    torch.testing.assert_close((gradient * direction).sum(1), expected, rtol=1e-4, atol=1e-6)


def test_ten_steps_raise_the_verified_value() -> None:
    task = shipped("pendulum", 6)
    layout, flat = policies(task, seeds=2)
    options = FlowpipeOptions(steps=10, pairs=4, epsilon=0.05, learning_rate=1e-2, final_learning_rate=1e-2)
    told = []
    after = ascend(task, layout, flat.float(), options, (0, 1), progress=lambda *news: told.append(news))
    assert after.dtype == torch.float32
    assert [step for step, _, _ in told] == list(range(1, 11))
    before, later = (verified(task, layout, rows, (0.03,)) for rows in (flat, after))
    assert (later > before * 0.98).all()


@pytest.mark.parametrize("objective", ["margin", "both"])
def test_objectives_with_margins_raise_the_verified_margin(objective: Any) -> None:
    base = shipped("quadrotor1d", 8).loop.specification
    task = task_of(replace(base, requirements=(requirement("stay", box_region(z=("-4.1", 0)), 0, "0.8"),)))
    layout, flat = policies(task)
    rates = {"learning_rate": 0.1, "final_learning_rate": 0.1}
    options = FlowpipeOptions(steps=15, objective=objective, epsilon=0.1, pairs=2, **rates)
    after = ascend(task, layout, flat, options, (0,))
    margins = []
    for rows in (flat, after):
        policy = policy_of(layout, rows[0])
        result = verify_radii(policy, task.loop.specification, [0.1], options=Options(splits=1), check=False)[0]
        margins.append(result.requirements[0].margin)
    assert margins[0] < 0.0 < margins[1]


@pytest.mark.parametrize("name", ["quadrotor1d", "navigation"])
def test_a_seed_among_others_becomes_what_it_becomes_alone(name: str) -> None:
    task = shipped(name, 3)
    layout, flat = policies(task, seeds=3)
    options = FlowpipeOptions(steps=4, pairs=3, clip=0.01)
    together = ascend(task, layout, flat, options, (0, 1, 2))
    for seed in range(3):
        assert torch.equal(ascend(task, layout, flat[seed : seed + 1], options, (seed,))[0], together[seed])


def test_a_run_that_goes_on_from_its_state_ends_as_if_undisturbed() -> None:
    task = shipped("pendulum", 2)
    layout, flat = policies(task, seeds=2)
    options = FlowpipeOptions(steps=9, pairs=3)

    def score(actor: Any) -> Any:
        return verified(task, layout, actor, (0.05,))[:, 0]

    def trainer() -> FlowpipeTrainer:
        return FlowpipeTrainer(task, layout, flat, options, (0, 1), score, every=2)

    whole, first, second = trainer(), trainer(), trainer()
    for _ in range(9):
        whole.advance()
    for _ in range(4):
        first.advance()
    second.restore({name: value.clone() for name, value in first.tensors().items()}, first.numbers())
    while not second.done:
        second.advance()
    assert torch.equal(whole.actor, second.actor)
    assert torch.equal(whole.best, second.best)
    assert torch.equal(whole.scores, second.scores)


def test_the_policy_that_is_kept_is_the_one_with_the_best_score() -> None:
    task = shipped("quadrotor1d", 3)
    layout, flat = policies(task, seeds=2)
    seen: list[Any] = []
    scores = [[1.0, 5.0], [3.0, np.nan], [2.0, 4.0]]

    def score(actor: Any) -> Any:
        seen.append(actor)
        return np.array(scores[len(seen) - 1])

    trainer = FlowpipeTrainer(task, layout, flat, FlowpipeOptions(steps=4, pairs=2), (0, 1), score, every=2)
    while not trainer.done:
        trainer.advance()
    assert torch.equal(trainer.best, torch.stack([seen[1][0], seen[0][1]]))
    assert not torch.equal(seen[0], seen[1])


def test_a_seed_without_a_finite_gradient_stands_still_and_the_others_do_not_notice() -> None:
    task = shipped("quadrotor1d", 4)
    layout, flat = policies(task, seeds=2)
    options = FlowpipeOptions(steps=3, pairs=2)
    broken = flat.clone()
    broken[0, 0] = np.nan
    trainer = FlowpipeTrainer(task, layout, broken, options, (0, 1))
    skipped = [trainer.advance().skipped.tolist() for _ in range(3)]
    assert skipped == [[True, False]] * 3
    assert torch.equal(trainer.actor[0, 1:], broken[0, 1:])
    assert torch.equal(trainer.actor[1], ascend(task, layout, flat[1:], options, (1,))[0])


def test_a_set_that_explodes_keeps_a_finite_gradient() -> None:
    """Cubes of cubes overflow after six periods."""
    plant = plant_of({"x": "x**3 + u"}, discrete=True)
    reward = Reward({"x": Fraction(1)}, {}, Fraction("0.99"), None)
    task = task_of(specification_of(plant, {"x": (2, 3)}, period=1, periods=9, observation="0.1", reward=reward))
    layout, flat = policies(task)
    trainer = FlowpipeTrainer(task, layout, flat, FlowpipeOptions(steps=1, pairs=4), (0,))
    outcome, _, gradient = trainer.gradient(trainer.pairs(0))
    assert (outcome.value < -1e3).all()
    assert gradient.isfinite().all() and gradient.abs().sum() > 0.0


def test_pairs_stratify_radii_and_stay_in_the_box_of_starts() -> None:
    task = shipped("quadrotor2d")
    layout, flat = policies(task)
    trainer = FlowpipeTrainer(task, layout, flat, FlowpipeOptions(pairs=8, epsilon=0.4), (0,))
    pairs = trainer.pairs(3)
    strata = np.sort(pairs.epsilon[0]) / 0.05
    assert (np.floor(strata) == np.arange(8)).all()
    low, high = trainer.start
    assert (pairs.center - pairs.radius >= low - 1e-15).all() and (pairs.center + pairs.radius <= high + 1e-15).all()
    assert (pairs.radius[0, :2] == 0.5 * (high - low)).all()
    assert not np.array_equal(pairs.epsilon, trainer.pairs(4).epsilon)


def test_margins_without_requirements_are_refused() -> None:
    task = shipped("quadrotor1d", 3)
    layout, flat = policies(task)
    with pytest.raises(UsageError, match="no requirements"):
        FlowpipeTrainer(task, layout, flat, FlowpipeOptions(objective="both"), (0,))
