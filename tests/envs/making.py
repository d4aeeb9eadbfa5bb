"""Environments by the name of their task."""

from __future__ import annotations

from typing import Any

from torchrl.envs import EnvBase

from envs import EnvOptions, find_task


def make_env(name: str, **options: Any) -> EnvBase:
    """The batched environment of a task."""
    return find_task(name).make_env(EnvOptions(**options))
