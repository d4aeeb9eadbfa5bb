"""An average of the actor's recent weights, which is the policy that counts."""

from __future__ import annotations

from copy import deepcopy

import torch
from torch import nn
from torch.optim.swa_utils import get_ema_multi_avg_fn
from torchrl.trainers import Trainer, TrainerHookBase


class ActorAverageHook(TrainerHookBase):
    """Keeps an exponential moving average of an actor's weights.

    The closed-loop success of the weights themselves jumps from update to update, that of their
    average hardly does.  Experience is still collected with the weights themselves.

    Deviation: the paper evaluates the last weights; ``optim.actor_average=null`` does.

    Args:
        actor: Being trained.
        decay: Share of the average that one update keeps, in (0, 1).

    Raises:
        ValueError: If ``decay`` is out of range.
    """

    def __init__(self, actor: nn.Module, decay: float) -> None:
        if not 0.0 < decay < 1.0:
            raise ValueError(f"optim.actor_average must be in (0, 1) or null, got {decay}.")
        self.actor = actor
        self.average = deepcopy(actor).requires_grad_(False)
        # AveragedModel's own function without its shell, which reads a counter back each time.
        self._average = get_ema_multi_avg_fn(decay)

    @torch.no_grad()
    def __call__(self) -> None:
        """Moves the average towards the weights of now."""
        self._average(list(self.average.parameters()), list(self.actor.parameters()), None)

    def register(self, trainer: Trainer, name: str = "actor_average") -> None:
        """Registers at ``post_optim``; the average itself is checkpointed as the policy."""
        trainer.register_op("post_optim", self)
