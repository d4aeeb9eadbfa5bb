"""Documents say what the code says, lead somewhere, and can be read in a terminal."""

from __future__ import annotations

import re
import shutil
import subprocess
from dataclasses import fields
from pathlib import Path

import pytest

from docs.site.places import FRONT, ROOT, pages
from envs.door.metrics import DoorMetrics
from pipeline.act.metrics import EpisodeMetrics
from pipeline.data.demonstrations import DemosSettings
from pipeline.renamed import IMPLIED, RENAMED

WIDTH = 100
NUMBERS = 3
"""In a paragraph, at most: more is a table's, and a table is made from data."""
EXCEPTIONS: dict[str, str] = {}
"""Pages with longer paragraphs of numbers, and why. None is left."""
GENERATED = ("summary.md", "tables.md", "latest.md", "report.md")
"""Written by a command from data: tables, whatever their width."""
DOCUMENTS = [path for path in pages() if path.name not in GENERATED]
CODE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
LINK = re.compile(r"\]\(([^)\s]+)\)")
CHANGELOG = ROOT / "CHANGELOG.md"
PRESETS = ROOT / "docs" / "presets.md"
# Where old names stand beside today's, for those who look them up.
OF_BEFORE = {PRESETS: "| `{}` |", CHANGELOG: "(was `{}`)"}


def named(path: Path) -> str:
    return str(path.relative_to(ROOT))


def anchors(text: str) -> set[str]:
    """Of the headings, as GitHub makes them."""
    headings = re.findall(r"^#+ (.+)$", CODE.sub("", text), re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).replace(" ", "-") for heading in headings}


def paragraphs(text: str) -> list[str]:
    """Paragraphs and items of lists, without front matter, code, tables and marks."""
    text = re.sub(r"\A---\n.*?\n---\n", "", text, flags=re.DOTALL)
    text = re.sub(
        r"^```.*?^```|<!--.*?-->|^\|.*?$|^#.*?$", "", text, flags=re.DOTALL | re.MULTILINE
    )
    return [part for part in re.split(r"\n\s*\n|\n(?=\s*(?:-|\d+\.) )", text) if part.strip()]


def numbers(paragraph: str) -> list[str]:
    """Those that a reader meets: not of names, addresses, years, code and items of a list."""
    plain = re.sub(r"`[^`]*`|\]\([^)]*\)|^\s*\d+\. |arXiv:[\d.]+|\b(?:19|20)\d\d\b", "", paragraph)
    return re.findall(r"(?<![\w.,-])\d[\d.,]*", plain)


def test_there_is_more_than_the_front():
    assert len(DOCUMENTS) > len(FRONT) + 40


@pytest.mark.parametrize("path", DOCUMENTS, ids=named)
def test_links_lead_somewhere(path: Path):
    for link in LINK.findall(CODE.sub("", path.read_text())):
        if link.startswith(("http://", "https://")):
            continue
        file, _, anchor = link.partition("#")
        target = (path.parent / file).resolve() if file else path
        assert target.exists(), link
        if anchor:
            assert anchor in anchors(target.read_text()), link


@pytest.mark.parametrize("path", DOCUMENTS, ids=named)
def test_prose_fits_a_terminal(path: Path):
    for line in CODE.sub("", path.read_text()).splitlines():
        assert len(line) <= WIDTH or line.startswith(("|", "#")), line


@pytest.mark.parametrize("path", DOCUMENTS, ids=named)
def test_no_paragraph_is_a_wall_of_numbers(path: Path):
    if named(path) in EXCEPTIONS:
        return
    for paragraph in paragraphs(path.read_text()):
        assert len(numbers(paragraph)) <= NUMBERS, paragraph


def test_an_exception_is_still_one():
    for name in EXCEPTIONS:
        found = paragraphs((ROOT / name).read_text())
        assert any(len(numbers(part)) > NUMBERS for part in found), f"{name} needs no exception"


def test_numbers_of_code_lists_and_addresses_do_not_count():
    text = "2. Of 25 and 1,000 at [0.5](a/7.md), `x=3` in 2019 (arXiv:1709.10089), bc_sac_10.\n"
    assert paragraphs("# 9 lives\n\n| 1 | 2 |\n\n" + text + "- item 4\n- item 5") == [
        text.strip(),
        "- item 4",
        "- item 5",
    ]
    assert [part.strip(".,") for part in numbers(text)] == ["25", "1,000", "0.5"]


def test_a_change_is_one_line():
    changes = CHANGELOG.read_text().split("## [Unreleased]")[1].splitlines()
    for line in changes:
        assert not line or line.startswith(("- ", "## ", "### ")), f"goes on over a line: {line}"


@pytest.mark.parametrize("path", DOCUMENTS, ids=named)
def test_options_have_todays_names(path: Path):
    text = path.read_text()
    for old in RENAMED:
        if path in OF_BEFORE:
            text = text.replace(OF_BEFORE[path].format(old), "")
        assert not re.search(rf"(?<![\w.]){re.escape(old)}(?!\w)", text), old


def test_the_table_of_old_names_is_complete():
    rows = re.findall(r"^\| `([\w.]+)` \| `([\w.]+)` \|(.*)\|$", PRESETS.read_text(), re.MULTILINE)
    assert {old: new for old, new, _ in rows} == dict(RENAMED)
    for old, _, also in rows:
        implied = [f"`{key}={value}`" for key, value in IMPLIED.get(old, {}).items()]
        assert also.split() == implied, old


def test_every_figure_of_an_evaluation_is_explained():
    told = (ROOT / "docs" / "metrics.md").read_text()
    of_every_task, of_the_door = told.split("### Of the door")
    for metrics, text in ((EpisodeMetrics, of_every_task), (DoorMetrics, told)):
        for name in (field.name for field in fields(metrics)):
            assert name.endswith("_ci95") or f"`{name}`" in text, name
    assert "`angle_mean_deg`" in of_the_door


def test_where_training_stops_at_a_refused_episode_the_option_that_goes_on_is_named():
    assert not DemosSettings().skip_refused
    found = {
        named(path): part
        for path in DOCUMENTS
        for part in paragraphs(path.read_text())
        if "demos-check" in part and "where training would" in " ".join(part.split())
    }
    assert found.keys() == {"docs/reference/demonstrations.md", "docs/tutorial/your-task.md"}
    for name, part in found.items():
        assert "unless `demos.skip_refused=true` leaves" in " ".join(part.split()), name


@pytest.mark.parametrize("key", ["bc_nll", "bc_nll_train", "bc_nll_held_out"])
def test_the_unit_of_an_imitation_error_is_told_by_its_kind(key: str):
    text = (ROOT / "docs" / "metrics.md").read_text()
    (row,) = re.findall(rf"^\|[^|]*`{key}`[^|]*\|([^|]*)\|", text, re.MULTILINE)
    assert row.strip() == "nats; with `loss.imitation=mse` squared units of the action"


@pytest.mark.parametrize("path", DOCUMENTS, ids=named)
def test_what_is_said_to_be_in_the_history_is_there(path: Path):
    git = shutil.which("git")
    named_objects = re.findall(r"git show (\S+?)[`\s]", path.read_text())
    if named_objects and (git is None or not _whole_history(git)):
        pytest.skip("a copy without the history")
    for name in named_objects:
        found = subprocess.run([git, "cat-file", "-e", name], cwd=ROOT, check=False)
        assert found.returncode == 0, name


def _whole_history(git: str) -> bool:
    asked = [git, "rev-parse", "--is-shallow-repository"]
    told = subprocess.run(asked, cwd=ROOT, capture_output=True, text=True, check=False)
    return told.stdout.strip() == "false"
