"""Grad: acts on an observation perturbed along the gradient of Q(s, mu(s_adv)), Alg. 4 of [1]_.

The gradient descends Q; losses are on clean observations.

References
----------
.. [1] Pattanaik et al., "Robust deep reinforcement learning with adversarial attacks", AAMAS 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..attacks import grad
from ..losses import Networks
from ..networks import Tensor, forward
from .algorithm import Decision
from .pa_pc import PointAlgorithm


@dataclass(frozen=True)
class GradAlgorithm(PointAlgorithm):
    """Acts with mu(s_adv), s_adv where the gradient of Q points down."""

    def act(self, networks: Networks, x: Tensor, draws: Tensor) -> Decision:
        layouts = networks.actor_layout, networks.critic_layout
        seen = grad(layouts[0], networks.actor, layouts[1], networks.first_critic, x, self.rows)
        return Decision(forward(networks.actor_layout, networks.actor, seen)[:, 0])
