"""Code that nobody but a run directory names: it may lie within it, and is not run on its word."""

from __future__ import annotations

import os
import shlex
from collections.abc import Mapping, Sequence
from operator import attrgetter
from pathlib import Path

from pipeline.files.run_files import TRUST, RunDirectoryError
from pipeline.literals import TASK_KEY, typed, word
from pipeline.overrides import keys_of
from pipeline.recipe import Recipe
from pipeline.settings import plain


def require_trusted(
    recipe: Recipe, imports: Mapping[str, str], overrides: Sequence[str], where: Path
) -> None:
    """Refuses to run what the command line does not name too, unless :data:`TRUST` is 1.

    Args:
        recipe: Of the run.
        imports: What it imports of somebody's code, by key (`Recipe.imports`).
        overrides: ``key=value`` of the command line.
        where: The recipe stands, for the message.

    Raises:
        RunDirectoryError: If something is asked for by the run directory alone.
    """
    if os.environ.get(TRUST) == "1":
        return
    for key, what in imports.items():
        if not any(key in keys_of(override) for override in overrides):
            value = plain(attrgetter(key)(recipe))
            again = f"TASK={value}" if key == TASK_KEY else _arguments(f"{key}={typed(value)}")
            raise RunDirectoryError(
                f"{where} asks to import {what!r} ({key}={typed(value)}), which runs its code. If "
                f"you trust it, set {TRUST}=1, or name it yourself: {again}"
            )


def _arguments(override: str) -> str:
    """``ARGS=...`` of make, which hands its words to a shell."""
    told = word(override)
    # Within double quotes there can be none.
    return f"ARGS={shlex.quote(told)}" if '"' in told else f'ARGS="{told}"'
