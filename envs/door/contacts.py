"""What of the door a hand may touch, and what its ways of opening are called."""

from __future__ import annotations

from types import MappingProxyType
from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.contacts import PARTS, THUMB, Surface
from envs.adroit.touch import Contacts

GEOMS: Final[dict[str, tuple[str, ...]]] = {
    "frame": ("post_hinge", "post_latch"),
    "door": ("panel", "rim_hinge", "rim_latch"),
    "latch": ("spindle", "lever", "back_lever"),
}
"""Names for the geoms of bodies, in the order of the model file, which has none."""
EDGE_M: Final = -0.21
"""Along the door from its middle: beyond it the rim of 0.05 m that begins at -0.2 m is round."""


def _of_door(point: NDArray[np.float64]) -> str:
    if point[0] < EDGE_M:
        return "edge"
    return "panel" if point[1] < 0.0 else "back"


def _of_spindle(point: NDArray[np.float64]) -> str:
    """It goes through the door; the hand begins at y < 0."""
    return "latch" if point[1] < 0.0 else "back"


SURFACES: Final = (
    Surface("lever", "handle"),
    Surface("spindle", _of_spindle),
    Surface("back_lever", "back"),
    *(Surface(geom, _of_door) for geom in GEOMS["door"]),
    *(Surface(geom, "frame") for geom in GEOMS["frame"]),
)

CONTACTS: Final = Contacts(
    parts=PARTS,
    thumb=THUMB,
    targets=("handle", "latch", "panel", "edge", "back", "frame"),
    held=("handle", "latch"),
    # A closed door rests at 0.012 rad, and its latch gives up to 0.034.
    begins=0.05,
    moved=0.2,
    words=MappingProxyType(
        {
            "grasp": "led by an opposed grasp of the handle",
            "held": "led by the handle, not opposed",
            "flung": "the hand off for much of the door's travel",
            "elsewhere": "pushed or pulled at edge, panel or back",
            "short": "opened, never past 1.35 rad",
            "touched": "handle touched, not opened",
            "untouched": "handle never touched",
        }
    ),
)
