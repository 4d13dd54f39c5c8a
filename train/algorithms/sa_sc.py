"""SA-SC: set actor, set critic (Alg. 1, Prop. 3.1 and Def. 3.2 of the paper).

It executes the center of the action's enclosure and stores the noisy, clipped center with the enclosure's generators,
so that exploration reaches the critic's input.
"""

from __future__ import annotations

from dataclasses import dataclass

from ..losses import Networks, Penalty, critic_columns, set_actor, set_critic
from ..networks import Tensor
from ..replay import Transitions
from ..set_propagation import enclose, merged, merged_count
from .algorithm import Decision, joint
from .sa_pc import SetActorAlgorithm


@dataclass(frozen=True)
class SetCriticAlgorithm(SetActorAlgorithm):
    """Acts with c_A; both losses are set losses, omega weighs the two volumes of the actor's."""

    def columns(self, networks: Networks) -> int:
        return merged_count(networks.actor_layout, len(self.rows))

    def act(self, networks: Networks, x: Tensor, draws: Tensor) -> Decision:
        found = enclose(networks.actor_layout, networks.actor, x, self.rows)
        return Decision(found.center[:, 0], merged(found)[:, :, 0])

    def critic(self, networks: Networks, batch: Transitions, y: Tensor, gradient: Tensor) -> Tensor:
        options = self.options
        penalty = Penalty(options.critic_weight / self.epsilon, options.floor, options.gradients == "exact")
        columns = critic_columns(self.rows, batch.columns.transpose(1, 2))
        return set_critic(networks, joint(batch), columns, y, penalty, gradient)

    def actor(self, networks: Networks, batch: Transitions, gradient: Tensor) -> Tensor:
        return set_actor(networks, batch.observation, self.rows, self.penalty, self.options.omega, gradient)
