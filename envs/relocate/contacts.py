"""What a hand may touch in this task, and what its strategies are called."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from envs.adroit.contacts import PARTS, THUMB, Surface
from envs.adroit.touch import Contacts

GEOMS: Final[dict[str, tuple[str, ...]]] = {"table": ("table", "leg_1", "leg_2", "leg_3", "leg_4")}
"""Names for the geoms of bodies, in the order of the model file, which has none."""

SURFACES: Final = (
    Surface("sphere", "ball"),
    Surface("table", "table"),
)

CONTACTS: Final = Contacts(
    parts=PARTS,
    thumb=THUMB,
    targets=("ball", "table"),
    held=("ball",),
    begins=0.0,
    moved=0.05,  # m nearer to the target
    words=MappingProxyType(
        {
            "grasp": "carried with an opposed grasp of the ball",
            "held": "carried in touch with the ball, not opposed",
            "flung": "the hand off the ball for much of the way",
            "elsewhere": "the hand elsewhere for much of the way",
            "short": "moved, never far enough",
            "touched": "the ball touched, not moved",
            "untouched": "the ball never touched",
        }
    ),
)
