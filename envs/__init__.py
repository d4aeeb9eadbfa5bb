"""Tasks to learn and demonstrations to learn from.

Importing this package registers the door with gymnasium as ``AdroitDoor-v0``.
"""

from __future__ import annotations

import gymnasium

from envs.door.gymnasium_env import GYMNASIUM_ID, AdroitDoorEnv
from envs.door.task import HORIZON
from envs.options import EnvOptions
from envs.registry import find_task
from envs.task import Stage, Task

__all__ = ["EnvOptions", "Stage", "Task", "find_task"]

if GYMNASIUM_ID not in gymnasium.registry:
    gymnasium.register(
        GYMNASIUM_ID,
        entry_point=f"{AdroitDoorEnv.__module__}:{AdroitDoorEnv.__name__}",
        max_episode_steps=HORIZON,
    )
