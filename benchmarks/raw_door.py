"""One door of the project's model played with MuJoCo's own calls: the physics without a system.

It shares the compiled model with the project and none of its stepping code, which is what is
measured against it.
"""

from __future__ import annotations

import copy

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.adroit.scene import SUBSTEPS, HandScene
from envs.door.hand import DOOR_POSITION, OBSERVED_JOINTS


class RawDoor:
    """A model and its data. An action is five calls' worth of ``mj_step``."""

    def __init__(self, scene: HandScene) -> None:
        self.model = copy.copy(scene.model)
        self.data = mujoco.MjData(self.model)
        # Views into MuJoCo's memory, so that reading them costs no attribute access.
        self.control = self.data.ctrl
        self.qpos = self.data.qpos
        self.palm = scene.read["palm"].of(self.data)
        self.handle = scene.read["handle"].of(self.data)
        self.frame = scene.placed[DOOR_POSITION].of(self.model)

    def reset(self, position: NDArray[np.float64] | None = None) -> None:
        """The task's reset pose; the door at ``position`` [3] (m), or where it was."""
        if position is not None:
            self.frame[:] = position
        mujoco.mj_resetData(self.model, self.data)
        mujoco.mj_forward(self.model, self.data)

    def step(self, control: NDArray[np.float64]) -> None:
        """One control step towards the position targets [28]."""
        self.control[:] = control
        mujoco.mj_step(self.model, self.data, SUBSTEPS)

    def observation(self) -> NDArray[np.float64]:
        """The task's 38 observations."""
        return np.concatenate(
            [self.qpos[OBSERVED_JOINTS], self.palm, self.handle, self.palm - self.handle]
        )
