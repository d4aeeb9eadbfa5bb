"""The directory of a run: made, and its recipe written and read."""

from __future__ import annotations

import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from pipeline.files import again
from pipeline.files.config_file import read_config, saved_values
from pipeline.files.run_files import (
    CONFIG,
    HISTORY,
    VERSIONS,
    RunDirectoryError,
    versions,
    with_sum,
    write_atomically,
)
from pipeline.files.run_format import latest_of
from pipeline.files.run_lock import is_locked
from pipeline.overrides import overridden
from pipeline.recipe import Recipe
from pipeline.renamed import rename_override
from pipeline.settings import SettingsError
from pipeline.trust import require_trusted

IDENTITY: Final = ("variant", "preset", "seed", "run_dir")
"""Keys that say which run it is; a run that exists brings its own."""


def create_run_dir(path: Path, recipe: Recipe) -> None:
    """Makes a new run directory and writes the recipe and versions into it.

    Raises:
        RunDirectoryError: If it exists already or cannot be written.
    """
    try:
        path.mkdir(parents=True)
    except FileExistsError as error:
        raise RunDirectoryError(existing(path)) from error
    except OSError as error:
        raise _unwritable(path, error) from error
    try:
        write_atomically(path / VERSIONS, json.dumps(versions(), indent=2) + "\n")
        save_recipe(path, recipe)
    except OSError as error:
        raise _unwritable(path, error) from error


def _unwritable(path: Path, error: OSError) -> RunDirectoryError:
    return RunDirectoryError(
        f"Run directory {path} cannot be written ({error.strerror}); choose another with RUN=."
    )


def existing(path: Path) -> str:
    """What a directory that is in a new run's way holds, and what can be done with it."""
    another = "or choose another with RUN=<new directory>"
    if not (path / CONFIG).is_file():
        return f"{path} exists and is no run directory: remove it, {another}."
    if is_locked(path):
        return f"Run directory {path} exists, and a run is under way in it: wait for it, {another}."
    checkpoint = latest_of(path)
    if checkpoint is None:
        return (
            f"Run directory {path} exists: a run that ended before its first checkpoint. Start it "
            f"again with RESUME={path}, {another}."
        )
    budget, counted = saved_recipe(path).budget, int(checkpoint.name.rpartition("-")[2])
    if counted < budget.total:
        return (
            f"Run directory {path} exists: a run at {counted} of {budget.total} {budget.unit}. "
            f"Continue it with RESUME={path}, {another}."
        )
    task = again.task_of(path)
    longer = again.command("train", "", task, [f"{budget.key}=..."], RESUME=path)
    return (
        f"Run directory {path} exists: a complete run of {counted} {budget.unit}. Evaluate it with "
        f"{again.evaluate(path)}, train it for longer with {longer}, {another}."
    )


def save_recipe(path: Path, recipe: Recipe, change: Mapping[str, Any] | None = None) -> None:
    """Writes the recipe of a run: of a new one, or of one resumed with other values.

    Args:
        path: The run directory.
        recipe: All of its values.
        change: What is new since it was written last; added to the file's history.
    """
    values = recipe.plain()
    if change is not None:
        values[HISTORY] = [*read_config(path).get(HISTORY, []), dict(change)]
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    write_atomically(path / CONFIG, with_sum(text))


def saved_recipe(run_dir: Path) -> Recipe:
    """The recipe that a run directory holds, as it stands; nothing of it is imported.

    Raises:
        RunDirectoryError: If there is none, or it is damaged.
        RunFormatError: If it is a link.
    """
    try:
        return Recipe.of(saved_values(run_dir), str(run_dir / CONFIG))
    except SettingsError as error:
        raise RunDirectoryError(str(error)) from error


def load_recipe(run_dir: Path, overrides: Sequence[str] = (), *, training: bool = False) -> Recipe:
    """Reads the recipe of a run, with ``key=value`` of a command line on top.

    Args:
        run_dir: The run.
        overrides: Of the command line.
        training: Whether it is trained further, and not only played.

    Raises:
        RunDirectoryError: If there is none, it is damaged, an override names an unknown key or one
            of :data:`IDENTITY`, or its task or objective runs somebody's code of which the command
            line says nothing.
        RunFormatError: If it is a link.
    """
    path = run_dir / CONFIG
    # Hydra's mark for new keys is not needed here.
    typed = [rename_override(override.lstrip("+")) for override in overrides]
    _require_itself(typed, path)
    values = saved_values(run_dir)
    try:
        recipe = Recipe.of(values, str(path))
        for override in typed:
            recipe = overridden(recipe, override)
    except SettingsError as error:
        raise RunDirectoryError(
            f"{error} (with overrides {typed})" if typed else str(error)
        ) from error
    require_trusted(recipe, recipe.imports(training=training), typed, path)
    return recipe


def _require_itself(overrides: list[str], where: Path) -> None:
    """Refuses to call a run something else than it was trained as, or to move it."""
    for override in overrides:
        key, separator, _ = override.partition("=")
        if separator and key in IDENTITY:
            raise RunDirectoryError(
                f"{where}: which run it is and where it is kept cannot be named anew; leave out "
                f"{override}" + (", or set evaluation.seed" if key == "seed" else "")
            )
