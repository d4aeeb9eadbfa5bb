"""Pictures of somebody's environment, and its own window."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Any

import gymnasium
import numpy as np
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torchrl.envs import EnvBase

from envs.demonstrations.episode import Episode
from envs.library.copies import Copies
from envs.library.probe import Probed
from envs.library.resimulation import Resimulation
from envs.library.vector_env import VectorEnv
from envs.one_line import kind_and_text
from envs.pictures import (
    HUMAN,
    RGB,
    Picture,
    Render,
    RenderingUnavailableError,
    backend_named,
)

Envs = list[gymnasium.Env[Any, Any]]


def render_of(name: str, found: Probed, resimulation: Resimulation) -> Render | None:
    """The capability of a task; None if its environment makes no pictures."""
    if RGB not in found.shows:
        return None
    shown = LibraryPictures(name, resimulation)
    window = shown.window if HUMAN in found.shows else None
    return Render(shown.open, found.pictures_per_second, shown.begin, window)


@dataclass(frozen=True)
class LibraryPictures:
    """Pictures of the copies that are in this process.

    Attributes:
        name: of the task, for messages.
        resimulation: begins recorded episodes.
    """

    name: str
    resimulation: Resimulation

    @contextmanager
    def open(self, env: EnvBase, picture: Picture) -> Iterator[LibraryRenderer]:
        """The renderer of an environment made with ``rgb_array``; its size is the environment's.

        Raises:
            ValueError: a camera is asked for.
            RenderingUnavailableError: it makes no picture.
        """
        if picture.camera is not None:
            raise ValueError(
                f"CAMERA={picture.camera}: the cameras of task {self.name} are arguments of its "
                'environment, if it has any; name one there: ARGS="task.kwargs.camera_name=..."'
            )
        renderer = LibraryRenderer(self.name, _envs(env))
        with backend_named():
            env.reset()
            renderer.render()  # what is missing is told now, not after minutes of other work
            yield renderer

    def begin(self, env: EnvBase, episode: Episode) -> TensorDictBase:
        """Puts the only copy where a recorded episode begins.

        Raises:
            ValueError: the episode holds nothing by which it could be.
        """
        assert isinstance(env, VectorEnv)
        begun = self.resimulation.begin(env, episode)
        if begun is None:
            raise ValueError(f"{episode.provenance} holds nothing by which it can be begun")
        found: TensorDictBase = begun
        return found

    @contextmanager
    def window(self, env: EnvBase) -> Iterator[LibraryWindow]:
        """The window of an environment made with ``human``, which it opens itself.

        Raises:
            RenderingUnavailableError: it opens none.
        """
        shown = LibraryWindow(self.name, _envs(env))
        env.reset()
        shown.show()
        yield shown


class LibraryRenderer:
    """Asks environments for pictures.

    Args:
        name: of the task.
        envs: made with ``rgb_array``.
    """

    def __init__(self, name: str, envs: Envs) -> None:
        self._name = name
        self._envs = envs

    def render(self, index: int = 0) -> NDArray[Any]:
        """Picture of a copy as it is now, uint8 [height, width, 3].

        Raises:
            RenderingUnavailableError: the environment makes none.
        """
        picture = np.asarray(_asked(self._name, self._envs[index]))
        if picture.dtype != np.uint8 or picture.ndim != 3 or picture.shape[2] != 3:
            raise RenderingUnavailableError(
                f"task {self._name}: render() gave {picture.dtype} of shape "
                f"{list(picture.shape)}; expected a picture, uint8 [height, width, 3]"
            )
        return picture

    def close(self) -> None:
        """The environments close what they opened."""


class LibraryWindow:
    """Has an environment show itself.

    Args:
        name: of the task.
        envs: the only one, made with ``human``.
    """

    def __init__(self, name: str, envs: Envs) -> None:
        self._name = name
        self._env = envs[0]

    def show(self) -> bool:
        """Show it as it is now. Gymnasium does not tell of a window that was closed."""
        _asked(self._name, self._env)
        return True


def _asked(name: str, env: gymnasium.Env[Any, Any]) -> Any:
    try:
        return env.render()
    # Whatever somebody's environment raises, or its library of graphics, is told in one line.
    except Exception as error:
        raise RenderingUnavailableError(
            f"task {name} shows no picture ({kind_and_text(error)})"
        ) from error


def _envs(env: EnvBase) -> Envs:
    assert isinstance(env, VectorEnv)
    assert isinstance(env.copies, Copies)
    return env.copies.envs
