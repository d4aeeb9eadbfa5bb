"""What a task offers to those who want to look: pictures, and a window to watch it in."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable, Iterator, Sequence
from contextlib import AbstractContextManager, contextmanager
from ctypes.util import find_library
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Final, Protocol

from numpy.typing import NDArray

if TYPE_CHECKING:
    from tensordict import TensorDictBase
    from torchrl.envs import EnvBase

    # At run time it imports `envs.task`, which imports this module.
    from envs.demonstrations.episode import Episode

RGB: Final = "rgb_array"
"""Gymnasium's name for pictures."""
HUMAN: Final = "human"
"""Gymnasium's name for a window."""
SCREENS: Final = ("DISPLAY", "WAYLAND_DISPLAY")
"""Environment variables, one of which is set where there is a screen."""
CHOSEN: Final = "MUJOCO_GL"
"""Environment variable by which a user chooses how MuJoCo renders."""
BACKENDS: Final = {"egl": "EGL", "osmesa": "OSMesa"}
"""Libraries that need no screen, by their names in MuJoCo."""


class RenderingUnavailableError(RuntimeError):
    """No picture can be made, or no window opened, on this machine; one line says what to do."""


def without_screen() -> bool:
    """Whether this machine certainly has no screen."""
    return sys.platform.startswith("linux") and not any(map(os.environ.get, SCREENS))


def backends() -> list[str] | None:
    """What this machine has for rendering without a screen, by MuJoCo's names, the best first.

    None where there is nothing to choose: there is a screen, or the user has chosen.
    """
    if os.environ.get(CHOSEN) or not without_screen():
        return None
    return [name for name, library in BACKENDS.items() if find_library(library) is not None]


@contextmanager
def backend_named() -> Iterator[None]:
    """Names the best of `backends` to libraries that would take one that needs a screen.

    Gymnasium's MuJoCo environments read it when they make their first picture, dm_control when it
    is imported.
    """
    found = backends()
    if not found:
        yield
        return
    os.environ[CHOSEN] = found[0]
    try:
        yield
    finally:
        os.environ.pop(CHOSEN, None)


@dataclass(frozen=True)
class Picture:
    """What a picture is asked to be.

    Attributes:
        width: px.
        height: px. A task that makes pictures of one size only may give another.
        camera: its name; None is the task's own view.
    """

    width: int = 480
    height: int = 480
    camera: str | None = None


class Renderer(Protocol):
    """Takes pictures of one copy of an environment."""

    def render(self, index: int = 0) -> NDArray[Any]:
        """Picture of copy ``index`` as it is now, uint8 [height, width, 3]."""
        ...

    def close(self) -> None:
        """Free what it holds."""
        ...


class Window(Protocol):
    """Shows the first copy of an environment to somebody."""

    def show(self) -> bool:
        """Show it as it is now; False once the window has been closed."""
        ...


@dataclass(frozen=True)
class Render:
    """How films of a task are made.

    Environments are made for it with ``EnvOptions.render_mode``.

    Attributes:
        open: makes the renderer of an environment. Raises `RenderingUnavailableError` where there
            is nothing to render with, and ValueError where there is no such camera.
        steps_per_second: control steps in a second of the task's own time.
        begin: puts the first copy where a recorded episode begins and gives what it observes
            there, as a reset does. None: recordings cannot be filmed. Raises ValueError if the
            episode does not say where it begins.
        window: opens a window; None: it cannot be watched live.
        notes: lines of the task's own to stand in the picture, from what the environment tells with
            an observation; None: nothing. `Task.strategies` has a line of its own.
    """

    open: Callable[[EnvBase, Picture], AbstractContextManager[Renderer]]
    steps_per_second: float
    begin: Callable[[EnvBase, Episode], TensorDictBase] | None = None
    window: Callable[[EnvBase], AbstractContextManager[Window]] | None = None
    notes: Callable[[TensorDictBase], Sequence[str]] | None = None
