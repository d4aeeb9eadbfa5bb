"""Pages of methods: every variant has one, and what they name is there."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from docs.site import new_page, variants
from docs.site.links import LINK
from docs.site.page import Page
from docs.site.places import DOCS, ROOT, pages
from docs.site.symbols import lines
from pipeline.commands import settings
from pipeline.renamed import REMOVED, RENAMED

PAGES = [path for path in sorted((DOCS / "methods").glob("*.md")) if path.name != "README.md"]
TELLING = [
    path
    for path in pages()
    if path.is_relative_to(DOCS) and path.parts[len(DOCS.parts)] in
    ("methods", "lab", "explanation", "tutorial", "presets.md")
]  # fmt: skip
"""Pages in which code in the text that looks like a key is one."""
KEY = re.compile(r"`([a-z_]+(?:\.[a-z_]+)+)(?:[=:][^`]*)?`")
SYMBOL = re.compile(r"\[`([A-Za-z_.]+)`\]\(([^)\s#]+\.py)\)")
FILES = ("json", "jsonl", "csv", "yaml")
"""Ends of names that look like keys: evaluation.json."""
WATCH = re.compile(r"## Metrics to watch\n(.*?)\n## ", re.DOTALL)
HEADINGS = [
    "Objective", "Configuration", "In the code", "Metrics to watch", "Results",
    "Departures from the paper",
]  # fmt: skip
MARKS = {"variant-yaml", "results", "curve", "cells", "departures"}


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def test_every_variant_has_its_page():
    told = [name for path in PAGES for name in Page.read(path).about["variants"]]
    assert sorted(told) == sorted(variants.variant_files()), (
        "one page for each variant: begin it with python -m docs.site.new_page NAME"
    )


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_a_page_has_every_part(path: Path):
    text = path.read_text()
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == HEADINGS
    assert set(re.findall(r"<!-- generated: ([\w-]+) -->", text)) == MARKS
    assert "```math" in text


@pytest.mark.parametrize("path", TELLING, ids=named)
def test_keys_that_a_page_names_exist(path: Path):
    known = settings.keys()
    sections = {key.split(".")[0] for key in known if "." in key}
    for key in KEY.findall(path.read_text()):
        first, *_, last = key.split(".")
        if first in sections and last not in FILES and key not in {**RENAMED, **REMOVED}:
            assert key in known, key


@pytest.mark.parametrize("path", TELLING, ids=named)
def test_names_that_link_to_code_are_defined_there(path: Path):
    for name, target in SYMBOL.findall(path.read_text()):
        file = (path.parent / target).resolve()
        assert name in lines(file), f"{name} is not in {target}"


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_a_page_leads_to_code(path: Path):
    text = path.read_text().split("## In the code")[1].split("\n## ")[0]
    assert any(found["target"].endswith(".py") for found in LINK.finditer(text))


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_metrics_to_watch_are_explained(path: Path):
    told = (DOCS / "metrics.md").read_text()
    (part,) = WATCH.findall(path.read_text())
    names = re.findall(r"^- `([\w/]+)`", part, re.MULTILINE)
    assert len(names) >= 3
    for name in names:
        assert f"`{name}`" in told, name


def test_departures_are_those_of_the_files_and_of_their_parents(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    (tmp_path / "one.yaml").write_text("# Deviation: a first\n# part. Undo: x=1.\nx: 2\n")
    (tmp_path / "two.yaml").write_text(
        "# @package _global_\n# Two (somebody, 2020).\n# Deviation: a second.\n"
        "# Deviation: a third.\ndefaults: [one, _self_]\n"
    )
    monkeypatch.setattr(variants, "VARIANTS", tmp_path)
    assert variants.departures(["two"]).splitlines() == [
        "- `two`: a second.",
        "- `two`: a third.",
        "- `one`: a first part. Undo: x=1.",
    ]
    assert variants.comments(tmp_path / "two.yaml")[0] == "Two (somebody, 2020)."


def test_results_of_a_method_are_its_rows_and_the_papers():
    table = variants.results(["dbc_sac"])
    ours, theirs = table.splitlines()[2:]
    assert ours.startswith("| `dbc_sac` | 5 |")
    assert theirs == "| the paper's `dbc_sac` | 1 | - | - | 966.7 | 99.3 % | 94.8 % |  |"
    assert "make rows" in variants.results(["loki"])


def test_a_new_page_has_every_part_and_says_what_is_missing(tmp_path: Path):
    new_page.main("sacfd", tmp_path)
    text = (tmp_path / "sacfd.md").read_text()
    assert re.findall(r"^## (.+)$", text, re.MULTILINE) == HEADINGS
    assert Page.read(tmp_path / "sacfd.md").about["variants"] == ["sacfd"]
    assert "WHAT IT IS" in text
    with pytest.raises(SystemExit, match="is there already"):
        new_page.main("sacfd", tmp_path)
    with pytest.raises(SystemExit, match=r"configs/variant/nobody\.yaml is not there"):
        new_page.main("nobody", tmp_path)


@pytest.mark.parametrize("path", PAGES, ids=named)
def test_a_page_is_filled_in(path: Path):
    assert not re.search(r"\b[A-Z]{4,} [A-Z]{2,} [A-Z]{2,}", path.read_text())
