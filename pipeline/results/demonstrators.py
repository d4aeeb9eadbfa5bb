"""Who made a file of demonstrations, and how many episodes it holds.

A recording of this project tells both in its card. Files of others do not: those that are published
are listed by their checksum, in a YAML file beside the table.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import yaml

from envs.demonstrations import DemonstrationError
from envs.demonstrations.readers.recording import read_card
from pipeline.files.run_files import RunDirectoryError
from pipeline.results.evaluation import MadeFrom

FILE: Final = "demonstrations.yaml"
MAKERS: Final = ("human", "robot")


@dataclass(frozen=True)
class Demonstrators:
    """Of one file; None where nobody tells."""

    by: str | None = None
    episodes: int | None = None


def read_listed(path: Path) -> dict[str, Demonstrators]:
    """The files of others by SHA-256 (hex); none where there is no list.

    Raises:
        RunDirectoryError: If an entry is not ``{by: human|robot, episodes: COUNT}``.
    """
    content = yaml.safe_load(path.read_text()) if path.is_file() else {}
    found = {}
    for key, entry in (content or {}).items():
        told = entry if isinstance(entry, Mapping) else {}
        by, episodes = told.get("by"), told.get("episodes")
        if by not in MAKERS or not isinstance(episodes, int) or episodes < 1:
            raise RunDirectoryError(
                f"{path}: {key} must say by: {' or '.join(MAKERS)}, and episodes: a count"
            )
        found[str(key)] = Demonstrators(by, episodes)
    return found


def demonstrators(
    made_from: MadeFrom, limit: int | None, listed: Mapping[str, Demonstrators]
) -> Demonstrators:
    """Of the demonstrations that an evaluated run was given.

    Args:
        made_from: Of its evaluation: source and checksum.
        limit: The first so many were taken; None is all.
        listed: Files of others.
    """
    found = listed.get(str(made_from.demos_sha256))
    if found is None:
        found = _of_recording(Path(str(made_from.demos)))
    if limit is None or found.episodes is None:
        return found
    return Demonstrators(found.by, min(limit, found.episodes))


def _of_recording(path: Path) -> Demonstrators:
    """What the card says: a policy or a controller acted."""
    try:
        return Demonstrators("robot", int(read_card(path)["kept"]))
    except (DemonstrationError, OSError, KeyError, TypeError, ValueError):
        return Demonstrators()  # none of ours, or no longer there
