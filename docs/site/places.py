"""Where the site's sources lie, and where each of them goes."""

from __future__ import annotations

from pathlib import Path, PurePosixPath
from typing import Final

ROOT: Final = Path(__file__).parents[2]
DOCS: Final = ROOT / "docs"
FRONT: Final = {
    ROOT / "README.md": PurePosixPath("index.md"),
    ROOT / "CONTRIBUTING.md": PurePosixPath("contributing.md"),
    ROOT / "CHANGELOG.md": PurePosixPath("changelog.md"),
    ROOT / "SECURITY.md": PurePosixPath("security.md"),
}
"""Pages of the repository's root, which hosts of repositories look for there."""
BENCHMARKS: Final = {
    ROOT / "benchmarks/results/latest.md": PurePosixPath("results/benchmarks.md"),
    ROOT / "benchmarks/results/second_machine/latest.md": PurePosixPath(
        "results/benchmarks-second-machine.md"
    ),
}
"""What ``make bench`` wrote."""
APART: Final = ("site", "results/policies", "assets")
"""Folders of ``docs`` whose Markdown is no page of the site."""


def pages() -> dict[Path, PurePosixPath]:
    """Every committed page, and its place in the site."""
    found = FRONT | BENCHMARKS
    for path in sorted(DOCS.rglob("*.md")):
        place = path.relative_to(DOCS)
        if not any(place.is_relative_to(folder) for folder in APART):
            found[path] = PurePosixPath(place.as_posix())
    return found


def relative(target: PurePosixPath, start: PurePosixPath) -> str:
    """The link from the page ``start`` to ``target``, both places in the site."""
    here = start.parent.parts
    there = target.parts
    common = 0
    while common < min(len(here), len(there) - 1) and here[common] == there[common]:
        common += 1
    return "/".join([".."] * (len(here) - common) + list(there[common:]))
