from __future__ import annotations

import os
import subprocess
import sys

import mujoco
import pytest

from envs.door.render import DoorRenderer, RenderingUnavailableError
from envs.door.simulator import DoorSimulator

# The OpenGL library is chosen when mujoco is imported, so pictures need a process of their own.
PICTURES = """
import sys
import gymnasium, numpy as np
import envs
from envs.door.render import RenderingUnavailableError
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


def test_pictures(request):
    result = subprocess.run(
        [sys.executable, "-c", PICTURES],
        env=os.environ | {"MUJOCO_GL": "egl", "PYTHONPATH": os.pathsep.join(sys.path)},
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
    with pytest.raises(
        RenderingUnavailableError,
        match=r"apt-get install libegl1 libgl1.*MUJOCO_GL=egl.*gladLoadGL error",
    ):
        DoorRenderer(one_door)


def test_unknown_camera():
    with DoorSimulator(1) as simulator, pytest.raises(ValueError, match=r"'top'.*'fixed'"):
        DoorRenderer(simulator, camera="top")
