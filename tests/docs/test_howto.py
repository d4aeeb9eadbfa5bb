"""docs/howto: Python runs as it stands, and what `make train` is given there is a recipe."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path
from types import SimpleNamespace

import gymnasium
import numpy as np
import pytest

from configs import compose

ROOT = Path(__file__).parents[2]
PAGES = sorted((ROOT / "docs" / "howto").glob("*.md"))
PYTHON = re.compile(r"^```python\n(.*?)^```", re.DOTALL | re.MULTILINE)
SHELL = re.compile(r"^```(?:sh)?\n(.*?)^```", re.DOTALL | re.MULTILINE)
INLINE = re.compile(r"(?<!`)`([^`]+)`(?!`)")
SYNOPSIS = re.compile(r"\[[A-Z]+=|\.\.\.")
"""Of a line that says what a command may be given, and is none."""
CODE = [
    pytest.param(page, text, id=f"{page.stem}-{number}")
    for page in PAGES
    for number, text in enumerate(PYTHON.findall(page.read_text()))
]


def commands(page: str) -> list[list[str]]:
    """Words of the calls of make in a page's blocks and in code of its prose, without synopses."""
    blocks = "\n".join(SHELL.findall(page)).replace("\\\n", "")
    prose = re.sub(r"^```.*?^```", "", page, flags=re.DOTALL | re.MULTILINE)
    found, rest = [], ""
    for line in [*blocks.splitlines(), *INLINE.findall(prose)]:
        rest += line + "\n"
        try:
            words = shlex.split(rest, comments=True)
        except ValueError:  # a quote is open
            continue
        if "make" in words and not SYNOPSIS.search(rest):
            found.append(words[words.index("make") :])
        rest = ""
    return found


CALLS = [
    pytest.param(words, id=f"{page.stem}: {' '.join(words)}"[:90])
    for page in PAGES
    for words in commands(page.read_text())
]
TRAININGS = [call for call in CALLS if call.values[0][1:2] == ["train"]]


@pytest.mark.parametrize(("page", "text"), CODE)
def test_the_python_of_a_page_runs(page: Path, text: str, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.chdir(ROOT)
    monkeypatch.setattr(gymnasium.envs.registration, "registry", dict(gymnasium.registry))
    exec(compile(text, str(page), "exec"), {})


def test_an_environment_with_the_methods_of_the_page_goes_on_from_its_state():
    (text,) = [code.values[1] for code in CODE if "def get_state" in code.values[1]]
    names: dict[str, object] = {}
    exec(compile(text, "your-environment.md", "exec"), names)

    def made(seed: int) -> SimpleNamespace:
        return SimpleNamespace(
            place=np.array([0.5, 1.0 * seed]), steps=seed, held=seed > 3,
            noise=np.random.default_rng(seed),
        )  # fmt: skip

    one, other = made(7), made(2)
    names["set_state"](other, names["get_state"](one))
    assert (other.place.tolist(), other.steps, other.held) == ([0.5, 7.0], 7, True)
    assert other.noise.random() == one.noise.random()


def test_there_are_trainings_to_compose():
    assert len(TRAININGS) >= 4


@pytest.mark.parametrize("words", TRAININGS)
def test_what_make_train_is_given_is_a_recipe(words: list[str]):
    """As make hands it on; of a sweep, the first value of each key."""
    asked = subprocess.run(
        ["make", "--no-print-directory", "-n", *words[1:], "VENV=nowhere"],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    (line,) = [line for line in asked.stdout.splitlines() if "pipeline.train" in line]
    assert asked.stdout.endswith(f"{line}\n"), "what follows is run as another command"
    given = shlex.split(line.partition("pipeline.train")[2])
    sweeps = "--multirun" in given
    keys = [key for key in given if key != "--multirun" and not key.startswith("hydra")]
    compose(*([re.sub(r",.*", "", key) for key in keys] if sweeps else keys))


@pytest.mark.parametrize("words", CALLS)
def test_a_call_of_make_names_what_the_makefile_reads(words: list[str]):
    makefile = (ROOT / "Makefile").read_text()
    for name in re.findall(r"(?:^|\s)([A-Z_]+)=", " ".join(words)):
        assert re.search(rf"\b{name}\b", makefile), name
