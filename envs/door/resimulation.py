"""Play recorded episodes in our own simulator: true states, our reward, our termination."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from envs.adroit.replay import Replay, replay
from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.door import task
from envs.door.demos import DOOR_POSITION, QPOS, QVEL
from envs.door.simulator import DoorSimulator

#: Doors stepped together. More would only raise the memory; the result does not depend on it.
BATCH = 64


def resimulate(
    episodes: Sequence[Episode],
    *,
    num_threads: int | None = None,
    from_reset_pose: bool = True,
    horizon: int | None = None,
) -> list[Episode]:
    """Replay the executed actions of each episode, open loop, at the door it was recorded with.

    The recorded observations of the human demonstrations do not start in the pose in which the task
    starts (entries differ by up to 0.4), and their rewards follow another formula. The replayed
    episode holds the states that a policy will really see, the task's reward and its termination.

    Args:
        episodes: episodes with actions; where the door position is unknown it is inferred from the
            handle in the first observation (the door is closed there).
        num_threads: threads of the simulator, default all available cores. No effect on the result.
        from_reset_pose: start at qpos = qvel = 0, as every episode of the task does; otherwise at
            the recorded state, with the hand's joints read from the first observation where the
            file holds no state.
        horizon: play at most so many steps; default the whole episode.

    Returns:
        Episodes of kind ``resimulated``, in the same order. Actions stay as recorded.

    Raises:
        DemonstrationError: the physics diverges, or an episode's door position cannot be inferred.
    """
    played: list[Episode] = []
    if not episodes:
        return played
    size = min(len(episodes), BATCH)
    with DoorSimulator(size, num_threads=num_threads) as simulator:
        offset = _handle_offset(simulator)
        for start in range(0, len(episodes), size):
            batch = episodes[start : start + size]
            doors = np.stack([door_position(episode, offset) for episode in batch])
            result = _play(simulator, batch, doors, from_reset_pose, horizon)
            played += [
                _resimulated(episode, doors[i], result, i, from_reset_pose)
                for i, episode in enumerate(batch)
            ]
    return played


def door_position(episode: Episode, handle_offset: NDArray[np.float64]) -> NDArray[np.float64]:
    """Position of the episode's door frame [3] in metres, inferred if the file does not hold it.

    Args:
        episode: any episode.
        handle_offset: [3], handle minus frame position with the door closed.

    Raises:
        DemonstrationError: the position is unknown and the door is not closed at the start.
    """
    if DOOR_POSITION in episode.start:
        return episode.start[DOOR_POSITION]
    first = episode.observations[0].astype(np.float64)
    if abs(first[task.HINGE]) > 0.01 or abs(first[task.LATCH]) > 0.05:
        raise DemonstrationError(
            episode.provenance,
            "has no door position and begins with a moved door",
            "Load it without re-simulation, or store the door position in the file",
        )
    return first[task.HANDLE] - handle_offset


def _handle_offset(simulator: DoorSimulator) -> NDArray[np.float64]:
    origin = np.zeros((simulator.num_doors, 3))
    return simulator.reset(origin)[0, task.HANDLE].astype(np.float64)


def _play(
    simulator: DoorSimulator,
    batch: Sequence[Episode],
    doors: NDArray[np.float64],
    from_reset_pose: bool,
    horizon: int | None,
) -> Replay:
    lengths = np.array([min(e.length, horizon or e.length) for e in batch])
    # The last batch may be smaller than the simulator: idle doors play nothing.
    spare = simulator.num_doors - len(batch)
    actions = np.zeros((simulator.num_doors, lengths.max(), task.ACTION_SIZE))
    for i, (episode, length) in enumerate(zip(batch, lengths, strict=True)):
        actions[i, :length] = episode.played_actions[:length]
    qpos = qvel = None
    if not from_reset_pose:
        qpos = np.pad(np.stack([_start_qpos(e) for e in batch]), ((0, spare), (0, 0)))
        zeros = np.zeros(qpos.shape[1])
        qvel = np.stack([e.start.get(QVEL, zeros) for e in batch])
        qvel = np.pad(qvel, ((0, spare), (0, 0)))
    return replay(
        simulator,
        actions,
        np.pad(lengths, (0, spare)),
        {DOOR_POSITION: np.pad(doors, ((0, spare), (0, 0)), mode="edge")},
        qpos=qpos,
        qvel=qvel,
    )


def _start_qpos(episode: Episode) -> NDArray[np.float64]:
    if QPOS in episode.start:
        return episode.start[QPOS]
    first = episode.observations[0]
    # Only the slide of the forearm (the first joint) is not observed.
    return np.concatenate([[0.0], first[task.HAND_QPOS], first[[task.HINGE, task.LATCH]]])


def _resimulated(
    episode: Episode, door: NDArray[np.float64], result: Replay, index: int, from_reset_pose: bool
) -> Episode:
    if result.diverged[index]:
        raise DemonstrationError(
            episode.provenance,
            f"makes the physics diverge at step {result.steps[index]}",
            "Load it without re-simulation, or remove the episode",
        )
    steps = int(result.steps[index])
    observations = result.observations[index, : steps + 1].copy()
    start = {DOOR_POSITION: door}
    if not from_reset_pose:
        start |= {QPOS: _start_qpos(episode)}
        start |= {QVEL: episode.start[QVEL]} if QVEL in episode.start else {}
    return Episode(
        observations=observations,
        actions=episode.actions[:steps],
        rewards=task.reward(observations[1:]),
        terminated=task.terminated(observations[1:]),
        provenance=dataclasses.replace(episode.provenance, kind="resimulated"),
        start=start,
        success=task.success(observations),
        progress=task.hinge_angle(observations),
        executed_actions=(
            None if episode.executed_actions is None else episode.executed_actions[:steps]
        ),
    )
