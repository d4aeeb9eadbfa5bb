"""Pictures of a door."""

from __future__ import annotations

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.door.simulator import DoorSimulator


class RenderingUnavailableError(RuntimeError):
    """No OpenGL context can be made on this machine."""


class DoorRenderer:
    """Renders one door of a simulator off screen.

    Args:
        simulator: The simulator whose doors are shown.
        width: Picture width, pixels.
        height: Picture height, pixels.
        camera: Name of a camera of the scene: ``fixed`` or ``vil_camera``.

    Raises:
        RenderingUnavailableError: If there is no OpenGL to render with.
        ValueError: If the scene has no such camera.
    """

    def __init__(
        self,
        simulator: DoorSimulator,
        width: int = 640,
        height: int = 480,
        camera: str = "fixed",
    ) -> None:
        model = simulator.scene.model
        known = [model.camera(index).name for index in range(model.ncam)]
        if camera not in known:
            raise ValueError(f"no camera {camera!r} in the door scene; there are {known}")
        self._simulator = simulator
        self._camera = camera
        try:
            self._renderer = mujoco.Renderer(model, height=height, width=width)
        # Which exception it is depends on the OpenGL loader that is missing.
        except Exception as error:
            raise RenderingUnavailableError(
                "MuJoCo cannot open an OpenGL context. On a machine without a display: "
                "apt-get install libegl1 libgl1, then start again with MUJOCO_GL=egl set in the "
                f"environment ({type(error).__name__}: {error})"
            ) from error

    def render(self, door: int = 0) -> NDArray[np.uint8]:
        """Picture of door `door` as it is now, shape [height, width, 3], uint8 RGB."""
        self._renderer.update_scene(self._simulator.data(door), camera=self._camera)
        return self._renderer.render()

    def close(self) -> None:
        """Free the OpenGL context."""
        self._renderer.close()
