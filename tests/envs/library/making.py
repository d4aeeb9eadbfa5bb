"""Environments of the toys, by what is special about them."""

from __future__ import annotations

from typing import Any

from envs import EnvOptions, Task, find_task
from envs.library.vector_env import VectorEnv
from envs.options import TaskOptions
from tests.envs.library.toys import HERE


def task(name: str, **options: Any) -> Task:
    """The task of a toy, with options of the user's."""
    return find_task(f"{HERE}/{name}-v0", TaskOptions(**options))


def make(name: str, options: TaskOptions | None = None, **env: Any) -> VectorEnv:
    """A batched toy: reproducible and in this process unless told otherwise."""
    found = find_task(f"{HERE}/{name}-v0", options or TaskOptions())
    made = found.make_env(EnvOptions(**{"seed": 0, "workers": 0, **env}))
    assert isinstance(made, VectorEnv)
    return made
