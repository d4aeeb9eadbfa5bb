"""docs/tutorial/first-run.md: its commands as they stand, and the files that it names."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

from tests.docs.shell import ROOT, Shell

TUTORIAL = ROOT / "docs" / "tutorial" / "first-run.md"
RUN = re.compile(r"<!-- run:(\w+) -->\n```\w*\n(.*?)```", re.DOTALL)
FILES = re.compile(r"^\| `([\w./]+)` \|", re.MULTILINE)
LINKED = (
    "Makefile", "bcsac.py", "configs", "constraints.txt", "envs", "losses", "pipeline",
    "pyproject.toml",
)  # fmt: skip
CHAPTERS = ["train", "eval", "look", "change"]


@pytest.fixture(scope="module")
def clone(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder in which ``make`` is this repository's, and where nothing of a user's lies."""
    made = tmp_path_factory.mktemp("clone")
    for name in LINKED:
        (made / name).symlink_to(ROOT / name)  # not copied: make compares ages
    return made


@pytest.fixture(scope="module")
def said(clone: Path, shell: Shell) -> dict[str, str]:
    return {
        chapter: shell.run(commands, clone)
        for chapter, commands in RUN.findall(TUTORIAL.read_text())
    }


def test_every_chapter_runs(said: dict[str, str]):
    assert list(said) == CHAPTERS


def test_the_run_holds_the_files_that_the_table_names(said: dict[str, str], clone: Path):
    names = FILES.findall(TUTORIAL.read_text())
    assert len(names) == 5
    for name in names:
        assert (clone / "runs" / "first" / name).exists(), name


def test_what_the_last_chapter_changes_is_in_the_second_run(said: dict[str, str], clone: Path):
    weights = [
        re.search(r"bc_weight:\n(?:.*\n)*?\s+init: ([\d.]+)", text)
        for text in ((clone / "runs" / n / "config.yaml").read_text() for n in ("first", "second"))
    ]
    assert [float(found[1]) for found in weights if found] == [1.0, 10.0]


def test_the_evaluation_and_the_pictures_are_there(said: dict[str, str], clone: Path):
    evaluation = json.loads((clone / "runs" / "first" / "evaluation.json").read_text())
    assert evaluation["episodes"] == 20
    assert (clone / "runs" / "first" / "diagnostics.png").is_file()
    assert (clone / "runs" / "report" / "index.html").is_file()
