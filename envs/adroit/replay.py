"""Open-loop replay: play given action sequences in many copies at once."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from envs.adroit.physics import PhysicsDivergedError
from envs.adroit.simulator import HandSimulator
from envs.steps import count_steps


@dataclass(frozen=True, eq=False)
class Replay:
    """What N copies did. Rows are valid up to and including ``steps``.

    Attributes:
        observations: float32 [N, H + 1, O].
        rewards: float32 [N, H], of the task.
        terminated: bool [N, H].
        success: bool [N, H + 1].
        progress: float32 [N, H + 1].
        steps: int [N], transitions played in each copy.
        diverged: bool [N], copies whose physics broke down.
    """

    observations: NDArray[np.float32]
    rewards: NDArray[np.float32]
    terminated: NDArray[np.bool_]
    success: NDArray[np.bool_]
    progress: NDArray[np.float32]
    steps: NDArray[np.int64]
    diverged: NDArray[np.bool_]

    @classmethod
    def empty(cls, copies: int, horizon: int, observation_size: int) -> Replay:
        """Nothing played yet."""
        return cls(
            observations=np.zeros((copies, horizon + 1, observation_size), dtype=np.float32),
            rewards=np.zeros((copies, horizon), dtype=np.float32),
            terminated=np.zeros((copies, horizon), dtype=bool),
            success=np.zeros((copies, horizon + 1), dtype=bool),
            progress=np.zeros((copies, horizon + 1), dtype=np.float32),
            steps=np.zeros(copies, dtype=np.int64),
            diverged=np.zeros(copies, dtype=bool),
        )

    def ever(self, holds: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """Whether it held after any step that was played, [N], of [N, H + 1]."""
        played = np.arange(holds.shape[1]) <= self.steps[:, None]
        return np.asarray((holds & played)[:, 1:].any(axis=1))

    def note(self, t: int, simulator: HandSimulator, active: NDArray[np.bool_]) -> None:
        """Take down where the active copies are after t steps."""
        observation = simulator.observation()
        judged = simulator.judged(observation)
        self.observations[active, t] = observation[active]
        self.success[active, t] = judged.success[active]
        self.progress[active, t] = judged.progress[active]
        self.steps[active] = t
        if t > 0:
            self.rewards[active, t - 1] = judged.reward[active]
            self.terminated[active, t - 1] = judged.terminated[active]


KeepGoing = Callable[[int, Replay], NDArray[np.bool_]]
"""Which copies are worth playing on, [N], given how many steps they have made and what they did."""


def replay(
    simulator: HandSimulator,
    actions: NDArray[np.floating],
    lengths: NDArray[np.integer],
    placement: Mapping[str, NDArray[np.float64]],
    *,
    qpos: NDArray[np.float64] | None = None,
    qvel: NDArray[np.float64] | None = None,
    keep_going: KeepGoing | None = None,
) -> Replay:
    """Reset all copies of the simulator and play one action sequence in each.

    A copy stops after its ``lengths`` actions, at a terminal observation, when its physics diverges
    or when ``keep_going`` gives it up.

    Args:
        simulator: N copies; their state is overwritten.
        actions: [N, H, A]; the simulator clips them to [-1, 1].
        lengths: [N], each in 0..H.
        placement: where things stand, [N, k] by name.
        qpos: [N, nq] start positions, default the tasks' reset pose (zeros).
        qvel: [N, nv] start velocities, default zeros.
        keep_going: optional rule that abandons copies early.

    Returns:
        What happened and how far each copy came.
    """
    copies, horizon, _ = actions.shape
    played = Replay.empty(copies, horizon, simulator.task.observation_size)
    simulator.start(placement, qpos=qpos, qvel=qvel)
    played.note(0, simulator, np.ones(copies, dtype=bool))
    active = np.asarray(lengths) > 0
    for t in range(int(np.max(lengths))):
        if not active.any():
            break
        try:
            simulator.step(actions[:, t], mask=active)
        except PhysicsDivergedError as error:
            # The others have been stepped; reading the observations is all that is left to do.
            played.diverged[list(error.indices)] = True
            active &= ~played.diverged
        played.note(t + 1, simulator, active)
        active &= (t + 1 < lengths) & ~played.terminated[:, t]
        if keep_going is not None:
            active &= keep_going(t + 1, played)
    count_steps(int(played.steps.sum()))
    return played
