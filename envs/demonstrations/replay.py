"""Open-loop replay: play given action sequences in many doors at once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.door import task
from envs.door.simulator import DoorSimulator, PhysicsDivergedError

#: Called with the time step t (0-based) and the observations [N, 38] after it; returns bool [N]:
#: which doors are worth playing on.
KeepGoing = Callable[[int, NDArray[np.float32]], NDArray[np.bool_]]


@dataclass(frozen=True, eq=False)
class Replay:
    """What N doors did.

    Attributes:
        observations: float32 [N, H + 1, 38]; row i is valid up to and including ``steps[i]``.
        steps: int [N], transitions played in each door.
        diverged: bool [N], doors whose physics broke down.
    """

    observations: NDArray[np.float32]
    steps: NDArray[np.int64]
    diverged: NDArray[np.bool_]


def replay(
    simulator: DoorSimulator,
    actions: NDArray[np.floating],
    lengths: NDArray[np.integer],
    door_position: NDArray[np.float64],
    *,
    qpos: NDArray[np.float64] | None = None,
    qvel: NDArray[np.float64] | None = None,
    keep_going: KeepGoing | None = None,
) -> Replay:
    """Reset all doors of the simulator and play one action sequence in each.

    A door stops after its ``lengths`` actions, at a terminal observation, when its physics diverges
    or when ``keep_going`` gives it up.

    Args:
        simulator: N doors; their state is overwritten.
        actions: [N, H, 28]; the simulator clips them to [-1, 1].
        lengths: [N], each in 1..H.
        door_position: [N, 3] in metres.
        qpos: [N, 30] start positions, default the task's reset pose (zeros).
        qvel: [N, 30] start velocities, default zeros.
        keep_going: optional rule that abandons doors early.

    Returns:
        The observations and how far each door came.
    """
    doors, horizon, _ = actions.shape
    observations = np.zeros((doors, horizon + 1, task.OBSERVATION_SIZE), dtype=np.float32)
    observations[:, 0] = simulator.reset(door_position, qpos=qpos, qvel=qvel)
    steps = np.zeros(doors, dtype=np.int64)
    diverged = np.zeros(doors, dtype=bool)
    active = np.asarray(lengths) > 0
    for t in range(int(np.max(lengths))):
        if not active.any():
            break
        try:
            after = simulator.step(actions[:, t], mask=active)
        except PhysicsDivergedError as error:
            # The others have been stepped; reading the observations is all that is left to do.
            diverged[list(error.doors)] = True
            active &= ~diverged
            after = simulator.observation()
        observations[active, t + 1] = after[active]
        steps[active] = t + 1
        active &= (t + 1 < lengths) & ~task.terminated(observations[:, t + 1])
        if keep_going is not None:
            active &= keep_going(t, observations[:, t + 1])
    return Replay(observations, steps, diverged)
