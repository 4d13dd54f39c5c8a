"""Naive: acts on the worst of random perturbed observations, Alg. 2 of [1]_; losses on clean observations.

The perturbations are two-sided, over the whole ball.

References
----------
.. [1] Pattanaik et al., "Robust deep reinforcement learning with adversarial attacks", AAMAS 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..attacks import naive
from ..losses import Networks
from ..networks import Tensor, forward
from .algorithm import Decision
from .pa_pc import PointAlgorithm


@dataclass(frozen=True)
class NaiveAlgorithm(PointAlgorithm):
    """Acts with mu(s_adv), s_adv the candidate with the lowest Q(s, mu(s_adv))."""

    @property
    def draws(self) -> int:
        return self.options.attack_steps * len(self.rows)

    def act(self, networks: Networks, x: Tensor, draws: Tensor) -> Decision:
        candidates = draws.unflatten(1, (1, self.options.attack_steps, len(self.rows)))
        layouts = networks.actor_layout, networks.critic_layout
        seen = naive(layouts[0], networks.actor, layouts[1], networks.first_critic, x, self.rows, candidates)
        return Decision(forward(networks.actor_layout, networks.actor, seen)[:, 0])
