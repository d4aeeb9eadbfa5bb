"""One step of behaviour cloning."""

from __future__ import annotations

from functools import partial
from typing import Any

from pydantic.dataclasses import dataclass as settings
from tensordict import TensorDict, TensorDictBase
from torch import Tensor
from torchrl.trainers import OptimizationStepper, Trainer

from losses import Objective
from pipeline.learn.gradients import ImitationGradients, hand_over
from pipeline.learn.optimizers import AdamStep, load_adam, make_adam, make_annealing, set_recordable
from pipeline.learn.update_guard import HEALTH, GuardedUpdate, Network, UpdateGuard
from pipeline.machine.compilation import compiled
from pipeline.machine.cuda_graphs import recorded
from pipeline.settings import STRICT, Count, Rate


@settings(frozen=True, kw_only=True, config=STRICT)
class CloningSettings:
    """Offline behaviour cloning: one recipe for the `bc` row, the ILD demonstrator, pretraining."""

    updates: Count = 100_000  # made in whole hundreds: rounded up
    lr: Rate = 1e-5
    anneal: bool = False  # cosine from lr to 0 over the updates
    batch_size: Count = 1024


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
        loss: Objective,
        *,
        actor_lr: float,
        anneal_updates: int | None = None,
        cuda_graphs: bool = False,
        compile_updates: bool = False,
    ) -> None:
        self.gradients = ImitationGradients(loss)
        self.updates = 0
        parameters = dict(loss.actor.named_parameters())
        self.guard = UpdateGuard([Network("actor", parameters, {"bc": "loss_bc"}, "bc.lr")])
        self.optimizer = make_adam([(loss.actor.parameters(), actor_lr)])
        self.annealing = make_annealing(self.optimizer, anneal_updates)
        self._prepare = partial(set_recordable, recorded=cuda_graphs, compiled=compile_updates)
        self._prepare(self.optimizer)
        self._adam = AdamStep(self.optimizer)
        learn = compiled(self._learn, self._adam.state, compile_updates)
        self._record = partial(recorded, learn, cuda_graphs)
        self._update = self._record()

    def step(self, _trainer: Trainer | None, sub_batch: TensorDictBase) -> TensorDictBase:
        """Updates on one batch of demonstration rows; returns ``loss_bc``.

        Raises:
            NonFiniteError: If it or a parameter is not finite; see ``UpdateGuard``.
        """
        found = self._update(sub_batch)
        self.updates += 1
        self.guard.watch(GuardedUpdate(self.updates, found.pop(HEALTH), sub_batch, found))
        self.annealing.step()
        return TensorDict(found, device=sub_batch.device)

    def settle(self) -> None:
        """Waits until all updates so far are known to be finite.

        Raises:
            NonFiniteError: If one was not.
        """
        self.guard.settle()

    def _learn(self, batch: TensorDictBase) -> dict[str, Tensor]:
        found, gradients = self.gradients.actor(batch)
        hand_over(self.gradients.actor_parameters, gradients)
        self._adam()
        return found | {HEALTH: self.guard.health(found, self.gradients.actor_parameters)}

    def state_dict(self) -> dict[str, Any]:
        """Optimizer moments and the number of updates."""
        return {
            "updates": self.updates,
            "optimizer": self.optimizer.state_dict(),
            "annealing": self.annealing.state_dict(),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave, except for the rate: that stays its own."""
        self.updates = state.get("updates", 0)  # of checkpoints from before they were counted
        load_adam(self.optimizer, state["optimizer"], self.annealing, state["annealing"])
        self._prepare(self.optimizer)
        self._update = self._record()  # the old one's is on the memory of what was before
