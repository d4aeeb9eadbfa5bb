"""The door as a task of this project: everything it offers, in one place."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any, Final

import numpy as np
import torch
from numpy.typing import NDArray
from tensordict import TensorDict, TensorDictBase
from torch import Tensor

from envs.adroit.render import View
from envs.adroit.room import REWARDS, Pictures
from envs.adroit.scene import STEPS_PER_SECOND
from envs.adroit.states import States
from envs.door import metrics, task
from envs.door.contacts import CONTACTS
from envs.door.defaults import DEFAULTS
from envs.door.demos import DOOR_POSITION, SCHEMA
from envs.door.disturbing import DISTURB
from envs.door.paper import PAPER
from envs.door.resimulation import resimulate
from envs.door.simulator import DOOR
from envs.door.starts import door_position
from envs.door.torchrl_env import DoorEnv
from envs.door.variation import VARY
from envs.motion import Motion
from envs.options import EnvOptions
from envs.rewards import SPARSE
from envs.task import Stage, Task


def make_env(options: EnvOptions) -> DoorEnv:
    """N doors on all cores."""
    return DoorEnv(
        options.num_envs,
        horizon=options.horizon,
        success_steps=options.success_steps,
        sparse=options.reward == SPARSE,
        contacts=options.contacts,
        num_threads=options.num_threads,
        seed=options.seed,
        device=options.device,
    )


def starts(seed: int, first: int, count: int) -> TensorDict:
    """Door frame positions [count, 3] (m) of the list with this seed."""
    positions = np.stack([door_position(seed, first + i, 0) for i in range(count)])
    return TensorDict({DOOR_POSITION: torch.as_tensor(positions)}, [count])


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
        returns,
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
    make_env=make_env,
    stages=(REACHED, LATCH_TURNED, *(_beyond(angle) for angle in task.OPEN_THRESHOLDS)),
    starts=starts,
    demos=SCHEMA,
    resimulate=resimulate,
    states=States(DOOR),
    vary=VARY,
    render=Pictures(VIEW).render(),
    summary=summary,
    motion=MOTION,
    disturb=DISTURB,
    contacts=CONTACTS,
    progress_unit="rad",
    rewards=REWARDS,
    reference=PAPER,
    defaults=DEFAULTS,
)
