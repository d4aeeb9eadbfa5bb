"""What of the door can be disturbed."""

from __future__ import annotations

from math import inf
from types import MappingProxyType
from typing import Final

from envs.adroit.disturbing import damping, friction, hand_disturb, mass
from envs.disturbing import Box, Disturb, Factor
from envs.door.hand import DOOR, DOOR_POSITION
from envs.door.task import DOOR_POSITION_HIGH, DOOR_POSITION_LOW

FRAME: Final = Box(
    key=DOOR_POSITION,
    low=DOOR_POSITION_LOW,
    high=DOOR_POSITION_HIGH,
    names=("door_x", "door_y", "door_z"),
    least=(-inf, -inf, DOOR_POSITION_LOW[2]),
    most=(inf, inf, inf),
    why="a door frame below z = 0.252 m penetrates the table and jams",
)

DISTURB: Final[Disturb] = hand_disturb(
    DOOR,
    MappingProxyType(
        {
            "hinge_friction": (Factor("friction of the hinge"), friction("door_hinge")),
            "hinge_damping": (Factor("damping of the hinge"), damping("door_hinge")),
            "latch_friction": (Factor("friction of the latch"), friction("latch")),
            "mass": (Factor("mass of door and latch"), mass("door", "latch")),
        }
    ),
    (FRAME,),
)
