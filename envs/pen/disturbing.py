"""What of the pen can be disturbed."""

from __future__ import annotations

from math import pi
from types import MappingProxyType
from typing import Final

from envs.adroit.disturbing import FINGER_DAMPING, hand_disturb, mass
from envs.disturbing import Box, Disturb, Factor
from envs.pen.hand import ASKED_ORIENTATION, PEN, angles_of, orientation
from envs.pen.task import ASKED_ANGLE

ASKED: Final = Box(
    key=ASKED_ORIENTATION,
    low=(-ASKED_ANGLE, -ASKED_ANGLE),
    high=(ASKED_ANGLE, ASKED_ANGLE),
    names=("asked_x", "asked_y"),
    least=(-pi / 2, -pi / 2),
    most=(pi / 2, pi / 2),
    why="beyond a quarter turn from upright the pen would have to point down into the hand",
    unit="rad",
    placed=orientation,
    numbers=angles_of,
    beyond=(0.1, 0.2, 0.4),
)

DISTURB: Final[Disturb] = hand_disturb(
    PEN,
    MappingProxyType(
        {
            "mass": (Factor("mass of the pen"), mass("Object")),
            "finger_damping": FINGER_DAMPING,
        }
    ),
    (ASKED,),
)
