"""Stores collected experience."""

from __future__ import annotations

from typing import Any

from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.rows import TransitionRows


class StoreHook(TrainerHookBase):
    """Writes every collected frame, the random ones included, to the main buffer.

    It runs at ``batch_process``: TorchRL's own storing hooks run at ``pre_epoch``, which is skipped
    until ``init_random_frames`` are collected, so the seed steps of the paper would be lost.

    Args:
        buffer: The main replay buffer.
        to_rows: How trajectories become rows.
    """

    def __init__(self, buffer: TensorDictReplayBuffer, to_rows: TransitionRows) -> None:
        self.buffer = buffer
        self.to_rows = to_rows

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Stores ``batch`` [N, T] and hands it on unchanged."""
        self.store(batch)
        return batch

    def store(self, batch: TensorDictBase) -> None:
        """Stores the rows of ``batch`` [N, T]."""
        self.buffer.extend(self.to_rows(batch))

    def register(self, trainer: Trainer, name: str = "store") -> None:
        """Registers at ``batch_process``; the buffer is checkpointed as ``main_buffer``."""
        trainer.register_module("main_buffer", self.buffer)
        trainer.register_op("batch_process", self)

    def state_dict(self) -> dict[str, Any]:
        """The hook itself is stateless; the buffer is a component of its own."""
        return {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Nothing to restore."""
