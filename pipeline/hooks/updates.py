"""The updates of a portion, and those that a run which was stopped between them still owes."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import tensordict
from tensordict import TensorDict, TensorDictBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.data.mixture import Mixture
from pipeline.machine.interruption import StopRequest


class UpdatesHook(TrainerHookBase):
    """Draws a batch for each update; on a request to stop, no more of them in this portion.

    The rest is made when the run goes on, on the batches that were drawn for it: the run is that
    which was not stopped, bit for bit. Their average in the logs is over the updates before the
    stop.

    Args:
        mixture: Draws.
        sample: As ``mixture``, timed for instance.
        stop: The request.
    """

    def __init__(
        self,
        mixture: Mixture,
        sample: Callable[[TensorDictBase], TensorDictBase],
        stop: StopRequest,
    ) -> None:
        self.mixture = mixture
        self.sample = sample
        self.stop = stop
        self.owed = 0
        self._made = 0
        self._trainer: Trainer | None = None

    def begin(self) -> None:
        """Trainer hook ``pre_optim_steps``."""
        self._made = 0

    def __call__(self, collected: TensorDictBase) -> TensorDictBase:
        """Trainer hook ``process_optim_batch``: the batch of the next update.

        Raises:
            StopIteration: By which the trainer ends the portion's updates.
        """
        # The trainer logs an average of at least one.
        if self.stop.made and self._made and self._trainer is not None:
            self.owed = self._trainer.optim_steps_per_batch - self._made
            self._trainer._optim_count -= 1  # this one is counted already
            raise StopIteration
        self._made += 1
        return self.sample(collected)

    def catch_up(self) -> None:
        """Trainer hook ``setup``: makes the updates that are owed.

        Raises:
            Interrupted: If they are cut short again; what is still owed then is saved.
        """
        if not self.owed or self._trainer is None:
            return
        usual, self._trainer.optim_steps_per_batch = self._trainer.optim_steps_per_batch, self.owed
        self.owed = 0
        self._trainer.optim_steps(self.mixture.collected)
        self._trainer.optim_steps_per_batch = usual
        if self.owed:
            self._trainer.optimization_stepper.settle()
            self._trainer.save_trainer(force_save=True)
            self.stop.leave()

    def register(self, trainer: Trainer, name: str = "updates") -> None:
        """Registers at ``setup``, ``pre_optim_steps`` and ``process_optim_batch``."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_op("setup", self.catch_up)
        trainer.register_op("pre_optim_steps", self.begin)
        trainer.register_op("process_optim_batch", self)

    def state_dict(self) -> dict[str, Any]:
        """How many are owed, and the batches that are drawn for them already."""
        drawn = self.mixture.drawn if self.owed else []
        return {"owed": self.owed, "drawn": tensordict.stack(drawn).to_dict() if drawn else {}}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.owed = state["owed"]
        drawn = state["drawn"]
        batches = TensorDict(drawn, batch_size=drawn["action"].shape[:2]).unbind(0) if drawn else ()
        self.mixture.go_on(list(batches), TensorDict({}, [0]))
