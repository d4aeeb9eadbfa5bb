from __future__ import annotations

import os
import subprocess
import sys
import types

import mujoco
import pytest

from envs import pictures
from envs.adroit import render
from envs.adroit.render import HandRenderer, RenderingUnavailableError
from envs.adroit.simulator import HandSimulator
from envs.door.hand import DOOR

# The OpenGL library is chosen when mujoco is imported, so pictures need a process of their own.
PICTURES = """
import sys
import gymnasium, numpy as np
import envs
from envs.adroit.render import RenderingUnavailableError
env = gymnasium.make("AdroitDoor-v0", render_mode="rgb_array", width=64, height=48)
env.reset(options={"door_position": [-0.25, 0.3, 0.3]})
try:
    first = env.render()
except RenderingUnavailableError as error:
    sys.exit(f"unavailable: {error}")
assert first.shape == (48, 64, 3) and first.dtype == np.uint8, (first.shape, first.dtype)
assert first.std() > 5, "the picture is blank"
assert np.array_equal(first, env.render()), "the picture of one state changes"
env.reset(options={"door_position": [-0.2, 0.35, 0.35]})
assert not np.array_equal(first, env.render()), "the picture does not show the door's position"
env.close()
"""


@pytest.mark.parametrize("chosen", [{"MUJOCO_GL": "egl"}, {}], ids=["egl", "by_itself"])
def test_pictures_without_a_screen(chosen: dict[str, str], request):
    others = {k: v for k, v in os.environ.items() if k not in {*render.SCREENS, render.CHOSEN}}
    result = subprocess.run(
        [sys.executable, "-c", PICTURES],
        env=others | chosen | {"PYTHONPATH": os.pathsep.join(sys.path)},
        capture_output=True,
        text=True,
        cwd=request.config.rootpath,
        check=False,
    )
    if "unavailable: " in result.stderr:
        pytest.skip(result.stderr.strip().splitlines()[-1])
    assert result.returncode == 0, result.stderr


def test_missing_opengl_names_the_remedy(monkeypatch, one_door):
    def no_context(*args, **kwargs):
        raise mujoco.FatalError("gladLoadGL error")

    monkeypatch.setattr(mujoco, "Renderer", no_context)
    monkeypatch.setenv("MUJOCO_GL", "egl")
    with pytest.raises(
        RenderingUnavailableError,
        match=r"apt-get install libegl1 libgl1.*MUJOCO_GL=egl.*gladLoadGL error",
    ):
        HandRenderer(one_door)


def test_no_screen_and_no_library_is_said_before_anything_is_opened(monkeypatch, one_door):
    for name in (*render.SCREENS, render.CHOSEN):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pictures, "find_library", lambda _name: None)
    monkeypatch.setattr(mujoco, "Renderer", None)  # calling it would say so
    with pytest.raises(
        RenderingUnavailableError,
        match=r"no display \(DISPLAY or .*no EGL and no OSMesa\. .*apt-get",
    ) as said:
        HandRenderer(one_door)
    assert "\n" not in str(said.value)


def test_osmesa_is_taken_where_egl_does_not_start(monkeypatch, one_door):
    """A machine may have EGL's library and nothing behind it."""
    tried = []

    class Backend:
        def __init__(self, name):
            self.GLContext = name

    def opened(*_args, **_kwargs):
        tried.append(gl_context.GLContext)
        if tried[-1] == "mujoco.egl":
            raise ImportError("Cannot initialize a EGL device display")
        return "a renderer"

    gl_context = types.ModuleType("gl_context")
    for place in ("mujoco.rendering.classic.gl_context", "mujoco.gl_context"):
        monkeypatch.setitem(sys.modules, place, gl_context)
    for name in (*render.SCREENS, render.CHOSEN):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr(pictures, "find_library", lambda name: name)
    monkeypatch.setattr(render, "import_module", Backend)
    monkeypatch.setattr(mujoco, "Renderer", opened)
    assert HandRenderer(one_door)._renderer == "a renderer"
    assert tried == ["mujoco.egl", "mujoco.osmesa"]


def test_unknown_camera():
    with HandSimulator(DOOR, 1) as simulator, pytest.raises(ValueError, match=r"'top'.*'fixed'"):
        HandRenderer(simulator, camera="top")
