"""Films that lie in the run directories, inside of the page."""

from __future__ import annotations

import base64
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType
from typing import Final

from pipeline.files import again
from pipeline.report.page import Clip, Section, told_once
from pipeline.results.runs import EvaluatedRun, RunGroup

MOST_BYTES: Final = 3_000_000
"""Of one film."""
TOTAL_BYTES: Final = 15_000_000
"""Of all films of a page."""
KINDS: Final[Mapping[str, str]] = MappingProxyType({".mp4": "video/mp4", ".gif": "image/gif"})


def films(rows: Sequence[RunGroup]) -> Section:
    """What ``make video`` left in the run directories, as long as it is short."""
    clips: list[Clip] = []
    lacking: dict[str, str] = {}
    room = TOTAL_BYTES
    video, shorter = (again.command("video", "...", {}, EPISODES=n) for n in ("", 1))
    runs = [run for row in rows for run in row.runs]
    for run in runs:
        found = _films_of(run)
        if not found:
            lacking[run.name] = f"no film in the run's folder; make one with: {video}"
        for path in found:
            size = path.stat().st_size
            if size > MOST_BYTES:
                lacking[f"{run.name}/{path.name}"] = (
                    f"more than {MOST_BYTES / 1e6:g} MB; a shorter one: {shorter}, or as a GIF"
                )
            elif size > room:
                lacking[f"{run.name}/{path.name}"] = (
                    f"the films before it fill the {TOTAL_BYTES / 1e6:g} MB of a page"
                )
            else:
                room -= size
                clips.append(Clip(f"{run.name}: {path.name}", _data_uri(path)))
    return Section(
        "films",
        "Films",
        "Episodes of the fixed evaluation list, as they are evaluated.",
        clips=clips,
        absent=told_once(lacking, [run.name for run in runs], "runs"),
    )


def _films_of(run: EvaluatedRun) -> list[Path]:
    if not run.path.is_dir():
        return []
    # A link may lead to any file of the reader's.
    return sorted(
        path
        for path in run.path.iterdir()
        if path.suffix.lower() in KINDS and path.is_file() and not path.is_symlink()
        if not path.name.startswith(".")
    )


def _data_uri(path: Path) -> str:
    content = base64.b64encode(path.read_bytes()).decode()
    return f"data:{KINDS[path.suffix.lower()]};base64,{content}"
