"""Links of a page, which lead to files of the repository, as links within the site.

A link to a page leads to its place, a link to code to a page of that file, and where the link's
words are a name that the file defines, to its line.
"""

from __future__ import annotations

import re
import shutil
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath

from docs.site import symbols
from docs.site.page import Page, outside_code
from docs.site.places import ROOT, relative

LINK = re.compile(r"\[(?P<words>[^\[\]]*)\]\((?P<target>[^)\s]+)\)")
OUTWARD = ("http://", "https://", "mailto:")
PICTURES = (".png", ".svg")
LANGUAGES = {".py": "python", ".yaml": "yaml", ".toml": "toml", ".json": "json", ".md": "markdown"}
LARGEST = 100_000
"""Bytes of a file that is shown as a page; of a larger one only the name is."""
LINE = "__codelineno-0-{}"
"""The anchor of a line, as pymdownx.highlight makes it in a page of one block."""


class DeadLinkError(ValueError):
    """A link leads nowhere; the message names page and link."""


@dataclass
class Linker:
    """Rewrites the links of pages and keeps which files they lead to.

    Attributes:
        pages: place in the site of every page.
        files: place of every other file that a page leads to.
    """

    pages: dict[Path, PurePosixPath]
    files: dict[Path, PurePosixPath] = field(default_factory=dict)

    def rewritten(self, page: Page, text: str) -> str:
        """``text`` of ``page`` with links within the site.

        Raises:
            DeadLinkError: A link leads nowhere.
        """
        return outside_code(text, lambda part: LINK.sub(lambda m: self._link(page, m), part))

    def _link(self, page: Page, found: re.Match[str]) -> str:
        words, target = found["words"], found["target"]
        if target.startswith((*OUTWARD, "#")):
            return found[0]
        file, _, anchor = target.partition("#")
        path = (page.path.parent / file).resolve()
        if not path.exists():
            raise DeadLinkError(f"{page.path}: [{words}]({target}) leads nowhere")
        here = self.pages[page.path]
        if path in self.pages:
            to = relative(self.pages[path], here) + (f"#{anchor}" if anchor else "")
            return f"[{words}]({to})"
        if path.is_dir() and path / "README.md" in self.pages:
            return f"[{words}]({relative(self.pages[path / 'README.md'], here)})"
        place = self._place(path)
        if place is None:
            return words
        line = symbol_line(path, words)
        to = relative(place, here) + (f"#{LINE.format(line)}" if line else "")
        return f"[{words}]({to})"

    def _place(self, path: Path) -> PurePosixPath | None:
        if path.is_dir() or not path.is_relative_to(ROOT):
            return None
        name = path.relative_to(ROOT).as_posix()
        if path.suffix in PICTURES:
            return self.files.setdefault(path, PurePosixPath("files") / name)
        if path.stat().st_size > LARGEST or path.suffix in (".h5", ".parquet", ".safetensors"):
            return None
        return self.files.setdefault(path, PurePosixPath("source") / f"{name}.md")

    def write_files(self, out: Path) -> None:
        """Pages of the files that links lead to, and pictures, below ``out``."""
        for path, place in self.files.items():
            (out / place).parent.mkdir(parents=True, exist_ok=True)
            if place.parts[0] == "files":
                shutil.copyfile(path, out / place)
            else:
                (out / place).write_text(source_page(path))


def symbol_line(path: Path, words: str) -> int | None:
    """Line of the name that a link's words are, if its target defines it."""
    if path.suffix != ".py" or not words.startswith("`"):
        return None
    return symbols.lines(path).get(words.strip("`"))


def source_page(path: Path) -> str:
    """A page that shows a file, each line with an anchor."""
    name = path.relative_to(ROOT).as_posix()
    text = path.read_text().replace("--8<--", ";--8<--")
    language = LANGUAGES.get(path.suffix, "text")
    head = f"---\nsearch:\n  exclude: true\n---\n# `{name}`\n\n"
    return f'{head}```````{language} linenums="1"\n{text.rstrip()}\n```````\n'
