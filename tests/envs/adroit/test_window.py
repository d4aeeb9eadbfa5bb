"""MuJoCo's viewer, replaced: there is no screen where tests run."""

from __future__ import annotations

import contextlib
import sys
import types

import mujoco
import numpy as np
import pytest

from envs.adroit import window
from envs.door.definition import TASK, VIEW
from envs.options import EnvOptions
from envs.pictures import RenderingUnavailableError


class Viewer(contextlib.AbstractContextManager):
    def __init__(self, data: mujoco.MjData) -> None:
        self.data, self.running, self.synced, self.closed = data, True, 0, False
        self.cam = mujoco.MjvCamera()

    def __exit__(self, *_: object) -> None:
        self.closed = True

    def is_running(self) -> bool:
        return self.running

    def lock(self) -> contextlib.AbstractContextManager:
        return contextlib.nullcontext()

    def sync(self) -> None:
        self.synced += 1


@pytest.fixture
def viewers(monkeypatch: pytest.MonkeyPatch) -> list[Viewer]:
    opened: list[Viewer] = []

    def launch(_model: mujoco.MjModel, data: mujoco.MjData, **_: object) -> Viewer:
        opened.append(Viewer(data))
        return opened[-1]

    module = types.ModuleType("mujoco.viewer")
    module.launch_passive = launch  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "mujoco.viewer", module)
    monkeypatch.setattr(mujoco, "viewer", module, raising=False)
    glfw = types.ModuleType("glfw")
    glfw.init = lambda: True  # type: ignore[attr-defined]
    monkeypatch.setitem(sys.modules, "glfw", glfw)
    return opened


def test_a_mujoco_that_cannot_copy_is_told_before_a_window_opens(
    viewers: list[Viewer], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.delattr(mujoco, "mj_copyData", raising=False)
    env = TASK.make_env(EnvOptions(num_envs=1, seed=0))
    told = pytest.raises(RenderingUnavailableError, match=r"MuJoCo .* a later one, or make a film")
    with told, TASK.render.window(env):
        pass
    assert viewers == []


@pytest.mark.skipif(not hasattr(mujoco, "mj_copyData"), reason="this MuJoCo cannot copy")
def test_the_window_shows_the_first_copy_until_it_is_closed(viewers: list[Viewer]):
    env = TASK.make_env(EnvOptions(num_envs=2, seed=0))
    env.reset()
    assert TASK.render is not None
    assert TASK.render.window is not None
    with TASK.render.window(env) as shown:
        (viewer,) = viewers
        np.testing.assert_array_equal(viewer.cam.lookat, VIEW.lookat)
        assert viewer.cam.distance == VIEW.distance
        for _ in range(3):
            env.step(env.rand_action(env.reset()))
            assert shown.show()
            np.testing.assert_array_equal(viewer.data.qpos, env.simulator.qpos[0])
            handle = env.simulator.scene.model.site("S_handle").id
            np.testing.assert_allclose(
                viewer.data.site_xpos[handle], env.simulator._states.read["handle"][0], atol=1e-9
            )
        viewer.running = False
        assert not shown.show()
        assert viewer.synced == 3
    assert viewer.closed
    env.close()


def test_a_display_that_cannot_be_used_is_told_before_the_viewer_waits_for_it(
    viewers: list[Viewer], monkeypatch: pytest.MonkeyPatch
):
    monkeypatch.setattr(sys.modules["glfw"], "init", lambda: False)
    env = TASK.make_env(EnvOptions(seed=0))
    with pytest.raises(RenderingUnavailableError, match=r"cannot be used.*make video RUN="):
        window.open_window(env.simulator, VIEW.camera()).__enter__()
    assert not viewers
    env.close()
