"""Evaluation while training."""

from __future__ import annotations

import logging
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import Any

from tensordict import TensorDictBase
from tensordict.nn import TensorDictModuleBase
from torchrl.trainers import Trainer, TrainerHookBase

from pipeline.act.evaluation import Evaluator
from pipeline.files.curves import FRAMES, WALL_S, read_lines
from pipeline.files.run_files import ALARMS, as_json
from pipeline.machine.interruption import Interrupted, StopRequest
from pipeline.watch.alarm import unlearning
from pipeline.watch.phases import evaluated

_logger = logging.getLogger(__name__)
Keep = Callable[[int, Mapping[str, Any], Sequence[Mapping[str, Any]]], None]


class EvaluationHook(TrainerHookBase):
    """Evaluates the policy every ``interval`` frames, logs it and appends it to a JSON-lines file.

    Args:
        evaluator: What to run.
        policy: The actor being trained.
        interval: Frames between evaluations; 0 for none.
        path: ``learning_curve.jsonl`` of the run.
        diagnostics: What else to measure at each evaluation, by name.
        stop: On which the evaluation that is due is left for when the run goes on.
        unit: What the trainer counts, for the line that each evaluation is told in.
        keep: Is given the frames and figures of each evaluation and all rows before it, and keeps
            the weights that are worth it; None for nothing.

    A policy that unlearns raises an alarm: a warning, and a line in ``alarms.jsonl`` beside the
    curve (see ``pipeline/watch/alarm.py``).
    """

    def __init__(
        self,
        evaluator: Evaluator,
        policy: TensorDictModuleBase,
        interval: int,
        path: Path,
        diagnostics: Sequence[Callable[[], Mapping[str, float]]] = (),
        stop: StopRequest | None = None,
        unit: str = "frames",
        keep: Keep | None = None,
    ) -> None:
        self.unit = unit
        self.keep = keep
        self.stop = StopRequest() if stop is None else stop
        self.evaluator = evaluator
        self.policy = policy
        self.interval = interval
        self.path = path
        self.diagnostics = tuple(diagnostics)
        self.next_frame = 0
        self.last_frame = -1
        self.metrics: Mapping[str, Any] = {}
        self._trainer: Trainer | None = None

    def __call__(self, _batch: TensorDictBase | None = None) -> dict[str, Any] | None:
        """Evaluates when it is time; returns scalars for the logger."""
        if self.stop.made:
            return None
        try:
            return self._due()
        except Interrupted:
            if self._trainer is not None:
                self._trainer.request_stop()
            return None

    def _due(self) -> dict[str, Any] | None:
        frames = self._trainer.collected_frames if self._trainer is not None else 0
        if self.interval == 0 or frames < self.next_frame:
            return None
        found = self.evaluate(frames)
        while self.next_frame <= frames:
            self.next_frame += self.interval
        return found

    def begin(self) -> Mapping[str, Any]:
        """Evaluates what training begins with, in the row of 0 frames; returns its metrics."""
        self.evaluate(0)
        self.next_frame = self.interval
        return self.metrics

    def evaluate(self, frames: int) -> dict[str, Any]:
        """Evaluates now; the figures are kept in ``metrics`` until the next evaluation."""
        with self.stop.at_once():
            self.metrics = metrics = self.evaluator.metrics(self.evaluator.run(self.policy))
        self.last_frame = frames
        if self.keep is not None:  # before the row, which says that it was done
            self.keep(frames, metrics, read_lines(self.path))
        measured = {k: v for diagnostic in self.diagnostics for k, v in diagnostic().items()}
        _append(self.path, {"frames": frames, **metrics, **measured})
        self._tell(frames, measured.get(WALL_S))
        self._watch()
        scalars = {f"eval/{k}": v for k, v in metrics.items() if isinstance(v, (int, float))}
        scalars |= {f"diagnostics/{k}": v for k, v in measured.items()}
        return {**scalars, "log_pbar": False}

    def _tell(self, frames: int, seconds: float | None) -> None:
        total = frames if self._trainer is None else self._trainer.total_frames
        _logger.info("%s", evaluated(frames, total, self.unit, seconds, self.metrics))

    def _watch(self) -> None:
        """Raises the alarm if the last row of the curve is the first of a fall."""
        alarm = unlearning(read_lines(self.path))
        if alarm is not None:
            _logger.warning("%s", alarm)
            _append(self.path.with_name(ALARMS), asdict(alarm))

    def catch_up(self) -> None:
        """Makes the evaluation that a run which was stopped at its checkpoint still owes.

        Raises:
            Interrupted: If it is stopped again; it is owed as before.
        """
        frames = 0 if self._trainer is None else self._trainer.collected_frames
        if self._trainer is not None and frames > 0 and not self._written(frames):
            found = self._due()
            if found is not None:
                self._trainer._log(**found)

    def finish(self) -> None:
        """Evaluates the last policy too, wherever the run ends between two evaluations."""
        try:
            if self._trainer is None or self.interval == 0 or self.stop.made:
                return
            frames = self._trainer.collected_frames
            # The row of a complete run's end is written after its checkpoint, if it got that far.
            if frames != self.last_frame and not self._written(frames):
                self.evaluate(frames)
        finally:
            self.evaluator.close()

    def _written(self, frames: int) -> bool:
        return frames in {row[FRAMES] for row in read_lines(self.path)}

    def register(self, trainer: Trainer, name: str = "evaluation") -> None:
        """Registers at ``setup``, ``post_steps_log`` and ``shutdown``."""
        self._trainer = trainer
        trainer.register_module(name, self)
        trainer.register_op("setup", self.catch_up)
        trainer.register_op("post_steps_log", self)
        trainer.register_op("shutdown", self.finish)

    def state_dict(self) -> dict[str, Any]:
        """When the next evaluation is due and when the last one was."""
        return {
            "interval": self.interval,
            "next_frame": self.next_frame,
            "last_frame": self.last_frame,
        }

    def load_state_dict(self, state: dict[str, Any]) -> None:
        """Restores what :meth:`state_dict` gave."""
        self.next_frame = state["next_frame"]
        self.last_frame = state["last_frame"]
        if self.interval and state.get("interval", self.interval) != self.interval:
            # The first that is due in the new interval, as if it had always been this one.
            self.next_frame = (self.last_frame // self.interval + 1) * self.interval


def _append(path: Path, row: Mapping[str, Any]) -> None:
    with path.open("a") as file:
        file.write(as_json(row) + "\n")
