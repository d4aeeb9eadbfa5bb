"""TorchRL's trainer as this project sets it up, and the run around it."""

from __future__ import annotations

import random
from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from contextlib import nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import torch
from filelock import FileLock
from tensordict.nn import TensorDictModuleBase
from torchrl.checkpoint import Checkpoint
from torchrl.trainers import Trainer
from tqdm.contrib.logging import logging_redirect_tqdm

from envs import Task
from pipeline.best import BestWeights
from pipeline.files.background import BackgroundWork
from pipeline.files.curves import WALL_S
from pipeline.files.rotation import make_rotation
from pipeline.files.run_files import LEARNING_CURVE
from pipeline.files.time_use import OTHER, TimeUse
from pipeline.hooks import EvaluationHook, PortionGuard, ProgressHook, UpdatesHook
from pipeline.machine.disk import with_room
from pipeline.machine.interruption import StopRequest
from pipeline.non_finite import NonFiniteError
from pipeline.playing import make_evaluator
from pipeline.recipe import Recipe
from pipeline.watch.loggers import make_loggers

CHECKPOINT = "checkpoint"
"""Part of the time: writing checkpoints, and waiting for them."""


@dataclass(frozen=True)
class Run:
    """A composed run."""

    recipe: Recipe
    run_dir: Path
    trainer: Trainer
    actor: TensorDictModuleBase
    time_use: TimeUse
    evaluation: EvaluationHook
    updates: UpdatesHook
    stop: StopRequest
    """Ends the training after the present update, with a checkpoint."""
    lock: FileLock | None = None
    """Of ``run_dir``; free again when the run has been trained."""
    begin: Callable[[], object] | None = None
    """What a new run does before its first frame; one that is resumed has done it."""

    @property
    def sealing(self) -> BackgroundWork:
        """Of the checkpoint that was written last."""
        return self.trainer.checkpoint_rotation.sealing

    def train(self) -> None:
        """Trains to the end; the newest checkpoint and the learning curve are in ``run_dir``.

        Raises:
            OSError: If a file cannot be written; a checkpoint that was named before stays.
            Interrupted: If it was asked to stop (``stop``) before its end; it can go on from there.
            NonFiniteError: If numbers are not finite; what they were found in is in ``run_dir``.
        """
        try:
            # The trainer looks at its total only after a batch: a complete run would grow by one.
            if self.trainer.collected_frames < self.trainer.total_frames:
                self._go_on()
            else:
                owed = self.updates.owed
                self.updates.catch_up()
                if owed:
                    self.trainer.save_trainer(force_save=True)
                self.evaluation.finish()
                self.sealing.settle()
        except NonFiniteError as error:
            raise error.kept(self.run_dir) from error
        finally:
            self.sealing.end()  # before another process may come
            if self.lock is not None:
                self.lock.release()

    def _go_on(self) -> None:
        try:
            with self.time_use.part(OTHER):
                if self.begin is not None and self.trainer.collected_frames == 0:
                    self.begin()
                # Lines stand above the bar, not in it.
                bar = logging_redirect_tqdm() if self.trainer.progress_bar else nullcontext()
                with bar:
                    self.trainer.train()
                with self.time_use.part(CHECKPOINT):
                    self.sealing.settle()
        finally:
            self.time_use.write(self.run_dir)
        self.stop.leave()


def make_trainer(
    recipe: Recipe,
    run_dir: Path,
    stop: StopRequest,
    checkpoint: Checkpoint,
    time_use: TimeUse,
    **parts: object,
) -> Trainer:
    """TorchRL's trainer with this project's checkpointing, logging and progress bar."""
    rotation = make_rotation(run_dir, recipe.logging.checkpoints)
    trainer = Trainer(
        frame_skip=1,
        logger=make_loggers(list(recipe.logging.loggers), run_dir, recipe.logging.project),
        progress_bar=recipe.logging.progress,
        log_interval=recipe.logging.interval,
        save_trainer_interval=recipe.logging.checkpoint_interval,
        checkpoint=checkpoint,
        checkpoint_rotation=rotation,
        **parts,
    )
    # TorchRL keeps every value it was given. Between them the freed activations of large networks
    # cannot be joined again: the process grew by 1.4 MB per update of the paper's size.
    trainer._log_dict = defaultdict(lambda: deque(maxlen=1))
    trainer.register_module("time_use", time_use)
    PortionGuard().register(trainer)
    ProgressHook(recipe.budget.unit).register(trainer)
    # Before an evaluation and a checkpoint; collecting waits for the updates in any case.
    trainer.register_op("post_steps", trainer.optimization_stepper.settle)
    trainer.register_op("post_steps", lambda: trainer.request_stop() if stop.made else None)
    trainer.register_op("post_steps", rotation.sealing.check)
    with_room(trainer, run_dir, rotation.sealing)
    time_use.watch(trainer.optimization_stepper, "step", "update")
    time_use.watch(trainer, "save_trainer", CHECKPOINT)
    if trainer.logger is not None:
        time_use.watch(trainer.logger, "log_scalar", "log")
    return trainer


def make_evaluation_hook(
    recipe: Recipe,
    task: Task,
    stop: StopRequest,
    actor: TensorDictModuleBase,
    run_dir: Path,
    time_use: TimeUse,
    *diagnostics: Callable[[], Mapping[str, float]],
) -> EvaluationHook:
    """Evaluation of ``actor`` while it is trained, into the run's learning curve.

    Each row holds the metrics, the wall time so far (``wall_s``) and the ``diagnostics``.
    """
    evaluator = make_evaluator(
        recipe, task, episodes=recipe.evaluation.interval_episodes, keep_env=True
    )
    evaluator = replace(evaluator, between_steps=stop.leave)
    best = BestWeights(recipe, actor, run_dir)
    hook = EvaluationHook(
        evaluator,
        actor,
        recipe.evaluation.interval,
        run_dir / LEARNING_CURVE,
        [lambda: {WALL_S: round(time_use.elapsed, 3)}, *diagnostics],
        stop,
        recipe.budget.unit,
        best.offer if recipe.evaluation.keep_best else None,
    )
    time_use.watch(hook, "evaluate", "evaluate")
    return hook


def seed_everything(seed: int) -> None:
    """Seeds torch, numpy and Python; environments are seeded where they are built."""
    torch.manual_seed(seed)
    np.random.seed(seed)
    random.seed(seed)
