"""What trained policies are worth: returns, what adversaries leave of them, what is proved.

For every policy (one per seed) and radius: the undisturbed return, the return under four adversaries, V(s0), which is a
lower bound of all of them, and the largest radius at which the whole specification is VERIFIED.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from ..models.closed_loop import Plant
from ..models.policy import Policy
from ..specs.errors import UsageError
from ..verify.options import Options
from ..verify.verifier import verify_radii
from .adversary import AdversaryOptions
from .attacked_returns import Agents, Returns, attacked, initial_states, undisturbed
from .certified_radius import QUIET, certified_radius, radii_by_name
from .collapse import Collapse, collapses
from .networks import Layout, Tensor
from .statistics import PairedTest, paired_test
from .task import Task

Array = NDArray[np.float64]
Progress = Callable[[int, int, str], None]
"""Parts that are done, all parts, and what comes next."""

ATTACKS = ("naive", "grad", "mad", "adaptive")


@dataclass(frozen=True)
class EvaluationOptions:
    """What is evaluated, and how hard the adversaries try.

    Attributes
    ----------
    radii : tuple of Fraction
        Perturbation radii, exact; a component with a smaller share of the specification's perturbation gets its share.
    resolution : Fraction
        The certified radius is searched until what it could still be is closer than this.
    certify : bool
        Whether it is searched.
    draws, steps : int
        Candidates of `naive`, gradient steps of `mad`, in every control period.
    adversary : AdversaryOptions
    seed : int
        Of the adversaries' random numbers.
    verification : verify.options.Options
        Of V(s0) and of the certified radius.
    """

    radii: tuple[Fraction, ...]
    resolution: Fraction = Fraction(1, 1000)
    certify: bool = True
    draws: int = 10
    steps: int = 10
    adversary: AdversaryOptions = field(default_factory=AdversaryOptions)
    seed: int = 0
    verification: Options = field(default_factory=lambda: Options(splits=1))

    def __post_init__(self) -> None:
        if not self.radii or min(self.radii) < 0 or len(set(self.radii)) < len(self.radii):
            raise UsageError("different radii that are not negative are required", where="radii")
        if not self.resolution > 0:
            raise UsageError(f"a positive number is required, received {self.resolution}", where="resolution")
        for name in ("draws", "steps"):
            if getattr(self, name) < 1:
                raise UsageError(f"at least 1 is required, received {getattr(self, name)}", where=name)


@dataclass(frozen=True, eq=False)
class Evaluation:
    """S policies of one specification at E radii.

    Attributes
    ----------
    specification, plant : str
        Names, for titles.
    seeds : tuple of int
        One per policy.
    radii : tuple of Fraction
    discount : float
    starts : int
        Initial states of the simulations: the middle and corners of the initial set, or the one point that it is.
    nominal : Returns, shape (S,)
        Without perturbation, from the worst start.
    attacked : mapping of adversary to Returns, shape (S, E)
        From the worst start. `naive` and `grad` are missing where there are no critics.
    verified : Returns, shape (S, E)
        V(s0): proved lower bounds, for the whole initial set.
    certified : tuple of Fraction or None
        Largest radius at which the specification is VERIFIED; None: none of them.
    certifiable : bool
        Whether it was searched: the specification has requirements.
    resolution : Fraction
        Of the certified radius.
    collapses : tuple of Collapse
        One per policy.
    timings : dict of part to seconds
    """

    specification: str
    plant: str
    seeds: tuple[int, ...]
    radii: tuple[Fraction, ...]
    discount: float
    starts: int
    nominal: Returns
    attacked: Mapping[str, Returns]
    verified: Returns
    certified: tuple[Fraction | None, ...]
    certifiable: bool
    resolution: Fraction
    collapses: tuple[Collapse, ...]
    timings: Mapping[str, float]


def evaluate(
    task: Task,
    policies: Sequence[Policy],
    options: EvaluationOptions,
    *,
    seeds: Sequence[int] | None = None,
    critic_layout: Layout | None = None,
    critic: Tensor | None = None,
    plant: Plant | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate policies side by side, from the specification's initial set.

    Parameters
    ----------
    task : Task
    policies : sequence of Policy
        Of one shape, as read from their files: what is evaluated is what is deployed.
    options : EvaluationOptions
    seeds : sequence of int, optional
        Names of the policies; 0, 1, ... by default.
    critic_layout : Layout, optional
    critic : Tensor, shape (S, P'), optional
        The policies' critics, which `naive` and `grad` need. Of several critics the first.
    plant : Plant, optional
        Where the task has another plant than its specification names; then no radius can be certified.
    progress : callable, optional

    Returns
    -------
    Evaluation

    Raises
    ------
    SetrlError
        The policies do not fit the task or each other.
    """
    numbers = tuple(range(len(policies)) if seeds is None else seeds)
    if not policies or len(numbers) != len(policies):
        raise UsageError(f"one seed per policy is required, received {len(numbers)} for {len(policies)} policies")
    agents, starts = Agents.of(policies, critic_layout, critic), initial_states(task.loop)
    grid = np.array([float(radius) for radius in options.radii])
    watch = _Watch(progress, 2 + len(policies) * (1 + options.certify))

    watch.begin("simulation", "undisturbed")
    nominal, visited = undisturbed(task, agents, starts)
    watch.begin("adversaries", "adversaries")
    found = attacked(
        task,
        agents,
        grid,
        starts,
        draws=options.draws,
        steps=options.steps,
        adversary=options.adversary,
        seed=options.seed,
    )
    values = []
    for seed, policy in zip(numbers, policies, strict=True):
        watch.begin("verified performance", f"V(s0) of seed {seed}")
        values.append(verified_performance(task, policy, options.radii, options=options.verification, plant=plant))
    verified = Returns(np.array([v.discounted for v in values]), np.array([v.undiscounted for v in values]))
    certified: list[Fraction | None] = [None] * len(policies)
    for position, seed in enumerate(numbers if options.certify else ()):
        watch.begin("certified radius", f"certified radius of seed {seed}")
        certified[position] = certified_radius(
            task, policies[position], options.radii, options.resolution, options=options.verification, plant=plant
        )
    watch.begin("collapse", "collapse")
    judged = collapses(task, agents, starts, visited, options.radii, verified)
    watch.begin("", "done")
    specification = task.loop.specification
    return Evaluation(
        specification=specification.source.rsplit("/", 1)[-1],
        plant=task.loop.plant.description.name,
        seeds=numbers,
        radii=options.radii,
        discount=task.discount,
        starts=len(starts),
        nominal=nominal.least(1),
        attacked=found,
        verified=verified,
        certified=tuple(certified),
        certifiable=options.certify and bool(specification.requirements),
        resolution=options.resolution,
        collapses=judged,
        timings=watch.timings,
    )


