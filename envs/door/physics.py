"""The physics of a door: its state as a row of numbers, and how one control step advances it."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.door.scene import SUBSTEPS, DoorScene

Floats = NDArray[np.float64]

# Everything MuJoCo needs to continue an integration, the solver's warm start included.
_STATE: Final[int] = mujoco.mjtState.mjSTATE_INTEGRATION.value
_DIVERGENCE = [
    mujoco.mjtWarning.mjWARN_BADQPOS.value,
    mujoco.mjtWarning.mjWARN_BADQVEL.value,
    mujoco.mjtWarning.mjWARN_BADQACC.value,
]
_NO_WARNINGS = np.zeros(mujoco.mjtWarning.mjNWARNING.value, dtype=np.int32).tobytes()


class PhysicsDivergedError(RuntimeError):
    """The simulation of some doors produced NaN or huge numbers. Their indices are in `doors`."""

    def __init__(self, doors: Sequence[int]) -> None:
        self.doors = tuple(doors)
        super().__init__(
            f"physics diverged in doors {list(self.doors)}: check the actions and start states "
            "given to them, then reset them"
        )


class DoorStates:
    """What is known of N doors, as arrays: all that tells one door from another.

    Attributes:
        physics: MuJoCo's integration states, shape [N, 342]; one contiguous row per door.
        position: Where the door frames stand, shape [N, 3], m.
        palm: Palm positions, shape [N, 3], m, at the same instant as `physics`.
        handle: Handle positions, shape [N, 3], m.
        diverged: Whether MuJoCo met NaN or huge numbers since the last reset, bool [N].
        qpos, qvel, control: Views into `physics`: joint positions [N, 30], joint velocities
            [N, 30] and position targets [N, 28].
    """

    def __init__(self, model: mujoco.MjModel, num_doors: int) -> None:
        self.physics = np.zeros((num_doors, mujoco.mj_stateSize(model, _STATE)))
        self.position = np.zeros((num_doors, 3))
        self.palm = np.zeros((num_doors, 3))
        self.handle = np.zeros((num_doors, 3))
        self.diverged = np.zeros(num_doors, dtype=bool)
        qpos = _columns(model, mujoco.mjtState.mjSTATE_QPOS)
        qvel = _columns(model, mujoco.mjtState.mjSTATE_QVEL)
        self.qpos, self.qvel = self.physics[:, qpos], self.physics[:, qvel]
        self._motion = self.physics[:, qpos.start : qvel.stop]  # both, which are neighbours
        self.control = self.physics[:, _columns(model, mujoco.mjtState.mjSTATE_CTRL)]

    def flag_bad_numbers(self, doors: NDArray[np.int64]) -> None:
        """Mark those of `doors` whose positions or velocities MuJoCo would warn of next."""
        # Written so that NaN, which compares False, is bad too.
        good = np.abs(self._motion[doors]) <= mujoco.mjMAXVAL
        if not good.all():
            self.diverged[doors] |= ~good.all(axis=1)


class DoorPhysics:
    """One thread's MuJoCo model and data, through which every door passes in turn.

    Doors are copied in and out (3 kB) instead of having an `MjData` each: one `MjData` stays in the
    processor's cache, dozens do not. The door's position is a property of the model.

    A control step gives exactly what dm_control's `Physics.step(5)` does (and so RoboHive): five
    steps, and site positions of the same instant as the joint positions. dm_control gets these by
    ending with the first half of the next step; here only its beginning, `mj_kinematics`, is done
    and then done again by the next step, which costs less than keeping all of its results.

    Args:
        scene: The scene; its model is copied.
    """

    def __init__(self, scene: DoorScene) -> None:
        self._model = copy.copy(scene.model)
        self._data = mujoco.MjData(self._model)
        # Views into MuJoCo's memory: attribute access through the bindings is what costs time.
        self._frame = self._model.body_pos[scene.frame_body]
        self._palm = self._data.site_xpos[scene.palm_site]
        self._handle = self._data.site_xpos[scene.handle_site]
        self._warnings = self._data.warning.number

    def reset(self, states: DoorStates, door: int, qpos: Floats, qvel: Floats) -> None:
        """Start one door from positions [30] (rad, m) and velocities [30], forces forgotten."""
        self._frame[:] = states.position[door]
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = qpos
        self._data.qvel[:] = qvel
        # Positions are all that an observation needs; the first step computes the forces.
        mujoco.mj_kinematics(self._model, self._data)
        self._store(states, door)
        states.diverged[door] = False

    def advance(self, states: DoorStates, doors: deque[int]) -> None:
        """One control step (0.01 s) of each door, towards `states.control`, until none is left.

        Several threads may empty one queue.
        """
        # The GIL is held between MuJoCo's calls, by one thread at a time: little is done there.
        model, data, frame = self._model, self._data, self._frame
        position, physics = states.position, states.physics
        while True:
            try:
                door = doors.popleft()
            except IndexError:
                return
            frame[:] = position[door]
            mujoco.mj_setState(model, data, physics[door], _STATE)
            mujoco.mj_step(model, data, SUBSTEPS)
            mujoco.mj_kinematics(model, data)
            self._store(states, door)
            self._flag_warnings(states, door)

    def place(self, states: DoorStates, door: int) -> None:
        """Take up one door's `states.physics`, wherever it came from."""
        self._frame[:] = states.position[door]
        mujoco.mj_setState(self._model, self._data, states.physics[door], _STATE)
        mujoco.mj_kinematics(self._model, self._data)
        self._store(states, door)
        states.diverged[door] = False

    def _store(self, states: DoorStates, door: int) -> None:
        mujoco.mj_getState(self._model, self._data, states.physics[door], _STATE)
        states.palm[door] = self._palm
        states.handle[door] = self._handle

    def _flag_warnings(self, states: DoorStates, door: int) -> None:
        # Compared as bytes, because `any` takes five times as long, with the GIL held.
        if self._warnings.tobytes() == _NO_WARNINGS:
            return
        states.diverged[door] |= self._warnings[_DIVERGENCE].any()
        # Neither the warnings nor the numbers are the next door's.
        mujoco.mj_resetData(self._model, self._data)


def mujoco_data(scene: DoorScene, states: DoorStates, door: int) -> mujoco.MjData:
    """One door as MuJoCo data of its own, for the scene's model, which is given its position."""
    scene.model.body_pos[scene.frame_body] = states.position[door]
    data = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, data, states.physics[door], _STATE)
    # As after dm_control's step: all that follows from positions and velocities is up to date.
    mujoco.mj_step1(scene.model, data)
    return data


def _columns(model: mujoco.MjModel, component: mujoco.mjtState) -> slice:
    """Where a component lies in a state: they come in the order of their bits."""
    start = mujoco.mj_stateSize(model, _STATE & (component.value - 1))
    return slice(start, start + mujoco.mj_stateSize(model, component.value))
