"""What of the pen can be disturbed."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from envs.adroit.disturbing import FINGER_DAMPING, hand_disturb, mass
from envs.disturbing import Disturb, Factor
from envs.pen.hand import PEN

DISTURB: Final[Disturb] = hand_disturb(
    PEN,
    MappingProxyType(
        {
            "mass": (Factor("mass of the pen"), mass("Object")),
            "finger_damping": FINGER_DAMPING,
        }
    ),
)
