"""Evaluation while training."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.evaluation import Evaluator, as_scalars


class EvaluationHook(TrainerHookBase):
    """Evaluates the policy every ``interval`` frames, logs it and appends it to a JSON-lines file.

    Args:
        evaluator: What to run.
        policy: The actor being trained.
        interval: Frames between evaluations; 0 for none.
        path: ``learning_curve.jsonl`` of the run.
    """

    def __init__(
        self, evaluator: Evaluator, policy: TensorDictModuleBase, interval: int, path: Path
    ) -> None:
        self.evaluator = evaluator
        self.policy = policy
        self.interval = interval
        self.path = path
        self.next_frame = 0
        self.last_frame = -1
        self._trainer: Trainer | None = None

    def __call__(self, _batch: TensorDictBase | None = None) -> dict[str, Any] | None:
        """Evaluates when it is time; returns scalars for the logger."""
        frames = self._trainer.collected_frames if self._trainer is not None else 0
        if self.interval == 0 or frames < self.next_frame:
            return None
        while self.next_frame <= frames:
            self.next_frame += self.interval
        return self.evaluate(frames)

    def evaluate(self, frames: int) -> dict[str, Any]:
        """Evaluates now."""
        self.last_frame = frames
        metrics = as_scalars(self.evaluator.run(self.policy).metrics())
        with self.path.open("a") as file:
            file.write(json.dumps({"frames": frames, **metrics}) + "\n")
        scalars = {f"eval/{k}": v for k, v in metrics.items() if isinstance(v, (int, float))}
        return {**scalars, "log_pbar": False}

    def finish(self) -> None:
        """Evaluates the last policy too, wherever the run ends between two evaluations."""
        if self._trainer is None or self.interval == 0:
            return
        if self._trainer.collected_frames != self.last_frame:
            self.evaluate(self._trainer.collected_frames)

    def register(self, trainer: Trainer, name: str = "evaluation") -> None:
        """Registers at ``post_steps_log`` and ``shutdown``."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_op("post_steps_log", self)
        trainer.register_op("shutdown", self.finish)

    def state_dict(self) -> dict[str, Any]:
        """When the next evaluation is due and when the last one was."""
        return {"next_frame": self.next_frame, "last_frame": self.last_frame}

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.next_frame = state["next_frame"]
        self.last_frame = state["last_frame"]
