"""How the door's demonstrations are varied: the palm moves along with the door."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.guide import ArmGuide
from envs.adroit.hand import Placement
from envs.adroit.multiplication import HandVariation
from envs.adroit.varying import Guided, Varying, first
from envs.demonstrations.episode import Episode
from envs.door import task
from envs.door.demos import SCHEMA
from envs.door.hand import DOOR, DOOR_POSITION

GUIDE: Final = ArmGuide(
    arm=slice(0, 4),  # the forearm's slide, then its three rotations
    # The slide is not observed and not needed: sliding does not turn anything.
    joints=slice(1, 1 + task.HAND_QPOS.stop),
    observed=task.HAND_QPOS,
)
RAMP_STEPS: Final = 60
"""The offset grows linearly over so many recorded steps: episodes start in the same reset pose."""


def _offset(source: Placement, new: Placement) -> NDArray[np.float64]:
    return new[DOOR_POSITION] - source[DOOR_POSITION]


def follow(episode: Episode) -> tuple[NDArray[np.float64]]:
    """How much of the door's offset the palm has made at each step, [T]."""
    return (np.minimum(np.arange(episode.length) / RAMP_STEPS, 1.0),)


def begins(episode: Episode) -> int | None:
    """Step in which the door comes open; None if it never does."""
    return first(task.hinge_angle(episode.observations[1:]) > task.OPEN_THRESHOLDS[0])


VARYING: Final = Varying(
    name="DoorVariation",
    task=DOOR,
    schema=SCHEMA,
    apart=lambda source, new: float(np.linalg.norm(_offset(source, new))),
    apart_key="door_offset_m",
    scale_key="position_scale_m",
    progress="a hinge angle in rad",
    guided=Guided(GUIDE, lambda source, new: (_offset(source, new),), follow),
    begins=begins,
    under_way=lambda observations, _: task.hinge_angle(observations) > task.OPEN_THRESHOLDS[0],
    patience=30,
)
VARY: Final = HandVariation(VARYING, scale=0.08)
