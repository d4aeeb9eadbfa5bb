"""``python -m docs.site.fill``: writes generated text into the pages where it is committed too.

The site is built without it. On a page of the repository a mark shows nothing, so that a list that
readers need there stands between its mark and ``<!-- end: NAME -->``; a test says when it is not
what the code or the data say.
"""

from __future__ import annotations

from typing import Final

from docs.site.directives import DIRECTIVES, MARK
from docs.site.page import Page
from docs.site.places import pages
from pipeline.files.run_files import write_atomically

FILLED: Final = ("formats", "methods", "presets", "results-summary")
"""Directives whose text is committed."""


def filled(text: str, page: Page) -> str:
    """``text`` of a page with what the directives of :data:`FILLED` make between their marks.

    Raises:
        ValueError: The page lacks what a directive needs.
    """
    return MARK.sub(
        lambda found: (
            f"<!-- generated: {found[1]} -->\n{DIRECTIVES[found[1]](page)}\n"
            f"<!-- end: {found[1]} -->"
            if found[1] in FILLED
            else found[0]
        ),
        text,
    )


def main() -> None:
    """Writes every page that is not current, and names it."""
    for path in pages():
        text = path.read_text()
        current = filled(text, Page.read(path))
        if current != text:
            write_atomically(path, current)
            print(f"written: {path}")  # noqa: T201 - a command's output


if __name__ == "__main__":
    main()
