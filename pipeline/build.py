"""Composition root: from a configuration to a run that can be trained."""

from __future__ import annotations

import logging
import shutil
from dataclasses import replace
from functools import partial
from pathlib import Path

import torch

from envs import Task
from pipeline.cloning import behaviour_cloned, build_offline
from pipeline.compute import resolve_compute
from pipeline.conversion import make_episode_rows
from pipeline.data.demonstrations import Demonstrations, make_demonstrations
from pipeline.entropy_choice import with_chosen_entropy
from pipeline.files.checkpoint import load_trainer, trained_frames
from pipeline.files.curves import cut_back, last_wall_s
from pipeline.files.run_files import RunDirectoryError
from pipeline.files.run_format import latest_of
from pipeline.files.run_lock import lock_run
from pipeline.files.time_use import TimeUse
from pipeline.imitation_choice import with_chosen_imitation
from pipeline.machine.products import use_onednn
from pipeline.online import build_online
from pipeline.policy import WEIGHTS
from pipeline.recipe import Recipe
from pipeline.resuming import (
    as_decided,
    changes,
    entry,
    require_budget,
    require_changeable,
)
from pipeline.run_dir import create_run_dir, save_recipe, saved_recipe
from pipeline.scale_choice import unscaled, with_chosen_scale
from pipeline.trainer import Run, seed_everything
from pipeline.updates import actor_updates, late_actor
from pipeline.watch.loggers import require_loggers

_logger = logging.getLogger(__name__)


def build_run(recipe: Recipe, run_dir: str | Path, *, resume: bool = False) -> Run:
    """Composes the run that ``recipe`` describes, in a new run directory or an existing one.

    A new directory whose run cannot be composed is removed again.

    Args:
        recipe: Of the run.
        run_dir: Where it is kept.
        resume: Continue from the newest checkpoint in ``run_dir``, or start again where there is
            none. Rows that were written after it are cut off, since they are written again.

    Raises:
        RunDirectoryError: If the directory exists (new run) or is none of a run (resume), cannot be
            written or is in use, or if the resumed run is asked for what it cannot change.
        DemonstrationError: If the demonstrations are not usable.
        ValueError: If values of the configuration contradict each other.
    """
    logging.getLogger("torchrl").setLevel(logging.WARNING)  # it reports each buffer it allocates
    require_loggers(recipe.logging.loggers)
    time_use = TimeUse()
    with time_use.part("setup"):
        run_dir = Path(run_dir)
        return (_resume if resume else _start)(recipe, run_dir, time_use)


def _start(recipe: Recipe, run_dir: Path, time_use: TimeUse) -> Run:
    recipe = resolve_compute(recipe)
    create_run_dir(run_dir, recipe)
    try:
        lock = lock_run(run_dir)
        return replace(_compose(recipe, run_dir, time_use), lock=lock)
    except BaseException:
        shutil.rmtree(run_dir, ignore_errors=True)
        raise


def _resume(recipe: Recipe, run_dir: Path, time_use: TimeUse) -> Run:
    saved = saved_recipe(run_dir)
    if (run_dir / WEIGHTS).is_file():
        raise RunDirectoryError(f"{run_dir} holds an exported policy, not a run to go on with.")
    lock = lock_run(run_dir)
    try:
        return replace(_going_on(recipe, saved, run_dir, time_use), lock=lock)
    except BaseException:
        lock.release()
        raise


def _going_on(recipe: Recipe, saved: Recipe, run_dir: Path, time_use: TimeUse) -> Run:
    recipe = resolve_compute(as_decided(recipe, saved))
    changed = changes(saved, recipe)
    require_changeable(changed, recipe, run_dir)
    checkpoint = latest_of(run_dir)
    if checkpoint is None:
        _logger.warning("%s holds no checkpoint: the run starts again", run_dir)
        cut_back(run_dir, -1)
        run = _compose(recipe, run_dir, time_use)
    else:
        require_budget(recipe, trained_frames(checkpoint), run_dir, changed)
        run = _compose(recipe, run_dir, time_use)
        load_trainer(checkpoint, run.trainer)
        run = replace(run, begin=None)  # it has begun, even where it stopped in its first portion
        cut_back(run_dir, run.trainer.collected_frames)
        time_use.reach(last_wall_s(run_dir))
    if changed:
        save_recipe(run_dir, run.recipe, entry(changed, run.trainer.collected_frames))
    return run


def _compose(recipe: Recipe, run_dir: Path, time_use: TimeUse) -> Run:
    torch.set_num_threads(recipe.torch_threads or 1)
    use_onednn(bool(recipe.onednn))
    # Apart from the rest of the setup: it is the simulator that works there.
    task = recipe.find_task()
    if late := late_actor(recipe):
        _logger.warning("%s", late)
    for kind, entries in recipe.own_parts:  # before minutes of demonstrations
        kind.require(entries)
    recipe.loss.bc_weight.schedule(actor_updates(recipe))  # refuses what contradicts, likewise
    if recipe.curriculum.reverse:
        task.require("states", "curriculum.reverse=true")
    with time_use.part("demonstrations"):
        demos = _demonstrations(unscaled(recipe), task)
    chosen, demos = with_chosen_scale(recipe, demos)
    chosen = with_chosen_imitation(chosen, demos)
    clone = partial(behaviour_cloned, chosen, task, demos, time_use)
    chosen = with_chosen_entropy(chosen, clone, demos)
    if chosen != recipe:
        recipe = chosen
        save_recipe(run_dir, recipe)  # so that nobody chooses again
    seed_everything(recipe.seed)
    build = build_offline if recipe.offline else build_online
    return build(recipe, task, run_dir, demos, time_use)


def _demonstrations(recipe: Recipe, task: Task) -> Demonstrations | None:
    if not recipe.uses_demonstrations:
        return None
    return make_demonstrations(
        recipe.demos,
        task,
        make_episode_rows(recipe),
        cache_dir=Path(recipe.cache_dir),
        num_threads=recipe.env.num_threads,
    )
