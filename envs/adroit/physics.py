"""The physics of a hand: its state as a row of numbers, and how one control step advances it."""

from __future__ import annotations

import copy
from collections import deque
from collections.abc import Sequence
from typing import Final

import mujoco
import numpy as np
from numpy.typing import NDArray

from envs.adroit.contacts import ContactReader, Surface
from envs.adroit.scene import SUBSTEPS, HandScene
from envs.adroit.touch import Contacts

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
    """The simulation of some copies produced NaN or huge numbers. Which ones is in `indices`."""

    def __init__(self, indices: Sequence[int], copies: str = "copies") -> None:
        self.indices = tuple(indices)
        super().__init__(
            f"physics diverged in {copies} {list(self.indices)}: check the actions and start "
            "states given to them, then reset them"
        )


class HandStates:
    """What is known of N copies, as arrays: all that tells one copy from another.

    Attributes:
        physics: MuJoCo's integration states, shape [N, S]; one contiguous row per copy.
        placed: Where things stand, by name, shape [N, k] each (`HandScene.placed`).
        read: What was read after the last step, by name, shape [N, k] each (`HandScene.read`).
        readings: All of `read`, of which these are views, shape [N, R].
        changed: What of the model differs between copies beyond `placed`, by MuJoCo's name of the
            array, shape [N, k] each; empty unless somebody changes models (`envs.adroit.changes`).
        forces: Of contacts (`envs.adroit.touch.FORCES`), float32 [N, P, K]; [N, 0, 0] where nobody
            asked for them.
        opposition: Likewise (`envs.adroit.touch.OPPOSITION`), [N].
        diverged: Whether MuJoCo met NaN or huge numbers since the last reset, bool [N].
        qpos, qvel, control: Views into `physics`: joint positions [N, nq], joint velocities
            [N, nv] and position targets [N, A].
    """

    def __init__(self, scene: HandScene, num_copies: int) -> None:
        model, data = scene.model, mujoco.MjData(scene.model)
        self.physics = np.zeros((num_copies, mujoco.mj_stateSize(model, _STATE)))
        self.placed = {
            name: np.zeros((num_copies, len(numbers.of(model))))
            for name, numbers in scene.placed.items()
        }
        sizes = [len(numbers.of(data)) for numbers in scene.read.values()]
        self.readings = np.zeros((num_copies, sum(sizes)))
        parts = np.split(self.readings, np.cumsum(sizes)[:-1], axis=1)
        self.read = dict(zip(scene.read, parts, strict=True))
        self.changed: dict[str, Floats] = {}
        self.forces = np.zeros((num_copies, 0, 0), dtype=np.float32)
        self.opposition = np.zeros(num_copies, dtype=np.float32)
        self.diverged = np.zeros(num_copies, dtype=bool)
        qpos = _columns(model, mujoco.mjtState.mjSTATE_QPOS)
        qvel = _columns(model, mujoco.mjtState.mjSTATE_QVEL)
        self.qpos, self.qvel = self.physics[:, qpos], self.physics[:, qvel]
        self._motion = self.physics[:, qpos.start : qvel.stop]  # both, which are neighbours
        self.control = self.physics[:, _columns(model, mujoco.mjtState.mjSTATE_CTRL)]

    def flag_bad_numbers(self, copies: NDArray[np.int64]) -> None:
        """Mark those of `copies` whose positions or velocities MuJoCo would warn of next."""
        # Written so that NaN, which compares False, is bad too.
        good = np.abs(self._motion[copies]) <= mujoco.mjMAXVAL
        if not good.all():
            self.diverged[copies] |= ~good.all(axis=1)


