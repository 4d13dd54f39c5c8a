"""SA-PC: set actor, point critic (Def. 3.3 of the paper).

It executes mu(s); its policy gradient is taken at the center of the action's enclosure, and the volume of that
enclosure is penalised.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..losses import Networks, Penalty, set_actor
from ..networks import Tensor
from ..replay import Transitions
from .pa_pc import PointAlgorithm


@dataclass(frozen=True)
class SetActorAlgorithm(PointAlgorithm):
    """Acts with mu(s); point critic; the actor descends ``-Q(s, c_A) + (eta_mu/eps) sum lnDia(G_A)``."""

    @property
    def penalty(self) -> Penalty:
        """Of the action's volume."""
        options = self.options
        return Penalty(options.actor_weight / self.epsilon, options.floor, options.gradients == "exact")

    def actor(self, networks: Networks, batch: Transitions, gradient: Tensor) -> Tensor:
        return set_actor(networks, batch.observation, self.rows, self.penalty, 1.0, gradient)
