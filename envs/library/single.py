"""One environment of a library, with everything that was asked for around it."""

from __future__ import annotations

import contextlib
import io
import logging
import warnings
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Any, Final

import gymnasium
from gymnasium.wrappers import TimeLimit

from envs.library.files import make_from_file
from envs.library.functions import load_class
from envs.one_line import kind_and_text
from envs.options import TaskOptions
from envs.pictures import backend_named
from envs.registry import FORMS, UnknownTaskError

_logger = logging.getLogger(__name__)
Env = gymnasium.Env[Any, Any]


@dataclass(frozen=True)
class SingleEnv:
    """Makes one environment; travels to worker processes.

    Attributes:
        library: ``gymnasium``, ``dm_control`` or ``file``, which is the user's.
        wanted: what the library calls the environment.
        options: of the user; here its ``kwargs`` and ``wrappers`` count.
        called: the task, where that is not ``library:wanted``.
    """

    library: str
    wanted: str
    options: TaskOptions
    called: str = ""

    @property
    def name(self) -> str:
        """Of the task."""
        return self.called or f"{self.library}:{self.wanted}"

    def __call__(self, horizon: int | None = None, render_mode: str | None = None) -> Env:
        """A new environment whose episodes last at most ``horizon`` steps.

        Args:
            horizon: None is its own limit.
            render_mode: what it can be asked to show: ``rgb_array``, ``human``; None is nothing,
                or what ``task.kwargs`` say.

        Raises:
            UnknownTaskError: the library cannot make it.
            ValueError: a wrapper cannot be put around it.
        """
        # Before the environment, which may take seconds to make.
        wrappers = [load_class("task.wrappers", where) for where in self.options.wrappers]
        arguments = dict(self.options.kwargs)
        if render_mode is not None:
            arguments["render_mode"] = render_mode
        with quiet(self.name):
            try:
                env = LIBRARIES[self.library](self.wanted, arguments, horizon)
            # gymnasium, dm_control and the constructors each raise their own kinds.
            except Exception as error:
                given = f" with task.kwargs={arguments}" * bool(arguments)
                raise UnknownTaskError(
                    f"cannot make environment {self.name!r}{given} "
                    f"({kind_and_text(error)}); valid: {FORMS}"
                ) from error
            for where, wrapper in zip(self.options.wrappers, wrappers, strict=True):
                try:
                    env = wrapper(env)
                except Exception as error:
                    raise ValueError(
                        f"task.wrappers: {where} cannot wrap {self.name} ({kind_and_text(error)})"
                    ) from error
        return env


def _gymnasium(wanted: str, kwargs: dict[str, Any], horizon: int | None) -> Env:
    # Its checker looks at every step and warns; what matters of it is checked here once.
    return gymnasium.make(wanted, max_episode_steps=horizon, disable_env_checker=True, **kwargs)


def _dm_control(wanted: str, kwargs: dict[str, Any], horizon: int | None) -> Env:
    # Imported where it is used: both take a second, and most tasks need neither.
    with backend_named():
        from dm_control import suite  # noqa: PLC0415
    from shimmy.dm_control_compatibility import DmControlCompatibilityV0  # noqa: PLC0415

    arguments = dict(kwargs)
    render_mode = arguments.pop("render_mode", None)
    domain, separator, task = wanted.partition("/")
    if not separator:
        raise ValueError("expected DOMAIN/TASK")
    env = suite.load(domain, task, task_kwargs=arguments)
    if horizon is not None:
        # Half a step less: a limit in seconds is divided by the time step again, and rounded.
        seconds = (horizon - 0.5) * env.control_timestep()
        env = suite.load(domain, task, task_kwargs={**arguments, "time_limit": seconds})
    return DmControlCompatibilityV0(env, render_mode=render_mode, render_kwargs=_PICTURE)


def _file(wanted: str, kwargs: dict[str, Any], horizon: int | None) -> Env:
    env = make_from_file(wanted, kwargs)
    return env if horizon is None else TimeLimit(env, horizon)


_PICTURE: Final = {"width": 480, "height": 480, "camera_id": 0}
"""The suite's first camera follows what moves, where it has cameras at all."""

LIBRARIES: Final[Mapping[str, Callable[[str, dict[str, Any], int | None], Env]]] = MappingProxyType(
    {"gymnasium": _gymnasium, "dm_control": _dm_control, "file": _file}
)


@contextlib.contextmanager
def quiet(name: str) -> Iterator[None]:
    """Keeps what constructors print and warn of in the log, at level debug."""
    said = io.StringIO()
    # dm_control's compiler advises about every model through absl.
    absl = logging.getLogger("absl")
    level = absl.level
    absl.setLevel(logging.ERROR)
    try:
        with (
            warnings.catch_warnings(record=True) as warned,
            contextlib.redirect_stdout(said),
            contextlib.redirect_stderr(said),
        ):
            warnings.simplefilter("always")
            yield
    finally:
        absl.setLevel(level)
        for line in [*said.getvalue().splitlines(), *(str(w.message) for w in warned)]:
            _logger.debug("%s: %s", name, line)
