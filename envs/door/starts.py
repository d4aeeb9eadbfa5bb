"""Where the door stands at the start of an episode, drawn reproducibly for each door."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from envs.adroit.starts import episode_rng
from envs.door.task import DOOR_POSITION_HIGH, DOOR_POSITION_LOW


def sample_door_position(rng: np.random.Generator) -> NDArray[np.float64]:
    """Draw one door frame position from the task's reset box (paper, section IV-A; RoboHive).

    Args:
        rng: Source of randomness; three numbers are taken from it.

    Returns:
        Position, shape [3], m.
    """
    return rng.uniform(DOOR_POSITION_LOW, DOOR_POSITION_HIGH)


def door_position(seed: int, door: int, episode: int) -> NDArray[np.float64]:
    """Position of the door in episode `episode` (from 0) of door `door`, shape [3], m.

    Raises:
        ValueError: If a number is negative.
    """
    return sample_door_position(episode_rng(seed, door, episode))
