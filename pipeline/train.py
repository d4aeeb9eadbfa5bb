"""Entry point of ``make train``: Hydra composes the recipe, ``build.py`` the run."""

from __future__ import annotations

import atexit
import gc
import logging
import sys
from operator import attrgetter
from pathlib import Path

import hydra
from hydra.core.hydra_config import HydraConfig
from hydra.types import RunMode
from omegaconf import DictConfig
from omegaconf.errors import OmegaConfBaseException

from configs import prepare, recipe_of, require_known
from envs.task import TaskFailedError
from pipeline.best import better_before
from pipeline.build import build_run
from pipeline.files import again
from pipeline.literals import typed, word
from pipeline.machine.disk import training_stopped_by
from pipeline.machine.interruption import Interrupted, Interruption, interruption
from pipeline.machine.memory import told_memory
from pipeline.machine.sweep import note, sweep
from pipeline.non_finite import EXIT_CODE, NonFiniteError
from pipeline.recipe import Recipe
from pipeline.run_dir import load_recipe
from pipeline.settings import plain
from pipeline.watch.phases import outcome

logger = logging.getLogger(__name__)


def resolve(config: DictConfig) -> tuple[Recipe, Path, bool]:
    """The recipe, the run directory and whether an earlier run in it goes on.

    With ``resume=DIR`` the run's own recipe is read and only the overrides that were typed on the
    command line are put on top of it.

    Raises:
        ValueError: If a value is not possible.
        RunDirectoryError: If there is no run to resume, or it is also told what it is.
    """
    if config.resume is None:
        return recipe_of(config), Path(config.run_dir), False
    run_dir = Path(config.resume)
    asked = [o for o in HydraConfig.get().overrides.task if not o.startswith("resume=")]
    return load_recipe(run_dir, asked, training=True), run_dir, True


@hydra.main(version_base="1.3", config_path="pkg://configs", config_name="train")
def main(config: DictConfig) -> None:
    """Trains one run (or, with ``--multirun``, one of several)."""
    failed = _failure(config)
    if HydraConfig.get().mode == RunMode.MULTIRUN:
        note(HydraConfig.get().overrides.task, None if failed is None else failed[1])
        if failed is not None:
            print(f"error: {failed[1]}", file=sys.stderr)
    elif failed is not None:
        code, why = failed
        print(f"error: {why}", file=sys.stderr)
        sys.exit(code)


def _failure(config: DictConfig) -> tuple[int, str] | None:
    """Trains; returns the exit code and why, if that failed."""
    try:
        with interruption() as signals:
            _train(config, signals)
    except Interrupted as stop:
        # At its end the interpreter looks through all objects for garbage: for seconds.
        atexit.register(gc.freeze)
        sys.exit(stop.exit_code)  # of a whole sweep too
    except NonFiniteError as error:
        return EXIT_CODE, str(error)
    except (ValueError, FileNotFoundError, TaskFailedError) as error:
        return 1, str(error)
    except OSError as error:
        return 1, training_stopped_by(error)
    except OmegaConfBaseException as error:
        return 1, f"in the configuration: {error}"
    except (MemoryError, RuntimeError) as error:
        if (why := told_memory(error)) is None:
            raise
        return 1, why
    return None


def _train(config: DictConfig, signals: Interruption) -> None:
    recipe, run_dir, resume = resolve(config)
    try:
        run = build_run(recipe, run_dir, resume=resume)
    except Interrupted:
        print("stopped before the training began; nothing is lost", file=sys.stderr)
        raise
    logger.info("run directory: %s", run.run_dir)
    signals.asks(run.stop)
    try:
        run.train()
    except Interrupted:
        counted = f"{run.trainer.collected_frames} {recipe.budget.unit}"
        named = [
            word(f"{key}={typed(plain(attrgetter(key)(recipe)))}") for key in recipe.own_imports
        ]
        further = again.command("train", "", again.task_of(run_dir), named, RESUME=run_dir)
        print(f"stopped at {counted}; go on with: {further}", file=sys.stderr)
        raise
    found = outcome(run.evaluation.metrics)
    done = f"done: {found}" if found else "done"
    logger.info("%s; evaluate it with: %s", done, again.evaluate(run.run_dir))
    if better := better_before(run.run_dir):
        logger.info("%s", better)


def run_command_line() -> None:
    """Makes Hydra ready for the task that the arguments name, and trains."""
    try:
        prepared = prepare(sys.argv[1:])
        require_known(prepared)
        sys.argv[1:] = prepared
    except ValueError as error:
        sys.exit(f"error: {error}")
    with sweep():
        main()


if __name__ == "__main__":
    run_command_line()
