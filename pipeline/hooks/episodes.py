"""Statistics of training episodes, and the admission of good ones (SID)."""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

import numpy as np
import torch
from tensordict import TensorDictBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.data.episodes import EpisodeAssembler, FinishedEpisode

WINDOW = 20  # episodes in the running averages


class EpisodeHook(TrainerHookBase):
    """Follows the training episodes: logs return and success and offers each to the consumers.

    Args:
        consumers: Called with every finished episode and the number of collected frames, one after
            the other: SID's admission, backtracking.
        resumes_midway: Whether a resumed run continues the episodes that were open; if it starts
            fresh ones, their beginnings are not saved.
        device: Of the collected batches.
    """

    def __init__(
        self,
        *consumers: Callable[[FinishedEpisode, int], None],
        resumes_midway: bool = True,
        device: torch.device | str | None = None,
    ) -> None:
        self.assembler = EpisodeAssembler(device)
        self.resumes_midway = resumes_midway
        self.consumers = consumers
        self.returns: deque[float] = deque(maxlen=WINDOW)
        self.successes: deque[float] = deque(maxlen=WINDOW)
        self._trainer: Trainer | None = None

    def __call__(self, batch: TensorDictBase) -> TensorDictBase:
        """Takes ``batch`` [N, T] and hands it on unchanged."""
        frames = 0 if self._trainer is None else self._trainer.collected_frames + batch.numel()
        for episode in self.assembler(batch):
            self.returns.append(episode.episode_return)
            if episode.success is not None:
                self.successes.append(float(episode.success))
            for consumer in self.consumers:
                consumer(episode, frames)
        return batch

    def averages(self) -> dict[str, float]:
        """Means over the last ``WINDOW`` episodes; nothing before the first has ended."""
        found = {"train_return": self.returns, "train_success": self.successes}
        return {key: float(np.mean(values)) for key, values in found.items() if values}

    def log(self, _batch: TensorDictBase) -> dict[str, Any] | None:
        """The averages for the logger and the progress bar."""
        averages = self.averages()
        return {**averages, "log_pbar": True} if averages else None

    def register(self, trainer: Trainer, name: str = "episodes") -> None:
        """Registers at ``batch_process`` and ``pre_steps_log``."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_op("batch_process", self)
        trainer.register_op("pre_steps_log", self.log)

    def state_dict(self) -> dict[str, Any]:
        """Unfinished episodes and the running windows."""
        return {
            "assembler": self.assembler.state_dict() if self.resumes_midway else {},
            "returns": list(self.returns),
            "successes": list(self.successes),
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.assembler.load_state_dict(state["assembler"])
        self.returns = deque(state["returns"], maxlen=WINDOW)
        self.successes = deque(state["successes"], maxlen=WINDOW)
