"""TorchRL's trainer as this project sets it up, and the run around it."""

from __future__ import annotations

from collections import defaultdict, deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torchrl.checkpoint import Checkpoint
from torchrl.modules import ProbabilisticActor
from torchrl.trainers import Trainer

from configs.schema import Config
from pipeline import components
from pipeline.checkpoint import make_rotation
from pipeline.hooks import EvaluationHook
from pipeline.loggers import make_loggers
from pipeline.run_dir import LEARNING_CURVE
from pipeline.time_use import OTHER, TimeUse


@dataclass(frozen=True)
class Run:
    """A composed run."""

    config: Config
    run_dir: Path
    trainer: Trainer
    actor: ProbabilisticActor
    time_use: TimeUse

    def train(self) -> None:
        """Trains to the end; the newest checkpoint and the learning curve are in ``run_dir``."""
        # The trainer looks at its total only after a batch: a complete run would grow by one.
        if self.trainer.collected_frames < self.trainer.total_frames:
            try:
                with self.time_use.part(OTHER):
                    self.trainer.train()
            finally:
                self.time_use.write(self.run_dir)


def make_trainer(
    config: Config, run_dir: Path, checkpoint: Checkpoint, time_use: TimeUse, **parts: object
) -> Trainer:
    """TorchRL's trainer with this project's checkpointing, logging and progress bar."""
    trainer = Trainer(
        frame_skip=1,
        logger=make_loggers(list(config.logging.loggers), run_dir, config.logging.project),
        progress_bar=config.logging.progress,
        log_interval=config.logging.interval,
        save_trainer_interval=config.logging.checkpoint_interval,
        checkpoint=checkpoint,
        checkpoint_rotation=make_rotation(run_dir),
        **parts,
    )
    # TorchRL keeps every value it was given. Between them the freed activations of large networks
    # cannot be joined again: the process grew by 1.4 MB per update of the paper's size.
    trainer._log_dict = defaultdict(lambda: deque(maxlen=1))
    trainer.register_module("time_use", time_use)
    time_use.watch(trainer.optimization_stepper, "step", "update")
    time_use.watch(trainer, "save_trainer", "checkpoint")
    if trainer.logger is not None:
        time_use.watch(trainer.logger, "log_scalar", "log")
    return trainer


def make_evaluation_hook(
    config: Config,
    actor: ProbabilisticActor,
    run_dir: Path,
    time_use: TimeUse,
    *diagnostics: Callable[[], Mapping[str, float]],
) -> EvaluationHook:
    """Evaluation of ``actor`` while it is trained, into the run's learning curve.

    Each row holds the metrics, the wall time so far (``wall_s``) and the ``diagnostics``.
    """
    evaluator = components.make_evaluator(config, episodes=config.evaluation.interval_episodes)
    hook = EvaluationHook(
        evaluator,
        actor,
        config.evaluation.interval,
        run_dir / LEARNING_CURVE,
        [lambda: {"wall_s": round(time_use.elapsed, 3)}, *diagnostics],
    )
    time_use.watch(hook, "evaluate", "evaluate")
    return hook


def seed_everything(seed: int) -> None:
    """Seeds torch and numpy; environments are seeded where they are built."""
    torch.manual_seed(seed)
    np.random.seed(seed)
