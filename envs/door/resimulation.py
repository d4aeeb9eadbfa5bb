"""How recorded episodes of the door are played again: from the reset pose, at their door."""

from __future__ import annotations

import dataclasses
from functools import cache
from typing import Final

import numpy as np
from numpy.typing import NDArray

from envs.adroit.resimulation import Resimulation
from envs.adroit.simulator import HandSimulator
from envs.demonstrations.episode import Episode
from envs.demonstrations.errors import DemonstrationError
from envs.door import task
from envs.door.hand import DOOR, DOOR_POSITION


def in_reset_pose(episode: Episode) -> Episode:
    """The episode as one that begins in the pose in which the task begins, at its own door.

    The recorded observations of the human demonstrations begin in another pose (entries differ by
    up to 0.4), which no episode of the task does. A door position that is not recorded is inferred.

    Raises:
        DemonstrationError: an episode's door position cannot be inferred.
    """
    return dataclasses.replace(episode, start={DOOR_POSITION: door_position(episode)})


def door_position(episode: Episode) -> NDArray[np.float64]:
    """Position of the episode's door frame [3], m, from the handle where it is not recorded.

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
    return first[task.HANDLE] - _handle_offset()


@cache
def _handle_offset() -> NDArray[np.float64]:
    """Handle minus frame position with the door closed, [3], m."""
    with HandSimulator(DOOR, 1) as simulator:
        return simulator.start({DOOR_POSITION: np.zeros((1, 3))})[0, task.HANDLE].astype(float)


RESIMULATE: Final = Resimulation(DOOR, prepare=in_reset_pose)
