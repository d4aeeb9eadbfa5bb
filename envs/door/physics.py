"""One door's physics: its MuJoCo data, and how one control step advances it."""

from __future__ import annotations

from collections.abc import Sequence

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.door.scene import SUBSTEPS, DoorScene
from envs.door.task import HANDLE, HINGE, PALM, PALM_TO_HANDLE

# Everything MuJoCo needs to continue an integration, the solver's warm start included.
_STATE = mujoco.mjtState.mjSTATE_INTEGRATION
_DIVERGENCE = [
    mujoco.mjtWarning.mjWARN_BADQPOS.value,
    mujoco.mjtWarning.mjWARN_BADQVEL.value,
    mujoco.mjtWarning.mjWARN_BADQACC.value,
]
_JOINTS = slice(0, HINGE + 1)


class PhysicsDivergedError(RuntimeError):
    """The simulation of some doors produced NaN or huge numbers. Their indices are in `doors`."""

    def __init__(self, doors: Sequence[int]) -> None:
        self.doors = tuple(doors)
        super().__init__(
            f"physics diverged in doors {list(self.doors)}: check the actions and start states "
            "given to them, then reset them"
        )


class DoorPhysics:
    """The state of one door. The model, which holds the door's position, is passed in.

    One control step is exactly what dm_control's `Physics.step(5)` does (and so RoboHive): finish
    the step begun before, take four, begin the next. Site positions therefore belong to the same
    instant as the joint positions in the observation.

    Args:
        scene: The scene whose model (or a copy of it) every call gets.
    """

    __slots__ = ("_control", "_handle", "_observed_joints", "_palm", "_qpos", "_warnings", "data")

    def __init__(self, scene: DoorScene) -> None:
        self.data = mujoco.MjData(scene.model)
        # Views into MuJoCo's memory: attribute access through the bindings is what costs time.
        self._control = self.data.ctrl
        self._qpos = self.data.qpos
        self._palm = self.data.site_xpos[scene.palm_site]
        self._handle = self.data.site_xpos[scene.handle_site]
        self._warnings = self.data.warning.number
        # The arm's sliding joint (0) is not observed, and the observation has the latch first.
        self._observed_joints = np.r_[1 : scene.hinge_qpos, scene.latch_qpos, scene.hinge_qpos]

    def reset(
        self, model: mujoco.MjModel, qpos: NDArray[np.float64], qvel: NDArray[np.float64]
    ) -> None:
        """Start from joint positions [30] (rad, m) and velocities [30], all forces forgotten."""
        mujoco.mj_resetData(model, self.data)
        self.data.qpos[:] = qpos
        self.data.qvel[:] = qvel
        mujoco.mj_forward(model, self.data)

    def advance(self, model: mujoco.MjModel, control: NDArray[np.float64]) -> None:
        """One control step (0.01 s) towards the position targets `control`, shape [28]."""
        self._control[:] = control
        mujoco.mj_step2(model, self.data)
        mujoco.mj_step(model, self.data, SUBSTEPS - 1)
        mujoco.mj_step1(model, self.data)

    def observe(self, row: NDArray[np.float64]) -> None:
        """Write the observation into `row`, shape [38] (laid out as in `envs.door.task`)."""
        row[_JOINTS] = self._qpos[self._observed_joints]
        row[PALM] = self._palm
        row[HANDLE] = self._handle
        row[PALM_TO_HANDLE] = self._palm - self._handle

    @property
    def diverged(self) -> bool:
        """Whether MuJoCo met NaN or huge numbers since the last reset."""
        return bool(self._warnings[_DIVERGENCE].any())

    def get_state(self, model: mujoco.MjModel) -> NDArray[np.float64]:
        """The integration state, shape [342] for this model."""
        state = np.empty(mujoco.mj_stateSize(model, _STATE))
        mujoco.mj_getState(model, self.data, state, _STATE)
        return state

    def set_state(self, model: mujoco.MjModel, state: NDArray[np.float64]) -> None:
        """Continue bit for bit from `get_state`."""
        mujoco.mj_resetData(model, self.data)
        mujoco.mj_setState(model, self.data, state, _STATE)
        # A control step begins in the middle of a step: redo what `mj_step1` had prepared.
        mujoco.mj_step1(model, self.data)


def state_size(model: mujoco.MjModel) -> int:
    """Numbers in the integration state of one door."""
    return mujoco.mj_stateSize(model, _STATE)
