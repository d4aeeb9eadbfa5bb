"""Where the moving parts of a task stand in its observations, for comparisons with people."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.floating]


@dataclass(frozen=True)
class Motion:
    """What a task offers so that its episodes can be compared as movements.

    Both positions are from a point that stands still during an episode: the world's origin, or a
    place of the task's own that observations are told from.

    Attributes:
        effector: position of what acts (a palm, a gripper) [..., 3] from observations [..., O], m.
        target: position of what it acts on, likewise.
        posture: joint positions [..., J] from observations, rad.
        steps_per_second: control steps in a second of the task's own time.
    """

    effector: Callable[[Floats], Floats]
    target: Callable[[Floats], Floats]
    posture: Callable[[Floats], Floats]
    steps_per_second: float
