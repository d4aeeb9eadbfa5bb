"""The order of the site: which pages stand under which heading."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path, PurePosixPath

from docs.site import lab
from docs.site.page import Page
from docs.site.places import BENCHMARKS, DOCS

Entry = dict[str, object]
HEADINGS = {
    "Tutorials": ("tutorial/*.md",),
    "How-tos": ("howto/*.md",),
    "Methods": ("methods/*.md",),
    "Reference": ("reference/*.md", "metrics.md", "versions.md"),
    "Explanation": ("explanation/*.md", "presets.md", "performance.md", "reliability.md"),
    "Results": ("results/*.md", "results/tasks/*.md", "results/manner/*.md"),
}
FIRST = ("index.md", "README.md", "first-run.md")


def navigation(api: Sequence[PurePosixPath]) -> list[Entry]:
    """Headings with their pages, as the configuration of the site has them.

    Args:
        api: Generated pages of the Python interface.
    """
    found: list[Entry] = [{"Home": "index.md"}]
    for heading, patterns in HEADINGS.items():
        paths = [path for pattern in patterns for path in sorted(DOCS.glob(pattern), key=_order)]
        entries: list[Entry] = [_entry(path) for path in paths if _shown(path)]
        if heading == "Reference":
            entries.append({"Python": [{place.stem: str(place)} for place in api]})
        if heading == "Results":
            machines = ("Benchmarks", "Benchmarks, a second machine")
            named = zip(machines, BENCHMARKS.values(), strict=True)
            entries += [{name: str(place)} for name, place in named]
        found.append({heading: entries})
    notes: list[Entry] = [_entry(note.path) for note in lab.notes()]
    found.append({"Lab": [_entry(DOCS / "lab" / "README.md"), *notes]})
    project: list[Entry] = [{"Contributing": "contributing.md"}, {"Changelog": "changelog.md"}]
    found.append({"Project": [*project, {"Security": "security.md"}]})
    return found


def _order(path: Path) -> tuple[bool, str]:
    return path.name not in FIRST, path.name


def _shown(path: Path) -> bool:
    """Tables that another page shows whole are no entry of their own."""
    return not (path.parent.name == "results" and path.name in ("summary.md", "tables.md"))


def _entry(path: Path) -> Entry:
    return {Page.read(path).title: path.relative_to(DOCS).as_posix()}
