"""MAD: acts on the observation that changes the action most, found by projected gradient ascent [1]_.

References
----------
.. [1] Zhang et al., "Robust deep reinforcement learning against adversarial perturbations on state observations",
   NeurIPS 2020, section 3.4.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..attacks import mad
from ..losses import Networks
from ..networks import Tensor, forward
from .algorithm import Decision
from .pa_pc import PointAlgorithm


@dataclass(frozen=True)
class MadAlgorithm(PointAlgorithm):
    """Acts with mu(s_adv), s_adv the maximum of |mu(s_adv) - mu(s)|."""

    @property
    def draws(self) -> int:
        return len(self.rows)

    def act(self, networks: Networks, x: Tensor, draws: Tensor) -> Decision:
        steps = self.options.attack_steps
        seen = mad(networks.actor_layout, networks.actor, x, self.rows, draws[:, None], steps)
        return Decision(forward(networks.actor_layout, networks.actor, seen)[:, 0])
