"""docs/tutorial/your-task.md: its files and commands, run as they stand in an empty folder."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest
import yaml

from envs import find_task
from envs.demonstrations import load_demonstrations
from tests.docs.shell import Shell

ROOT = Path(__file__).parents[2]
TUTORIAL = ROOT / "docs" / "tutorial" / "your-task.md"
FILE = re.compile(r"<!-- file:(\S+) -->\n```\w*\n(.*?)```", re.DOTALL)
RUN = re.compile(r"<!-- run:(\w+) -->\n```\w*\n(.*?)```", re.DOTALL)
CHAPTERS = ["record", "train", "eval", "resume", "variant"]


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The tutorial's folder, with its files and nothing else."""
    made = tmp_path_factory.mktemp("tutorial") / "my_task"
    for name, text in FILE.findall(TUTORIAL.read_text()):
        (made / name).parent.mkdir(parents=True, exist_ok=True)
        (made / name).write_text(text)
    return made


@pytest.fixture(scope="module")
def said(folder: Path, shell: Shell) -> dict[str, str]:
    """What each chapter's commands print; they are run in the tutorial's order."""
    return {
        chapter: shell.run(commands, folder, BCSAC=str(ROOT))
        for chapter, commands in RUN.findall(TUTORIAL.read_text())
    }


def test_the_tutorial_has_every_chapter(said: dict[str, str]):
    assert list(said) == CHAPTERS


def test_the_controller_is_recorded_and_the_recording_is_usable(said: dict[str, str], folder: Path):
    assert "25 usable of 25 episodes" in said["record"]
    task = find_task(f"{folder / 'puck.py'}:make")
    episodes = load_demonstrations(str(folder / "demos.h5"), task).episodes
    assert len(episodes) == 25
    assert all(episode.succeeds for episode in episodes)


def test_a_policy_is_trained_evaluated_and_trained_further(said: dict[str, str], folder: Path):
    evaluation = json.loads((folder / "runs" / "first" / "evaluation.json").read_text())
    assert evaluation["episodes"] == 20
    assert 0.0 <= evaluation["success_once"] <= 1.0
    assert evaluation["made_from"]["variant"] == "bc_sac"
    assert evaluation["made_from"]["frames"] == 800, "of the preset, before the run went on"
    curve = (folder / "runs" / "first" / "learning_curve.jsonl").read_text().splitlines()
    assert json.loads(curve[-1])["frames"] == 1200, "what RESUME with more frames asks for"


def test_the_variant_is_the_users(said: dict[str, str], folder: Path):
    config = yaml.safe_load((folder / "runs" / "fading" / "config.yaml").read_text())
    assert config["variant"] == "fading"
    assert config["loss"]["bc_weight"]["kind"] == "cosine"
    assert config["growth"]["self_imitation"] is True


def test_what_is_made_lies_in_the_users_folder(said: dict[str, str], folder: Path):
    written = {entry.name for entry in folder.iterdir()} - {"__pycache__"}
    assert written == {"puck.py", "configs", "demos.h5", "runs"}
