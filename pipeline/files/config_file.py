"""``config.yaml`` of a run directory, read as data that a stranger may have written."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any, Final

import yaml

from envs.one_line import text_of
from pipeline.files.run_files import (
    CONFIG,
    HISTORY,
    PLACES,
    RunDirectoryError,
    config_of,
    read_summed,
)
from pipeline.files.run_format import require_plain
from pipeline.renamed import rename_keys

DEPTH: Final = 32
"""Of the deepest nesting that is read."""


def saved_values(run_dir: Path) -> dict[str, Any]:
    """What the run's recipe is made from, under the names of today.

    Raises:
        RunDirectoryError: As :func:`read_config`, or it holds an interpolation.
        RunFormatError: If it is a link.
    """
    path, saved = run_dir / CONFIG, read_config(run_dir)
    for key in (*PLACES, HISTORY):  # places: of runs made when they stood here too
        saved.pop(key, None)
    if "${" in json.dumps(saved, default=str):
        raise RunDirectoryError(
            f"{path} holds an interpolation (${{...}}), which no run writes: put its value there."
        )
    return rename_keys(saved)


def read_config(run_dir: Path) -> dict[str, Any]:
    """Everything that the file holds, as it stands there.

    Raises:
        RunDirectoryError: If there is none, it is damaged, or such as no run writes.
        RunFormatError: If it is a link.
    """
    path = require_plain(config_of(run_dir))
    text = read_summed(path)
    try:
        _require_bounded(text, path)
        saved = yaml.safe_load(text)
    except RunDirectoryError:
        raise
    except (yaml.YAMLError, ValueError) as error:  # ValueError: a date that is none
        raise RunDirectoryError(
            f"{path} is damaged ({text_of(error)}); restore the file."
        ) from error
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
