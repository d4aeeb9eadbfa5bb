"""Python files of a user: the one place where they are imported."""

from __future__ import annotations

import hashlib
import importlib.util
import sys
import traceback
from pathlib import Path
from types import ModuleType
from typing import Final

from bcsac import NAMES
from envs.one_line import kind_and_text

SUFFIX: Final = ".py"
_OF_A_PACKAGE: Final = (
    "a file that is named alone is of no package: say where its package lies with "
    "PYTHONPATH=folder, then import it by its whole name (from mypkg.x import y), or name what the "
    "package registers, TASK=gymnasium:MODULE:ID (docs/howto/your-environment.md)"
)


def split_file(where: str) -> tuple[str, str] | None:
    """Path and name of ``path/to/file.py[:NAME]`` ("" without a name); None for another form."""
    if where.endswith(SUFFIX):
        return where, ""
    path, separator, name = where.rpartition(f"{SUFFIX}:")
    return (path + SUFFIX, name) if separator else None


def import_file(path: str | Path, asked: str, form: str) -> ModuleType:
    """The module of a file, imported once in each process.

    Its name holds a hash of the resolved path, so that files of one name do not collide, nor hide a
    package. The file can import what lies beside it, behind everything that is installed.

    Args:
        path: of the file, from the working directory.
        asked: key and value that ask for it, for messages.
        form: of the value, for messages.

    Raises:
        ValueError: there is no such file, or it cannot be imported.
    """
    file = Path(path).resolve()
    if not file.is_file():
        raise ValueError(
            f"{asked}: there is no file {str(path)!r}; expected {form}, the path from the working "
            f"directory ({Path.cwd()})"
        )
    name = f"bcsac_{file.stem}_{hashlib.sha256(str(file).encode()).hexdigest()[:16]}"
    if name in sys.modules:
        return sys.modules[name]
    spec = importlib.util.spec_from_file_location(name, file)
    if spec is None or spec.loader is None:
        raise ValueError(f"{asked}: {file.name} is no Python file; expected {form}")
    module = importlib.util.module_from_spec(spec)
    if str(file.parent) not in sys.path:
        sys.path.append(str(file.parent))  # last: it must not hide what is installed
    sys.modules[name] = module  # dataclasses and pickle look a class's module up
    try:
        spec.loader.exec_module(module)
    # Whatever a user's file raises is told in one line; SystemExit would end the program silently.
    except (Exception, SystemExit) as error:
        del sys.modules[name]
        hint = f"; {_OF_A_PACKAGE}" if "attempted relative import" in str(error) else ""
        hint = hint or _of_a_shared_name(error, file)
        raise ValueError(f"{asked}: cannot import {told_at(error, file)}{hint}") from error
    return module


def _of_a_shared_name(error: BaseException, file: Path) -> str:
    """The remedy where a user's package has the name of one of ours and is not on the path."""
    name = (error.name or "").partition(".")[0] if isinstance(error, ModuleNotFoundError) else ""
    if name not in NAMES:
        return ""
    folder = next((up.parent for up in file.parents if up.name == name), file.parent)
    return (
        f"; {name} is also a package of this project: put PYTHONPATH={folder} before the command, "
        f"or start bcsac in {folder}"
    )


def told_at(error: BaseException, file: Path) -> str:
    """``file.py, line 3 (KeyError: 'x')``: what a user's file raised, and where in it."""
    if isinstance(error, SyntaxError) and error.filename == str(file):
        return f"{file.name}, line {error.lineno} ({type(error).__name__}: {error.msg})"
    frames = traceback.extract_tb(error.__traceback__)
    lines = [frame.lineno for frame in frames if frame.filename == str(file)]
    at = f", line {lines[-1]}" if lines else ""
    return f"{file.name}{at} ({kind_and_text(error)})"
