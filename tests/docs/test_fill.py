"""Text that is generated and committed too: current, and replaced when the site is built."""

from __future__ import annotations

from pathlib import Path

import pytest

from docs.site import directives
from docs.site.directives import expanded
from docs.site.fill import FILLED, filled
from docs.site.page import Page
from docs.site.places import ROOT, pages
from pipeline.files.run_files import write_atomically


def filled_again(path: Path) -> str:
    return filled(path.read_text(), Page.read(path))


MARKED = [
    path
    for path in pages()
    if any(f"\n<!-- generated: {name} -->\n" in path.read_text() for name in FILLED)
]


@pytest.mark.parametrize("path", MARKED, ids=lambda path: str(path.relative_to(ROOT)))
def test_what_is_committed_is_current(path: Path):
    assert path.read_text() == filled_again(path), "write it with: python -m docs.site.fill"


def test_every_one_of_them_stands_somewhere():
    texts = [path.read_text() for path in MARKED]
    for name in FILLED:
        assert any(f"<!-- end: {name} -->" in text for text in texts), name


def test_the_site_has_it_once_and_today_s(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    """Old text between a mark and its end is replaced, other marks and what follows stay."""
    made = {"formats": lambda _page: "| new |", "cli": lambda _page: "options"}
    monkeypatch.setattr(directives, "DIRECTIVES", made)
    monkeypatch.setattr("docs.site.fill.DIRECTIVES", made)
    path = tmp_path / "page.md"
    path.write_text(
        "Before\n\n<!-- generated: formats -->\n| old |\n<!-- end: formats -->\n\nBetween\n\n"
        "<!-- generated: cli -->\n\n<!-- generated: formats -->\n\nAfter\n"
    )
    page = Page.read(path)
    assert expanded(page) == "Before\n\n| new |\n\nBetween\n\noptions\n\n| new |\n\nAfter\n"
    once = filled(path.read_text(), page)
    new = "<!-- generated: formats -->\n| new |\n<!-- end: formats -->"
    assert once == f"Before\n\n{new}\n\nBetween\n\n<!-- generated: cli -->\n\n{new}\n\nAfter\n"
    write_atomically(path, once)
    assert filled_again(path) == once
