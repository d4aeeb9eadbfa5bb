"""Rules of the code that no linter checks: its lengths, and which of it may know the door."""

from __future__ import annotations

import ast
import re
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
PACKAGES = ("configs", "envs", "losses", "pipeline")
TASKS = ("adroit", "door", "hammer", "pen", "relocate")
"""Folders below `envs` that know what a hand does."""
GUIDE = ROOT / "CONTRIBUTING.md"
ENVS = sorted(
    path
    for path in (ROOT / "envs").iterdir()
    if (path.suffix == ".py" and path.stem != "__init__") or (path / "__init__.py").is_file()
)
FILE_LINES, FUNCTION_LINES = 300, 60
SOURCES = sorted(
    [ROOT / "bcsac.py", *(path for name in PACKAGES for path in (ROOT / name).rglob("*.py"))]
)
SETTINGS = sorted((ROOT / "configs").rglob("*.yaml"))

WORDS = re.compile(r"hinge|latch|door|palm", re.IGNORECASE)
"""Of the paper's task. What is of a task is a capability of `envs.task.Task`."""
KNOWN: dict[str, tuple[str, str]] = {
    "envs/__init__.py": ("door|Door", "importing it registers the door with gymnasium"),
    "envs/registry.py": ("door", "the one list of tasks by name"),
    "pipeline/recipe.py": ('name: str = "door"', "the task that is trained if none is named"),
    "pipeline/files/checkpoint.py": ('"door.replay_buffer"', "in the checkpoints that there are"),
    "envs/demonstrations/readers/recording.py": ('"door-recording"', "in the files that there are"),
}
"""By file: what its code may say (a pattern), and why. Comments and docstrings may say more."""


def named(path: Path) -> str:
    return path.relative_to(ROOT).as_posix()


def code_lines(text: str) -> list[tuple[int, str]]:
    """Numbered lines of Python without comments and docstrings, strings as they are."""
    tree = ast.parse(text)
    prose = {
        line
        for node in ast.walk(tree)
        if isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
        for line in range(node.lineno, (node.end_lineno or node.lineno) + 1)
    }
    lines = enumerate(text.splitlines(), start=1)
    return [(n, re.sub(r"(^|\s)#.*$", "", line)) for n, line in lines if n not in prose]


def long_functions(text: str, most: int) -> list[tuple[str, int]]:
    """Names and lengths [lines] of functions longer than ``most``, decorators not counted."""
    kinds = (ast.FunctionDef, ast.AsyncFunctionDef)
    lengths = [
        (node.name, (node.end_lineno or node.lineno) - node.lineno + 1)
        for node in ast.walk(ast.parse(text))
        if isinstance(node, kinds)
    ]
    return [(name, length) for name, length in lengths if length > most]


def test_a_file_is_read_in_one_go():
    lengths = {named(path): len(path.read_text().splitlines()) for path in [*SOURCES, *SETTINGS]}
    assert len(lengths) > 200
    assert {name: length for name, length in lengths.items() if length > FILE_LINES} == {}


def test_a_function_fits_a_screen():
    found = {named(path): long_functions(path.read_text(), FUNCTION_LINES) for path in SOURCES}
    assert {name: functions for name, functions in found.items() if functions} == {}


def test_only_its_own_folder_and_the_list_of_tasks_know_the_door():
    found = []
    for path in SOURCES:
        name = named(path)
        if name.startswith(tuple(f"envs/{task}/" for task in TASKS)):
            continue
        for number, line in code_lines(path.read_text()):
            rest = re.sub(KNOWN[name][0], "", line) if name in KNOWN else line
            if WORDS.search(rest):
                found.append(f"{name}:{number}: {line.strip()}")
    assert found == []


@pytest.mark.parametrize("path", SETTINGS, ids=named)
def test_no_preset_and_no_variant_sets_anything_of_the_door(path: Path):
    """What suits a task is in its `defaults`."""
    for line in path.read_text().splitlines():
        assert not WORDS.search(line.partition("#")[0]), line


@pytest.mark.parametrize("name", KNOWN)
def test_what_is_known_of_the_door_is_still_said(name: str):
    allowed = re.compile(KNOWN[name][0])
    assert any(allowed.search(line) for _, line in code_lines((ROOT / name).read_text())), (
        f"{name} needs no exception"
    )


def test_examples_in_comments_and_docstrings_are_no_code():
    text = (
        '"""A door."""\nx = "door"  # a door\n\n\ndef f():\n    """Of\n    doors."""\n    # palm\n'
    )
    assert [line.strip() for _, line in code_lines(text)] == ['x = "door"', "", "", "def f():", ""]


def test_a_function_is_as_long_as_from_its_def_to_its_last_line():
    text = "@wraps\ndef one():\n    a = 1\n    return a\n\n\ndef two(): ...\n"
    assert long_functions(text, 2) == [("one", 3)]
    assert long_functions(text, 3) == []


def test_the_contributing_guide_lists_the_contracts_of_imports():
    """All of them, by their names, and its table cites none that is not there."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    names = [contract["name"] for contract in settings["contracts"]]
    (guide,) = re.findall(r"## Where things go\n(.*?)\n## ", GUIDE.read_text(), re.DOTALL)
    listed = dict(re.findall(r"^(\d+)\. (.+)$", guide, re.MULTILINE))
    assert sorted(listed.values()) == sorted(names)
    cited = re.findall(r"^\| `.*\| ([\d, ]+|-) \|$", guide, re.MULTILINE)
    assert len(cited) == len(re.findall(r"^\| `", guide, re.MULTILINE))
    assert {number for cell in cited for number in re.findall(r"\d+", cell)} <= listed.keys()


@pytest.mark.parametrize("part", ENVS, ids=named)
def test_every_part_of_envs_has_a_row_in_the_contributing_guide_and_a_layer(part: Path):
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]
    layers = [
        re.split(r" \| ", layer)
        for contract in settings["contracts"]
        if contract["name"].startswith("the parts of envs")
        for layer in contract["layers"]
    ]
    assert sum(f"envs.{part.stem}" in layer for layer in layers) == 1
    (table,) = re.findall(r"\n\| where .*?\n\n", GUIDE.read_text(), re.DOTALL)
    name = part.name + "/" * part.is_dir()
    assert re.search(rf"^\| [^|]*`(?:envs/)?{re.escape(name)}`", table, re.MULTILINE)
