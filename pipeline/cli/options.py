"""Arguments and options that several commands have."""

from __future__ import annotations

import json
import re
from pathlib import Path
from typing import Annotated

import typer

from envs.registry import FORMS
from pipeline.files.run_files import config_of

VIDEO_MODULES = ("imageio", "imageio_ffmpeg", "PIL")
RESULTS_MODULES = ("matplotlib", "pandas", "pyarrow", "rliable")
OVERRIDE = re.compile(r"\+{0,2}[a-z_]+(\.\w+)*=")


def a_run(run_dir: Path) -> Path:
    """The argument, if it is a run directory: a slip of the pen is told before torch is loaded.

    Raises:
        RunDirectoryError: If it is none.
    """
    config_of(run_dir)
    return run_dir


RunDir = Annotated[Path, typer.Argument(help="A run directory.", callback=a_run)]
Overrides = Annotated[list[str] | None, typer.Argument(help="key=value on top of its config.")]
TaskName = Annotated[str | None, typer.Option("--task", help=f"Instead of RUN's: {FORMS}.")]
Episodes = Annotated[int | None, typer.Option(help="The first so many of the list.")]
Starts = Annotated[str | None, typer.Option(help="Episodes of the list by number: 3,17.")]
Worst = Annotated[int | None, typer.Option(help="So many that went worst in make eval.")]
Camera = Annotated[str | None, typer.Option(help="Its name; default: the task's own view.")]


def changes(task: str | None, overrides: list[str] | None = None) -> list[str]:
    """``--task`` and the ``key=value`` behind it, as overrides."""
    named = [] if task is None else [f"task.name={json.dumps(task)}"]
    return [*named, *(overrides or [])]


def named_first(first: str, overrides: list[str] | None) -> tuple[str, list[str]]:
    """What the first argument names, which may be left out, and the overrides."""
    if OVERRIDE.match(first) and not Path(first).exists():
        return "", [first, *(overrides or [])]
    return first, overrides or []
