"""PA-PC: point actor, point critic; DDPG [1]_ or TD3 [2]_ as they are.

References
----------
.. [1] Lillicrap et al., "Continuous control with deep reinforcement learning", ICLR 2016.
.. [2] Fujimoto et al., "Addressing function approximation error in actor-critic methods", ICML 2018.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..losses import Networks, point_actor, point_critic
from ..networks import Tensor
from ..replay import Transitions
from .algorithm import Algorithm, joint


@dataclass(frozen=True)
class PointAlgorithm(Algorithm):
    """Acts with mu(s); both losses are point losses on the clean observation."""

    def critic(self, networks: Networks, batch: Transitions, y: Tensor, gradient: Tensor) -> Tensor:
        return point_critic(networks, joint(batch), y, gradient)

    def actor(self, networks: Networks, batch: Transitions, gradient: Tensor) -> Tensor:
        return point_actor(networks, batch.observation, gradient)
