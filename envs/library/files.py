"""What a user's file offers as a task, by ``path/to/file.py[:NAME]``."""

from __future__ import annotations

import inspect
import typing
from collections.abc import Callable, Mapping
from pathlib import Path
from types import ModuleType
from typing import Any, Final

import gymnasium

from envs.task import Task
from envs.user_files import import_file, split_file

FORM: Final = "path/to/file.py[:NAME]"
WANTED: Final = "a Task, a gymnasium.Env class or a function that returns a gymnasium.Env"
DEFAULT: Final = "TASK"


def offered(name: str) -> Task | Callable[..., Any]:
    """The task of a file, or what makes its environment; makes none.

    Args:
        name: path, and the object's name: without one ``TASK``, or the only object that can be one.

    Raises:
        ValueError: the file cannot be imported, or holds no such object.
    """
    split = split_file(name)
    assert split is not None
    path, wanted = split
    asked = f"task.name={name}"
    module = import_file(path, asked, FORM)
    if not wanted and not hasattr(module, DEFAULT):
        return _only(module, asked)
    found = getattr(module, wanted or DEFAULT, None)
    if isinstance(found, Task) or callable(found):
        return found
    what = (
        f"is of type {type(found).__name__}"
        if hasattr(module, wanted or DEFAULT)
        else "is not there"
    )
    raise ValueError(
        f"{asked}: {wanted or DEFAULT!r} {what}; expected {WANTED}; found: {_listed(module)}"
    )


def resolved(name: str) -> str:
    """The same object wherever the working directory is."""
    split = split_file(name)
    assert split is not None
    path, wanted = split
    return str(Path(path).resolve()) + (f":{wanted}" if wanted else "")


def make_from_file(name: str, kwargs: Mapping[str, Any]) -> gymnasium.Env[Any, Any]:
    """An environment of the class or function of that name.

    Raises:
        ValueError: it makes something else.
    """
    make = offered(name)
    assert callable(make)
    env = make(**kwargs)
    if not isinstance(env, gymnasium.Env):
        raise ValueError(f"it made a {type(env).__name__}; expected a gymnasium.Env")
    return env


def _only(module: ModuleType, asked: str) -> Task | Callable[..., Any]:
    candidates = _candidates(module)
    # An environment beside a task is part of it.
    tasks = {name: value for name, value in candidates.items() if isinstance(value, Task)}
    suitable = tasks or candidates
    if len(suitable) == 1:
        return next(iter(suitable.values()))
    raise ValueError(
        f"{asked}: expected {DEFAULT}, or exactly one object that is {WANTED} (its return type "
        f"written down); found: {_listed(module)}; name one: path/to/file.py:NAME"
    )


def _candidates(module: ModuleType) -> dict[str, Any]:
    return {
        name: value
        for name, value in vars(module).items()
        if not name.startswith("_") and (isinstance(value, Task) or _makes_env(value, module))
    }


def _makes_env(value: Any, module: ModuleType) -> bool:
    if getattr(value, "__module__", None) != module.__name__:  # imported from elsewhere
        return False
    if inspect.isclass(value):
        return issubclass(value, gymnasium.Env) and not inspect.isabstract(value)
    if not inspect.isfunction(value):
        return False
    try:
        returned = typing.get_type_hints(value).get("return")
    except (NameError, TypeError):  # a hint of something that is not imported at run time
        return False
    returned = typing.get_origin(returned) or returned
    return inspect.isclass(returned) and issubclass(returned, gymnasium.Env)


def _listed(module: ModuleType) -> str:
    """``Reach (line 12)``, ...: what the file itself defines, and tasks."""
    found = []
    for name, value in vars(module).items():
        if isinstance(value, Task):
            found.append(f"{name} (a Task)")
        elif getattr(value, "__module__", None) == module.__name__ and callable(value):
            found.append(f"{name} (line {_line(value)})")
    return ", ".join(found) or "nothing"


def _line(value: Any) -> int | str:
    try:
        return inspect.getsourcelines(value)[1]
    except (OSError, TypeError):
        return "?"
