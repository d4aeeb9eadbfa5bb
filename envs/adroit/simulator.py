"""Many hands, stepped together on a few threads."""

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

from envs.adroit.changes import ModelChange, ModelChanges
from envs.adroit.hand import HandTask, Judged
from envs.adroit.physics import HandPhysics, HandStates, PhysicsDivergedError, mujoco_data

__all__ = ["HandSimulator", "PhysicsDivergedError", "available_cores"]


def available_cores() -> int:
    """Cores this process may use, at least 1."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class HandSimulator:
    """N independent copies of a hand task behind one array interface.

    MuJoCo's bindings release the GIL, so plain threads scale; each has its own MuJoCo model and
    data, through which copies pass in turn. Copies never interact: a trajectory does not depend on
    their number or that of threads. What one control step is: see `envs.adroit.physics`.

    Args:
        task: What the hand is to do.
        num_copies: Number of copies, N >= 1.
        num_threads: Threads that step them. Default: one per core available, at most N.

    Raises:
        ValueError: If a count is below 1.
        FileNotFoundError: If the model files are missing.
    """

    def __init__(self, task: HandTask, num_copies: int = 1, num_threads: int | None = None) -> None:
        if num_copies < 1:
            raise ValueError(f"num_copies must be at least 1, got {num_copies}")
        if num_threads is not None and num_threads < 1:
            raise ValueError(f"num_threads must be at least 1 (or None), got {num_threads}")
        self.task = task
        self.num_copies = num_copies
        self.num_threads = min(num_threads or available_cores(), num_copies)
        self.scene = task.scene()
        self._states = HandStates(self.scene, num_copies)
        self._changes: ModelChanges | None = None
        self._physics = [HandPhysics(self.scene, self._states) for _ in range(self.num_threads)]
        # The calling thread works too, so that one thread fewer has to be woken for each step.
        self._pool = ThreadPoolExecutor(self.num_threads - 1) if self.num_threads > 1 else None
        model = self.scene.model
        where = {name: numbers.of(model) for name, numbers in self.scene.placed.items()}
        self.start({name: np.tile(at, (num_copies, 1)) for name, at in where.items()})

    @property
    def placement(self) -> dict[str, NDArray[np.float64]]:
        """Where things stand, by name, shape [N, k] each (copies)."""
        return {name: values.copy() for name, values in self._states.placed.items()}

    @property
    def qpos(self) -> NDArray[np.float64]:
        """Joint positions, shape [N, nq], rad and m (a copy): those of the hand first."""
        return self._states.qpos.copy()

    @property
    def qvel(self) -> NDArray[np.float64]:
        """Joint velocities, shape [N, nv], rad/s and m/s (a copy)."""
        return self._states.qvel.copy()

    def observation(self) -> NDArray[np.float32]:
        """Current observations of all copies, shape [N, O]."""
        # A diverged copy's numbers may not fit: `PhysicsDivergedError` has told, NumPy need not.
        with np.errstate(over="ignore", invalid="ignore"):
            return self.task.observe(self._states)

    def judged(self, observation: NDArray[np.float32]) -> Judged:
        """What the task says of all copies now.

        Args:
            observation: Their current observations, [N, O].
        """
        with np.errstate(over="ignore", invalid="ignore"):
            return self.task.judge(self._states, observation)

    def data(self, index: int) -> mujoco.MjData:
        """One copy as MuJoCo data of its own of `scene.model`, for rendering.

        What `scene.model` places is put where it stands in this copy.
        """
        return mujoco_data(self.scene, self._states, index)

    def record_contacts(self) -> None:
        """Measure `forces` and `opposition` at every step from now on.

        Raises:
            ValueError: If the task does not say what can be touched.
        """
        contacts = self.task.contacts
        if contacts is None:
            raise ValueError("this task does not say what a hand may touch (HandTask.contacts)")
        shape = (self.num_copies, len(contacts.parts), len(contacts.targets))
        self._states.forces = np.zeros(shape, dtype=np.float32)
        for physics in self._physics:
            physics.record_contacts(contacts, self.task.surfaces)

    @property
    def forces(self) -> NDArray[np.float32]:
        """Normal forces of the last step by hand part and target, shape [N, P, K], N (a copy)."""
        return self._states.forces.copy()

    @property
    def opposition(self) -> NDArray[np.float32]:
        """How much the thumb opposes the hand, shape [N] (a copy): see `touch.OPPOSITION`."""
        return self._states.opposition.copy()

    def change_model(self, index: int, change: ModelChange | None) -> None:
        """Give one copy a model of its own: the scene's with this change, from its next reset on.

        Nothing of it is in `get_state`: who continues from a state changes the models first.

        Args:
            index: Of the copy.
            change: Writes into the numbers of a `mujoco.MjModel` as the scene has it; None takes
                the scene's.

        Raises:
            IndexError: If there is no such copy.
        """
        if not 0 <= index < self.num_copies:
            raise IndexError(f"index {index} is not in [0, {self.num_copies})")
        if self._changes is None:
            self._changes = ModelChanges(self.scene.model)
        if self._changes.make(change, index, self._states.changed, self.num_copies):
            for physics in self._physics:
                physics.carry_changes()

    def start(
        self,
        placement: Mapping[str, ArrayLike],
        indices: ArrayLike | None = None,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Put copies back to a start state.

        Args:
            placement: Where things stand, shape [n, k] for each name of `scene.placed`.
            indices: The n copies to reset, shape [n]. Default: all, in order (n = N).
            qpos: Joint positions, shape [n, nq]. Default: zeros, the tasks' reset pose.
            qvel: Joint velocities, shape [n, nv]. Default: zeros.

        Returns:
            The observations of these n copies, shape [n, O], float32.

        Raises:
            KeyError: If something is not placed.
            ValueError: If a shape does not fit or a number is not finite.
            IndexError: If an index is not a copy.
            PhysicsDivergedError: If the start state itself is beyond what MuJoCo can handle.
        """
        chosen = np.arange(self.num_copies) if indices is None else np.asarray(indices, dtype=int)
        if not set(chosen.tolist()) <= set(range(self.num_copies)):
            raise IndexError(f"indices {chosen.tolist()} are not all in [0, {self.num_copies})")
        states, count = self._states, len(chosen)
        where = {
            name: _checked(placement[name], (count, values.shape[1]), name)
            for name, values in states.placed.items()
        }
        rest, still = (
            np.zeros((count, states.qpos.shape[1])),
            np.zeros((count, states.qvel.shape[1])),
        )
        start_qpos = rest if qpos is None else _checked(qpos, rest.shape, "qpos")
        start_qvel = still if qvel is None else _checked(qvel, still.shape, "qvel")
        for name, values in where.items():
            states.placed[name][chosen] = values
        for row, index in enumerate(chosen):
            self._physics[0].reset(index, start_qpos[row], start_qvel[row])
        self._raise_if_diverged(chosen)
        return self.observation()[chosen]

    def step(self, action: ArrayLike, mask: NDArray[np.bool_] | None = None) -> NDArray[np.float32]:
        """Advance copies by one control step (0.01 s).

        Args:
            action: Normalised position targets, shape [N, A]; clipped to [-1, 1].
            mask: Which copies to advance, bool [N]; the others are left as they are. Default: all.

        Returns:
            The observations of all N copies, shape [N, O], float32.

        Raises:
            ValueError: If a shape does not fit or an action is not finite.
            PhysicsDivergedError: If a copy's state became NaN or huge. The other copies have been
                advanced; reset the named ones before the next step.
        """
        targets = _checked(action, (self.num_copies, self.task.action_size), "action")
        control = self.scene.control_middle + self.scene.control_half_range * targets.clip(
            -1.0, 1.0
        )
        active = np.ones(self.num_copies, dtype=bool) if mask is None else np.asarray(mask)
        if active.shape != (self.num_copies,) or active.dtype != bool:
            raise ValueError(f"mask must be bool of shape ({self.num_copies},), got {active}")
        chosen = np.flatnonzero(active)
        self._states.control[chosen] = control[chosen]
        self._advance(chosen)
        self._raise_if_diverged(chosen)
        return self.observation()

    def get_state(self) -> dict[str, NDArray[np.float64]]:
        """What a bit-exact continuation needs: ``physics`` [N, S] and the placement by name.

        With it ``readings`` [N, R], where these are older than the joint positions.
        """
        state = {"physics": self._states.physics.copy(), **self.placement}
        return state if self.scene.current else state | {"readings": self._states.readings.copy()}

    def set_state(self, state: Mapping[str, ArrayLike]) -> None:
        """Continue from what `get_state` returned.

        Raises:
            KeyError: If an entry is missing.
            ValueError: If an entry's shape does not fit this simulator or a number is not finite.
        """
        states = self._states
        targets = {"physics": states.physics, **states.placed}
        if not self.scene.current:
            targets["readings"] = states.readings
        found = {
            name: _checked(state[name], values.shape, f"state['{name}']")
            for name, values in targets.items()
        }
        for name, values in targets.items():
            values[:] = found[name]
        for index in range(self.num_copies):
            self._physics[0].take_up(index)

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

    def _advance(self, copies: NDArray[np.int64]) -> None:
        # A shared queue, not fixed shares: hands in contact take longer than free ones.
        queue = deque(copies.tolist())
        mine, *others = self._physics
        tasks: list[Future[None]] = []
        if self._pool is not None:
            tasks = [self._pool.submit(other.advance, queue) for other in others]
        mine.advance(queue)
        for task in tasks:
            task.result()

    def _raise_if_diverged(self, chosen: NDArray[np.int64]) -> None:
        self._states.flag_bad_numbers(chosen)
        broken = chosen[self._states.diverged[chosen]]
        if len(broken):
            raise PhysicsDivergedError(broken.tolist(), self.task.copies)


def _checked(values: ArrayLike, shape: tuple[int, ...], name: str) -> NDArray[np.float64]:
    array = np.asarray(values, dtype=np.float64)
    if array.shape != shape:
        raise ValueError(f"{name} must have shape {shape}, got {array.shape}")
    if not np.isfinite(array).all():
        raise ValueError(f"{name} holds NaN or infinite numbers")
    return array
