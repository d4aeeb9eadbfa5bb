"""The directory of a run: configuration, versions, logs, checkpoints, evaluations."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path
from typing import Any

import yaml

from pipeline.dotted import nest
from pipeline.files.run_files import (
    CONFIG,
    PLACES,
    TRUST,
    VERSIONS,
    RunDirectoryError,
    read_summed,
    versions,
    with_sum,
    write_atomically,
)
from pipeline.files.run_format import latest_of, require_plain
from pipeline.files.run_lock import is_locked
from pipeline.literals import LITERAL, TASK_KEY, literal
from pipeline.recipe import Recipe
from pipeline.renamed import rename_keys, rename_overrides
from pipeline.settings import SettingsError, plain

DEPTH = 32
"""Of the deepest nesting that is read."""
IDENTITY = ("variant", "preset", "seed")
"""Keys that say which run it is."""
HISTORY = "history"
"""In config.yaml, beside the values: when a resume changed which of them."""


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
    recipe, frames = saved_recipe(path), int(checkpoint.name.rpartition("-")[2])
    key = "bc.updates" if recipe.offline else "collector.total_frames"
    total = recipe.bc.updates if recipe.offline else recipe.collector.total_frames
    if frames < total:
        return (
            f"Run directory {path} exists: a run at {frames} of {total} frames. Continue it with "
            f"RESUME={path}, {another}."
        )
    return (
        f"Run directory {path} exists: a complete run of {frames} frames. Evaluate it with make "
        f'eval RUN={path}, train it for longer with RESUME={path} ARGS="{key}=...", {another}.'
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
        values[HISTORY] = [*_read(path / CONFIG).get(HISTORY, []), dict(change)]
    text = yaml.safe_dump(values, sort_keys=False, allow_unicode=True)
    write_atomically(path / CONFIG, with_sum(text))


def saved_recipe(run_dir: Path) -> Recipe:
    """The recipe that a run directory holds, as it stands; nothing of it is imported.

    Raises:
        RunDirectoryError: If there is none, or it is damaged.
        RunFormatError: If it is a link.
    """
    path = run_dir / CONFIG
    try:
        return Recipe.of(_values(path), str(path))
    except SettingsError as error:
        raise RunDirectoryError(str(error)) from error


def load_recipe(run_dir: Path, overrides: Sequence[str] = (), *, training: bool = False) -> Recipe:
    """Reads the recipe of a run, with ``key=value`` of a command line on top.

    Args:
        run_dir: The run.
        overrides: Of the command line.
        training: Whether it is trained further, and not only played.

    Raises:
        RunDirectoryError: If there is none, it is damaged, an override names an unknown key, or its
            task or objective runs somebody's code of which the command line says nothing.
        RunFormatError: If it is a link.
    """
    path = run_dir / CONFIG
    values = _values(path)
    # Hydra's mark for new keys is not needed here.
    typed, _ = rename_overrides([override.lstrip("+") for override in overrides])
    try:
        recipe = Recipe.of(values, str(path))
        for override in typed:
            recipe = overridden(recipe, override)
    except SettingsError as error:
        raise RunDirectoryError(
            f"{error} (with overrides {typed})" if typed else str(error)
        ) from error
    _require_trusted(recipe, recipe.imports(training=training), typed, path)
    _require_itself(typed, path)
    return recipe


def _require_itself(overrides: list[str], where: Path) -> None:
    """Refuses to call a run something else than it was trained as."""
    for key in IDENTITY:
        for override in overrides:
            if override.startswith(f"{key}="):
                raise RunDirectoryError(
                    f"{where}: what a run was trained as cannot be named anew; leave out "
                    f"{override}" + (", or set evaluation.seed" if key == "seed" else "")
                )


def _values(path: Path) -> dict[str, Any]:
    """What a recipe is made from, under the names of today."""
    saved = _read(path)
    for key in (*PLACES, HISTORY):  # places: of runs made when they stood here too
        saved.pop(key, None)
    if "${" in json.dumps(saved, default=str):
        raise RunDirectoryError(
            f"{path} holds an interpolation (${{...}}), which no run writes: put its value there."
        )
    return rename_keys(saved)


def _read(path: Path) -> dict[str, Any]:
    if not path.exists() and not path.is_symlink():
        raise RunDirectoryError(f"{path.parent} is not a run directory: it holds no {CONFIG}.")
    require_plain(path)
    text = read_summed(path)
    try:
        _require_bounded(text, path)
        saved = yaml.safe_load(text)
    except RunDirectoryError:
        raise
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date that is none
        told = " ".join(str(error).split())
        raise RunDirectoryError(f"{path} is damaged ({told}); restore the file.") from error
    if not isinstance(saved, dict):
        raise RunDirectoryError(f"{path} holds no recipe; restore the file.")
    return saved


def _require_bounded(text: str, path: Path) -> None:
    """Refuses what a few lines of YAML can make that fills the memory or takes hours."""
    depth = 0
    for event in yaml.parse(text):
        if isinstance(event, yaml.AliasEvent):
            raise RunDirectoryError(f"{path} holds an alias (*name), which no run writes.")
        depth += isinstance(event, yaml.CollectionStartEvent)
        depth -= isinstance(event, yaml.CollectionEndEvent)
        if depth > DEPTH:
            raise RunDirectoryError(f"{path} is nested deeper than any that a run writes.")


def _require_trusted(
    recipe: Recipe, imports: Mapping[str, str], overrides: list[str], where: Path
) -> None:
    """Refuses to run code that nobody but the run directory names: it may lie within it."""
    if os.environ.get(TRUST) == "1":
        return
    for key, what in imports.items():
        if not any(override.startswith(f"{key}=") for override in overrides):
            value = plain(attrgetter(key)(recipe))
            again = f"TASK={value}" if key == TASK_KEY else f'ARGS="{key}={_typed(value)}"'
            raise RunDirectoryError(
                f"{where} asks to import {what!r} ({key}={_typed(value)}), which runs its code. If "
                f"you trust it, set {TRUST}=1, or name it yourself: {again}"
            )


def _typed(value: Any) -> str:
    return f"[{','.join(value)}]" if isinstance(value, (list, tuple)) else str(value)


class _TypedValues(yaml.SafeLoader):
    """Values as Hydra reads them where a run is new: YAML has 010 for 8, 1:30 for 90, no for false.

    A number that is none of Python's stays a string, which the key's own type refuses.
    """


_TypedValues.yaml_implicit_resolvers = {}
for _tag, _form, _first in (
    ("bool", r"(?i:true|false)", "tTfF"),
    ("null", r"(?i:null)", "nN"),
    ("int", r"[-+]?[0-9]+(_[0-9]+)*", "-+0123456789"),
    ("float", r"[-+]?([0-9]+\.[0-9]*|\.[0-9]+|[0-9]+(?=[eE]))([eE][-+]?[0-9]+)?", "-+.0123456789"),
    ("float", r"[-+]?(?i:inf|nan)", "-+iInN"),
):
    _TypedValues.add_implicit_resolver(
        f"tag:yaml.org,2002:{_tag}", re.compile(rf"^(?:{_form})$"), list(_first)
    )
_TypedValues.add_constructor("tag:yaml.org,2002:int", lambda _, node: int(node.value))
_TypedValues.add_constructor("tag:yaml.org,2002:float", lambda _, node: float(node.value))


def recipe_of(overrides: Sequence[str]) -> Recipe:
    """The recipe that nothing but ``key=value`` describes, of commands that train nothing.

    Raises:
        SettingsError: If one is not possible.
    """
    recipe = Recipe()
    for override in overrides:
        recipe = overridden(recipe, override.lstrip("+"))
    return recipe


def overridden(recipe: Recipe, override: str) -> Recipe:
    """The recipe with one ``key=value`` on top.

    Raises:
        SettingsError: If it has another form, or the key or value is not possible.
    """
    name, separator, text = override.partition("=")
    if not separator:
        raise SettingsError(f"{override!r} is not of the form key=value")
    try:
        change: Any = (
            literal(text) if name in LITERAL or not text else yaml.load(text, _TypedValues)
        )
    except (yaml.YAMLError, ValueError) as error:
        told = " ".join(str(error).split())
        raise SettingsError(f"{override!r}: its value cannot be read ({told})") from error
    return recipe.changed(**nest(name, change))