class HandPhysics:
    """One thread's MuJoCo model and data, through which every copy passes in turn.

    States are copied in and out (3 kB) instead of having an `MjData` each: one `MjData` stays in
    the processor's cache, dozens do not. Where things stand is a property of the model.

    A control step is five steps of the simulation. Where the scene says so, site positions are
    brought to the same instant as the joint positions, exactly as dm_control's `Physics.step(5)`
    does (and so RoboHive). dm_control gets these by ending with the first half of the next step;
    here only its beginning, `mj_kinematics`, is done and then done again by the next step, which
    costs less than keeping all of its results.

    Args:
        scene: The scene; its model is copied.
        states: Of the copies, which this one works on.
    """

    def __init__(self, scene: HandScene, states: HandStates) -> None:
        self._model = copy.copy(scene.model)
        self._data = mujoco.MjData(self._model)
        self._states = states
        self._current = scene.current
        # Views into MuJoCo's memory: attribute access through the bindings is what costs time.
        self._stand = [
            (numbers.of(self._model), states.placed[name]) for name, numbers in scene.placed.items()
        ]
        self._of_copies = self._stand
        self._read = [
            (numbers.of(self._data), states.read[name]) for name, numbers in scene.read.items()
        ]
        self._warnings = self._data.warning.number
        self._contacts: ContactReader | None = None

    def reset(self, index: int, qpos: Floats, qvel: Floats) -> None:
        """Start one copy from positions [nq] (rad, m) and velocities [nv], forces forgotten."""
        self._put(index)
        mujoco.mj_resetData(self._model, self._data)
        self._data.qpos[:] = qpos
        self._data.qvel[:] = qvel
        if self._current:
            # Positions are all that an observation needs; the first step computes the forces.
            mujoco.mj_kinematics(self._model, self._data)
        else:
            mujoco.mj_forward(self._model, self._data)
        self._store(index)
        self._states.diverged[index] = False
        self._states.forces[index] = self._states.opposition[index] = 0.0

    def record_contacts(self, contacts: Contacts, surfaces: tuple[Surface, ...]) -> None:
        """Write `states.forces` and `states.opposition` at every step from now on."""
        self._contacts = ContactReader(self._model, contacts, surfaces)

    def carry_changes(self) -> None:
        """Give each copy its `states.changed` from now on, whose names may be new."""
        changed = [
            (getattr(self._model, name).reshape(-1), values)
            for name, values in self._states.changed.items()
        ]
        # Where things stand comes last: it is of this episode.
        self._of_copies = [*changed, *self._stand]

    def advance(self, copies: deque[int]) -> None:
        """One control step (0.01 s) of each copy, towards `states.control`, until none is left.

        Several threads may empty one queue.
        """
        # The GIL is held between MuJoCo's calls, by one thread at a time: little is done there.
        model, data, physics, current = self._model, self._data, self._states.physics, self._current
        states, contacts = self._states, self._contacts
        while True:
            try:
                index = copies.popleft()
            except IndexError:
                return
            self._put(index)
            mujoco.mj_setState(model, data, physics[index], _STATE)
            if contacts is None:
                mujoco.mj_step(model, data, SUBSTEPS)
            else:
                states.opposition[index] = contacts.step(data, states.forces[index])
            if current:
                mujoco.mj_kinematics(model, data)
            self._store(index)
            self._flag_warnings(index)

    def take_up(self, index: int) -> None:
        """Take up one copy's `states.physics`, wherever it came from."""
        if self._current:
            self._put(index)
            mujoco.mj_setState(self._model, self._data, self._states.physics[index], _STATE)
            mujoco.mj_kinematics(self._model, self._data)
            self._store(index)
        # Otherwise its readings came with it: they are older than its positions.
        self._states.diverged[index] = False

    def _put(self, index: int) -> None:
        for numbers, of_copies in self._of_copies:
            numbers[:] = of_copies[index]

    def _store(self, index: int) -> None:
        mujoco.mj_getState(self._model, self._data, self._states.physics[index], _STATE)
        for numbers, read in self._read:
            read[index] = numbers

    def _flag_warnings(self, index: int) -> None:
        # Compared as bytes, because `any` takes five times as long, with the GIL held.
        if self._warnings.tobytes() == _NO_WARNINGS:
            return
        self._states.diverged[index] |= self._warnings[_DIVERGENCE].any()
        # Neither the warnings nor the numbers are the next copy's.
        mujoco.mj_resetData(self._model, self._data)


def mujoco_data(scene: HandScene, states: HandStates, index: int) -> mujoco.MjData:
    """One copy as MuJoCo data of its own, for the scene's model, where its things are placed."""
    for name, values in states.changed.items():
        getattr(scene.model, name).reshape(-1)[:] = values[index]
    for name, numbers in scene.placed.items():
        numbers.of(scene.model)[:] = states.placed[name][index]
    data = mujoco.MjData(scene.model)
    mujoco.mj_setState(scene.model, data, states.physics[index], _STATE)
    # As after dm_control's step: all that follows from positions and velocities is up to date.
    mujoco.mj_step1(scene.model, data)
    return data


def _columns(model: mujoco.MjModel, component: mujoco.mjtState) -> slice:
    """Where a component lies in a state: they come in the order of their bits."""
    start = mujoco.mj_stateSize(model, _STATE & (component.value - 1))
    return slice(start, start + mujoco.mj_stateSize(model, component.value))
