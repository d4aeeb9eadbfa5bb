"""The pen as a task of this project: everything it offers, in one place."""

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
from envs.motion import Motion
from envs.pen import task
from envs.pen.contacts import CONTACTS
from envs.pen.demos import SCHEMA
from envs.pen.disturbing import DISTURB
from envs.pen.hand import PEN, palm
from envs.pen.variation import VARY
from envs.task import Stage, Task


def _aligned(after: TensorDictBase) -> Tensor:
    place = torch.linalg.vector_norm(after["observation"][..., task.OFF_CENTRE], dim=-1)
    return (place < task.HELD) & (after["progress"].squeeze(-1) > task.ALIGNMENTS[0])


VIEW: Final = View((0.06, -0.2, 0.22), distance=0.6, azimuth=90, elevation=-50)
"""Keeps the hand and what it is to do in sight for whole episodes."""

MOTION: Final = Motion(
    effector=palm,
    target=lambda seen: seen[..., task.PEN],
    posture=lambda seen: seen[..., task.HAND_QPOS],
    steps_per_second=STEPS_PER_SECOND,
)

TASK: Final = Task(
    name="pen",
    make_env=MakeEnv(PEN),
    stages=(
        Stage(f"> {task.ALIGNMENTS[0]} aligned", _aligned),
        Stage(f"> {task.ALIGNMENTS[1]} aligned", lambda after: after["success"].squeeze(-1)),
    ),
    starts=Starts(PEN),
    demos=SCHEMA,
    resimulate=Resimulation(PEN),
    render=Pictures(VIEW).render(),
    motion=MOTION,
    disturb=DISTURB,
    strategies=HandStrategies(CONTACTS),
    states=States(PEN),
    vary=VARY,
    progress_unit="cos",
    rewards=REWARDS,
    defaults=MappingProxyType(
        {
            "preset/default": {
                # Up to 61 a step, three times the door's.
                "loss.reward_scale": 0.03,
                "loss.target_entropy": -39,  # 1.6 an action entry, as the door's
                # Played faster than that, a pen is flung off the hand.
                "demos.multiply.speed_low": 0.8,
                "demos.multiply.speed_high": 1.2,
            },
        }
    ),
)
