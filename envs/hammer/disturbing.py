"""What of the hammer can be disturbed."""

from __future__ import annotations

from math import inf
from types import MappingProxyType
from typing import Final

from envs.adroit.disturbing import FINGER_DAMPING, friction, hand_disturb, mass
from envs.disturbing import Box, Disturb, Factor
from envs.hammer.hand import BOARD_POSITION, BOARD_X, BOARD_Y, HAMMER
from envs.hammer.task import BOARD_HEIGHT

_HALF_BOARD: Final = 0.08

BOARD: Final = Box(
    key=BOARD_POSITION,
    low=(BOARD_X, BOARD_Y, BOARD_HEIGHT[0]),
    high=(BOARD_X, BOARD_Y, BOARD_HEIGHT[1]),
    names=("board_x", "board_y", "board_z"),
    least=(-inf, -inf, _HALF_BOARD),
    most=(inf, inf, inf),
    why="the board reaches into the table below z = 0.08 m",
)

DISTURB: Final[Disturb] = hand_disturb(
    HAMMER,
    MappingProxyType(
        {
            "mass": (Factor("mass of the hammer"), mass("Object")),
            "nail_friction": (Factor("friction of the nail"), friction("nail_dir")),
            "finger_damping": FINGER_DAMPING,
        }
    ),
    (BOARD,),
)
