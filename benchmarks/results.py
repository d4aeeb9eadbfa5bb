"""The result file: sections measured at different times, on one machine."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from pipeline.files.run_files import write_atomically

JSON_NAME = "latest.json"
MARKDOWN_NAME = "latest.md"


class ResultsError(ValueError):
    """The result file cannot be continued; the message names it and the remedy."""


def load(path: Path) -> dict[str, Any]:
    """The content of a result file; empty if there is none.

    Raises:
        ResultsError: If it is damaged.
    """
    if not path.is_file():
        return {}
    try:
        content = json.loads(path.read_text())
    except json.JSONDecodeError as error:
        raise ResultsError(f"{path} is damaged ({error}); delete it or choose --out") from error
    if not isinstance(content, dict):
        raise ResultsError(f"{path} holds no results; delete it or choose --out")
    return content


def merge(
    old: Mapping[str, Any], new: Mapping[str, Any], machine: Mapping[str, Any]
) -> dict[str, Any]:
    """``old`` with the keys of ``new`` in place of its own.

    Raises:
        ResultsError: If ``old`` was measured on another machine or with other versions: numbers of
            two machines in one table would be compared.
    """
    before = old.get("machine")
    if before is not None and before != machine:
        changed = sorted(key for key in machine if before.get(key) != machine[key])
        raise ResultsError(
            f"the results so far were measured with another {', '.join(changed)}: measure all "
            "sections again (no --section) or choose another --out"
        )
    return {**old, "machine": dict(machine), **new}


def write(path: Path, text: str) -> None:
    """Replaces a file in one step: a reader never sees a part of it."""
    path.parent.mkdir(parents=True, exist_ok=True)
    write_atomically(path, text)
