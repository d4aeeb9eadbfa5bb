"""The hammer as a task of this project: everything it offers, in one place."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import torch
from tensordict import TensorDictBase
from torch import Tensor

from envs.adroit.render import View
from envs.adroit.resimulation import Resimulation
from envs.adroit.room import REWARDS, MakeEnv, Pictures, Starts
from envs.adroit.scene import STEPS_PER_SECOND
from envs.adroit.states import States
from envs.adroit.strategies import HandStrategies
from envs.hammer import task
from envs.hammer.contacts import CONTACTS
from envs.hammer.demos import SCHEMA
from envs.hammer.disturbing import DISTURB
from envs.hammer.hand import HAMMER
from envs.hammer.variation import VARY
from envs.motion import Motion
from envs.task import Stage, Task

REACHED_M: Final = 0.1
"""Distance between palm and hammer below which the hand counts as having reached it."""


def _reached(after: TensorDictBase) -> Tensor:
    seen = after["observation"]
    return (
        torch.linalg.vector_norm(seen[..., task.PALM] - seen[..., task.HAMMER], dim=-1) < REACHED_M
    )


def _lifted(after: TensorDictBase) -> Tensor:
    return after["observation"][..., task.HAMMER][..., 2] > task.LIFTED


VIEW: Final = View((0.0, -0.1, 0.18), distance=1.0, azimuth=45, elevation=-30)
"""Keeps the hand and what it is to do in sight for whole episodes."""

MOTION: Final = Motion(
    effector=lambda seen: seen[..., task.PALM],
    target=lambda seen: seen[..., task.HAMMER],
    posture=lambda seen: seen[..., task.WRIST_AND_FINGERS],
    steps_per_second=STEPS_PER_SECOND,
)

TASK: Final = Task(
    name="hammer",
    make_env=MakeEnv(HAMMER),
    stages=(
        Stage("reached", _reached),
        Stage("lifted", _lifted),
        Stage("nail hit", lambda after: after["progress"].squeeze(-1) > task.MOVED),
        Stage("nail in", lambda after: after["success"].squeeze(-1)),
    ),
    starts=Starts(HAMMER),
    demos=SCHEMA,
    resimulate=Resimulation(HAMMER),
    render=Pictures(VIEW).render(),
    motion=MOTION,
    disturb=DISTURB,
    strategies=HandStrategies(CONTACTS),
    states=States(HAMMER),
    vary=VARY,
    progress_unit="m",
    rewards=REWARDS,
    defaults=MappingProxyType(
        {
            "preset/default": {
                # Up to 102 a step, five times the door's.
                "loss.reward_scale": 0.02,
                # As the door's: 1.6 an action entry below a uniform distribution over [0, 1], which
                # is less than a cloned policy has.
                "loss.target_entropy": -42,
            },
        }
    ),
)
