"""Every departure from the paper that code and presets mark, with the line that makes it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

from docs.site.places import ROOT
from docs.site.tables import table

MARK = "Deviation:"
PLACES = ("configs/preset", "configs/variant", "losses", "envs", "pipeline")
SUFFIXES = (".py", ".yaml")


def render(folder: Path) -> str:
    """A table of all of them; links are relative to ``folder``."""
    up = "../" * len(folder.relative_to(ROOT).parts)
    lines = (
        (text, f"[{path.relative_to(ROOT)}]({up}{path.relative_to(ROOT)})")
        for path in _files()
        for text in marked(path.read_text())
    )
    return table(("what departs, and what undoes it", "where"), lines)


def marked(text: str) -> Iterator[str]:
    """The paragraphs of comments and docstrings that begin with the mark, each on one line."""
    lines = [re.sub(r"^\s*#? ?", "", line).strip() for line in text.splitlines()]
    comment = [line.lstrip().startswith("#") for line in text.splitlines()]
    for number, line in enumerate(lines):
        if not line.startswith(MARK):
            continue
        found = [line.removeprefix(MARK).strip()]
        for then, alike in zip(lines[number + 1 :], comment[number + 1 :], strict=True):
            if alike != comment[number] or not then or then.startswith((MARK, '"""')):
                break
            found.append(then)
        yield " ".join(found).removesuffix('"""').strip()


def _files() -> Iterator[Path]:
    for place in PLACES:
        yield from sorted(path for path in (ROOT / place).rglob("*") if path.suffix in SUFFIXES)
