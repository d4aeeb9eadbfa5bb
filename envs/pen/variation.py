"""How the pen's demonstrations are varied: other orientations near the one that was asked for."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.hand import Placement
from envs.adroit.multiplication import HandVariation
from envs.adroit.varying import Varying
from envs.pen import task
from envs.pen.demos import SCHEMA
from envs.pen.hand import ASKED_ORIENTATION, PEN


def pointing(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Where a body's z axis points, [3], turned by a unit quaternion [4] (w, x, y, z)."""
    w, x, y, z = quaternion
    return np.array([2 * (x * z + w * y), 2 * (y * z - w * x), 1 - 2 * (x * x + y * y)])


def angle(source: Placement, new: Placement) -> float:
    """Angle between the directions asked for, rad: turning about the pen's own axis is free."""
    cosine = pointing(source[ASKED_ORIENTATION]) @ pointing(new[ASKED_ORIENTATION])
    return float(np.arccos(np.clip(cosine, -1.0, 1.0)))


def on_the_hand(observations: NDArray[np.float32], _: Placement) -> NDArray[np.bool_]:
    """Whether the pen has not been dropped, bool [N], of observations [N, 45]."""
    return observations[:, task.PEN][:, 2] >= task.DROPPED


VARYING: Final = Varying(
    name="PenVariation",
    task=PEN,
    schema=SCHEMA,
    apart=angle,
    apart_key="asked_offset_rad",
    scale_key="angle_scale_rad",
    progress="the cosine of an angle",
    guided=None,
    # It lies in the hand from the first step on, and never comes back to it.
    begins=lambda _: 0,
    under_way=on_the_hand,
    patience=0,
)
VARY: Final = HandVariation(VARYING, scale=0.05)
