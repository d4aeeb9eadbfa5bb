"""Pictures of somebody's environment, which needs no OpenGL to make them."""

from __future__ import annotations

import os
from pathlib import Path

import numpy as np
import pytest
import torch

from envs import EnvOptions, Task, find_task, pictures
from envs.demonstrations import Episode, Provenance
from envs.pictures import HUMAN, RGB, Picture, RenderingUnavailableError

ENV = """
import gymnasium
import numpy as np
from gymnasium import spaces


class Lamp(gymnasium.Env):
    "Its picture is as bright as its seed says, and one brighter after each step."

    metadata = {metadata}
    observation_space = spaces.Box(-1000, 1000, (1,), np.float64)
    action_space = spaces.Box(-1, 1, (1,), np.float64)

    def __init__(self, render_mode: str | None = None) -> None:
        self.render_mode, self.level = render_mode, 0

    def reset(self, *, seed=None, options=None):
        self.level = (seed or 0) % 100
        return np.array([float(self.level)]), {{}}

    def step(self, action):
        self.level += 1
        return np.array([float(self.level)]), 1.0, False, self.level % 100 > 20, {{}}

    def render(self):
        {render}
"""
PICTURE = "return np.full((6, 8, 3), self.level, np.uint8) if self.render_mode else None"
MODES = {"render_modes": [RGB, HUMAN], "render_fps": 20}


def lamp(folder: Path, metadata: dict = MODES, render: str = PICTURE) -> Task:
    file = folder / "lamp.py"
    file.write_text(ENV.format(metadata=metadata, render=render))
    return find_task(f"{file}:Lamp")


def test_a_picture_shows_the_copy_as_it_is(tmp_path: Path):
    task = lamp(tmp_path)
    assert task.render is not None
    assert task.render.steps_per_second == 20.0
    env = task.make_env(EnvOptions(render_mode=RGB, horizon=50))
    assert task.starts is not None
    with task.render.open(env, Picture()) as renderer:
        td = env.reset(task.starts(0, 3, 1))
        for _ in range(3):
            picture = renderer.render()
            assert picture.shape == (6, 8, 3)
            assert (picture == int(td["observation"])).all()
            td = env.step(td.set("action", torch.zeros(1, 1)))["next"]
    env.close()


def test_a_recorded_episode_begins_where_its_seed_says(tmp_path: Path):
    task = lamp(tmp_path)
    assert task.render is not None
    assert task.render.begin is not None
    env = task.make_env(EnvOptions(render_mode=RGB, horizon=50))
    values = {
        "observations": np.array([[42.0], [43.0]], np.float32),
        "actions": np.zeros((1, 1), np.float32),
        "rewards": np.ones(1, np.float32),
        "terminated": np.zeros(1, bool),
        "provenance": Provenance("x.h5", 0, "recorded"),
    }
    begun = task.render.begin(env, Episode(**values, start={"start_seed": np.array([142.0])}))
    assert float(begun["observation"]) == 42.0
    with pytest.raises(ValueError, match=r"x\.h5, episode 0 holds nothing by which"):
        task.render.begin(env, Episode(**values))
    env.close()


def test_an_environment_without_pictures_is_a_task_without_films(tmp_path: Path):
    assert lamp(tmp_path, {"render_modes": ["ansi"]}).render is None


def test_one_without_a_window_has_none(tmp_path: Path):
    render = lamp(tmp_path, {"render_modes": [RGB]}).render
    assert render is not None
    assert render.window is None
    assert render.steps_per_second == 30.0


@pytest.mark.parametrize(
    ("render", "told"),
    [
        ("raise ModuleNotFoundError('no pygame\\nhere')", r"shows no picture .*no pygame here\)"),
        ("return None", r"render\(\) gave object of shape \[\]; expected a picture"),
        ("return np.zeros((6, 8, 3))", r"render\(\) gave float64 of shape \[6, 8, 3\]; expected"),
    ],
)
def test_what_is_no_picture_is_told_in_one_line_at_once(render: str, told: str, tmp_path: Path):
    task = lamp(tmp_path, render=render)
    assert task.render is not None
    env = task.make_env(EnvOptions(render_mode=RGB, horizon=50))
    with pytest.raises(RenderingUnavailableError, match=told) as said:
        task.render.open(env, Picture()).__enter__()
    assert "\n" not in str(said.value)
    env.close()


def test_a_camera_is_the_environments_own_business(tmp_path: Path):
    task = lamp(tmp_path)
    assert task.render is not None
    env = task.make_env(EnvOptions(render_mode=RGB, horizon=50))
    with pytest.raises(ValueError, match=r"CAMERA=top: .*task\.kwargs\.camera_name"):
        task.render.open(env, Picture(camera="top")).__enter__()
    env.close()


WHICH = "import os; return np.full((6, 8, 3), len(os.environ.get('MUJOCO_GL', '')), np.uint8)"


@pytest.mark.parametrize(
    ("screen", "chosen", "length"),
    [("", "", len("osmesa")), (":0", "", 0), ("", "egl", len("egl"))],
)
def test_an_environment_of_mujocos_renders_without_a_screen(
    screen: str, chosen: str, length: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
):
    """By the environment variable that gymnasium reads, for as long as pictures are made."""
    monkeypatch.setattr("sys.platform", "linux")
    monkeypatch.setattr(pictures, "find_library", lambda name: name if name == "OSMesa" else None)
    for name in pictures.SCREENS:
        monkeypatch.setenv(name, screen)
    monkeypatch.setenv(pictures.CHOSEN, chosen)
    task = lamp(tmp_path, render=WHICH)
    assert task.render is not None
    env = task.make_env(EnvOptions(render_mode=RGB, horizon=50))
    with task.render.open(env, Picture()) as renderer:
        assert (renderer.render() == length).all()
    assert os.environ.get(pictures.CHOSEN, "") == chosen
    env.close()
