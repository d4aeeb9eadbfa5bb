"""Commands that messages name: of make, or of ``bcsac`` where that was started."""

from __future__ import annotations

import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from hydra.core.override_parser.overrides_parser import OverridesParser

from bcsac import STARTED_AS
from pipeline.cli.judging import evaluate, robust
from pipeline.files import again
from pipeline.literals import literal

TASK = {"name": "my tasks/lift.py:LIFT"}
ROOT = Path(__file__).parents[3]


@pytest.fixture
def as_bcsac(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv(STARTED_AS, "bcsac")


def test_of_make_a_command_has_words(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.delenv(STARTED_AS, raising=False)
    told = again.command("eval", "runs/x", TASK, ["env.horizon=7"], EPISODES=5)
    assert shlex.split(told) == [
        "make", "eval", "RUN=runs/x", "EPISODES=5", "TASK=my tasks/lift.py:LIFT",
        "ARGS=env.horizon=7",
    ]  # fmt: skip


@pytest.mark.usefixtures("as_bcsac")
def test_of_bcsac_a_command_has_options():
    told = again.command(
        "eval", "my runs/x", TASK, ["env.horizon=7", "task.kwargs.a=1"], EPISODES=5
    )
    assert shlex.split(told) == [
        "bcsac", "eval", "my runs/x", "--episodes", "5", "--task", "my tasks/lift.py:LIFT",
        "env.horizon=7", "task.kwargs.a=1",
    ]  # fmt: skip
    assert again.command("eval", "runs/x", {}, EPISODES=5) == "bcsac eval runs/x --episodes 5"


@pytest.mark.usefixtures("as_bcsac")
def test_options_are_those_of_the_commands():
    told = again.command("robust", "x", TASK, EPISODES=5, BAR="0.5", ONLY="mass")
    asked = {word.removeprefix("--") for word in shlex.split(told) if word.startswith("--")}
    assert asked == {"episodes", "bar", "only", "task"}
    assert asked <= set(robust.__annotations__)
    assert {"episodes", "task"} <= set(evaluate.__annotations__)


@pytest.mark.usefixtures("as_bcsac")
@pytest.mark.parametrize("folder", ["runs/x", "my runs/it's, a=1", "runs/${x}"])
def test_of_bcsac_training_goes_on_with_keys_that_hydra_reads(folder: str):
    told = again.command("train", "", TASK, ["bc.updates=..."], RESUME=folder)
    program, target, *words = shlex.split(told)
    assert (program, target) == ("bcsac", "train")
    assert words[-1] == "bc.updates=..."
    values = {}
    for word in words[:-1]:
        key, _, value = word.partition("=")
        OverridesParser.create().parse_override(word)
        values[key] = literal(value)
    assert values == {"resume": folder, "task.name": TASK["name"]}


@pytest.mark.parametrize(
    ("module", "says"),
    [("bcsac", "make it with: bcsac eval"), ("pipeline.cli", "make it with: make eval")],
)
def test_a_message_names_the_command_that_was_started(module: str, says: str, tmp_path: Path):
    done = subprocess.run(
        [sys.executable, "-m", module, "table", str(tmp_path / "nowhere")],
        cwd=ROOT, capture_output=True, text=True, check=False,
    )  # fmt: skip
    assert done.returncode == 1
    assert says in done.stderr
