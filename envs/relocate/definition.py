"""Relocate as a task of this project: everything it offers, in one place."""

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
from envs.relocate import task
from envs.relocate.contacts import CONTACTS
from envs.relocate.demos import SCHEMA
from envs.relocate.disturbing import DISTURB
from envs.relocate.hand import RELOCATE
from envs.relocate.variation import VARY
from envs.task import Stage, Task

REACHED_M: Final = 0.1
"""Distance between palm and ball below which the hand counts as having reached it."""


def _reached(after: TensorDictBase) -> Tensor:
    distance = torch.linalg.vector_norm(after["observation"][..., task.BALL_TO_PALM], dim=-1)
    return distance < REACHED_M


def _within(distance: float) -> Stage:
    return Stage(f"< {distance} m", lambda after: after["progress"].squeeze(-1) > -distance)


VIEW: Final = View((0.0, 0.02, 0.16), distance=1.2, azimuth=60, elevation=-30)
"""Keeps the hand and what it is to do in sight for whole episodes."""

MOTION: Final = Motion(
    # Both from the place that the ball is carried to, which stands still: an observation shows
    # neither palm nor ball in the world.
    effector=lambda seen: seen[..., task.TARGET_TO_PALM],
    target=lambda seen: seen[..., task.TARGET_TO_BALL],
    posture=lambda seen: seen[..., task.WRIST_AND_FINGERS],
    steps_per_second=STEPS_PER_SECOND,
)

TASK: Final = Task(
    name="relocate",
    make_env=MakeEnv(RELOCATE),
    stages=(Stage("reached", _reached), _within(task.CLOSE), _within(task.VERY_CLOSE)),
    starts=Starts(RELOCATE),
    demos=SCHEMA,
    resimulate=Resimulation(RELOCATE),
    render=Pictures(VIEW).render(),
    motion=MOTION,
    disturb=DISTURB,
    strategies=HandStrategies(CONTACTS),
    states=States(RELOCATE),
    vary=VARY,
    progress_unit="m",
    rewards=REWARDS,
    defaults=MappingProxyType(
        {
            "preset/default": {
                # Up to 31 a step, half as much again as the door's.
                "loss.reward_scale": 0.06,
                "loss.target_entropy": -48,  # 1.6 an action entry, as the door's
                # A clone of these keeps the ball at its target (docs/howto/your-environment.md).
                "demos.multiply.enabled": True,
                "demos.multiply.target_episodes": 920,
                "demos.multiply.max_attempts": 10_000,
                "demos.held_out": 20,
                # Played faster, a hand that was moved to another ball closes beside it.
                "demos.multiply.speed_low": 0.9,
                "demos.multiply.speed_high": 1.2,
            },
        }
    ),
)
