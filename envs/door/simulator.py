"""Many doors, stepped together on a few threads."""

from __future__ import annotations

import copy
import os
from collections import deque
from collections.abc import Mapping
from concurrent.futures import ThreadPoolExecutor
from types import TracebackType
from typing import Self

import mujoco
import numpy as np
from numpy.typing import ArrayLike, NDArray

from envs.door.physics import DoorPhysics, PhysicsDivergedError, state_size
from envs.door.scene import build_scene
from envs.door.task import ACTION_SIZE, OBSERVATION_SIZE

__all__ = ["DoorSimulator", "PhysicsDivergedError", "available_cores"]


def available_cores() -> int:
    """Cores this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class DoorSimulator:
    """`num_doors` independent doors behind one array interface.

    The door's position is a property of the *model*, so there is one `MjModel` per thread and the
    position is written into it before each door is advanced. MuJoCo's bindings release the GIL, so
    plain threads scale. Doors never interact: a trajectory does not depend on the number of doors
    or threads. What one control step is: see `envs.door.physics`.

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
        model, frame = self.scene.model, self.scene.frame_body
        self._models = [model, *(copy.copy(model) for _ in range(self.num_threads - 1))]
        self._frames = [worker_model.body_pos[frame] for worker_model in self._models]
        self._pool = ThreadPoolExecutor(self.num_threads) if self.num_threads > 1 else None
        self._doors = [DoorPhysics(self.scene) for _ in range(num_doors)]
        self._door_position = np.zeros((num_doors, 3))
        self._observation = np.zeros((num_doors, OBSERVATION_SIZE))
        self.reset(np.tile(model.body_pos[frame], (num_doors, 1)))

    @property
    def door_position(self) -> NDArray[np.float64]:
        """Positions of the door frames, shape [N, 3], m (a copy)."""
        return self._door_position.copy()

    @property
    def qpos(self) -> NDArray[np.float64]:
        """Joint positions, shape [N, 30], rad and m (a copy): 28 of the hand, hinge, latch."""
        return np.stack([door.data.qpos for door in self._doors])

    @property
    def qvel(self) -> NDArray[np.float64]:
        """Joint velocities, shape [N, 30], rad/s and m/s (a copy)."""
        return np.stack([door.data.qvel for door in self._doors])

    def observation(self) -> NDArray[np.float32]:
        """Current observations of all doors, shape [N, 38] (laid out as in `envs.door.task`)."""
        return self._observation.astype(np.float32)

    def data(self, door: int) -> mujoco.MjData:
        """The live MuJoCo data of one door, for rendering. Read it, do not write it."""
        return self._doors[door].data

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
            self._door_position[index] = self._frames[0][:] = position[row]
            self._doors[index].reset(model, start_qpos[row], start_qvel[row])
            self._doors[index].observe(self._observation[index])
        self._raise_if_diverged(chosen)
        return self._observation[chosen].astype(np.float32)

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
        # A shared queue, not fixed shares: doors in contact take longer than free ones.
        queue = deque(chosen.tolist())
        if self._pool is None:
            self._work(0, queue, control)
        else:
            workers = range(self.num_threads)
            tasks = [self._pool.submit(self._work, worker, queue, control) for worker in workers]
            for task in tasks:
                task.result()
        self._raise_if_diverged(chosen)
        return self.observation()

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """What a bit-exact continuation needs: ``physics`` [N, 342], ``door_position`` [N, 3]."""
        physics = np.stack([door.get_state(self.scene.model) for door in self._doors])
        return {"physics": physics, "door_position": self.door_position}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Continue from what `get_state` returned.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If an entry's shape does not fit this simulator or a number is not finite.
        """
        model = self.scene.model
        physics_shape = (self.num_doors, state_size(model))
        physics = _checked(state["physics"], physics_shape, "state['physics']")
        position = _checked(state["door_position"], (self.num_doors, 3), "state['door_position']")
        for index, door in enumerate(self._doors):
            self._door_position[index] = self._frames[0][:] = position[index]
            door.set_state(model, physics[index])
            door.observe(self._observation[index])

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

    def _work(self, worker: int, queue: deque[int], control: NDArray[np.float64]) -> None:
        """Advance doors from the queue until it is empty, with this worker's own model."""
        model, frame = self._models[worker], self._frames[worker]
        while True:
            try:
                index = queue.popleft()
            except IndexError:
                return
            frame[:] = self._door_position[index]
            self._doors[index].advance(model, control[index])
            self._doors[index].observe(self._observation[index])

    def _raise_if_diverged(self, chosen: NDArray[np.int64]) -> None:
        broken = [int(index) for index in chosen if self._doors[index].diverged]
        if broken:
            raise PhysicsDivergedError(broken)


def _checked(values: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinite numbers")
    return array
