"""Tasks to learn and demonstrations to learn from.

Importing this package registers the door with gymnasium as ``AdroitDoor-v0``.
"""

from __future__ import annotations

from typing import Final

import gymnasium

from envs.door.task import HORIZON
from envs.options import EnvOptions
from envs.registry import find_task
from envs.task import Stage, Task

__all__ = ["EnvOptions", "Stage", "Task", "find_task"]

GYMNASIUM_ID: Final = "AdroitDoor-v0"
"""Of the door; gymnasium imports its environment when one is made."""

if GYMNASIUM_ID not in gymnasium.registry:
    gymnasium.register(
        GYMNASIUM_ID,
        entry_point="envs.door.gymnasium_env:AdroitDoorEnv",
        max_episode_steps=HORIZON,
    )
