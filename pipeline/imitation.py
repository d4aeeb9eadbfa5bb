"""One step of behaviour cloning."""

from __future__ import annotations

from functools import partial
from typing import Any

from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.trainers import OptimizationStepper, Trainer

from losses import BCSACLoss
from pipeline.compilation import compiled
from pipeline.cuda_graphs import recorded
from pipeline.gradients import ImitationGradients, hand_over
from pipeline.optimizers import AdamStep, make_adam, make_annealing, set_recordable


class ImitationStepper(OptimizationStepper):
    """One step of behaviour cloning (paper III-B): maximise E_D[log pi(a | s)].

    Args:
        loss: Only its imitation term and actor are used.
        actor_lr: Adam's rate.
        anneal_updates: Updates over which a cosine takes the rate to zero; None keeps it constant.
            The closed-loop success of a constant rate wanders from checkpoint to checkpoint while
            the loss hardly moves; an annealed run ends where the wandering has died down.
        cuda_graphs: Whether to replay updates as CUDA graphs; networks and batches are on a GPU
            then.
        compile_updates: Whether to compile the updates.
    """

    def __init__(
        self,
        loss: BCSACLoss,
        *,
        actor_lr: float,
        anneal_updates: int | None = None,
        cuda_graphs: bool = False,
        compile_updates: bool = False,
    ) -> None:
        self.gradients = ImitationGradients(loss)
        self.optimizer = make_adam([(loss.actor.parameters(), actor_lr)])
        self.annealing = make_annealing(self.optimizer, anneal_updates)
        self._prepare = partial(set_recordable, recorded=cuda_graphs, compiled=compile_updates)
        self._prepare(self.optimizer)
        self._adam = AdamStep(self.optimizer)
        learn = compiled(self._learn, self._adam.state, compile_updates)
        self._update = recorded(learn, cuda_graphs)

    def step(self, _trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates on one batch of demonstration rows; returns ``loss_bc``."""
        found = self._update(sub_batch)
        self.annealing.step()
        return TensorDict(found, device=sub_batch.device)

    def _learn(self, batch: TensorDictBase) -> dict[str, Tensor]:
        found, gradients = self.gradients.actor(batch)
        hand_over(self.gradients.actor_parameters, gradients)
        self._adam()
        return found

    def state_dict(self) -> dict[str, Any]:
        """Optimizer moments."""
        return {
            "optimizer": self.optimizer.state_dict(),
            "annealing": self.annealing.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.optimizer.load_state_dict(state["optimizer"])
        self._prepare(self.optimizer)
        self.annealing.load_state_dict(state["annealing"])
