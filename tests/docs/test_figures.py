"""The picture of the methods: drawn from the published rows, and small."""

from __future__ import annotations

import re
from pathlib import Path

from PIL import Image

from docs.site import curves, figures
from docs.site.page import Page

LARGEST = 300_000
"""Bytes of a picture that a clone holds."""


def source(path: Path) -> str:
    with Image.open(path) as picture:
        return str(picture.text[figures.SOURCE])


def test_the_committed_picture_is_of_the_published_rows():
    assert source(figures.PICTURE) == figures.digest(), "draw it: python -m docs.site.figures"
    assert figures.PICTURE.stat().st_size < LARGEST


def test_a_picture_names_the_rows_that_it_shows(tmp_path: Path):
    figures.draw(tmp_path / "new" / "curves.png")
    assert source(tmp_path / "new" / "curves.png") == figures.digest()


def test_the_curves_of_the_results_are_drawn_where_the_page_shows_them():
    page = Page.read(figures.RESULTS / "README.md")
    shown = re.findall(r"!\[.*over (.*), mean.*\]\((.*)\)", curves.of_results(page))
    assert [label for label, _ in shown] == [
        "environment frames",
        "simulator steps",
        "wall time (min)",
    ]
    for _, place in shown:
        assert (page.path.parent / place).stat().st_size > 5000
