"""The directory of a run: configuration, versions, logs, checkpoints, evaluations."""

from __future__ import annotations

import importlib.metadata
import json
import os
import platform
import subprocess
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf
from omegaconf.errors import OmegaConfBaseException
from yaml import YAMLError

from configs.schema import Config

CONFIG = "config.yaml"
VERSIONS = "versions.json"
LEARNING_CURVE = "learning_curve.jsonl"
ALARMS = "alarms.jsonl"
EVALUATION = "evaluation.json"
PACKAGES = ("torch", "torchrl", "tensordict", "mujoco", "dm-control", "gymnasium", "numpy")


class RunDirectoryError(ValueError):
    """The run directory cannot be used; the message names it and the remedy."""


def create_run_dir(path: Path, config: Config) -> None:
    """Makes a new run directory and writes the resolved configuration and versions into it.

    Raises:
        RunDirectoryError: If it exists already or cannot be written.
    """
    if path.exists():
        raise RunDirectoryError(
            f"Run directory {path} exists. Continue it with RESUME={path}, or choose another with "
            "RUN=<new directory>."
        )
    try:
        path.mkdir(parents=True)
        write_atomically(path / VERSIONS, json.dumps(versions(), indent=2) + "\n")
        save_config(path, config)
    except OSError as error:
        raise RunDirectoryError(
            f"Run directory {path} cannot be written ({error.strerror}); choose another with RUN=."
        ) from error


def save_config(path: Path, config: Config) -> None:
    """Writes the resolved configuration: of a new run, or of one resumed with other values."""
    write_atomically(path / CONFIG, OmegaConf.to_yaml(config, resolve=True))


def load_config(run_dir: Path, overrides: list[str] | None = None) -> Config:
    """Reads the configuration of a run, with command-line overrides on top.

    Raises:
        RunDirectoryError: If there is none, it is damaged, or an override names an unknown key.
    """
    path = run_dir / CONFIG
    if not path.is_file():
        raise RunDirectoryError(f"{run_dir} is not a run directory: it holds no {CONFIG}.")
    try:
        schema = OmegaConf.structured(Config)
        merged = OmegaConf.merge(
            schema, OmegaConf.load(path), OmegaConf.from_dotlist(overrides or [])
        )
    except (OmegaConfBaseException, YAMLError) as error:
        raise RunDirectoryError(
            f"{path} with overrides {overrides or []} does not fit the schema: {error}"
        ) from error
    return merged  # type: ignore[return-value]  # OmegaConf types the merge of a dataclass loosely


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


def write_atomically(path: Path, text: str) -> None:
    """Writes ``text`` so that a reader sees the old file or the new one, never a part."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.tmp")
    try:
        temporary.write_text(text)
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


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
