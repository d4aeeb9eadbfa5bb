"""The door as a task of this project: everything it offers, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import torch
from numpy.typing import NDArray
from tensordict import TensorDictBase
from torch import Tensor

from envs.adroit.render import View
from envs.adroit.room import REWARDS, MakeEnv, Pictures, Starts
from envs.adroit.scene import STEPS_PER_SECOND
from envs.adroit.states import States
from envs.adroit.strategies import HandStrategies
from envs.door import metrics, task
from envs.door.contacts import CONTACTS
from envs.door.defaults import DEFAULTS
from envs.door.demos import SCHEMA
from envs.door.disturbing import DISTURB
from envs.door.hand import DOOR
from envs.door.paper import PAPER
from envs.door.resimulation import RESIMULATE
from envs.door.variation import VARY
from envs.motion import Motion
from envs.task import Stage, Task


def _reached(after: TensorDictBase) -> Tensor:
    distance = torch.linalg.vector_norm(after["observation"][..., task.PALM_TO_HANDLE], dim=-1)
    return distance < metrics.REACHED_M


def _latch_turned(after: TensorDictBase) -> Tensor:
    return after["observation"][..., task.LATCH] > metrics.LATCH_TURNED_RAD


def _beyond(angle: float) -> Stage:
    return Stage(f"> {angle} rad", lambda after: after["progress"].squeeze(-1) > angle)


REACHED: Final = Stage("reached", _reached)
LATCH_TURNED: Final = Stage("latch turned", _latch_turned)


def summary(
    progress: NDArray[Any] | None,
    returns: NDArray[Any],
    lengths: NDArray[Any],
    stages: Mapping[str, NDArray[Any]],
) -> Mapping[str, Any]:
    """The columns of Tables I and II of the paper; see `envs.door.metrics.summarise`."""
    if progress is None:
        raise ValueError("a door's progress is its hinge angle, which the rollouts do not hold")
    found = metrics.summarise(
        progress,
        lengths,
        reached=stages[REACHED.label],
        latch_turned=stages[LATCH_TURNED.label],
    )
    return asdict(found)


VIEW: Final = View((0.08, -0.14, 0.24), distance=1.4, azimuth=115, elevation=-25)
"""Keeps the hand and what it is to do in sight for whole episodes."""

MOTION: Final = Motion(
    effector=lambda seen: seen[..., task.PALM],
    target=lambda seen: seen[..., task.HANDLE],
    posture=lambda seen: seen[..., task.WRIST_AND_FINGERS],
    steps_per_second=STEPS_PER_SECOND,
)

TASK: Final = Task(
    name="door",
    make_env=MakeEnv(DOOR),
    stages=(REACHED, LATCH_TURNED, *(_beyond(angle) for angle in task.OPEN_THRESHOLDS)),
    starts=Starts(DOOR),
    demos=SCHEMA,
    resimulate=RESIMULATE,
    states=States(DOOR),
    vary=VARY,
    render=Pictures(VIEW).render(),
    summary=summary,
    motion=MOTION,
    disturb=DISTURB,
    strategies=HandStrategies(CONTACTS),
    progress_unit="rad",
    rewards=REWARDS,
    reference=PAPER,
    defaults=DEFAULTS,
)
