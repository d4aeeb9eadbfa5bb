"""Functions of a user's file, by ``path.py:function``, and classes by ``module:Class``."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from typing import Any, Final

from envs.one_line import kind_and_text
from envs.user_files import import_file

FORM: Final = "path.py:function"


def load_function(key: str, where: str) -> Callable[..., Any]:
    """The function that ``path/to/file.py:function`` names.

    Args:
        key: of the configuration, for messages.
        where: path and name.

    Raises:
        ValueError: there is no such file or function, or the file cannot be imported.
    """
    path, _, name = where.rpartition(":")
    return _callable(f"{key}={where}", import_file(path, f"{key}={where}", FORM), name)


def load_class(key: str, where: str) -> Callable[..., Any]:
    """The class that ``module:Class`` names.

    Raises:
        ValueError: it cannot be imported.
    """
    module, separator, name = where.partition(":")
    if not separator:
        raise ValueError(f"{key}: {where!r} is no import path; expected module:Class")
    try:
        found = importlib.import_module(module)
    # Whatever an imported module raises is told in one line.
    except Exception as error:
        raise ValueError(f"{key}: cannot import {module!r} ({kind_and_text(error)})") from error
    return _callable(f"{key}={where}", found, name)


def _callable(asked: str, module: Any, name: str) -> Callable[..., Any]:
    found = getattr(module, name, None)
    if not callable(found):
        offered = sorted(n for n, v in vars(module).items() if callable(v) and n[0] != "_")
        raise ValueError(f"{asked}: there is no {name!r}; found: {', '.join(offered) or 'nothing'}")
    made: Callable[..., Any] = found
    return made
