"""Pictures of a hand."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from dataclasses import dataclass
from importlib import import_module
from typing import Any, Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.adroit.simulator import HandSimulator
from envs.pictures import CHOSEN, SCREENS, RenderingUnavailableError, backends

__all__ = ["HandRenderer", "RenderingUnavailableError", "View"]

SHADOW_PX: Final = 1024
"""Of the map of shadows. The scene's own 4096 take most of the time of a picture on a CPU."""
SAMPLES: Final = 4
"""Of a pixel, where edges are smoothed; the scene asks for 8."""
_REMEDY: Final = (
    "On a machine without a display: apt-get install libegl1 libgl1, then start again with "
    f"{CHOSEN}=egl set in the environment (or libosmesa6 and {CHOSEN}=osmesa)"
)


@dataclass(frozen=True)
class View:
    """Where a free camera stands.

    Attributes:
        lookat: the point in the middle of the picture, m.
        distance: from there, m.
        azimuth: degrees; at 90 it looks along y, as the forearm points.
        elevation: degrees; negative looks down.
    """

    lookat: tuple[float, float, float]
    distance: float
    azimuth: float
    elevation: float

    def camera(self) -> mujoco.MjvCamera:
        """As MuJoCo's camera."""
        camera = mujoco.MjvCamera()
        camera.lookat[:] = self.lookat
        camera.distance = self.distance
        camera.azimuth = self.azimuth
        camera.elevation = self.elevation
        return camera


class HandRenderer:
    """Renders one copy of a simulator off screen.

    Args:
        simulator: The simulator whose copies are shown.
        width: Picture width, pixels.
        height: Picture height, pixels.
        camera: Name of a camera of the scene (``fixed``, ``vil_camera``), or a view of one's own.

    Raises:
        RenderingUnavailableError: If there is no OpenGL to render with.
        ValueError: If the scene has no such camera.
    """

    def __init__(
        self,
        simulator: HandSimulator,
        width: int = 640,
        height: int = 480,
        camera: str | View = "fixed",
    ) -> None:
        model = simulator.scene.model
        known = [model.camera(index).name for index in range(model.ncam)]
        if isinstance(camera, str) and camera not in known:
            raise ValueError(f"no camera {camera!r} in the scene; there are {known}")
        self._simulator = simulator
        self._camera = camera.camera() if isinstance(camera, View) else camera
        model.vis.quality.shadowsize = SHADOW_PX
        model.vis.quality.offsamples = SAMPLES
        self._renderer = _opened(model, width, height)

    def render(self, index: int = 0) -> NDArray[np.uint8]:
        """Picture of copy `index` as it is now, shape [height, width, 3], uint8 RGB."""
        self._renderer.update_scene(self._simulator.data(index), camera=self._camera)
        return self._renderer.render()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()


def _opened(model: mujoco.MjModel, width: int, height: int) -> mujoco.Renderer:
    told: Exception | None = None
    for context in _contexts():
        try:
            context()
            return mujoco.Renderer(model, height=height, width=width)
        # Which exception it is depends on the OpenGL loader that is missing.
        except Exception as error:
            told = told or error
    if told is None:
        raise RenderingUnavailableError(
            f"there is no display ({' or '.join(SCREENS)}), no EGL and no OSMesa. {_REMEDY}"
        )
    what = " ".join(f"{type(told).__name__}: {told}".split())
    raise RenderingUnavailableError(
        f"MuJoCo cannot open an OpenGL context. {_REMEDY} ({what})"
    ) from told


def _contexts() -> Iterator[Any]:
    """What has mujoco's renderer take one way to OpenGL, one after the other.

    It settles on GLFW, which needs a screen, when it is imported; EGL and OSMesa are for machines
    without one, where the user chose nothing.
    """
    found = backends()
    if found is None:
        yield lambda: None
        return
    for name in found:
        yield lambda name=name: _take(name)


def _take(backend: str) -> None:
    places = ("mujoco.rendering.classic.gl_context", "mujoco.gl_context")  # of new and old releases
    module: Any = next(sys.modules[place] for place in places if place in sys.modules)
    module.GLContext = import_module(f"mujoco.{backend}").GLContext
