"""Entries that name parts of a user's own file: form, settings, and how to type them."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import pytest

from configs import compose
from pipeline.build import build_run
from pipeline.files.run_files import RunDirectoryError
from pipeline.learn.own_terms import TERMS
from pipeline.literals import typed, word
from pipeline.overrides import overridden
from pipeline.recipe import Recipe
from pipeline.run_dir import create_run_dir, load_recipe
from pipeline.settings import SettingsError

FILE = """
class Part:
    def __init__(self, size, *, name="part"):
        self.size, self.name = size, name


def anything(**options):
    return options


def nothing():
    return "made"


def given(context, rows=3):
    return context, rows


def failing(size):
    raise KeyError(size)
"""


@pytest.fixture
def file(tmp_path: Path) -> Path:
    path = tmp_path / "my_parts.py"
    path.write_text(FILE)
    return path


def test_what_stands_beside_the_name_is_passed_on(file: Path):
    part = TERMS.make({"term": f"{file}:Part", "size": 3, "name": "big"})
    assert (part.size, part.name) == (3, "big")
    assert TERMS.make(f"{file}:nothing") == "made"
    assert TERMS.make({"term": f"{file}:anything", "a": [1, "b"]}) == {"a": [1, "b"]}


def test_what_the_run_passes_is_no_setting(file: Path):
    kind = type(TERMS)("sampler.own_sources", "source", given=1)
    assert kind.make(f"{file}:given", "the context") == ("the context", 3)
    with pytest.raises(ValueError, match="given has no setting 'context'; it has rows"):
        kind.require([{"source": f"{file}:given", "context": 1}])
    with pytest.raises(ValueError, match=r"nothing cannot be called with these \(too many pos"):
        kind.require([f"{file}:nothing"])


@pytest.mark.parametrize(
    ("name", "options", "message"),
    [
        ("Part", {"size": 1, "label": "x"}, "Part has no setting 'label'; it has size, name"),
        ("Part", {}, r"Part cannot be called with these \(missing a required argument: 'size'\)"),
        ("nothing", {"size": 1}, "nothing has no setting 'size'; it has none"),
        ("absent", {}, "there is no 'absent'; found: Part, anything"),
    ],
)
def test_what_cannot_be_called_is_refused_in_one_line(
    file: Path, name: str, options: dict[str, Any], message: str
):
    with pytest.raises(ValueError, match=message) as refused:
        TERMS.require([{"term": f"{file}:{name}", **options}])
    assert str(refused.value).startswith("loss.own_terms=")
    assert "\n" not in str(refused.value)


def test_what_fails_is_told_in_one_line(file: Path):
    with pytest.raises(ValueError, match=r"size: 1\}: it cannot be made \(KeyError: 1\)"):
        TERMS.make({"term": f"{file}:failing", "size": 1})


@pytest.mark.parametrize(
    ("entry", "message"),
    [
        ({"at": 1}, r"loss.own_terms: an entry {at: 1} needs term: path.py:NAME"),
        ({"term": 3}, r"needs term: path.py:NAME"),
        ({"term": "a.py:A", "at": None}, "at=None cannot be a setting"),
        ({"term": "a.py:A", "at": float("inf")}, "at=inf cannot be a setting"),
        ({"term": "a.py:A", "at": {"x": 1}}, "at={'x': 1} cannot be a setting"),
        ({"term": "a.py:A", "at": [1, {"x": 1}]}, "cannot be a setting"),
        ({"term": "a.py:A", "weight": {"kind": "linear", "x": 1}}, "weight: there is no key x"),
        ({"term": "a.py:A", "weight": {"init": -1}}, "weight: init=-1"),
        (3, "loss.own_terms.0=3: must be a valid string"),
    ],
)
def test_a_recipe_refuses_what_is_no_entry(entry: Any, message: str):
    with pytest.raises(SettingsError, match=message) as refused:
        Recipe.of({"loss": {"own_terms": [entry]}}, "here")
    assert "\n" not in str(refused.value)


@pytest.mark.parametrize(
    "entry",
    [
        "my_terms.py:Centre",
        {"term": "a/b.py:A", "weight": 0.1, "on": True, "n": 3, "less": -1e-3},
        {"term": "a b.py:A", "name": "my name", "like": "true", "number": "3", "empty": ""},
        {"term": "a.py:A", "list": [1, "x", "null", False], "none": []},
        {"term": "a.py:A", "weight": {"kind": "piecewise", "init": None, "values": [1.0, 0.5]}},
    ],
)
def test_hydra_and_a_resumed_run_read_what_is_typed(entry: Any):
    recipe = Recipe.of({"loss": {"own_terms": [entry, "b.py:B"]}}, "here")
    override = f"loss.own_terms={typed(recipe.loss.own_terms)}"
    for read in (compose("variant=sac", override), overridden(Recipe(), override)):
        assert read.loss.own_terms == recipe.loss.own_terms
    assert Recipe.of(recipe.plain(), "there") == recipe


def test_a_mapping_is_one_word_of_a_shell():
    assert word("loss.own_terms=[a.py:A]") == "loss.own_terms=[a.py:A]"
    assert word("x=[{term: a.py:A, b: 1}]") == "'x=[{term: a.py:A, b: 1}]'"


def test_a_strangers_part_is_imported_when_it_is_named_again(
    tmp_path: Path, file: Path, monkeypatch: pytest.MonkeyPatch
):
    """As the message says it, whose words a shell takes apart."""
    monkeypatch.delenv("TRUST", raising=False)
    entries = [{"term": f"{file}:Part", "size": 1}]
    create_run_dir(tmp_path / "run", Recipe().changed(loss={"own_terms": entries}))
    load_recipe(tmp_path / "run")
    with pytest.raises(RunDirectoryError, match=r"asks to import .*my_parts\.py:Part'") as refused:
        load_recipe(tmp_path / "run", training=True)
    (named,) = re.findall(r"ARGS=\"'(.*)'\"", str(refused.value))
    recipe = load_recipe(tmp_path / "run", [named], training=True)
    assert recipe.loss.own_terms == tuple(entries)
    monkeypatch.setenv("TRUST", "1")
    assert load_recipe(tmp_path / "run", training=True) == recipe


def test_a_run_refuses_them_before_it_reads_demonstrations(tmp_path: Path, file: Path):
    recipe = compose(
        "variant=bc_sac",
        "preset=smoke",
        "demos.source='nowhere.h5'",
        f"loss.own_terms=[{{term: {file}:Part, length: 1}}]",
    )
    with pytest.raises(ValueError, match="Part has no setting 'length'"):
        build_run(recipe, tmp_path / "run")
    assert not (tmp_path / "run").exists()
