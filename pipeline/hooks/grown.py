"""Keeps the grown demonstrations in the checkpoint and their size in the log."""

from __future__ import annotations

from typing import Any

import numpy as np
from tensordict import TensorDictBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.data.admission import MovingBound
from pipeline.data.buffers import GrownDemonstrations


class GrownHook(TrainerHookBase):
    """Logs how many episodes have joined D and how good and old they are.

    Args:
        grown: The grown part of D.
        bound: The moving bound of its admission, kept in the checkpoint too.
    """

    def __init__(self, grown: GrownDemonstrations, bound: MovingBound | None = None) -> None:
        self.grown = grown
        self.bound = bound
        self._trainer: Trainer | None = None

    def __call__(self, _batch: TensorDictBase) -> dict[str, Any] | None:
        """Number, mean return and mean age (frames) of the grown episodes."""
        records = self.grown.records
        if not records or self._trainer is None:
            return None
        return {
            "grown/episodes": len(records),
            "grown/return_mean": float(np.mean([r.episode_return for r in records])),
            "grown/age_frames": float(
                np.mean([self._trainer.collected_frames - r.frame for r in records])
            ),
        }

    def register(self, trainer: Trainer, name: str = "grown") -> None:
        """Registers at ``pre_steps_log``; rows are checkpointed as ``grown_buffer``."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_module("grown_buffer", self.grown.buffer)
        if self.bound is not None:
            trainer.register_module("moving_bound", self.bound)
        trainer.register_op("pre_steps_log", self)

    def state_dict(self) -> dict[str, Any]:
        """Provenance of the grown episodes."""
        return self.grown.state_dict()

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.grown.load_state_dict(state)
