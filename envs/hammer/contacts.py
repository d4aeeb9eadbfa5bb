"""What a hand may touch in this task, and what its strategies are called."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

from envs.adroit.contacts import PARTS, THUMB, Surface
from envs.adroit.touch import Contacts

GEOMS: Final[dict[str, tuple[str, ...]]] = {"nail": ("nail_head", "nail_shank")}
"""Names for the geoms of bodies, in the order of the model file, which has none."""

SURFACES: Final = (
    Surface("handle", "handle"),
    Surface("neck", "neck"),
    Surface("head", "head"),
    Surface("nail_head", "nail"),
    Surface("nail_shank", "nail"),
    Surface("board", "board"),
)

CONTACTS: Final = Contacts(
    parts=PARTS,
    thumb=THUMB,
    targets=("handle", "neck", "head", "nail", "board"),
    held=("handle", "neck", "head"),
    begins=0.0,
    moved=0.01,  # m that the nail was driven
    words=MappingProxyType(
        {
            "grasp": "driven with an opposed grasp of the hammer",
            "held": "driven in touch with the hammer, not opposed",
            "flung": "the hand off the hammer for much of the way",
            "elsewhere": "the hand elsewhere for much of the way",
            "short": "moved, never far enough",
            "touched": "the hammer touched, not moved",
            "untouched": "the hammer never touched",
        }
    ),
)
