"""TorchRL's trainer as this project sets it up, and the run around it."""

from __future__ import annotations

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


@dataclass(frozen=True)
class Run:
    """A composed run."""

    config: Config
    run_dir: Path
    trainer: Trainer
    actor: ProbabilisticActor

    def train(self) -> None:
        """Trains to the end; the newest checkpoint and the learning curve are in ``run_dir``."""
        # The trainer looks at its total only after a batch: a complete run would grow by one.
        if self.trainer.collected_frames < self.trainer.total_frames:
            self.trainer.train()


def make_trainer(config: Config, run_dir: Path, checkpoint: Checkpoint, **parts: object) -> Trainer:
    """TorchRL's trainer with this project's checkpointing, logging and progress bar."""
    return Trainer(
        frame_skip=1,
        logger=make_loggers(list(config.logging.loggers), run_dir, config.logging.project),
        progress_bar=config.logging.progress,
        log_interval=config.logging.interval,
        save_trainer_interval=config.logging.checkpoint_interval,
        checkpoint=checkpoint,
        checkpoint_rotation=make_rotation(run_dir),
        **parts,
    )


def make_evaluation_hook(
    config: Config, actor: ProbabilisticActor, run_dir: Path
) -> EvaluationHook:
    """Evaluation of ``actor`` while it is trained, into the run's learning curve."""
    return EvaluationHook(
        components.make_evaluator(config, episodes=config.evaluation.interval_episodes),
        actor,
        config.evaluation.interval,
        run_dir / LEARNING_CURVE,
    )


def seed_everything(seed: int) -> None:
    """Seeds torch and numpy; environments are seeded where they are built."""
    torch.manual_seed(seed)
    np.random.seed(seed)
