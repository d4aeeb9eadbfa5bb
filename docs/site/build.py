"""Pages as they are committed in, pages as the site needs them out."""

from __future__ import annotations

from pathlib import Path

import yaml

from docs.site.directives import expanded
from docs.site.links import Linker
from docs.site.maths import with_mathml
from docs.site.page import Page
from docs.site.places import pages


def build_pages(out: Path) -> None:
    """Writes every page, and the files that pages lead to, below ``out``.

    Raises:
        DeadLinkError: A link leads nowhere.
        ValueError: A mark names no directive, or the page lacks what it needs.
    """
    places = pages()
    linker = Linker(places)
    for path, place in places.items():
        page = Page.read(path)
        text = with_mathml(linker.rewritten(page, expanded(page)))
        head = f"---\n{yaml.safe_dump(dict(page.about))}---\n" if page.about else ""
        (out / place).parent.mkdir(parents=True, exist_ok=True)
        (out / place).write_text(head + text)
    linker.write_files(out)
