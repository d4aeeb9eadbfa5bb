"""Keys that had other names: published run directories of before mean what they did.

Command lines know some of them for one release (:data:`ALIASES`).
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any, Final

from pipeline.dotted import flatten, put
from pipeline.settings import SettingsError

RENAMED: Final[Mapping[str, str]] = {
    "env.name": "task.name",
    "env.open_steps": "env.success_steps",
    "demos.end_angle": "demos.end_progress",
    "demos.multiply.min_angle": "demos.multiply.min_progress",
    "loss.angle_bonus": "loss.progress_bonus",
    "loss.bc_emphasis.closed": "loss.bc_emphasis.before",
    "loss.bc_emphasis.open": "loss.bc_emphasis.beyond",
    "loss.bc_emphasis.angle": "loss.bc_emphasis.progress",
    "growth.admission.min_angle": "growth.admission.min_progress",
}
"""New name by old name, each in a ``config.yaml`` of ``docs/results/policies``; values mean the
same."""
IMPLIED: Final[Mapping[str, Mapping[str, object]]] = {
    # The bonus of a door grew up to 1.5 rad, and an angle was what made an episode good.
    "loss.angle_bonus": {"loss.progress_bonus_cap": 1.5},
    "growth.admission.min_angle": {"growth.admission.success": False},
}
"""What else an old key meant."""
REMOVED: Final[Mapping[str, str]] = {"loss.bc_decay": "loss.bc_weight.decay"}
"""Keys that saved runs hold beside the one that has their value where anything reads it."""
ALIASES: Final[Mapping[str, str]] = {"env.name": "task.name", **REMOVED}
"""Those that a command line may still use. One may go one release after it came; ``CHANGELOG.md``
says when that was."""


def require_todays(config: Mapping[str, Any], where: str) -> None:
    """Refuses old names in values that are written today.

    Args:
        config: By key; sections are mappings.
        where: They come from, for the message.

    Raises:
        SettingsError: Naming the old key and today's.
    """
    given = set(flatten(config))
    for old, new in {**RENAMED, **REMOVED}.items():
        if old in given:
            raise SettingsError(f"{where}: there is no {old} any more: set {new}")


def rename_override(override: str) -> str:
    """A ``key=value`` of a command line under today's name; anything else as it is."""
    key, separator, value = override.partition("=")
    return f"{ALIASES[key]}={value}" if separator and key in ALIASES else override


def rename_keys(config: dict[str, Any]) -> dict[str, Any]:
    """A saved configuration under today's names; it is changed in place, too."""
    for old, new in RENAMED.items():
        path, key = old.split(".")[:-1], old.split(".")[-1]
        holder = _holder(config, path)
        if holder is None or key not in holder:
            continue
        put(config, new, holder.pop(key))
        for implied, value in IMPLIED.get(old, {}).items():
            put(config, implied, value)
    for old in REMOVED:
        *path, key = old.split(".")
        if holder := _holder(config, path):
            holder.pop(key, None)
    return config


def _holder(config: dict[str, Any], path: list[str]) -> dict[str, Any] | None:
    for name in path:
        found = config.get(name)
        if not isinstance(found, dict):
            return None
        config = found
    return config
