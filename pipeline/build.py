"""Composition root: from a configuration to a run that can be trained."""

from __future__ import annotations

import shutil
from pathlib import Path

import torch

from configs.schema import Config
from pipeline import components
from pipeline.checkpoint import latest_checkpoint, load_trainer
from pipeline.cloning import build_offline
from pipeline.components import Demonstrations
from pipeline.compute import resolve_compute
from pipeline.online import build_online
from pipeline.products import use_onednn
from pipeline.run_dir import create_run_dir, save_config
from pipeline.time_use import TimeUse
from pipeline.trainer import Run, seed_everything


def build_run(config: Config, *, resume: bool = False) -> Run:
    """Composes the run that ``config`` describes, in a new run directory or an existing one.

    A new directory whose run cannot be composed is removed again.

    Args:
        config: Resolved configuration.
        resume: Continue from the newest checkpoint in ``config.run_dir``.

    Raises:
        RunDirectoryError: If the directory exists (new run) or cannot be written.
        FileNotFoundError: If there is no checkpoint to resume from.
        DemonstrationError: If the demonstrations are not usable.
        ValueError: If values of the configuration contradict each other.
    """
    time_use = TimeUse()
    with time_use.part("setup"):
        run_dir = Path(config.run_dir)
        config = resolve_compute(config)
        torch.set_num_threads(config.torch_threads or 1)
        use_onednn(bool(config.onednn))
        if resume:
            checkpoint = latest_checkpoint(run_dir)
            run = _compose(config, run_dir, time_use)
            load_trainer(checkpoint, run.trainer)
            save_config(run_dir, config)
            return run
        create_run_dir(run_dir, config)
        try:
            return _compose(config, run_dir, time_use)
        except BaseException:
            shutil.rmtree(run_dir, ignore_errors=True)
            raise


def _compose(config: Config, run_dir: Path, time_use: TimeUse) -> Run:
    # Apart from the rest of the setup: it is the simulator that works there.
    with time_use.part("demonstrations"):
        demos = _demonstrations(config)
    seed_everything(config.seed)
    build = build_offline if config.offline else build_online
    return build(config, run_dir, demos, time_use)


def _demonstrations(config: Config) -> Demonstrations | None:
    needed = (
        config.offline
        or config.pretrain
        or config.sampler.demo_ratio > 0
        or config.sampler.demo_update_period > 0
        or config.growth.bc_model
        or config.actor.normalise_observations
        or config.critic.normalise_observations
    )
    if not needed:
        return None
    return components.make_demonstrations(
        config.demos,
        components.make_rows(config),
        cache_dir=Path(config.cache_dir),
        num_threads=config.env.num_threads,
    )
