"""The progress bar of a run that may have begun before, or clones."""

from __future__ import annotations

from torchrl.trainers import Trainer, TrainerHookBase


class ProgressHook(TrainerHookBase):
    """Says what TorchRL's bar counts, begins where a resumed run does, and ends with the training.

    The trainer makes its bar anew, at 0 and without a unit, and leaves it open.

    Args:
        unit: Of what is counted.
    """

    def __init__(self, unit: str) -> None:
        self.unit = unit

    def register(self, trainer: Trainer, name: str = "progress") -> None:
        """Has ``trainer`` call it at both ends of its training, if it shows a bar."""
        if not trainer.progress_bar:
            return

        def begin() -> None:
            bar = trainer._pbar
            bar.unit = f" {self.unit}"
            # The rate is that of what comes from here on.
            bar.initial = bar.n = trainer.collected_frames
            bar.refresh()

        trainer.register_op("setup", begin)
        trainer.register_op("shutdown", lambda: trainer._pbar.close())
