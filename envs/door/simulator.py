"""Many doors, stepped together on a few threads."""

from __future__ import annotations

from typing import Final

import numpy as np
from numpy.typing import ArrayLike, NDArray

from envs.adroit.hand import HandTask, Judged
from envs.adroit.physics import HandStates
from envs.adroit.simulator import HandSimulator, PhysicsDivergedError, available_cores
from envs.door import task
from envs.door.contacts import CONTACTS, SURFACES
from envs.door.demos import DOOR_POSITION
from envs.door.scene import DoorScene, build_scene
from envs.door.starts import sample_door_position

__all__ = ["DOOR", "DoorSimulator", "PhysicsDivergedError", "available_cores"]

# The arm's sliding joint (0) is not observed, and the observation has the latch (29) first.
_OBSERVED_JOINTS: Final = np.r_[1:28, 29, 28]


def _observe(states: HandStates) -> NDArray[np.float32]:
    palm, handle = states.read["palm"], states.read["handle"]
    observation = np.empty((len(palm), task.OBSERVATION_SIZE), dtype=np.float32)
    observation[:, : task.HINGE + 1] = states.qpos[:, _OBSERVED_JOINTS]
    observation[:, task.PALM] = palm
    observation[:, task.HANDLE] = handle
    observation[:, task.PALM_TO_HANDLE] = palm - handle
    return observation


def _judge(_: HandStates, observation: NDArray[np.float32]) -> Judged:
    return Judged(
        reward=task.reward(observation),
        success=task.success(observation),
        progress=task.hinge_angle(observation),
        terminated=task.terminated(observation),
    )


DOOR: Final = HandTask(
    copies="doors",
    observation_size=task.OBSERVATION_SIZE,
    action_size=task.ACTION_SIZE,
    horizon=task.HORIZON,
    scene=build_scene,
    observe=_observe,
    judge=_judge,
    draw=lambda rng: {DOOR_POSITION: sample_door_position(rng)},
    contacts=CONTACTS,
    surfaces=SURFACES,
)


class DoorSimulator(HandSimulator):
    """`num_doors` independent doors behind one array interface; see `HandSimulator`.

    Args:
        num_doors: Number of doors, N >= 1.
        num_threads: Threads that step them. Default: one per core available, at most `num_doors`.

    Raises:
        ValueError: If a count is below 1.
        FileNotFoundError: If the model files are missing.
    """

    scene: DoorScene

    def __init__(self, num_doors: int = 1, num_threads: int | None = None) -> None:
        super().__init__(DOOR, num_doors, num_threads)

    @property
    def num_doors(self) -> int:
        """Number of doors N."""
        return self.num_copies

    @property
    def door_position(self) -> NDArray[np.float64]:
        """Positions of the door frames, shape [N, 3], m (a copy)."""
        return self.placement[DOOR_POSITION]

    def reset(
        self,
        door_position: ArrayLike,
        indices: ArrayLike | None = None,
        qpos: ArrayLike | None = None,
        qvel: ArrayLike | None = None,
    ) -> NDArray[np.float32]:
        """Put doors back to a start state, their frames at `door_position` [n, 3] (m).

        The rest is as in `HandSimulator.start`.
        """
        return self.start({DOOR_POSITION: door_position}, indices, qpos, qvel)
