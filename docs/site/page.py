"""A page of Markdown: its front matter, its text, and what is code in it."""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

FRONT_MATTER = re.compile(r"\A---\n(.*?)\n---\n", re.DOTALL)
FENCE = re.compile(r"^```.*?^```$", re.DOTALL | re.MULTILINE)
TITLE = re.compile(r"^# (.+)$", re.MULTILINE)


@dataclass(frozen=True)
class Page:
    """One file of Markdown.

    Attributes:
        path: of the file.
        about: its front matter; empty without one.
        text: what follows.
    """

    path: Path
    about: Mapping[str, Any]
    text: str

    @classmethod
    def read(cls, path: Path) -> Page:
        """Reads a file.

        Raises:
            ValueError: Its front matter is no mapping.
        """
        text = path.read_text()
        found = FRONT_MATTER.match(text)
        if found is None:
            return cls(path, {}, text)
        about = yaml.safe_load(found[1])
        if not isinstance(about, dict):
            raise ValueError(f"{path}: its front matter is no mapping of keys to values")
        return cls(path, about, text[found.end() :])

    @property
    def title(self) -> str:
        """The first heading, without marks of code."""
        found = TITLE.search(FENCE.sub("", self.text))
        return found[1].replace("`", "") if found else self.path.stem


def outside_code(text: str, change: Callable[[str], str]) -> str:
    """``text`` with ``change`` made to what is not between fences."""
    parts, end = [], 0
    for fence in FENCE.finditer(text):
        parts += [change(text[end : fence.start()]), fence[0]]
        end = fence.end()
    return "".join([*parts, change(text[end:])])
