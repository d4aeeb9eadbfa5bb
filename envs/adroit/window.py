"""A hand in MuJoCo's viewer."""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any, Final

import mujoco

from envs.adroit.simulator import HandSimulator
from envs.pictures import RenderingUnavailableError

_FILM: Final = "make a film instead: make video RUN=..."


class HandWindow:
    """Shows the first copy of a simulator.

    Args:
        simulator: whose copy.
        viewer: what ``mujoco.viewer.launch_passive`` gave for ``data``.
        data: of the simulator's model, which the viewer shows.
    """

    def __init__(self, simulator: HandSimulator, viewer: Any, data: mujoco.MjData) -> None:
        self._simulator = simulator
        self._viewer = viewer
        self._data = data

    def show(self) -> bool:
        """Show it as it is now; False once the window has been closed."""
        if not self._viewer.is_running():
            return False
        model = self._simulator.scene.model
        with self._viewer.lock():
            mujoco.mj_copyData(self._data, model, self._simulator.data(0))
        self._viewer.sync()
        return True


@contextmanager
def open_window(simulator: HandSimulator, camera: mujoco.MjvCamera) -> Iterator[HandWindow]:
    """Opens MuJoCo's viewer.

    Args:
        simulator: whose first copy is shown.
        camera: where the free camera stands at first.

    Raises:
        RenderingUnavailableError: the screen cannot be used, or MuJoCo is too old for it.
    """
    _require_screen()
    _require_copies()
    import mujoco.viewer  # noqa: PLC0415 - opens a library of windows

    data = simulator.data(0)
    try:
        viewer = mujoco.viewer.launch_passive(
            simulator.scene.model, data, show_left_ui=False, show_right_ui=False
        )
    except RuntimeError as error:  # on macOS, without mjpython
        raise RenderingUnavailableError(f"{error}; or {_FILM}") from error
    with viewer:
        for name in ("lookat", "distance", "azimuth", "elevation"):
            setattr(viewer.cam, name, getattr(camera, name))
        yield HandWindow(simulator, viewer, data)


def _require_copies() -> None:
    if not hasattr(mujoco, "mj_copyData"):
        raise RenderingUnavailableError(
            f"MuJoCo {mujoco.__version__} cannot copy what a window shows: install a later one, or "
            f"{_FILM}"
        )


def _require_screen() -> None:
    """The viewer waits for ever for a window that cannot be opened; ask first."""
    import glfw  # noqa: PLC0415 - comes with mujoco, and looks for a screen

    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # it warns of what is raised here
        usable = glfw.init()
    if not usable:
        raise RenderingUnavailableError(
            f"the display cannot be used (GLFW does not start): {_FILM}"
        )
