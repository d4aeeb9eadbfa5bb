"""Tasks by name."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from importlib import import_module
from importlib.metadata import entry_points
from types import MappingProxyType
from typing import Final

from envs.options import TaskOptions
from envs.reference import Reference
from envs.task import Task
from envs.user_files import split_file

ENTRY_POINTS: Final = "bcsac.tasks"
"""Group of entry points by which packages of others offer tasks."""
FORMS: Final = (
    "door, hammer, pen, relocate, gymnasium:ID (gymnasium:Pendulum-v1), gymnasium:MODULE:ID, "
    "dm_control:DOMAIN/TASK (dm_control:walker/walk), path/to/file.py[:NAME], "
    f"or an entry point of the group {ENTRY_POINTS}"
)

OURS: Final[Mapping[str, str]] = MappingProxyType(
    {name: f"envs.{name}.definition" for name in ("door", "hammer", "pen", "relocate")}
)
"""Modules that hold a ``TASK``, by its name. They are imported when they are asked for."""
REFERENCES: Final[Mapping[str, str]] = MappingProxyType({"door": "envs.door.paper"})
"""Modules whose ``PAPER`` are the published rows of a task of ours, by its name."""
LIBRARIES: Final[Mapping[str, str]] = MappingProxyType(
    {"gymnasium": "envs.library", "dm_control": "envs.library"}
)
"""Modules whose ``find(library, name, options)`` makes a task of somebody's environment, and whose
``DEFAULTS`` suit all of these."""
FILES: Final = "envs.library"
"""Module whose ``find_file(name, options)`` and ``file_defaults(name)`` do so for a user's file."""

NO_OPTIONS: Final = TaskOptions()


def imports_of(name: str, options: TaskOptions = NO_OPTIONS) -> dict[str, str]:
    """What making a task runs of somebody's code, on the word of its name and options alone.

    Ours, a library's own, and what installed packages offer as entry points are none of it;
    ``task.kwargs`` are data. gymnasium imports ``MODULE`` of ``gymnasium:MODULE:ID`` so that it
    registers the id.

    Returns:
        What is imported, by the key of the configuration that asks for it.
    """
    asked = {}
    library, separator, wanted = name.partition(":")
    if separator and library in LIBRARIES:
        module, further, _ = wanted.rpartition(":")
        if further:
            asked["task.name"] = module
    elif (file := split_file(name)) is not None:
        asked["task.name"] = file[0]
    if options.wrappers:
        asked["task.wrappers"] = ", ".join(options.wrappers)
    for key in ("success", "reward", "progress"):
        # Whatever names a file, of whatever else it may be part.
        file = split_file(getattr(options, key) or "")
        if file is not None:
            asked[f"task.{key}"] = file[0]
    return asked


class UnknownTaskError(ValueError):
    """No task has this name."""


def find_task(name: str, options: TaskOptions = NO_OPTIONS) -> Task:
    """The task called ``name``.

    Args:
        name: one of :data:`FORMS`.
        options: of the user, for environments of a library.

    Raises:
        UnknownTaskError: the name has another form, or nobody offers it.
        ValueError: the task cannot use an option.
    """
    library, separator, wanted = name.partition(":")
    if separator and library in LIBRARIES:
        find: Callable[[str, str, TaskOptions], Task] = import_module(LIBRARIES[library]).find
        return find(library, wanted, options)
    if split_file(name) is not None:
        find_file: Callable[[str, TaskOptions], Task] = import_module(FILES).find_file
        return find_file(name, options)
    for key, value in options.given().items():
        raise ValueError(
            f"{key}={value} is for environments of gymnasium, dm_control and files, and task "
            f"{name} is complete as it is: leave it out"
        )
    if name in OURS:
        ours: Task = import_module(OURS[name]).TASK
        return ours
    found = [entry for entry in entry_points(group=ENTRY_POINTS) if entry.name == name]
    if found:
        offered: Task = found[0].load()
        return offered
    raise UnknownTaskError(f"unknown task {name!r}; valid: {FORMS}")


def reference_of(name: str) -> Reference | None:
    """:attr:`envs.task.Task.reference` of the task called ``name``.

    Ours are not made for it: a task stands on torch and MuJoCo, its published rows on nothing.

    Raises:
        UnknownTaskError, ValueError: as :func:`find_task`.
    """
    if name not in OURS:
        return find_task(name).reference
    if name not in REFERENCES:
        return None
    published: Reference = import_module(REFERENCES[name]).PAPER
    return published


def task_defaults(name: str) -> Mapping[str, Mapping[str, object]]:
    """:attr:`envs.task.Task.defaults` of the task called ``name``; makes no environment.

    Raises:
        UnknownTaskError: nobody offers it.
        ValueError: a file holds no task.
    """
    library, separator, _ = name.partition(":")
    if separator and library in LIBRARIES:
        defaults: Mapping[str, Mapping[str, object]] = import_module(LIBRARIES[library]).DEFAULTS
        return defaults
    if split_file(name) is not None:
        own: Mapping[str, Mapping[str, object]] = import_module(FILES).file_defaults(name)
        return own
    return find_task(name).defaults
