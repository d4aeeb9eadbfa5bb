"""Recipes from YAML and a command line."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from functools import cache
from pathlib import Path
from typing import Any, Final

from hydra import compose as hydra_compose
from hydra import initialize_config_module
from hydra.core.config_store import ConfigStore
from hydra.core.hydra_config import HydraConfig
from hydra.core.override_parser.types import Quote, QuotedString
from omegaconf import DictConfig, OmegaConf, open_dict

from configs.schema import OF_PRESETS, READ_AS, register_schema
from configs.sweeps import MULTIRUN, with_run_dirs
from envs.registry import task_defaults
from pipeline.files.run_files import PLACES
from pipeline.literals import LITERAL, TASK_KEY, literal
from pipeline.recipe import Recipe, TaskSettings
from pipeline.renamed import rename_override

_logger = logging.getLogger(__name__)

Defaults = Mapping[str, Mapping[str, object]]
HERE: Final = Path(__file__).parent
NEW_KEYS: Final = (
    "task.kwargs.",
    "task.randomise.factors.",
    "task.randomise.outside.",
    "loss.bc_weight.kwargs.",
    "loss.bc_weight={",
)
"""Begin what may set keys that any task, or a user's own schedule, has."""


def task_named(overrides: Sequence[str]) -> str:
    """The task that a command line asks for."""
    parts = [override.partition("=") for override in overrides]
    named = [value for key, separator, value in parts if separator and key == TASK_KEY]
    return literal(named[-1]) if named else TaskSettings.name


@cache
def adjusted() -> tuple[str, ...]:
    """Configuration files behind which a task may put values of its own.

    Those are the files that ask for them in their own list of defaults, such as
    ``optional /task_variant@_global_: best`` in ``variant/best``.
    """
    found = []
    for folder in ("preset", "variant"):
        for path in sorted((HERE / folder).glob("*.yaml")):
            asked = f"optional /task_{folder}@_global_"
            content: Any = OmegaConf.to_container(OmegaConf.load(path))
            if {asked: path.stem} in content.get("defaults", []):
                found.append(f"{folder}/{path.stem}")
    return tuple(found)


def register_task_defaults(defaults: Defaults) -> None:
    """Has Hydra put a task's own values behind the files of :func:`adjusted`.

    Args:
        defaults: values of dotted keys, by file (:attr:`envs.task.Task.defaults`).

    Raises:
        ValueError: If a file is none of those.
    """
    unknown = sorted(set(defaults) - set(adjusted()))
    if unknown:
        raise ValueError(f"task defaults follow {unknown}, which is none of {list(adjusted())}")
    for file in adjusted():
        folder, name = file.split("/")
        node: Any = OmegaConf.create({})
        for key, value in defaults.get(file, {}).items():
            OmegaConf.update(node, key, value)
        ConfigStore.instance().store(
            group=f"task_{folder}", name=name, node=node, package="_global_"
        )


def prepare(overrides: Sequence[str]) -> list[str]:
    """Makes Hydra ready for a command line: the keys, and the values of the task it asks for.

    Args:
        overrides: As typed; ``env.name`` is read as ``task.name``.

    Returns:
        The overrides under today's names.

    Raises:
        UnknownTaskError: If no task has the name that is asked for.
        ValueError: If a key is a preset's alone, or all runs of a sweep are to be kept in one
            directory.
    """
    register_schema()
    for override in overrides:
        key, _, value = override.lstrip("+").partition("=")
        if key in OF_PRESETS:
            raise ValueError(
                f"{key} is for files of presets alone: type {READ_AS[key]}={value}, which "
                "variants that do not read it refuse"
            )
    renamed = [rename_override(override) for override in overrides]
    for typed, today in zip(overrides, renamed, strict=True):
        if typed != today:
            old, new = typed.partition("=")[0], today.partition("=")[0]
            _logger.warning("%s is now called %s; the old name will go", old, new)
    register_task_defaults(task_defaults(task_named(renamed)))
    several = bool(MULTIRUN & set(renamed))
    spelled = [spelled_for_hydra(override, several=several) for override in renamed]
    return with_run_dirs(spelled) if several else spelled


def spelled_for_hydra(override: str, *, several: bool = False) -> str:
    """An override as Hydra wants it, so that paths and a task's options can be typed plainly.

    Its dictionaries take new keys behind ``++`` only, its grammar knows no unquoted ``>``, and
    commas, equals signs and quotes of a path would be read as grammar.

    Args:
        override: As typed.
        several: Whether several runs are asked for: a comma in a path means what it does to Hydra.
    """
    key, separator, value = override.partition("=")
    if separator and key in LITERAL and value not in {"", "null"} and not several:
        quoted = QuotedString(text=literal(value), quote=Quote.single).with_quotes()
        return f"{key}={quoted}".replace("${", "\\${")
    if separator and override.startswith(NEW_KEYS):
        return f"++{override}"
    if separator and key == "task.success" and ">" in value and value[0] not in "'\"":
        return f"{key}='{value}'"
    return override


def recipe_of(config: DictConfig) -> Recipe:
    """The recipe that Hydra composed.

    Raises:
        SettingsError: If a value is of another type than its key's, or out of its range.
    """
    values = OmegaConf.to_container(config, resolve=True)
    assert isinstance(values, dict)
    kept = {str(key): value for key, value in values.items() if key not in (*PLACES, *OF_PRESETS)}
    return Recipe.of(kept, "the configuration")


def compose(*overrides: str) -> Recipe:
    """The recipe that ``make train`` with these arguments would train.

    Args:
        overrides: As on the command line: ``variant=sid_bc``, ``preset=smoke``, ``seed=3``.

    Raises:
        UnknownTaskError: If no task has the name that is asked for.
        HydraException: If a key or choice is unknown.
        SettingsError: If a value is of another type than its key's, or out of its range.
    """
    renamed = prepare(overrides)
    with initialize_config_module("configs", version_base="1.3"):
        config = hydra_compose("train", renamed, return_hydra_config=True)
    # Names of the choices made are looked up in Hydra's own part, as under hydra.main.
    HydraConfig.instance().set_config(config)
    with open_dict(config):
        del config["hydra"]
    return recipe_of(config)
