"""Commands that messages and reports name, in words of a shell.

They are of make, or of ``bcsac`` where this one was started so: an installed package has no make.
A run directory does not run somebody's code that only it names (``pipeline.run_dir``), so that a
command names it again: a task's file, and files of its rules.
"""

from __future__ import annotations

import os
import re
import shlex
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, Final

import yaml

from bcsac import STARTED_AS
from envs.options import TaskOptions
from envs.registry import imports_of
from pipeline.files.run_files import CONFIG
from pipeline.literals import TASK_KEY, literal, typed
from pipeline.renamed import rename_keys

TASK: Final = "task."
KEYS: Final = {"RUN": "run_dir", "RESUME": "resume", "TASK": TASK_KEY}
"""What the Makefile calls otherwise than Hydra."""
RULES: Final = ("success", "reward", "progress")


def evaluate(run: Path) -> str:
    """``make eval RUN=...`` with what the run's ``config.yaml`` names of somebody's code."""
    return command("eval", run, task_of(run))


def command(
    target: str,
    run: Path | str,
    task: Mapping[str, Any],
    overrides: Sequence[str] = (),
    **words: object,
) -> str:
    """A target of the Makefile for a run, or the command of ``bcsac`` behind it, as asked before.

    Args:
        target: Of the Makefile.
        run: A run directory.
        task: What is known of the run's ``task.*``, without that prefix.
        overrides: ``key=value`` that the command had on top of the run's.
        words: Further ``NAME=value`` of the command; empty ones are left out.
    """
    named = [literal(value) for key, _, value in map(_parts, overrides) if key == TASK_KEY]
    rest = [one for one in overrides if not one.startswith(f"{TASK_KEY}=")]
    asked = imports_of(str(task.get("name") or ""), _options(task))
    if TASK_KEY in asked and not named:
        named = [str(task["name"])]
    given = {TASK_KEY, *(key for key, _, _ in map(_parts, rest))}
    rest += [f"{key}={typed(task[key.removeprefix(TASK)])}" for key in asked if key not in given]
    told = {"RUN": run, **words, "TASK": "".join(named[-1:])}
    known = {name: str(value) for name, value in told.items() if str(value)}
    if os.environ.get(STARTED_AS) == "bcsac":
        return shlex.join(["bcsac", target, *_arguments(target, known), *rest])
    known |= {"ARGS": " ".join(rest)} if rest else {}
    return " ".join(["make", target, *(f"{k}={shlex.quote(v)}" for k, v in known.items())])


def _arguments(target: str, words: Mapping[str, str]) -> list[str]:
    """Of ``bcsac``, what the Makefile makes of its words: keys to train, options to all others."""
    if target == "train":
        return [f"{KEYS[name]}={_as_literal(value)}" for name, value in words.items()]
    options = ((f"--{name.lower()}", value) for name, value in words.items() if name != "RUN")
    return [*([words["RUN"]] if "RUN" in words else []), *(one for pair in options for one in pair)]


def _as_literal(value: str) -> str:
    """Between quotes where Hydra reads something else than the value; see ``pipeline.literals``."""
    if re.fullmatch(r"[\w./:-]+", value):
        return value
    escaped = value.replace("${", "\\${").replace("'", "\\'")
    return f"'{escaped}'"


def _parts(override: str) -> tuple[str, str, str]:
    return override.partition("=")


def _options(task: Mapping[str, Any]) -> TaskOptions:
    """Of what a file says, which may be anything."""
    wrappers = task.get("wrappers")
    found: dict[str, Any] = {k: v for k in RULES if isinstance(v := task.get(k), str)}
    if isinstance(wrappers, list | tuple):
        found["wrappers"] = tuple(map(str, wrappers))
    return TaskOptions(**found)


def task_of(run: Path) -> Mapping[str, Any]:
    """``task.*`` of a run; nothing where it cannot be read: a remedy is told, not an error."""
    try:
        found = rename_keys(yaml.safe_load((run / CONFIG).read_text()))["task"]
    except (OSError, ValueError, KeyError, TypeError, AttributeError, RecursionError):
        return {}
    except yaml.YAMLError:
        return {}
    return found if isinstance(found, Mapping) else {}