def verified_performance(
    task: Task,
    policy: Policy,
    radii: Sequence[Fraction],
    *,
    options: Options | None = None,
    plant: Plant | None = None,
) -> Returns:
    """V(s0) at every radius, in one batch.

    Parameters
    ----------
    task : Task
    policy : Policy
    radii : sequence of Fraction
    options : Options, optional
        ``Options(splits=1)`` by default.
    plant : Plant, optional
        Instead of the plant that the specification names.

    Returns
    -------
    Returns, shape (E,)
    """
    specification = replace(task.loop.specification, requirements=())
    bounds = [radii_by_name(task, policy, radius) for radius in radii]
    options = options or Options(splits=1)
    with np.errstate(**QUIET):
        results = verify_radii(policy, specification, bounds, options=options, plant=plant, check=False)
    found = [result.value for result in results]
    pairs = [(value.discounted, value.undiscounted) for value in found if value is not None]
    assert len(pairs) == len(radii), "a task has a reward"
    return Returns(*np.array(pairs, dtype=np.float64).T)


def compare(first: Evaluation, second: Evaluation) -> tuple[PairedTest, ...]:
    """Test whether the first trainings have a higher V(s0) than the second, seed by seed; one test per radius.

    Parameters
    ----------
    first, second : Evaluation
        Of the same seeds, radii and specification.

    Returns
    -------
    tuple of PairedTest

    Raises
    ------
    UsageError
        They are not of the same seeds, radii and specification.
    """
    for what in ("specification", "seeds", "radii"):
        one, two = getattr(first, what), getattr(second, what)
        if one != two:
            raise UsageError(f"a paired test needs the same {what} on both sides", remedy="evaluate both alike")
    pairs = zip(first.verified.discounted.T, second.verified.discounted.T, strict=True)
    return tuple(paired_test(one, two) for one, two in pairs)


class _Watch:
    """Seconds of every part, and word of it to the caller."""

    def __init__(self, progress: Progress | None, parts: int) -> None:
        self.progress, self.parts, self.done = progress, parts + 1, -1
        self.timings: dict[str, float] = {}
        self.part, self.started = "", time.perf_counter()

    def begin(self, part: str, words: str) -> None:
        now = time.perf_counter()
        if self.part:
            self.timings[self.part] = self.timings.get(self.part, 0.0) + now - self.started
        self.part, self.started, self.done = part, now, self.done + 1
        if self.progress is not None:
            self.progress(self.done, self.parts, words)
