"""Many doors, stepped together on a few threads."""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Mapping
from concurrent.futures import Future, ThreadPoolExecutor
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from envs.door.physics import DoorPhysics, DoorStates, PhysicsDivergedError, mujoco_data
from envs.door.scene import build_scene
from envs.door.task import ACTION_SIZE, HANDLE, HINGE, OBSERVATION_SIZE, PALM, PALM_TO_HANDLE

__all__ = ["DoorSimulator", "PhysicsDivergedError", "available_cores"]


def available_cores() -> int:
    """Cores this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class DoorSimulator:
    """`num_doors` independent doors behind one array interface.

    MuJoCo's bindings release the GIL, so plain threads scale; each has its own MuJoCo model and
    data, through which doors pass in turn. Doors never interact: a trajectory does not depend on
    the number of doors or threads. What one control step is: see `envs.door.physics`.

    Args:
        num_doors: Number of doors, N >= 1.
        num_threads: Threads that step them. Default: one per core available, at most `num_doors`.

    Raises:
        ValueError: If a count is below 1.
        FileNotFoundError: If the model files are missing.
    """

    def __init__(self, num_doors: int = 1, num_threads: int | None = None) -> None:
        if num_doors < 1:
            raise ValueError(f"num_doors must be at least 1, got {num_doors}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be at least 1 (or None), got {num_threads}")
        self.num_doors = num_doors
        self.num_threads = min(num_threads or available_cores(), num_doors)
        self.scene = build_scene()
        model = self.scene.model
        self._states = DoorStates(model, num_doors)
        self._physics = [DoorPhysics(self.scene) for _ in range(self.num_threads)]
        # The calling thread works too, so that one thread fewer has to be woken for each step.
        self._pool = ThreadPoolExecutor(self.num_threads - 1) if self.num_threads > 1 else None
        # The arm's sliding joint (0) is not observed, and the observation has the latch first.
        hinge, latch = self.scene.hinge_qpos, self.scene.latch_qpos
        self._observed_joints = np.r_[1:hinge, latch, hinge]
        self.reset(np.tile(model.body_pos[self.scene.frame_body], (num_doors, 1)))

    @property
    def door_position(self) -> NDArray[np.float64]:
        """Positions of the door frames, shape [N, 3], m (a copy)."""
        return self._states.position.copy()

    @property
    def qpos(self) -> NDArray[np.float64]:
        """Joint positions, shape [N, 30], rad and m (a copy): 28 of the hand, hinge, latch."""
        return self._states.qpos.copy()

    @property
    def qvel(self) -> NDArray[np.float64]:
        """Joint velocities, shape [N, 30], rad/s and m/s (a copy)."""
        return self._states.qvel.copy()

    def observation(self) -> NDArray[np.float32]:
        """Current observations of all doors, shape [N, 38] (laid out as in `envs.door.task`)."""
        states = self._states
        observation = np.empty((self.num_doors, OBSERVATION_SIZE), dtype=np.float32)
        # A diverged door's numbers may not fit: `PhysicsDivergedError` has told, NumPy need not.
        with np.errstate(over="ignore", invalid="ignore"):
            observation[:, : HINGE + 1] = states.qpos[:, self._observed_joints]
            observation[:, PALM] = states.palm
            observation[:, HANDLE] = states.handle
            observation[:, PALM_TO_HANDLE] = states.palm - states.handle
        return observation

    def data(self, door: int) -> mujoco.MjData:
        """A copy of one door as MuJoCo data of `scene.model`, for rendering.

        The door frame of `scene.model` is put where this door stands.
        """
        return mujoco_data(self.scene, self._states, door)

    def reset(
        self,
        door_position: ArrayLike,
        indices: ArrayLike | None = None,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Put doors back to a start state.

        Args:
            door_position: Where the door frames stand, shape [n, 3], m.
            indices: The n doors to reset, shape [n]. Default: all, in order (n = N).
            qpos: Joint positions, shape [n, 30]. Default: zeros, the task's reset pose.
            qvel: Joint velocities, shape [n, 30]. Default: zeros.

        Returns:
            The observations of these n doors, shape [n, 38], float32.

        Raises:
            ValueError: If a shape does not fit or a number is not finite.
            IndexError: If an index is not a door.
            PhysicsDivergedError: If the start state itself is beyond what MuJoCo can handle.
        """
        chosen = np.arange(self.num_doors) if indices is None else np.asarray(indices, dtype=int)
        if not set(chosen.tolist()) <= set(range(self.num_doors)):
            raise IndexError(f"indices {chosen.tolist()} are not all in [0, {self.num_doors})")
        model, count = self.scene.model, len(chosen)
        rest = np.zeros((count, model.nq))
        position = _checked(door_position, (count, 3), "door_position")
        start_qpos = rest if qpos is None else _checked(qpos, rest.shape, "qpos")
        start_qvel = rest if qvel is None else _checked(qvel, rest.shape, "qvel")
        for row, index in enumerate(chosen):
            self._states.position[index] = position[row]
            self._physics[0].reset(self._states, index, start_qpos[row], start_qvel[row])
        self._raise_if_diverged(chosen)
        return self.observation()[chosen]

    def step(self, action: ArrayLike, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """Advance doors by one control step (0.01 s).

        Args:
            action: Normalised position targets, shape [N, 28]; clipped to [-1, 1].
            mask: Which doors to advance, bool [N]; the others are left as they are. Default: all.

        Returns:
            The observations of all N doors, shape [N, 38], float32.

        Raises:
            ValueError: If a shape does not fit or an action is not finite.
            PhysicsDivergedError: If a door's state became NaN or huge. The other doors have been
                advanced; reset the named ones before the next step.
        """
        targets = _checked(action, (self.num_doors, ACTION_SIZE), "action").clip(-1.0, 1.0)
        control = self.scene.control_middle + self.scene.control_half_range * targets
        active = np.ones(self.num_doors, dtype=bool) if mask is None else np.asarray(mask)
        if active.shape != (self.num_doors,) or active.dtype != bool:
            raise ValueError(f"mask must be bool of shape ({self.num_doors},), got {active}")
        chosen = np.flatnonzero(active)
        self._states.control[chosen] = control[chosen]
        self._advance(chosen)
        self._raise_if_diverged(chosen)
        return self.observation()

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """What a bit-exact continuation needs: ``physics`` [N, 342], ``door_position`` [N, 3]."""
        return {"physics": self._states.physics.copy(), "door_position": self.door_position}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Continue from what `get_state` returned.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If an entry's shape does not fit this simulator or a number is not finite.
        """
        states = self._states
        physics = _checked(state["physics"], states.physics.shape, "state['physics']")
        position = _checked(state["door_position"], (self.num_doors, 3), "state['door_position']")
        states.physics[:], states.position[:] = physics, position
        for door in range(self.num_doors):
            self._physics[0].place(states, door)

    def close(self) -> None:
        """Stop the threads. Calling it twice is fine."""
        if self._pool is not None:
            self._pool.shutdown()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self.close()

    def _advance(self, doors: NDArray[np.int64]) -> None:
        # A shared queue, not fixed shares: doors in contact take longer than free ones.
        queue = deque(doors.tolist())
        mine, *others = self._physics
        tasks: list[Future[None]] = []
        if self._pool is not None:
            tasks = [self._pool.submit(other.advance, self._states, queue) for other in others]
        mine.advance(self._states, queue)
        for task in tasks:
            task.result()

    def _raise_if_diverged(self, chosen: NDArray[np.int64]) -> None:
        self._states.flag_bad_numbers(chosen)
        broken = chosen[self._states.diverged[chosen]]
        if len(broken):
            raise PhysicsDivergedError(broken.tolist())


def _checked(values: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinite numbers")
    return array
