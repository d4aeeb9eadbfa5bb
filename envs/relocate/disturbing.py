"""What of relocate can be disturbed."""

from __future__ import annotations

from math import inf
from types import MappingProxyType
from typing import Final

from envs.adroit.disturbing import FINGER_DAMPING, hand_disturb, mass
from envs.disturbing import Box, Disturb, Factor
from envs.relocate.hand import BALL_POSITION, RELOCATE, TARGET_POSITION
from envs.relocate.task import BALL_HEIGHT, BALL_HIGH, BALL_LOW, TARGET_HIGH, TARGET_LOW

_HALF_TABLE: Final = 0.45

BALL: Final = Box(
    key=BALL_POSITION,
    low=(*BALL_LOW, BALL_HEIGHT),
    high=(*BALL_HIGH, BALL_HEIGHT),
    names=("ball_x", "ball_y", ""),
    least=(-_HALF_TABLE, -_HALF_TABLE, BALL_HEIGHT),
    most=(_HALF_TABLE, _HALF_TABLE, BALL_HEIGHT),
    why="the table ends there, and the ball falls",
)
TARGET: Final = Box(
    key=TARGET_POSITION,
    low=TARGET_LOW,
    high=TARGET_HIGH,
    names=("target_x", "target_y", "target_z"),
    least=(-inf, -inf, BALL_HEIGHT),
    most=(inf, inf, inf),
    why="the ball cannot be carried into the table",
)

DISTURB: Final[Disturb] = hand_disturb(
    RELOCATE,
    MappingProxyType(
        {
            "mass": (Factor("mass of the ball"), mass("Object")),
            "finger_damping": FINGER_DAMPING,
        }
    ),
    (BALL, TARGET),
)
