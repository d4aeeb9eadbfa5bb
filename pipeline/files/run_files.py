"""The files of a run directory, and how they are written."""

from __future__ import annotations

import hashlib
import importlib.metadata
import json
import math
import os
import platform
import subprocess
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from envs.whole_files import whole_file

CONFIG = "config.yaml"
HISTORY = "history"
"""In that file, beside the values: when a resume changed which of them."""
PLACES = ("run_dir", "resume")
"""Keys of a command line that say where a run is and not what it is."""
VERSIONS = "versions.json"
LEARNING_CURVE = "learning_curve.jsonl"
CHECKPOINTS = "checkpoints"
ALARMS = "alarms.jsonl"
EVALUATION = "evaluation.json"
TRUST = "TRUST"
"""Environment variable, and variable of make: 1 trusts what a run directory asks to import."""
PACKAGES = ("torch", "torchrl", "tensordict", "mujoco", "dm-control", "gymnasium", "numpy")

SUM = "# sha256 of all below: "
TEXT_BYTES = 2**20
"""No configuration is as large."""


class RunDirectoryError(ValueError):
    """The run directory cannot be used; the message names it and the remedy."""


def config_of(run_dir: Path) -> Path:
    """``config.yaml`` of a run directory.

    Raises:
        RunDirectoryError: If there is none.
    """
    path = run_dir / CONFIG
    if not path.exists() and not path.is_symlink():
        raise RunDirectoryError(f"{run_dir} is not a run directory: it holds no {CONFIG}.")
    return path


def versions() -> dict[str, Any]:
    """Packages, interpreter, machine and git revision."""
    found: dict[str, str | None] = {}
    for package in PACKAGES:
        try:
            found[package] = importlib.metadata.version(package)
        except importlib.metadata.PackageNotFoundError:
            found[package] = None
    return {
        "packages": found,
        "python": platform.python_version(),
        "machine": f"{platform.system()} {platform.machine()}, {os.cpu_count()} cores",
        "git": _git("rev-parse", "HEAD"),
        "git_dirty": bool(_git("status", "--porcelain")),
    }


def write_atomically(path: Path, text: str | bytes) -> None:
    """Writes ``text`` so that a reader sees the old file or the new one, never a part.

    So does one after a power cut. Bytes are written as they are.

    Raises:
        OSError: If it cannot be written; it names ``path``.
    """
    with whole_file(path) as temporary:
        temporary.write_bytes(text.encode() if isinstance(text, str) else text)


def with_sum(text: str) -> str:
    """``text`` behind a comment with its checksum, for :func:`read_summed`."""
    return f"{SUM}{_sum(text)}\n{text}"


def read_summed(path: Path) -> str:
    """A text that :func:`with_sum` made; others, of before, are read as they are.

    Raises:
        RunDirectoryError: If it is too large, no text, or not what its checksum is of.
    """
    if path.stat().st_size > TEXT_BYTES:
        raise RunDirectoryError(f"{path} is larger than any that this project writes; restore it.")
    try:
        first, _, text = path.read_text().partition("\n")
    except UnicodeDecodeError as error:
        raise RunDirectoryError(f"{path} is damaged ({error}); restore the file.") from error
    if not first.startswith(SUM):
        return f"{first}\n{text}"
    if first != f"{SUM}{_sum(text)}":
        raise RunDirectoryError(
            f"{path} is not as it was written: it is damaged, or was edited. Restore it, and give "
            "other values on the command line; if an edit is meant, remove its first line."
        )
    return text


def _sum(text: str) -> str:
    return hashlib.sha256(text.encode()).hexdigest()


def as_json(value: Any, **options: Any) -> str:
    """``value`` as JSON, which has no NaN and no infinity: what is not finite is null."""
    return json.dumps(_with_null(value), allow_nan=False, **options)


def _with_null(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, Mapping):
        return {key: _with_null(entry) for key, entry in value.items()}
    if isinstance(value, (list, tuple)):
        return [_with_null(entry) for entry in value]
    return value


def _git(*arguments: str) -> str | None:
    try:
        done = subprocess.run(
            ["git", *arguments],
            cwd=Path(__file__).parent,
            capture_output=True,
            text=True,
            check=True,
            timeout=10,
        )
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip()
