"""What the site is made from: settings, commands, links, formulas, and a look at the result."""

from __future__ import annotations

import dataclasses
import re
from pathlib import Path, PurePosixPath

import pytest

from docs.site import check, commands, deviations, evaluation_figures, navigation, symbols
from docs.site.links import DeadLinkError, Linker, source_page
from docs.site.page import Page
from docs.site.places import ROOT, pages, relative
from envs.door.metrics import DoorMetrics
from pipeline.act.metrics import EpisodeMetrics
from pipeline.commands import settings
from pipeline.recipe import Recipe

MAKEFILE = (ROOT / "Makefile").read_text()


def leaves(values: dict[str, object], prefix: str = "") -> set[str]:
    """Dotted keys of nested values."""
    found: set[str] = set()
    for key, value in values.items():
        name = f"{prefix}{key}"
        found |= leaves(value, f"{name}.") if isinstance(value, dict) and value else {name}
    return found


def test_the_reference_has_every_key_of_a_recipe():
    told = {setting.key: setting for section in settings.sections() for setting in section.settings}
    assert set(told) == leaves(Recipe().plain())
    assert told["loss.gamma"].default == "0.99"
    assert told["task.kwargs"].default == "{}"


def test_what_a_setting_means_is_the_comment_beside_it_or_above_it():
    told = {setting.key: setting for section in settings.sections() for setting in section.settings}
    assert told["optim.anneal_actor"].meaning == "cosine from actor_lr to 0 over the run"
    assert told["env.workers"].meaning.startswith("Processes that step copies")
    assert told["env.workers"].meaning.endswith("None = if a step is over 1 ms.")


def test_figures_of_an_evaluation_are_told_with_what_the_code_says():
    told = {name: says for name, _, says in evaluation_figures.fields(EpisodeMetrics)}
    assert list(told) == [field.name for field in dataclasses.fields(EpisodeMetrics)]
    assert told["progress_max_mean"].startswith("mean over episodes of the largest progress; None")
    assert told["success_once"].endswith("The same for the following.")
    of_the_door = {n: s for n, _, s in evaluation_figures.fields(DoorMetrics)}
    assert of_the_door["angle_mean_deg_opened"].endswith("None if there are none.")


def test_every_target_of_make_is_told():
    told = {name for described in commands.targets().values() for name in described}
    phony = set(re.findall(r"^\.PHONY: ([\w-]+)$", MAKEFILE, re.MULTILINE))
    assert told == phony
    assert "| `make docs` | build the documentation site" in commands.render_targets()


def test_every_command_is_told_with_its_options():
    text = commands.render_cli()
    for name in ("eval", "results", "record", "video", "report", "demos-check"):
        assert f"### `bcsac {name}`" in text
    assert "| `--episodes` |" in text
    assert "| `RUN` |" in text


def test_every_page_but_tables_is_in_the_navigation():
    def entries(value: object) -> set[str]:
        if isinstance(value, dict):
            return set().union(*map(entries, value.values()))
        if isinstance(value, list):
            return set().union(*map(entries, value))
        return {str(value)}

    told = entries(navigation.navigation([]))
    shown_within_another = {"results/summary.md", "results/tables.md"}
    assert told == {str(place) for place in pages().values()} - shown_within_another


@pytest.mark.parametrize(
    ("target", "start", "link"),
    [
        ("methods/bc.md", "index.md", "methods/bc.md"),
        ("methods/bc.md", "methods/sac.md", "bc.md"),
        ("index.md", "lab/notes/01-x.md", "../../index.md"),
        ("source/losses/actor.py.md", "methods/bc.md", "../source/losses/actor.py.md"),
    ],
)
def test_a_link_between_two_places(target: str, start: str, link: str):
    assert relative(PurePosixPath(target), PurePosixPath(start)) == link


@pytest.fixture
def repository(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page, and a file of code with a class in its third line."""
    monkeypatch.setattr("docs.site.links.ROOT", tmp_path)
    (tmp_path / "code.py").write_text('"""Doc."""\n\nclass Thing:\n    def act(self): ...\n')
    (tmp_path / "page.md").write_text("# Page\n")
    (tmp_path / "other.md").write_text("# Other\n")
    return tmp_path


@pytest.mark.parametrize(
    ("text", "made"),
    [
        ("[`Thing`](code.py)", "[`Thing`](../source/code.py.md#__codelineno-0-3)"),
        ("[`Thing.act`](code.py)", "[`Thing.act`](../source/code.py.md#__codelineno-0-4)"),
        ("[the file](code.py)", "[the file](../source/code.py.md)"),
        ("[other](other.md#part)", "[other](other.md#part)"),
        ("[out](https://example.org)", "[out](https://example.org)"),
        ("```\n[no](link.md)\n```", "```\n[no](link.md)\n```"),
    ],
)
def test_links_become_links_within_the_site(repository: Path, text: str, made: str):
    page, other = repository / "page.md", repository / "other.md"
    linker = Linker({page: PurePosixPath("a/page.md"), other: PurePosixPath("a/other.md")})
    assert linker.rewritten(Page.read(page), text) == made


def test_departures_are_found_in_comments_and_docstrings():
    text = (
        "# Deviation: one thing,\n# on two lines. Undo: x=1.\n# Deviation: another.\nx = 1\n"
        'def act():\n    """Acts.\n\n    Deviation: it acts\n    otherwise.\n\n    Args:\n    """\n'
    )
    assert list(deviations.marked(text)) == [
        "one thing, on two lines. Undo: x=1.",
        "another.",
        "it acts otherwise.",
    ]


def test_a_dead_link_is_named(repository: Path):
    page = repository / "page.md"
    linker = Linker({page: PurePosixPath("page.md")})
    with pytest.raises(DeadLinkError, match=r"page\.md: \[x\]\(gone\.md\) leads nowhere"):
        linker.rewritten(Page.read(page), "[x](gone.md)")


def test_the_lines_of_a_source_page_are_those_of_the_file(repository: Path):
    shown = source_page(repository / "code.py").split('linenums="1"\n')[1]
    assert shown.splitlines()[2] == "class Thing:"
    assert symbols.lines(repository / "code.py") == {"Thing": 3, "Thing.act": 4}


def test_the_finished_site_is_looked_at(tmp_path: Path):
    (tmp_path / "a.html").write_text(
        '<h1 id="top">A</h1><a href="b.html#there">b</a><a href="b.html#gone">b</a>'
        '<a href="c.html">c</a><a href="#top">t</a><a href="https://example.org">e</a>'
        '<script src="https://example.org/x.js"></script><img src="b.png">'
    )
    (tmp_path / "b.html").write_text('<p id="there">B</p>')
    assert check.problems(tmp_path) == [
        "a.html: loads https://example.org/x.js",
        "a.html: b.html#gone names an anchor that is not there",
        "a.html: c.html leads nowhere",
    ]


def test_every_page_can_be_made(tmp_path: Path):
    pytest.importorskip("latex2mathml", reason="the extra docs is not installed")
    from docs.site.build import build_pages

    build_pages(tmp_path)
    made = (tmp_path / "methods" / "bc_sac.md").read_text()
    assert '--8<-- "configs/variant/bc_sac.yaml"' in made
    assert '<math xmlns="http://www.w3.org/1998/Math/MathML" display="block">' in made
    assert "| `bc_sac_1` | 5 |" in made
    assert "generated:" not in (tmp_path / "lab" / "README.md").read_text()
