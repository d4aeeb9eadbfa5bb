"""What a hand may touch in this task, and what its strategies are called."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from envs.adroit.contacts import PARTS, THUMB, Surface
from envs.adroit.touch import Contacts

SURFACES: Final = (Surface("pen", "pen"),)

CONTACTS: Final = Contacts(
    parts=PARTS,
    thumb=THUMB,
    targets=("pen",),
    held=("pen",),
    begins=0.0,
    moved=0.1,  # cosine to the asked orientation
    words=MappingProxyType(
        {
            "grasp": "turned with an opposed grasp of the pen",
            "held": "turned in touch with the pen, not opposed",
            "flung": "the hand off the pen for much of the way",
            "elsewhere": "the hand elsewhere for much of the way",
            "short": "moved, never far enough",
            "touched": "the pen touched, not moved",
            "untouched": "the pen never touched",
        }
    ),
)
