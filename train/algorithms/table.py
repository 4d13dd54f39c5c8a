"""Which class an algorithm's name stands for."""

from __future__ import annotations

from ..networks import Tensor
from ..options import Algorithm as Name
from ..options import TrainingOptions
from .algorithm import Algorithm
from .grad import GradAlgorithm
from .mad import MadAlgorithm
from .naive import NaiveAlgorithm
from .pa_pc import PointAlgorithm
from .sa_pc import SetActorAlgorithm
from .sa_sc import SetCriticAlgorithm

TABLE: dict[Name, type[Algorithm]] = {
    "pa-pc": PointAlgorithm,
    "naive": NaiveAlgorithm,
    "grad": GradAlgorithm,
    "mad": MadAlgorithm,
    "sa-pc": SetActorAlgorithm,
    "sa-sc": SetCriticAlgorithm,
}


def algorithm_of(options: TrainingOptions, epsilon: float, rows: Tensor) -> Algorithm:
    """The algorithm that options ask for.

    A radius of zero has no sets and no adversary, and sets that weigh nothing are points: then it is pa-pc, by
    definition.
    """
    name = options.algorithm
    weights = {"sa-pc": options.actor_weight, "sa-sc": options.actor_weight + options.critic_weight}
    if epsilon == 0.0 or weights.get(name) == 0.0:
        name = "pa-pc"
    return TABLE[name](options, epsilon, rows)
