"""What an algorithm is: how it acts and which losses its networks descend. The loop around it is `train.trainer`."""

from __future__ import annotations

from abc import ABC, abstractmethod
from dataclasses import dataclass

import torch

from ..losses import Networks
from ..networks import Tensor, forward
from ..options import TrainingOptions
from ..replay import Transitions


@dataclass(frozen=True)
class Decision:
    """What is executed before exploration: `action` (S, m), and `columns` (S, q, m) where it is a set."""

    action: Tensor
    columns: Tensor | None = None


@dataclass(frozen=True)
class Algorithm(ABC):
    """An algorithm under given options.

    Attributes
    ----------
    options : TrainingOptions
    epsilon : float
        Perturbation radius of the training.
    rows : Tensor, shape (q, n)
        Generators of the set of perturbed network inputs at that radius.
    """

    options: TrainingOptions
    epsilon: float
    rows: Tensor

    @property
    def draws(self) -> int:
        """Uniform numbers per seed and environment step that `act` needs."""
        return 0

    def columns(self, networks: Networks) -> int:
        """Generators of an action's set that are stored with a transition."""
        return 0

    def act(self, networks: Networks, x: Tensor, draws: Tensor) -> Decision:
        """Decide at observations (S, 1, n), with uniform `draws` (S, self.draws)."""
        return Decision(forward(networks.actor_layout, networks.actor, x)[:, 0])

    @abstractmethod
    def critic(self, networks: Networks, batch: Transitions, y: Tensor, gradient: Tensor) -> Tensor:
        """Gradient of the critic's loss, into `gradient`; the loss per critic."""

    @abstractmethod
    def actor(self, networks: Networks, batch: Transitions, gradient: Tensor) -> Tensor:
        """Gradient of the actor's loss, into `gradient`; the loss per seed."""


def joint(batch: Transitions) -> Tensor:
    """Observation and action, the critic's input (S, B, n + m)."""
    return torch.cat([batch.observation, batch.action], -1)
