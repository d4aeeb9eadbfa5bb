"""DA-SAC's extra updates on the demonstration buffer (paper, Algorithm 1)."""

from __future__ import annotations

from typing import Any

from torchrl.trainers import OptimizationStepper, Trainer, TrainerHookBase

from pipeline.data.mixture import Mixture


class DemoUpdateHook(TrainerHookBase):
    """After every ``period``-th update, one more update on a batch drawn from R_d alone.

    Lines 15-18 of Algorithm 1: ``if t mod f = 0: d ~ R_d; sac.update(d)``.

    Args:
        stepper: The stepper of the ordinary updates.
        demos: Mixture that draws demonstration rows only.
        period: f of the algorithm; the paper's 0.5 Hz is 2.

    Raises:
        ValueError: If ``period`` is below 1.
    """

    def __init__(self, stepper: OptimizationStepper, demos: Mixture, period: int) -> None:
        if period < 1:
            raise ValueError(f"sampler.demo_update_period must be at least 1 here, got {period}.")
        self.stepper = stepper
        self.demos = demos
        self.period = period
        self.updates = 0
        self._trainer: Trainer | None = None

    def __call__(self) -> None:
        """Counts one ordinary update and follows it up when it is the turn of R_d."""
        self.updates += 1
        if self.updates % self.period == 0:
            batch = self.demos.sample()
            # In this update the demonstrations *are* the replay buffer: the RL terms see them.
            self.stepper.step(self._trainer, batch.exclude("is_demo"))

    def register(self, trainer: Trainer, name: str = "demo_update") -> None:
        """Registers at ``post_optim``, which runs after each update."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_op("post_optim", self)

    def state_dict(self) -> dict[str, Any]:
        """The count of ordinary updates."""
        return {"updates": self.updates}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.updates = state["updates"]
