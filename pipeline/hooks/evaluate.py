"""Evaluation while training."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.alarm import unlearning
from pipeline.evaluation import Evaluator, as_scalars
from pipeline.run_dir import ALARMS

_logger = logging.getLogger(__name__)


class EvaluationHook(TrainerHookBase):
    """Evaluates the policy every ``interval`` frames, logs it and appends it to a JSON-lines file.

    Args:
        evaluator: What to run.
        policy: The actor being trained.
        interval: Frames between evaluations; 0 for none.
        path: ``learning_curve.jsonl`` of the run.
        diagnostics: What else to measure at each evaluation, by name.

    A policy that unlearns raises an alarm: a warning, and a line in ``alarms.jsonl`` beside the
    curve (see ``pipeline/alarm.py``).
    """

    def __init__(
        self,
        evaluator: Evaluator,
        policy: TensorDictModuleBase,
        interval: int,
        path: Path,
        diagnostics: Sequence[Callable[[], Mapping[str, float]]] = (),
    ) -> None:
        self.evaluator = evaluator
        self.policy = policy
        self.interval = interval
        self.path = path
        self.diagnostics = tuple(diagnostics)
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
        measured = {k: v for diagnostic in self.diagnostics for k, v in diagnostic().items()}
        _append(self.path, {"frames": frames, **metrics, **measured})
        self._watch()
        scalars = {f"eval/{k}": v for k, v in metrics.items() if isinstance(v, (int, float))}
        scalars |= {f"diagnostics/{k}": v for k, v in measured.items()}
        return {**scalars, "log_pbar": False}

    def _watch(self) -> None:
        """Raises the alarm if the last row of the curve is the first of a fall."""
        alarm = unlearning([json.loads(line) for line in self.path.read_text().splitlines()])
        if alarm is not None:
            _logger.warning("%s", alarm)
            _append(self.path.with_name(ALARMS), asdict(alarm))

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


def _append(path: Path, row: Mapping[str, Any]) -> None:
    with path.open("a") as file:
        file.write(json.dumps(row) + "\n")
