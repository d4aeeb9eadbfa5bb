"""Stores collected experience."""

from __future__ import annotations

from typing import Any

import torch
from tensordict import TensorDictBase
from torchrl.data import TensorDictReplayBuffer
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.data.portions import PortionRows
from pipeline.data.rows import TransitionRows


class StoreHook(TrainerHookBase):
    """Writes every collected frame, the random ones included, to the main buffer.

    It runs at ``batch_process``: TorchRL's own storing hooks run at ``pre_epoch``, which is skipped
    until ``init_random_frames`` are collected, so the seed steps of the paper would be lost.
    With n-step rows, a frame is stored once its n steps are collected or its episode has ended.

    Args:
        buffer: The main replay buffer.
        to_rows: How trajectories become rows.
        resumes_midway: Whether a resumed run continues the episodes that were open; if it starts
            fresh ones, the rows that wait for their next steps are not saved.
        device: Of the collected batches.
    """

    def __init__(
        self,
        buffer: TensorDictReplayBuffer,
        to_rows: TransitionRows,
        *,
        resumes_midway: bool = True,
        device: torch.device | str | None = None,
    ) -> None:
        self.buffer = buffer
        self.to_rows = PortionRows(to_rows, device)
        self.resumes_midway = resumes_midway

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Stores ``batch`` [N, T] and hands it on unchanged."""
        self.store(batch)
        return batch

    def store(self, batch: TensorDictBase) -> None:
        """Stores the rows that are known with ``batch`` [N, T]."""
        rows = self.to_rows(batch)
        if rows.shape[0] > 0:
            self.buffer.extend(rows)

    def register(self, trainer: Trainer, name: str = "store") -> None:
        """Registers at ``batch_process``; the buffer is checkpointed as ``main_buffer``."""
        trainer.register_module(name, self)
        trainer.register_module("main_buffer", self.buffer)
        trainer.register_op("batch_process", self)

    def state_dict(self) -> dict[str, Any]:
        """The steps whose rows are not known yet; the buffer is a component of its own."""
        return self.to_rows.state_dict() if self.resumes_midway else {}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.to_rows.load_state_dict(state)
